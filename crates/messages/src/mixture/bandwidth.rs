//! Kernel densities from particles, and rules for how wide their kernels are.

use super::Mixture;
use super::small::{Small, difference, whitener};
use crate::kernel::floor_diagonal;
use crate::vector::exponentials;
use crate::vector::log_sum;
use crate::{Moments, Particles, Role};
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;
use sumprod_graph::MessageError;

/// How the covariance of a kernel density's kernels is chosen.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Bandwidth {
    /// h²P with P the sample's own covariance and h = (4 / (n (d + 2)))^(1 / (d + 4)), n its effective size: best
    /// for a Gaussian, too wide for anything with several modes (Silverman 1986, section 4.3).
    #[default]
    Silverman,
    /// Silverman's covariance times this factor squared.
    Scaled(f64),
    /// The h for which the sample predicts itself best, each point by the others: maximises the leave-one-out
    /// likelihood Σᵢ wᵢ ln Σⱼ≠ᵢ wⱼ N(xᵢ; xⱼ, h²P) (Duin 1976, "On the choice of smoothing parameters for Parzen
    /// estimators"). O(n²), on at most 400 of the points.
    LeaveOneOut,
    /// This covariance, row-major: where the kernel is known, as that of a transition or a measurement is.
    Known(Vec<f64>),
}

/// Points that the leave-one-out likelihood is computed on.
const POINTS: usize = 400;

impl Mixture {
    /// A kernel on every particle.
    ///
    /// # Errors
    ///
    /// Where there is no particle, they are the values of a likelihood, or the kernel is not positive definite.
    pub fn from_particles(particles: &Particles, bandwidth: &Bandwidth) -> Result<Self, MessageError> {
        let space = sumprod_graph::Space::new(particles.coordinates());
        if particles.is_empty() {
            return Err(MessageError::Unsupported("a kernel density needs at least one particle".into()));
        }
        if particles.role() == Role::Likelihood {
            let reason =
                "the values of a likelihood have no kernel density; multiply them onto a sample first";
            return Err(MessageError::Unsupported(reason.into()));
        }
        let kernel = match bandwidth {
            Bandwidth::Known(covariance) => covariance.clone(),
            Bandwidth::Silverman => silverman(particles, 1.0),
            Bandwidth::Scaled(factor) if *factor > 0.0 && factor.is_finite() => silverman(particles, *factor),
            Bandwidth::Scaled(factor) => {
                let reason = format!("the factor of a kernel's width is {factor}; it must be positive");
                return Err(MessageError::Unsupported(reason));
            }
            Bandwidth::LeaveOneOut => silverman(particles, leave_one_out(particles)?),
        };
        let log_weights = particles.log_weights().to_vec();
        Self::with_shared_covariance(&space, log_weights, particles.points().to_vec(), kernel)
    }
}

fn silverman(particles: &Particles, factor: f64) -> Vec<f64> {
    let Moments { mut covariance, mean } = particles.moments();
    let d = mean.len() as f64;
    let n = particles.effective_sample_size();
    let h = factor * (4.0 / (n * (d + 2.0))).powf(1.0 / (d + 4.0));
    floor_diagonal(&mut covariance, mean.len());
    covariance.iter_mut().for_each(|entry| *entry *= h * h);
    covariance
}

