//! What every family tells the others of a message it holds.

use crate::mixture::{MixtureForm, MixtureMessage};
use crate::{DynamicGaussian, Particles};
use std::sync::Arc;
use sumprod_graph::{Coordinate, MessageError, Quality, Stream};

/// A message as the other families read it: one implementation per family, in that family's file.
pub(super) trait Held {
    /// As a Gaussian, and the divergence (nats) that costs.
    fn to_gaussian(&self) -> Result<(DynamicGaussian, f64), MessageError>;

    /// As at most `count` particles, and the divergence (nats) that costs.
    fn to_particles(
        &self,
        coordinates: &Arc<[Coordinate]>,
        count: usize,
        stream: &mut Stream,
    ) -> Result<(Particles, f64), MessageError>;

    /// As a mixture of this form, and the divergence (nats) that costs.
    fn to_mixture(
        &self,
        coordinates: &[Coordinate],
        form: &MixtureForm,
    ) -> Result<(MixtureMessage, f64), MessageError>;

    /// Log of the message at a point, up to a constant; none where the family cannot be read between its points.
    fn log_value(&self, coordinates: &[Coordinate], point: &[f64]) -> Option<f64>;

    /// Whether it says nothing.
    fn is_vacuous(&self) -> bool;

    /// Whether it is a distribution.
    fn is_distribution(&self) -> bool;

    /// What is known of its quality.
    fn known_quality(&self) -> Quality;
}
