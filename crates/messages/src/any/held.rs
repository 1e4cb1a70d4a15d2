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

    /// The same on the coordinates `read` alone; none where the others cannot be summed out.
    fn to_marginal(
        &self,
        coordinates: &[Coordinate],
        read: &[usize],
        form: &MixtureForm,
    ) -> Result<Option<(MixtureMessage, f64)>, MessageError>;

    /// Adds `power` times the log of the message at every point (point by point) to `logs`, up to a constant; nothing
    /// where the family cannot be read between its points.
    fn add_logs(
        &self,
        coordinates: &[Coordinate],
        points: &[f64],
        power: f64,
        logs: &mut [f64],
    ) -> Result<(), MessageError>;

    /// Whether it says nothing.
    fn is_vacuous(&self) -> bool;

    /// Whether it is a distribution.
    fn is_distribution(&self) -> bool;

    /// What is known of its quality.
    fn known_quality(&self) -> Quality;
}