/// The best factor on Silverman's width, by golden section in its logarithm between 1/100 and 3.
fn leave_one_out(particles: &Particles) -> Result<f64, MessageError> {
    let d = particles.dimension();
    let reference = silverman(particles, 1.0);
    let (matrix, log_determinant) = match whitener(&reference, d) {
        Some(found) => found,
        None => {
            crate::Cholesky::new(&reference, d, "the sample's covariance")?;
            return Ok(1.0);
        }
    };
    let stride = particles.len().div_ceil(POINTS);
    let chosen: Vec<usize> = (0..particles.len()).step_by(stride).collect();
    let logs: Vec<f64> = chosen.iter().map(|&i| particles.log_weights()[i]).collect();
    let n = chosen.len();
    let mut squares = vec![0.0; n * (n.saturating_sub(1)) / 2];
    let mut offset = Small::from_elem(0.0, d);
    let mut next = squares.iter_mut();
    for (position, &i) in chosen.iter().enumerate() {
        for &j in &chosen[..position] {
            difference(particles.coordinates(), particles.point(i), particles.point(j), &mut offset);
            let squared: f64 = (0..d)
                .map(|row| (0..=row).map(|k| matrix[row * d + k] * offset[k]).sum::<f64>().powi(2))
                .sum();
            if let Some(square) = next.next() {
                *square = squared;
            }
        }
    }
    let weights: Vec<f64> = logs.iter().map(|log| log.exp()).collect();
    let total = log_sum(&logs).exp();
    let (mut halves, mut kernels) = (vec![0.0; squares.len()], Vec::new());
    let mut likelihood = |log_factor: f64| -> f64 {
        let half = -0.5 * (-2.0 * log_factor).exp();
        let constant = -0.5 * (d as f64 * TAU.ln() + log_determinant) - d as f64 * log_factor;
        halves.iter_mut().zip(&squares).for_each(|(out, square)| *out = half * square);
        exponentials(&halves, 0.0, &mut kernels);
        let mut sums = vec![0.0; n];
        let mut rest = kernels.as_slice();
        for i in 0..n {
            let (row, after) = rest.split_at(i);
            rest = after;
            let mut own = 0.0;
            for ((kernel, sum), weight) in row.iter().zip(&mut sums).zip(&weights) {
                own += weight * kernel;
                *sum += weights[i] * kernel;
            }
            sums[i] += own;
        }
        let log = |(sum, weight): (&f64, &f64)| {
            // A point alone within 38 widths counts as if it were just there, so that the criterion stays finite.
            weight * ((sum / (total - weight).max(f64::MIN_POSITIVE)).max(1e-300).ln() + constant)
        };
        sums.iter().zip(&weights).map(log).sum()
    };
    // Fewer points than there are have a wider best width: h ∝ n^(-1 / (d + 4)).
    let scale = (1.0 / stride as f64).powf(1.0 / (d as f64 + 4.0));
    let ratio = 0.5 * (5.0f64.sqrt() - 1.0);
    let (mut low, mut high) = (0.01f64.ln(), 3.0f64.ln());
    let (mut a, mut b) = (high - ratio * (high - low), low + ratio * (high - low));
    let (mut at_a, mut at_b) = (likelihood(a), likelihood(b));
    while high - low > 0.02 {
        if at_a > at_b {
            (high, b, at_b) = (b, a, at_a);
            a = high - ratio * (high - low);
            at_a = likelihood(a);
        } else {
            (low, a, at_a) = (a, b, at_b);
            b = low + ratio * (high - low);
            at_b = likelihood(b);
        }
    }
    Ok((0.5 * (low + high)).exp() * scale)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_distr::{Distribution, StandardNormal};
    use sumprod_graph::{Coordinate, Purpose, Space, Stream};

    fn normals(count: usize, seed: u64) -> Vec<f64> {
        let mut random = Stream::new(seed, 0, Purpose::User(3), 0).fast();
        (0..count).map(|_| StandardNormal.sample(&mut random)).collect()
    }

    #[test]
    fn silverman_has_the_shape_of_the_sample() {
        let points: Vec<f64> =
            normals(2000, 1).chunks(2).flat_map(|z| [3.0 * z[0], z[0] + 0.5 * z[1]]).collect();
        let particles = Particles::equally_weighted(&Space::real(2), points).unwrap();
        let mixture = Mixture::from_particles(&particles, &Bandwidth::Silverman).unwrap();
        let (kernel, covariance) = (mixture.shared_covariance().unwrap(), particles.moments().covariance);
        for (a, b) in kernel.iter().zip(&covariance) {
            assert!((a / b - 0.1).abs() < 1e-6, "n = 1000, d = 2: h² = n^(-1/3)");
        }
    }

    #[test]
    fn leave_one_out_is_near_silverman_for_a_gaussian_and_narrow_for_two_modes() {
        let width = |points: Vec<f64>| {
            let particles = Particles::equally_weighted(&Space::real(1), points).unwrap();
            let best = Mixture::from_particles(&particles, &Bandwidth::LeaveOneOut).unwrap();
            let rule = Mixture::from_particles(&particles, &Bandwidth::Silverman).unwrap();
            (best.covariance_of(0)[0] / rule.covariance_of(0)[0]).sqrt()
        };
        let one = width(normals(500, 2));
        assert!((0.5..1.5).contains(&one), "{one}");
        let two = normals(500, 3)
            .into_iter()
            .enumerate()
            .map(|(i, z)| if i % 2 == 0 { z - 10.0 } else { z + 10.0 });
        let two = width(two.collect());
        assert!(two < 0.2, "{two}");
    }

    #[test]
    fn angles_are_measured_across_the_cut() {
        let points: Vec<f64> = normals(400, 4).iter().map(|z| std::f64::consts::PI + 0.1 * z).collect();
        let particles = Particles::equally_weighted(&Space::new([Coordinate::Angle]), points).unwrap();
        let mixture = Mixture::from_particles(&particles, &Bandwidth::LeaveOneOut).unwrap();
        assert!(mixture.covariance_of(0)[0] < 0.01);
        let (near, far) = (mixture.log_density(&[-3.1]).unwrap(), mixture.log_density(&[0.0]).unwrap());
        assert!(near > 0.0 && far < -20.0);
    }

    #[test]
    fn one_particle_and_bad_factors() {
        let one = Particles::equally_weighted(&Space::real(2), vec![1.0, 2.0]).unwrap();
        for rule in [Bandwidth::Silverman, Bandwidth::LeaveOneOut] {
            let mixture = Mixture::from_particles(&one, &rule).unwrap();
            assert_eq!(mixture.mean_of(0), [1.0, 2.0]);
        }
        assert!(Mixture::from_particles(&one, &Bandwidth::Scaled(0.0)).is_err());
        assert!(Mixture::from_particles(&one, &Bandwidth::Known(vec![1.0, 2.0, 2.0, 1.0])).is_err());
    }
}
