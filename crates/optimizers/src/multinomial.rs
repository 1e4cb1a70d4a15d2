//! Multinomial reselection: independent draws with replacement.
//!
//! Source: Gordon, Salmond, Smith, "Novel approach to nonlinear/non-Gaussian Bayesian state estimation" (1993).

use rand::RngExt;
use sumprod_graph::FastStream;

use crate::reselection::{Reselection, invert};

/// Independent draws with replacement: the counts are multinomial.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Multinomial;

impl Reselection for Multinomial {
    fn choose(&self, shares: &[f64], count: usize, random: &mut FastStream) -> Vec<usize> {
        invert(shares, sorted_uniforms(count, random).into_iter())
    }
}

/// Ordered independent uniform draws from [0, 1), in linear time: partial sums of exponential spacings divided by
/// the sum of one spacing more.
pub(crate) fn sorted_uniforms(count: usize, random: &mut FastStream) -> Vec<f64> {
    let mut reached = 0.0;
    let mut spacing = || -(1.0 - random.random::<f64>()).ln();
    let mut sums: Vec<f64> = Vec::with_capacity(count);
    for _ in 0..count {
        reached += spacing();
        sums.push(reached);
    }
    let total = reached + spacing();
    sums.iter_mut().for_each(|sum| *sum /= total);
    sums
}

#[cfg(test)]
mod tests {
    use super::*;
    use sumprod_graph::{Purpose, Stream};

    #[test]
    fn sorted_uniforms_have_the_moments_of_order_statistics() {
        // The k-th of n has mean k/(n + 1); 20,000 draws, bound 5 standard errors: error probability 6e-7 each.
        let (n, draws) = (4, 20_000);
        let mut random = Stream::new(1, 0, Purpose::Optimizer, 0).fast();
        let mut sums = vec![0.0; n];
        for _ in 0..draws {
            let uniforms = sorted_uniforms(n, &mut random);
            assert!(uniforms.is_sorted() && uniforms.iter().all(|u| (0.0..=1.0).contains(u)));
            sums.iter_mut().zip(&uniforms).for_each(|(sum, u)| *sum += u);
        }
        for (k, sum) in sums.iter().enumerate() {
            let (a, b) = (k as f64 + 1.0, (n - k) as f64);
            let deviation = (a * b / ((a + b).powi(2) * (a + b + 1.0))).sqrt();
            let error = sum / f64::from(draws) - a / (n as f64 + 1.0);
            assert!(error.abs() < 5.0 * deviation / f64::from(draws).sqrt(), "{k}: {error}");
        }
    }
}
