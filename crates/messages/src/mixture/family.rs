//! Mixtures as a family of messages.

use super::{MixtureForm, MixtureMessage, lift};
use crate::{GaussianFamily, GaussianForm, Moments};
use sumprod_graph::{Coordinate, Message, MessageError, Messages, Quality, Space, Stream, wrap_angle};

impl Message for MixtureMessage {
    type Form = MixtureForm;

    fn vacuous(space: &Space) -> Self {
        Self::flat(space.coordinates().unwrap_or_default())
    }

    fn product(
        incoming: Messages<'_, Self>,
        form: &MixtureForm,
        stream: &mut Stream,
    ) -> Result<Self, MessageError> {
        let all: Vec<&Self> = incoming.iter().collect();
        let Some(first) = all.first() else {
            return Err(MessageError::Unsupported("a product needs at least one message".into()));
        };
        lift::product(&all, first.coordinates(), form, stream)
    }

    /// Only a single Gaussian can be taken out of a mixture.
    fn quotient(&self, incoming: &Self) -> Option<Self> {
        if incoming.is_flat() {
            return Some(self.clone());
        }
        let divisor = incoming.potential().filter(|potential| potential.len() == 1)?;
        let quotient = match (self.density(), self.potential()) {
            (Some(density), _) => {
                let negative = divisor.negated();
                let (quotient, _) = density.times_local(negative.local(0)).ok()?;
                Self::from(quotient)
            }
            (None, Some(potential)) => potential
                .times_single(divisor.local(0), -1.0)
                .checked("the quotient of messages")
                .ok()?
                .into(),
            (None, None) => return None,
        };
        Some(quotient.costing(self.loss().unwrap_or(0.0)))
    }

    /// The largest shift of a mean in standard deviations, or of a standard deviation's logarithm.
    fn change(&self, previous: &Self) -> f64 {
        if self == previous {
            return 0.0;
        }
        match (self.read_moments(), previous.read_moments()) {
            (Some((read, new)), Some((other, old))) if read == other => {
                let kinds: Vec<Coordinate> = read.iter().map(|&k| self.coordinates()[k]).collect();
                moved(&kinds, &new, &old)
            }
            (None, None) => match (self.to_gaussian(), previous.to_gaussian()) {
                (Ok((new, _)), Ok((old, _))) => new.change(&old),
                _ => 1.0,
            },
            _ => 1.0,
        }
    }

    /// The mixture of both, held by no more components than the larger of them.
    fn damp(&mut self, previous: &Self, damping: f64) -> bool {
        let count = self.len().max(previous.len());
        let damped = match (self.density(), previous.density()) {
            (Some(new), Some(old)) => new.blend(old, damping).and_then(|both| both.fewer(count, None)),
            _ => match (self.potential(), previous.potential()) {
                (Some(new), Some(old)) => {
                    return new.blend(old, damping, count).map(|blend| self.become_held(blend)).is_some();
                }
                _ => return false,
            },
        };
        let Ok((damped, loss)) = damped else { return false };
        *self = Self::from(damped).costing(loss + self.loss().unwrap_or(0.0));
        true
    }

    fn check_form(form: &MixtureForm, space: &Space) -> Result<(), String> {
        if form.components == 0 {
            return Err("the number of components is 0; it must be at least 1".into());
        }
        if form.samples == 0 {
            return Err("the number of samples is 0; it must be at least 1".into());
        }
        match space {
            Space::Continuous(coordinates) if coordinates.is_empty() => {
                Err("a mixture cannot hold a variable without coordinates".into())
            }
            Space::Continuous(_) | Space::Se2 => Ok(()),
            Space::Se3 => Err("a mixture cannot hold a pose in space: a mean of quaternions is none".into()),
            Space::Finite(states) => Err(format!("a mixture cannot hold a variable of {states} states")),
        }
    }

    fn belief_form<'a>(edges: impl Iterator<Item = &'a MixtureForm>) -> MixtureForm {
        edges
            .fold(None, |best: Option<&MixtureForm>, form| match best {
                Some(best) if best.components >= form.components => Some(best),
                _ => Some(form),
            })
            .copied()
            .unwrap_or_default()
    }

    fn is_proper(&self) -> bool {
        self.density().is_some() || self.potential().is_some_and(|potential| potential.to_density().is_ok())
    }

    fn quality(&self) -> Quality {
        let product = self.product_quality();
        Quality {
            effective_sample_size: product
                .and_then(|found| found.sampled().then_some(found.effective_sample_size)),
            conversion_loss: self.loss(),
            components: Some(self.len()),
            modes: self.regions(),
            product: product.map(super::ProductQuality::outcome),
        }
    }
}

