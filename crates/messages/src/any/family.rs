//! How rules read and write messages, whatever their family.

use super::{AnyForm, AnyMessage, AnyValue};
use crate::mixture::{MixtureFamily, MixtureForm, MixtureMessage};
use crate::{DynamicGaussian, GaussianFamily, GaussianForm, Moments, Particles, ParticlesForm};
use sumprod_graph::{Coordinate, Message, MessageError, Stream};

impl GaussianFamily for AnyMessage {
    fn gaussian_form(form: &AnyForm) -> GaussianForm {
        match form {
            AnyForm::Gaussian(form) => *form,
            _ => GaussianForm::default(),
        }
    }

    fn dimension(&self) -> usize {
        self.coordinates.len()
    }

    fn read_information(&self, information: &mut [f64], vector: &mut [f64]) -> Result<f64, MessageError> {
        let before = self.loss.unwrap_or(0.0);
        match &self.value {
            AnyValue::Gaussian(gaussian) => Ok(before + gaussian.read_information(information, vector)?),
            value => {
                let (gaussian, loss) = value.held().to_gaussian()?;
                gaussian.read_information(information, vector)?;
                Ok(before + loss)
            }
        }
    }

    fn write_information(
        &mut self,
        like: &Self,
        information: &[f64],
        vector: &[f64],
        loss: f64,
    ) -> Result<(), MessageError> {
        match &mut self.value {
            AnyValue::Gaussian(gaussian) => gaussian.fill_from(information, vector),
            value => *value = AnyValue::Gaussian(DynamicGaussian::from_information(information, vector)?),
        }
        self.coordinates.clone_from(&like.coordinates);
        self.loss = (loss != 0.0).then_some(loss);
        Ok(())
    }
}

/// A family that can be read and written as particles.
pub trait ParticleFamily: Message {
    /// How many particles an edge of this form holds; none where it does not hold particles.
    fn particles_form(form: &Self::Form) -> Option<ParticlesForm>;

    /// The message as particles, at most `count` where they must be drawn, and what that costs (nats). Vacuous
    /// messages are empty sets.
    ///
    /// # Errors
    ///
    /// Where the message is improper and cannot be drawn from.
    fn read_particles(&self, count: usize, stream: &mut Stream) -> Result<(Particles, f64), MessageError>;

    /// The particles, where it is held by particles.
    fn as_particles(&self) -> Option<&Particles>;

    /// The Gaussian, where it is held by one.
    fn as_gaussian(&self) -> Option<&DynamicGaussian>;

    /// The coordinates of the variable, real or angular.
    fn coordinates(&self) -> &[Coordinate];

    /// Lets `fill` rewrite the message as particles on the space of `like`, in storage it may reuse; `fill`
    /// returns what conversions cost (nats).
    ///
    /// # Errors
    ///
    /// Whatever `fill` returns.
    fn write_particles(
        &mut self,
        like: &Self,
        fill: impl FnOnce(&mut Particles) -> Result<f64, MessageError>,
    ) -> Result<(), MessageError>;
}

impl ParticleFamily for Particles {
    fn particles_form(form: &ParticlesForm) -> Option<ParticlesForm> {
        Some(*form)
    }

    fn read_particles(&self, _count: usize, _stream: &mut Stream) -> Result<(Particles, f64), MessageError> {
        Ok((self.clone(), 0.0))
    }

    fn as_particles(&self) -> Option<&Particles> {
        Some(self)
    }

    fn as_gaussian(&self) -> Option<&DynamicGaussian> {
        None
    }

    fn coordinates(&self) -> &[Coordinate] {
        Particles::coordinates(self)
    }

    fn write_particles(
        &mut self,
        _like: &Self,
        fill: impl FnOnce(&mut Particles) -> Result<f64, MessageError>,
    ) -> Result<(), MessageError> {
        fill(self).map(|_| ())
    }
}

impl MixtureFamily for AnyMessage {
    fn read_mixture(&self, form: &MixtureForm) -> Result<(MixtureMessage, f64), MessageError> {
        let (mixture, loss) = self.value.held().to_mixture(&self.coordinates, form)?;
        Ok((mixture, self.loss.unwrap_or(0.0) + loss))
    }

    fn read_marginal(
        &self,
        read: &[usize],
        form: &MixtureForm,
    ) -> Result<Option<(MixtureMessage, f64)>, MessageError> {
        let found = self.value.held().to_marginal(&self.coordinates, read, form)?;
        Ok(found.map(|(mixture, loss)| (mixture, self.loss.unwrap_or(0.0) + loss)))
    }

    fn known_moments(&self) -> Option<Moments> {
        self.moments().ok()
    }
}

impl AnyMessage {
    /// Becomes a mixture on the space of `like`, having cost `loss` nats in conversions.
    pub fn write_mixture(&mut self, like: &Self, mixture: MixtureMessage, loss: f64) {
        self.value = AnyValue::Mixture(mixture);
        self.coordinates.clone_from(&like.coordinates);
        self.loss = (loss != 0.0).then_some(loss);
    }
}

impl ParticleFamily for AnyMessage {
    fn particles_form(form: &AnyForm) -> Option<ParticlesForm> {
        match form {
            AnyForm::Particles(form) => Some(*form),
            _ => None,
        }
    }

    fn read_particles(&self, count: usize, stream: &mut Stream) -> Result<(Particles, f64), MessageError> {
        let (particles, loss) = self.to_particles(count, stream)?;
        Ok((particles, self.loss.unwrap_or(0.0) + loss))
    }

    fn as_particles(&self) -> Option<&Particles> {
        self.particles()
    }

    fn as_gaussian(&self) -> Option<&DynamicGaussian> {
        match &self.value {
            AnyValue::Gaussian(gaussian) => Some(gaussian),
            _ => None,
        }
    }

    fn coordinates(&self) -> &[Coordinate] {
        &self.coordinates
    }

    fn write_particles(
        &mut self,
        like: &Self,
        fill: impl FnOnce(&mut Particles) -> Result<f64, MessageError>,
    ) -> Result<(), MessageError> {
        if !matches!(self.value, AnyValue::Particles(_)) {
            self.value = AnyValue::Particles(Particles::default());
        }
        if let AnyValue::Particles(particles) = &mut self.value {
            let loss = fill(particles)?;
            self.coordinates.clone_from(&like.coordinates);
            self.loss = (loss != 0.0).then_some(loss);
        }
        Ok(())
    }
}
