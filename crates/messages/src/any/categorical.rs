//! States among the other families: they mix with no other, and are part of graphs whose factors join both kinds.

use super::held::Held;
use super::{AnyForm, AnyMessage, AnyValue};
use crate::categorical::{Categorical, CategoricalFamily, CategoricalForm};
use crate::mixture::{MixtureForm, MixtureMessage};
use crate::{DynamicGaussian, Particles};
use std::sync::Arc;
use sumprod_graph::{Coordinate, Message, MessageError, Messages, Quality, Stream};

fn no_coordinates() -> MessageError {
    MessageError::Unsupported("a message over finitely many states has no place among coordinates".into())
}

impl Held for Categorical {
    fn to_gaussian(&self) -> Result<(DynamicGaussian, f64), MessageError> {
        Err(no_coordinates())
    }

    fn to_particles(
        &self,
        _coordinates: &Arc<[Coordinate]>,
        _count: usize,
        _stream: &mut Stream,
    ) -> Result<(Particles, f64), MessageError> {
        Err(no_coordinates())
    }

    fn to_mixture(
        &self,
        _coordinates: &[Coordinate],
        _form: &MixtureForm,
    ) -> Result<(MixtureMessage, f64), MessageError> {
        Err(no_coordinates())
    }

    fn to_marginal(
        &self,
        _coordinates: &[Coordinate],
        _read: &[usize],
        _form: &MixtureForm,
    ) -> Result<Option<(MixtureMessage, f64)>, MessageError> {
        Err(no_coordinates())
    }

    fn add_logs(
        &self,
        _coordinates: &[Coordinate],
        _points: &[f64],
        _power: f64,
        _logs: &mut [f64],
    ) -> Result<(), MessageError> {
        Err(no_coordinates())
    }

    fn is_vacuous(&self) -> bool {
        Self::is_vacuous(self)
    }

    fn is_distribution(&self) -> bool {
        Message::is_proper(self)
    }

    fn known_quality(&self) -> Quality {
        Message::quality(self)
    }
}

/// The product of messages that all hold states.
pub(super) fn product(
    incoming: Messages<'_, AnyMessage>,
    form: &CategoricalForm,
    stream: &mut Stream,
    out: &mut AnyMessage,
) -> Result<(), MessageError> {
    let states: Option<Vec<Categorical>> = incoming.iter().map(|m| m.categorical().cloned()).collect();
    let Some(states) = states else {
        let reason = "messages over finitely many states multiply no others";
        return Err(MessageError::Unsupported(reason.into()));
    };
    let edges: Vec<u32> = (0..states.len() as u32).collect();
    out.value = AnyValue::Categorical(Categorical::product(Messages::new(&states, &edges), form, stream)?);
    Ok(())
}

impl CategoricalFamily for AnyMessage {
    fn categorical_form(form: &AnyForm) -> Option<CategoricalForm> {
        match form {
            AnyForm::Categorical(form) => Some(*form),
            _ => None,
        }
    }

    fn states(&self) -> usize {
        self.categorical().map_or(0, Categorical::states)
    }

    fn read_logs(&self, logs: &mut [f64]) {
        if let Some(states) = self.categorical() {
            states.read_logs(logs);
        }
    }

    fn write_logs(&mut self, _like: &Self, logs: &[f64]) -> Result<(), MessageError> {
        if let AnyValue::Categorical(states) = &mut self.value {
            states.write_logs(&Categorical::default(), logs)?;
        } else {
            self.value = AnyValue::Categorical(Categorical::new(logs)?);
            self.coordinates = Arc::from([]);
        }
        self.loss = None;
        Ok(())
    }

    fn values(&self) -> Option<&[f64]> {
        self.categorical().and_then(CategoricalFamily::values)
    }

    fn write_values(&mut self, _like: &Self, values: &[f64]) -> Result<bool, MessageError> {
        self.loss = None;
        if let AnyValue::Categorical(states) = &mut self.value {
            return states.write_values(&Categorical::default(), values);
        }
        let mut states = Categorical::default();
        let held = states.write_values(&Categorical::default(), values)?;
        self.value = AnyValue::Categorical(states);
        self.coordinates = Arc::from([]);
        Ok(held)
    }
}
