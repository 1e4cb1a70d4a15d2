//! Means and covariances, the form in which answers are read.

use crate::Cholesky;
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};
use sumprod_graph::MessageError;

/// A mean and a covariance (row-major, the square of the mean's length).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Moments {
    /// The mean, in the variable's units.
    pub mean: Vec<f64>,
    /// The covariance, row-major.
    pub covariance: Vec<f64>,
}

impl Moments {
    /// Independent coordinates of these means and variances, one variance a mean.
    pub fn diagonal(mean: &[f64], variances: &[f64]) -> Self {
        let d = mean.len();
        let mut covariance = vec![0.0; d * d];
        for (entry, variance) in covariance.iter_mut().step_by(d + 1).zip(variances) {
            *entry = *variance;
        }
        Self { mean: mean.to_vec(), covariance }
    }

    /// Number of coordinates.
    pub fn dimension(&self) -> usize {
        self.mean.len()
    }

    /// Entry of the covariance.
    pub fn covariance_at(&self, row: usize, column: usize) -> f64 {
        self.covariance[row * self.mean.len() + column]
    }
}

/// Kullback-Leibler divergence KL(p ‖ q) of two Gaussians given by their moments, in nats.
///
/// # Errors
///
/// Where a covariance is not positive definite, or the dimensions differ.
pub fn gaussian_divergence(p: &Moments, q: &Moments) -> Result<f64, MessageError> {
    let d = p.dimension();
    if q.dimension() != d {
        let what = "the second distribution";
        return Err(MessageError::Dimension { what, found: q.dimension(), expected: d });
    }
    let (of_p, of_q) = (
        Cholesky::new(&p.covariance, d, "the covariance of the first distribution")?,
        Cholesky::new(&q.covariance, d, "the covariance of the second distribution")?,
    );
    let mut inverse = vec![0.0; d * d];
    of_q.inverse(&mut inverse);
    let trace: f64 = inverse.iter().zip(&p.covariance).map(|(a, b)| a * b).sum();
    let mut shift: Vec<f64> = p.mean.iter().zip(&q.mean).map(|(a, b)| a - b).collect();
    let distance = of_q.squared_length(&mut shift);
    Ok(0.5 * (trace + distance - d as f64 + of_q.log_determinant() - of_p.log_determinant()))
}

/// The error for an information matrix without an inverse: how many directions it constrains, and one it does not.
pub(crate) fn improper(what: &'static str, information: &[f64], dimension: usize) -> MessageError {
    if let Some(&value) = information.iter().find(|value| !value.is_finite()) {
        return MessageError::NotFinite { what, value };
    }
    let eigen = DMatrix::from_row_slice(dimension, dimension, information).symmetric_eigen();
    let largest = eigen.eigenvalues.amax();
    let rank = eigen.eigenvalues.iter().filter(|&&value| value > 1e-12 * largest).count();
    let (weakest, value) = eigen.eigenvalues.argmin();
    if rank == dimension || value < -1e-9 * largest {
        return MessageError::NotPositiveDefinite { what, pivot: weakest, value };
    }
    let direction = eigen.eigenvectors.column(weakest);
    let terms: Vec<String> = direction
        .iter()
        .enumerate()
        .filter(|(_, share)| share.abs() > 1e-3)
        .map(|(coordinate, share)| format!("{share:+.3} of coordinate {coordinate}"))
        .collect();
    MessageError::Improper { what, rank, dimension, direction: terms.join(" ") }
}
