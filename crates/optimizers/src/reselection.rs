//! Choosing which particles live on: weights in, ancestors out.
//!
//! **Law.** Let w₁ … wₙ be the weights divided by their sum, N the number of ancestors asked for and Cᵢ the number
//! of them that are i. Then
//!
//! 1. Σ Cᵢ = N;
//! 2. E Cᵢ = N wᵢ, so that (1/N) Σ Cᵢ f(xᵢ) has the expectation Σ wᵢ f(xᵢ) for every f;
//! 3. a particle of weight zero is never chosen;
//! 4. only the proportions of the weights matter, not their scale;
//! 5. ancestors come in ascending order, and the same stream yields the same ancestors.
//!
//! What the implementations differ in is the variance that is left:
//!
//! | | Cᵢ lies within | variance of (1/N) Σ Cᵢ f(xᵢ) | source |
//! |---|---|---|---|
//! | [`Multinomial`](crate::Multinomial) | 0 … N | Var_w f / N | Gordon, Salmond, Smith 1993 |
//! | [`Residual`](crate::Residual) | at least ⌊N wᵢ⌋ | at most multinomial's | Liu, Chen 1998 |
//! | [`Stratified`](crate::Stratified) | less than 2 from N wᵢ | at most multinomial's | Kitagawa 1996 |
//! | [`Systematic`](crate::Systematic) | less than 1 from N wᵢ | usually least, but depends on the order of the particles | Carpenter, Clifford, Fearnhead 1999 |
//! | [`Ssp`](crate::Ssp) | less than 1 from N wᵢ | vanishes in any order, since the counts are negatively associated | Gerber, Chopin, Whiteley 2019 |

use sumprod_graph::{FastStream, Space, Stream};
use sumprod_messages::{Particles, Role};

use crate::error::OptimizerError;

/// A way to choose which particles live on. Implementations write [`choose`](Self::choose); see the
/// [module](self) for the law that it keeps.
pub trait Reselection: Send + Sync {
    /// Chooses `count` ancestors, in ascending order.
    ///
    /// `shares` are finite, not negative, and sum to one up to rounding; `count` is at least one.
    fn choose(&self, shares: &[f64], count: usize, random: &mut FastStream) -> Vec<usize>;

    /// Indices of `count` ancestors, in ascending order; `weights` may have any scale.
    ///
    /// O(n + `count`) for n weights.
    ///
    /// # Errors
    ///
    /// Where `count` or the number of weights is zero, a weight is negative or not finite, or no weight is
    /// positive.
    fn ancestors(
        &self,
        weights: &[f64],
        count: usize,
        stream: &mut Stream,
    ) -> Result<Vec<usize>, OptimizerError> {
        let shares = shares(weights)?;
        if count == 0 {
            return Err(OptimizerError::Empty { what: "the number of particles to choose" });
        }
        Ok(self.choose(&shares, count, &mut stream.fast()))
    }

    /// `count` equally weighted particles for the same distribution.
    ///
    /// # Errors
    ///
    /// As [`ancestors`](Self::ancestors), and where the particles hold a likelihood.
    fn reselect(
        &self,
        particles: &Particles,
        count: usize,
        stream: &mut Stream,
    ) -> Result<Particles, OptimizerError> {
        if particles.role() == Role::Likelihood {
            return Err(OptimizerError::Likelihood);
        }
        let ancestors = self.ancestors(&particles.weights(), count, stream)?;
        let mut points = Vec::with_capacity(count * particles.dimension());
        for ancestor in ancestors {
            points.extend_from_slice(particles.point(ancestor));
        }
        let space = Space::new(particles.coordinates());
        Ok(Particles::equally_weighted(&space, points)?)
    }
}

/// The weights divided by their sum.
fn shares(weights: &[f64]) -> Result<Vec<f64>, OptimizerError> {
    if weights.is_empty() {
        return Err(OptimizerError::Empty { what: "the number of weights" });
    }
    if let Some(index) = weights.iter().position(|weight| !(weight.is_finite() && *weight >= 0.0)) {
        return Err(OptimizerError::Weight { index, value: weights[index] });
    }
    // Divided by the largest first, so that neither huge nor tiny weights leave the range of the sum.
    let largest = weights.iter().copied().fold(0.0, f64::max);
    if largest == 0.0 {
        return Err(OptimizerError::Total { total: 0.0 });
    }
    let mut shares: Vec<f64> = weights.iter().map(|weight| weight / largest).collect();
    let total: f64 = shares.iter().sum();
    shares.iter_mut().for_each(|share| *share /= total);
    Ok(shares)
}

