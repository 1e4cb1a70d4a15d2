//! A prior on a variable.

use super::checks::{finite, size};
use crate::{Noise, Real, Residual};
use sumprod_graph::{MessageError, Space};

/// x ~ N(mean, R), or Student-t, angles wrapped: r(x) = x - mean.
#[derive(Clone, Debug)]
pub struct Prior {
    mean: Vec<f64>,
    angles: Vec<usize>,
    noise: Noise,
    dimensions: [usize; 1],
}

impl Prior {
    /// A prior on a variable of this space.
    ///
    /// # Errors
    ///
    /// Where the mean is not finite, or the mean or the noise have not as many components as the space.
    pub fn new(space: &Space, mean: &[f64], noise: Noise) -> Result<Self, MessageError> {
        finite("the mean of the prior", mean)?;
        size("the mean of the prior", mean.len(), space.dimension())?;
        size("the noise of the prior", noise.dimension(), space.dimension())?;
        let angles = (0..mean.len()).filter(|&index| space.is_angle(index)).collect();
        Ok(Self { mean: mean.to_vec(), angles, noise, dimensions: [mean.len()] })
    }
}

impl Residual for Prior {
    fn dimensions(&self) -> &[usize] {
        &self.dimensions
    }

    fn noise(&self) -> &Noise {
        &self.noise
    }

    fn residual<T: Real>(&self, x: &[&[T]], out: &mut [T]) {
        for ((out, x), mean) in out.iter_mut().zip(x[0]).zip(&self.mean) {
            *out = *x - *mean;
        }
    }

    fn angles(&self) -> &[usize] {
        &self.angles
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_prior_that_does_not_fit_its_space_is_refused() {
        let error = |mean: &[f64], components| {
            let noise = Noise::isotropic(components, 1.0).unwrap();
            Prior::new(&Space::pose2(), mean, noise).err()
        };
        assert_eq!(error(&[1.0, 2.0, 3.0], 3), None);
        for (mean, components, what, found) in [
            (&[1.0, 2.0][..], 3, "the mean of the prior", 2),
            (&[0.0; 4], 3, "the mean of the prior", 4),
            (&[0.0; 3], 2, "the noise of the prior", 2),
        ] {
            let expected = Some(MessageError::Dimension { what, found, expected: 3 });
            assert_eq!(error(mean, components), expected);
        }
        let infinite = MessageError::NotFinite { what: "the mean of the prior", value: f64::INFINITY };
        assert_eq!(error(&[0.0, f64::INFINITY, 0.0], 3), Some(infinite));
    }
}
