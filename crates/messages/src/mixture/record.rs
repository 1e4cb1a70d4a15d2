//! How mixtures are written, and checked again where they are read.

use super::Mixture;
use serde::{Deserialize, Serialize};
use sumprod_graph::{Coordinate, MessageError, Space};

/// A mixture as it is written.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct MixtureRecord {
    coordinates: Vec<Coordinate>,
    log_weights: Vec<f64>,
    means: Vec<f64>,
    covariances: Vec<f64>,
    shared: bool,
}

impl From<Mixture> for MixtureRecord {
    fn from(mixture: Mixture) -> Self {
        let Mixture { coordinates, log_weights, means, covariances, shared } = mixture;
        Self { coordinates, log_weights, means, covariances, shared }
    }
}

impl TryFrom<MixtureRecord> for Mixture {
    type Error = MessageError;

    fn try_from(record: MixtureRecord) -> Result<Self, MessageError> {
        let MixtureRecord { coordinates, log_weights, means, covariances, shared } = record;
        let written = log_weights.clone();
        let space = Space::new(coordinates);
        let mut mixture = Self::checked(&space, log_weights, means, covariances, shared)?;
        // Normalised numbers are kept to the bit: normalising them again would move the last digit.
        let total: f64 = written.iter().map(|log| log.exp()).sum();
        if written.len() == mixture.len() && (total - 1.0).abs() < 1e-9 {
            mixture.log_weights = written;
        }
        Ok(mixture)
    }
}
