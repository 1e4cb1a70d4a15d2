//! Mixtures among the other families.

use super::convert::drawn_from_gaussians;
use super::held::Held;
use super::{AnyMessage, AnyValue};
use crate::mixture::{MixtureFamily, MixtureForm, MixtureMessage};
use crate::{DynamicGaussian, Particles};
use std::sync::Arc;
use sumprod_graph::{Coordinate, Message, MessageError, Messages, Quality, Stream};

impl Held for MixtureMessage {
    fn to_gaussian(&self) -> Result<(DynamicGaussian, f64), MessageError> {
        Self::to_gaussian(self)
    }

    fn to_particles(
        &self,
        coordinates: &Arc<[Coordinate]>,
        count: usize,
        stream: &mut Stream,
    ) -> Result<(Particles, f64), MessageError> {
        if let Some(gaussian) = self.potential().and_then(crate::mixture::Potential::as_gaussian) {
            return drawn_from_gaussians(&gaussian, coordinates, count, stream);
        }
        Self::to_particles(self, count, stream)
    }

    fn to_mixture(
        &self,
        _coordinates: &[Coordinate],
        form: &MixtureForm,
    ) -> Result<(MixtureMessage, f64), MessageError> {
        let before = self.loss().unwrap_or(0.0);
        let (read, after) = self.read_mixture(form)?;
        Ok((read, after - before))
    }

    fn to_marginal(
        &self,
        _coordinates: &[Coordinate],
        read: &[usize],
        form: &MixtureForm,
    ) -> Result<Option<(MixtureMessage, f64)>, MessageError> {
        let before = self.loss().unwrap_or(0.0);
        Ok(self.read_marginal(read, form)?.map(|(read, after)| (read, after - before)))
    }

    fn add_logs(
        &self,
        _: &[Coordinate],
        points: &[f64],
        power: f64,
        logs: &mut [f64],
    ) -> Result<(), MessageError> {
        let mut own = vec![0.0; logs.len()];
        self.log_values(points, &mut own)?;
        logs.iter_mut().zip(&own).for_each(|(log, own)| *log += power * own);
        Ok(())
    }

    fn is_vacuous(&self) -> bool {
        self.is_flat()
    }

    fn is_distribution(&self) -> bool {
        Message::is_proper(self)
    }

    fn known_quality(&self) -> Quality {
        Message::quality(self)
    }
}

/// The product held as a mixture: every message is read as one.
pub(super) fn product(
    incoming: Messages<'_, AnyMessage>,
    form: &MixtureForm,
    stream: &mut Stream,
    out: &mut AnyMessage,
) -> Result<(), MessageError> {
    let mut loss = 0.0;
    let mut read = Vec::with_capacity(incoming.len());
    for message in incoming.iter() {
        let (mixture, cost) = message.value.held().to_mixture(&out.coordinates, form)?;
        loss += cost;
        read.push(mixture);
    }
    let edges: Vec<u32> = (0..read.len() as u32).collect();
    out.value = AnyValue::Mixture(MixtureMessage::product(Messages::new(&read, &edges), form, stream)?);
    out.lose(loss);
    Ok(())
}
