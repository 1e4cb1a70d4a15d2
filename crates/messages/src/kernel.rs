//! Gaussian kernels on particles, for messages that are carried by different points.

use crate::particles::Particles;
use crate::{Cholesky, Moments};
use smallvec::SmallVec;
use std::f64::consts::TAU;
use sumprod_graph::MessageError;

/// A Gaussian kernel with the shape of a sample's covariance.
pub(crate) struct Kernel {
    shape: Cholesky,
    log_normaliser: f64,
}

impl Kernel {
    /// Silverman's rule with the sample's own covariance P: kernel covariance h²P, h = (4 / (n (d + 2)))^(1/(d+4)),
    /// n the effective sample size (Silverman 1986, section 4.3).
    pub(crate) fn silverman(sample: &Particles) -> Result<Self, MessageError> {
        let Moments { mut covariance, mean } = sample.moments();
        let d = mean.len();
        let dimension = d as f64;
        let n = sample.effective_sample_size();
        let h = (4.0 / (n * (dimension + 2.0))).powf(1.0 / (dimension + 4.0));
        floor_diagonal(&mut covariance, d);
        covariance.iter_mut().for_each(|entry| *entry *= h * h);
        let shape = Cholesky::new(&covariance, d, "the kernel's covariance")?;
        let log_normaliser = -0.5 * (dimension * TAU.ln() + shape.log_determinant());
        Ok(Self { shape, log_normaliser })
    }

    fn log_kernel(&self, sample: &Particles, index: usize, point: &[f64]) -> f64 {
        let mut offset: SmallVec<[f64; 6]> = SmallVec::from_elem(0.0, point.len());
        sample.offset(point, sample.point(index), &mut offset);
        -0.5 * self.shape.squared_length(&mut offset)
    }

    /// Log of Σᵢ wᵢ N(x; xᵢ, h²P) for a sample.
    pub(crate) fn log_density(&self, sample: &Particles, point: &[f64]) -> f64 {
        let terms = (0..sample.len()).map(|i| sample.log_weights[i] + self.log_kernel(sample, i, point));
        self.log_normaliser + log_sum(terms)
    }
}

/// Kernel regression (Nadaraya 1964, Watson 1964) of a likelihood known at its points.
pub(crate) fn regression(kernel: &Kernel, likelihood: &Particles, point: &[f64]) -> f64 {
    let logs = (0..likelihood.len()).map(|i| kernel.log_kernel(likelihood, i, point));
    let values = logs.clone().zip(&likelihood.log_weights).map(|(log, value)| log + value);
    log_sum(values) - log_sum(logs)
}

/// Log of a sum of exponentials, minus infinity for an empty one.
pub(crate) fn log_sum(terms: impl Iterator<Item = f64> + Clone) -> f64 {
    let largest = terms.clone().fold(f64::NEG_INFINITY, f64::max);
    if largest == f64::NEG_INFINITY {
        return largest;
    }
    largest + terms.map(|term| (term - largest).exp()).sum::<f64>().ln()
}

/// Keeps the covariance of a collapsed sample invertible: a relative floor on its diagonal, absolute at zero.
pub fn floor_diagonal(covariance: &mut [f64], dimension: usize) {
    for k in 0..dimension {
        let entry = &mut covariance[k * dimension + k];
        *entry += 1e-9 * *entry + 1e-12;
    }
}