/// The index whose stretch of the cumulative shares each target falls into; targets ascend within [0, 1).
pub(crate) fn invert(shares: &[f64], targets: impl Iterator<Item = f64>) -> Vec<usize> {
    // Where rounding leaves the sum of the shares below the last target, the last positive share takes it.
    let last = shares.iter().rposition(|&share| share > 0.0).unwrap_or(0);
    let (mut index, mut reached) = (0, shares.first().copied().unwrap_or(0.0));
    targets
        .map(|target| {
            while target >= reached && index < last {
                index += 1;
                reached += shares[index];
            }
            index
        })
        .collect()
}

/// The whole copies and the fraction of one more that a share of `count` expects.
pub(crate) fn split(share: f64, count: usize) -> (usize, f64) {
    // Equal weights do not divide to exactly 1/n: what is whole but for rounding counts as whole.
    const ROUNDING: f64 = 1e-12;
    let expected = share * count as f64;
    let nearest = expected.round();
    if (expected - nearest).abs() <= ROUNDING * expected {
        return (nearest as usize, 0.0);
    }
    (expected as usize, expected.fract())
}

/// Ancestors from the number of each.
pub(crate) fn repeat(counts: &[usize]) -> Vec<usize> {
    counts.iter().enumerate().flat_map(|(index, &count)| std::iter::repeat_n(index, count)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Scheme, Systematic};
    use sumprod_graph::Purpose;

    fn stream(entity: u64) -> Stream {
        Stream::new(5, 0, Purpose::Optimizer, entity)
    }

    #[test]
    fn wrong_weights_are_refused_with_their_numbers() {
        let refuse =
            |weights: &[f64], count| Systematic.ancestors(weights, count, &mut stream(0)).unwrap_err();
        assert_eq!(refuse(&[1.0, -2.0], 3), OptimizerError::Weight { index: 1, value: -2.0 });
        assert!(refuse(&[1.0, f64::NAN], 3).to_string().starts_with("weight 1 is NaN"));
        assert!(refuse(&[f64::INFINITY], 3).to_string().starts_with("weight 0 is inf"));
        assert_eq!(refuse(&[0.0, 0.0], 3), OptimizerError::Total { total: 0.0 });
        assert!(refuse(&[], 3).to_string().contains("the number of weights is 0"));
        assert!(refuse(&[1.0], 0).to_string().contains("the number of particles to choose is 0"));
    }

    #[test]
    fn huge_and_tiny_weights_keep_their_proportions() {
        for scheme in Scheme::ALL {
            for scale in [f64::MAX, f64::MIN_POSITIVE] {
                let ancestors = scheme.ancestors(&[scale, 0.0, scale], 1000, &mut stream(1)).unwrap();
                let first = ancestors.iter().filter(|&&ancestor| ancestor == 0).count();
                assert!(!ancestors.contains(&1));
                assert!((first as i64 - 500).abs() < 100, "{scheme:?} {first}");
            }
        }
    }

    #[test]
    fn particles_come_out_equally_weighted_on_the_chosen_points() {
        let points = vec![0.0, 0.1, 1.0, 1.1, 2.0, 2.1];
        let log_weights = [0.5_f64, 0.25, 0.25].map(f64::ln).to_vec();
        let particles = Particles::new(&Space::real(2), points, log_weights).unwrap();
        let chosen = Systematic.reselect(&particles, 8, &mut stream(2)).unwrap();
        assert_eq!((chosen.len(), chosen.dimension()), (8, 2));
        assert!((chosen.effective_sample_size() - 8.0).abs() < 1e-12);
        let firsts = (0..8).filter(|&index| chosen.point(index) == [0.0, 0.1]).count();
        assert_eq!(firsts, 4);
        let likelihood = Particles::likelihood(&particles, vec![0.0; 3]).unwrap();
        let error = Systematic.reselect(&likelihood, 8, &mut stream(2)).unwrap_err();
        assert_eq!(error, OptimizerError::Likelihood);
    }

    #[test]
    fn inversion_gives_what_rounding_leaves_to_the_last_positive_share() {
        assert_eq!(invert(&[0.5, 0.5 - 1e-12, 0.0], [0.25, 0.75, 1.0 - 1e-16].into_iter()), [0, 1, 1]);
        assert_eq!(invert(&[0.0, 1.0], [0.0].into_iter()), [1]);
    }
}
