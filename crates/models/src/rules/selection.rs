//! Systematic selection of a message's particles.

use crate::cloud::{self, BLOCK, Selection};
use rand::RngExt;
use sumprod_graph::FastStream;
use sumprod_messages::vector;

/// Systematic selection of `count` indices in proportion to exp(log weight); nondecreasing.
pub(crate) fn select(log_weights: &[f64], count: usize, random: &mut FastStream) -> Vec<u32> {
    let largest = log_weights.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let mut weights = Vec::new();
    vector::exponentials(log_weights, largest, &mut weights);
    let totals: Vec<f64> = weights.chunks(BLOCK).map(|block| block.iter().sum()).collect();
    let scales = vec![1.0; totals.len()];
    let mut chosen = vec![0; count];
    let selection = Selection { weights: &weights, scales: &scales, totals: &totals };
    cloud::select(selection, random.random(), false, &mut chosen);
    chosen
}

#[cfg(test)]
mod tests {
    use super::*;
    use sumprod_graph::{Purpose, Stream};

    fn random(entity: u64) -> FastStream {
        Stream::new(3, 0, Purpose::User(3), entity).fast()
    }

    /// Systematic selection copies each particle ⌊N w⌋ or ⌈N w⌉ times, in order, and none of weight zero.
    #[test]
    fn selection_is_systematic() {
        for entity in 0..200 {
            let mut draws = random(entity);
            let mut logs: Vec<f64> = (0..50).map(|_| 40.0 - 6.0 * draws.random::<f64>()).collect();
            (logs[0], logs[7], logs[49]) = (f64::NEG_INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY);
            let total: f64 = logs.iter().map(|log| log.exp()).sum();
            for count in [1, 7, 50, 1000] {
                let chosen = select(&logs, count, &mut draws);
                assert_eq!(chosen.len(), count);
                assert!(chosen.is_sorted());
                for (index, log) in logs.iter().enumerate() {
                    let copies = chosen.iter().filter(|&&other| other as usize == index).count();
                    let expected = count as f64 * log.exp() / total;
                    assert!((copies as f64 - expected).abs() < 1.0 + 1e-9, "{copies} for {expected}");
                    assert!(expected > 0.0 || copies == 0);
                }
            }
        }
        assert!(select(&[0.0; 3], 0, &mut random(0)).is_empty());
    }

    /// Over 4,000 selections of 3, the mean number of copies is 3 w within 4.5 standard errors of at most
    /// ½ / √4000: wrong with probability below 4e-5.
    #[test]
    fn selection_is_unbiased() {
        let weights: [f64; 4] = [0.05, 0.4, 0.22, 0.33];
        let logs = weights.map(f64::ln);
        let mut copies = [0.0; 4];
        let mut draws = random(1000);
        for _ in 0..4000 {
            for index in select(&logs, 3, &mut draws) {
                copies[index as usize] += 1.0 / 4000.0;
            }
        }
        for (copies, weight) in copies.iter().zip(weights) {
            assert!((copies - 3.0 * weight).abs() < 4.5 * 0.5 / 4000.0_f64.sqrt(), "{copies} {weight}");
        }
    }
}
