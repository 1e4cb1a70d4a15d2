//! The wrapper that makes one set of rules a factor of every family.

use crate::rules::{View, WithForm};
use crate::{Expansion, Rules};
use std::any::Any;
use sumprod_graph::{Coordinate, Factor, Incoming, MessageError, Port, Stream};
use sumprod_messages::{
    AnyForm, AnyMessage, DynamicGaussian, Gaussian, GaussianFamily, GaussianForm, MixtureFamily, MixtureForm,
    MixtureMessage, ParticleFamily, Particles, ParticlesForm,
};

/// Rules as a factor of every family; [`crate::AddModel`] puts it on.
#[derive(Clone, Debug)]
pub struct Model<T>(pub T);

impl<T: Rules> Model<T> {
    fn gaussian_into<M: GaussianFamily>(
        &self,
        to: Port,
        incoming: &Incoming<'_, M>,
        form: GaussianForm,
        wrapped: fn(&M) -> &[Coordinate],
        out: &mut M,
    ) -> Result<(), MessageError> {
        let draft = self.0.gaussian(to, &View { incoming, form, wrapped })?;
        out.write_information(incoming.belief(to), &draft.information, &draft.vector, draft.loss)
    }

    fn particles_into<M: ParticleFamily>(
        &self,
        to: Port,
        incoming: &Incoming<'_, M>,
        form: &ParticlesForm,
        stream: &mut Stream,
        out: &mut M,
    ) -> Result<(), MessageError> {
        let view = View { incoming, form: GaussianForm::default(), wrapped: |_| &[] };
        out.write_particles(incoming.belief(to), |particles| {
            self.0.particles(to, &view, form, stream, particles)
        })
    }

    fn mixture<M: GaussianFamily + MixtureFamily>(
        &self,
        to: Port,
        incoming: &Incoming<'_, M>,
        form: &MixtureForm,
        coordinates: fn(&M) -> &[Coordinate],
        stream: &mut Stream,
    ) -> Result<(MixtureMessage, f64), MessageError> {
        let view = View { incoming, form: GaussianForm::default(), wrapped: coordinates };
        self.0.mixture(to, &WithForm { view, form, coordinates }, form, stream)
    }
}

/// Answers a joint solve.
fn answer(rules: &impl Rules, question: &mut dyn Any) -> bool {
    let Some(question) = question.downcast_mut::<Expansion>() else { return false };
    question.refusal = rules.expand(question).err();
    true
}

macro_rules! gaussian_factor {
    ($family:ty $(, $dimension:ident)?) => {
        impl<T: Rules $(, const $dimension: usize)?> Factor<$family> for Model<T> {
            fn dimensions(&self) -> &[usize] {
                self.0.dimensions()
            }

            fn message(
                &self,
                to: Port,
                incoming: &Incoming<'_, $family>,
                form: &GaussianForm,
                stream: &mut Stream,
            ) -> Result<$family, MessageError> {
                let mut out = <$family>::default();
                self.message_into(to, incoming, form, stream, &mut out)?;
                Ok(out)
            }

            fn message_into(
                &self,
                to: Port,
                incoming: &Incoming<'_, $family>,
                form: &GaussianForm,
                _stream: &mut Stream,
                out: &mut $family,
            ) -> Result<(), MessageError> {
                self.gaussian_into(to, incoming, *form, |_| &[], out)
            }

            fn is_constant(&self) -> bool {
                self.0.is_constant()
            }

            fn answer(&self, question: &mut dyn Any) -> bool {
                answer(&self.0, question)
            }
        }
    };
}

gaussian_factor!(Gaussian<D>, D);
gaussian_factor!(DynamicGaussian);

impl<T: Rules> Factor<Particles> for Model<T> {
    fn dimensions(&self) -> &[usize] {
        self.0.dimensions()
    }

    fn message(
        &self,
        to: Port,
        incoming: &Incoming<'_, Particles>,
        form: &ParticlesForm,
        stream: &mut Stream,
    ) -> Result<Particles, MessageError> {
        let mut out = Particles::default();
        self.message_into(to, incoming, form, stream, &mut out)?;
        Ok(out)
    }

    fn message_into(
        &self,
        to: Port,
        incoming: &Incoming<'_, Particles>,
        form: &ParticlesForm,
        stream: &mut Stream,
        out: &mut Particles,
    ) -> Result<(), MessageError> {
        self.particles_into(to, incoming, form, stream, out)
    }

    fn answer(&self, question: &mut dyn Any) -> bool {
        answer(&self.0, question)
    }
}

impl<T: Rules> Factor<MixtureMessage> for Model<T> {
    fn dimensions(&self) -> &[usize] {
        self.0.dimensions()
    }

    fn message(
        &self,
        to: Port,
        incoming: &Incoming<'_, MixtureMessage>,
        form: &MixtureForm,
        stream: &mut Stream,
    ) -> Result<MixtureMessage, MessageError> {
        let (message, loss) = self.mixture(to, incoming, form, MixtureMessage::coordinates, stream)?;
        Ok(message.costing(loss))
    }

    fn is_constant(&self) -> bool {
        self.0.is_constant()
    }

    fn answer(&self, question: &mut dyn Any) -> bool {
        answer(&self.0, question)
    }
}

/// Angles of particles and mixtures are read by the direction of their mean, which lies in (-π, π].
fn wrapped(message: &AnyMessage) -> &[Coordinate] {
    if message.as_gaussian().is_some() { &[] } else { ParticleFamily::coordinates(message) }
}

impl<T: Rules> Factor<AnyMessage> for Model<T> {
    fn dimensions(&self) -> &[usize] {
        self.0.dimensions()
    }

    fn message(
        &self,
        to: Port,
        incoming: &Incoming<'_, AnyMessage>,
        form: &AnyForm,
        stream: &mut Stream,
    ) -> Result<AnyMessage, MessageError> {
        let mut out = incoming.belief(to).clone();
        self.message_into(to, incoming, form, stream, &mut out)?;
        Ok(out)
    }

    fn message_into(
        &self,
        to: Port,
        incoming: &Incoming<'_, AnyMessage>,
        form: &AnyForm,
        stream: &mut Stream,
        out: &mut AnyMessage,
    ) -> Result<(), MessageError> {
        match form {
            AnyForm::Gaussian(form) => self.gaussian_into(to, incoming, *form, wrapped, out),
            AnyForm::Particles(form) => self.particles_into(to, incoming, form, stream, out),
            AnyForm::Mixture(form) => {
                let (message, loss) =
                    self.mixture(to, incoming, form, ParticleFamily::coordinates, stream)?;
                out.write_mixture(incoming.belief(to), message, loss);
                Ok(())
            }
            AnyForm::Categorical(_) => {
                let reason = "a residual has no message over finitely many states; use a table";
                Err(MessageError::Unsupported(reason.into()))
            }
        }
    }

    fn is_constant(&self) -> bool {
        self.0.is_constant()
    }

    fn answer(&self, question: &mut dyn Any) -> bool {
        answer(&self.0, question)
    }
}
