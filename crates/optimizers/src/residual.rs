//! Residual reselection: ⌊N wᵢ⌋ copies for certain, the rest drawn.
//!
//! Source: Liu, Chen, "Sequential Monte Carlo methods for dynamic systems" (1998).

use sumprod_graph::FastStream;

use crate::multinomial::sorted_uniforms;
use crate::reselection::{Reselection, invert, repeat, split};

/// ⌊N wᵢ⌋ copies of each for certain; the others are multinomial draws by what the weights leave over.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Residual;

impl Reselection for Residual {
    fn choose(&self, shares: &[f64], count: usize, random: &mut FastStream) -> Vec<usize> {
        let (mut counts, mut over): (Vec<usize>, Vec<f64>) =
            shares.iter().map(|&share| split(share, count)).unzip();
        let certain: usize = counts.iter().sum();
        let missing = count.saturating_sub(certain);
        if missing > 0 {
            let total: f64 = over.iter().sum();
            over.iter_mut().for_each(|share| *share /= total);
            for index in invert(&over, sorted_uniforms(missing, random).into_iter()) {
                counts[index] += 1;
            }
        }
        repeat(&counts)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sumprod_graph::{Purpose, Stream};

    #[test]
    fn the_certain_copies_are_always_there() {
        let shares = [0.55, 0.3, 0.15];
        for entity in 0..200 {
            let mut random = Stream::new(2, 0, Purpose::Optimizer, entity).fast();
            let chosen = Residual.choose(&shares, 10, &mut random);
            for (index, certain) in [5, 3, 1].into_iter().enumerate() {
                assert!(chosen.iter().filter(|&&ancestor| ancestor == index).count() >= certain);
            }
        }
    }
}