impl MixtureMessage {
    fn become_held(&mut self, potential: super::Potential) {
        let loss = self.loss().unwrap_or(0.0);
        *self = Self::from(potential).costing(loss);
    }

    /// Moments on the coordinates that are read, where they have any.
    fn read_moments(&self) -> Option<(Vec<usize>, Moments)> {
        if let Some(density) = self.density() {
            return Some(((0..density.dimension()).collect(), density.moments()));
        }
        let (read, density) = self.potential()?.density_on_read()?;
        Some((read, density.moments()))
    }

    /// The number of modes that valleys separate, on the coordinates that are read.
    fn regions(&self) -> Option<usize> {
        match (self.density(), self.potential()) {
            (Some(density), _) => density.regions().ok().flatten(),
            (None, Some(potential)) if potential.len() == 1 => (!potential.is_flat()).then_some(1),
            (None, Some(potential)) => potential.density_on_read()?.1.regions().ok().flatten(),
            (None, None) => None,
        }
    }
}

fn moved(coordinates: &[Coordinate], new: &Moments, old: &Moments) -> f64 {
    let each = coordinates.iter().enumerate().map(|(k, kind)| {
        let (a, b) = (new.covariance_at(k, k), old.covariance_at(k, k));
        let mut shift = new.mean[k] - old.mean[k];
        if *kind == Coordinate::Angle {
            shift = wrap_angle(shift);
        }
        let scaled = if shift == 0.0 { 0.0 } else { shift.abs() / a.max(b).max(f64::MIN_POSITIVE).sqrt() };
        scaled.max(0.5 * (a / b).ln().abs())
    });
    each.fold(0.0, f64::max).min(f64::MAX)
}

impl GaussianFamily for MixtureMessage {
    fn gaussian_form(_: &MixtureForm) -> GaussianForm {
        GaussianForm::default()
    }

    fn dimension(&self) -> usize {
        self.coordinates().len()
    }

    fn read_information(&self, information: &mut [f64], vector: &mut [f64]) -> Result<f64, MessageError> {
        let (gaussian, loss) = self.to_gaussian()?;
        gaussian.read_information(information, vector)?;
        Ok(loss + self.loss().unwrap_or(0.0))
    }

    fn write_information(
        &mut self,
        like: &Self,
        information: &[f64],
        vector: &[f64],
        loss: f64,
    ) -> Result<(), MessageError> {
        let gaussian = crate::DynamicGaussian::from_information(information, vector)?;
        *self = Self::from_gaussian(like.coordinates(), &gaussian).costing(loss);
        Ok(())
    }
}

/// What a rule for mixtures reads and writes, whatever the family.
pub trait MixtureFamily: Message {
    /// The message as a mixture of at most what `form` holds, and what that costs (nats).
    ///
    /// # Errors
    ///
    /// Where it is the values of a likelihood.
    fn read_mixture(&self, form: &MixtureForm) -> Result<(MixtureMessage, f64), MessageError>;

    /// The same on the coordinates `read` alone, which a mixture of few components holds better than all of them; none
    /// where what is left out cannot be summed out.
    ///
    /// # Errors
    ///
    /// As [`MixtureFamily::read_mixture`].
    fn read_marginal(
        &self,
        read: &[usize],
        form: &MixtureForm,
    ) -> Result<Option<(MixtureMessage, f64)>, MessageError>;

    /// Mean and covariance, where it is a distribution.
    fn known_moments(&self) -> Option<Moments>;
}

impl MixtureFamily for MixtureMessage {
    fn read_mixture(&self, form: &MixtureForm) -> Result<(MixtureMessage, f64), MessageError> {
        let read = if self.len() > form.components { self.reduced(form.components)? } else { self.clone() };
        let loss = read.loss().unwrap_or(0.0);
        Ok((read, loss))
    }

    fn read_marginal(
        &self,
        read: &[usize],
        form: &MixtureForm,
    ) -> Result<Option<(MixtureMessage, f64)>, MessageError> {
        let marginal: Self = match (self.density(), self.potential()) {
            (Some(density), _) => density.marginal(read)?.into(),
            (None, Some(potential)) if potential.is_flat() => {
                Self::flat(&read.iter().map(|&k| self.coordinates()[k]).collect::<Vec<_>>())
            }
            (None, Some(potential)) => match potential.to_density() {
                Ok((density, _)) => density.marginal(read)?.into(),
                Err(_) if potential.read().iter().all(|k| read.contains(k)) => {
                    let Ok((density, _)) = potential.density_on(read) else { return Ok(None) };
                    density.into()
                }
                Err(_) => return Ok(None),
            },
            (None, None) => return Ok(None),
        };
        marginal.costing(self.loss().unwrap_or(0.0)).read_mixture(form).map(Some)
    }

    fn known_moments(&self) -> Option<Moments> {
        self.moments().ok()
    }
}
