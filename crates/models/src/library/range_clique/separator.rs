//! What a clique shares with the rest of the graph: the positions that its landmark was measured from.

use std::f64::consts::TAU;
use sumprod_graph::MessageError;
use sumprod_messages::{Cholesky, DynamicGaussian, Moments};

/// A Gaussian over the positions, one after the other.
pub(super) struct Separator {
    pub(super) mean: Vec<f64>,
    pub(super) covariance: Vec<f64>,
    /// The inverse of the covariance; both row-major.
    pub(super) information: Vec<f64>,
    /// Log of its largest value.
    pub(super) log_peak: f64,
}

impl Separator {
    /// The marginal of these coordinates.
    ///
    /// # Errors
    ///
    /// Where the message leaves one of them open.
    pub(super) fn new(message: &DynamicGaussian, coordinates: &[usize]) -> Result<Self, MessageError> {
        let Moments { mean: all, covariance: full } = message.moments()?;
        let mean: Vec<f64> = coordinates.iter().map(|&row| all[row]).collect();
        let covariance: Vec<f64> = coordinates
            .iter()
            .flat_map(|&row| coordinates.iter().map(move |&column| (row, column)))
            .map(|(row, column)| full[row * all.len() + column])
            .collect();
        let factor = Cholesky::new(&covariance, mean.len(), "the covariance of the measured positions")?;
        let mut information = vec![0.0; covariance.len()];
        factor.inverse(&mut information);
        let log_peak = -0.5 * (mean.len() as f64 * TAU.ln() + factor.log_determinant());
        Ok(Self { mean, covariance, information, log_peak })
    }

    /// Half the squared Mahalanobis length of `positions` less the mean.
    pub(super) fn half_squared_length(&self, positions: &[f64]) -> f64 {
        let d = self.mean.len();
        let offset = |k: usize| positions[k] - self.mean[k];
        let forces = (0..d).map(|row| {
            let entries = &self.information[row * d..][..d];
            offset(row) * entries.iter().enumerate().map(|(k, a)| a * offset(k)).sum::<f64>()
        });
        0.5 * forces.sum::<f64>()
    }
}
