//! The sum of all families: one graph, each edge in its own form.
//!
//! A product of messages in different forms is taken in the belief's form:
//!
//! - a **Gaussian** belief reads particles by their moments, and reports what that cost;
//! - a **particle** belief keeps its points and weighs them by each Gaussian or mixture, which costs nothing; where
//!   there are no points yet it draws them from the product of those;
//! - a **mixture** belief reads Gaussians as they are, and a sample by kernels, and reports what that cost;
//! - a **categorical** belief, of a variable of finitely many states, reads no other kind.
//!
//! A family says in one place how the others read it (`Held`), and the enums below list it.

mod categorical;
mod convert;
mod family;
mod held;
mod mixture;
mod product;

pub use family::ParticleFamily;

use crate::categorical::{Categorical, CategoricalForm};
use crate::mixture::{MixtureForm, MixtureMessage};
use crate::{DynamicGaussian, GaussianForm, Moments, Particles, ParticlesForm};
use convert::no_distribution;
use held::Held;
use product::{gaussian_product, particle_product};
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use sumprod_graph::{Coordinate, Message, MessageError, Messages, Quality, Space, Stream};

/// How an edge holds its messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum AnyForm {
    /// A Gaussian in information form.
    Gaussian(GaussianForm),
    /// Weighted particles.
    Particles(ParticlesForm),
    /// A mixture of Gaussians.
    Mixture(MixtureForm),
    /// Values of finitely many states.
    Categorical(CategoricalForm),
}

impl Default for AnyForm {
    fn default() -> Self {
        Self::Gaussian(GaussianForm::default())
    }
}

impl AnyForm {
    /// A Gaussian, linearised to first order.
    pub fn gaussian() -> Self {
        Self::default()
    }

    /// `count` weighted particles.
    pub fn particles(count: usize) -> Self {
        Self::Particles(ParticlesForm::new(count))
    }

    /// A mixture of at most `components` Gaussians.
    pub fn mixture(components: usize) -> Self {
        Self::Mixture(MixtureForm::new(components))
    }

    /// Values of finitely many states, summed over at this temperature.
    pub fn categorical(temperature: f64) -> Self {
        Self::Categorical(CategoricalForm { temperature })
    }

    /// The name of the family.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Gaussian(_) => "gaussian",
            Self::Particles(_) => "particles",
            Self::Mixture(_) => "mixture",
            Self::Categorical(_) => "categorical",
        }
    }

    fn richness(&self) -> usize {
        match self {
            Self::Gaussian(_) => 0,
            // Edges of such a variable have no other form.
            Self::Categorical(_) => 1,
            Self::Particles(form) => form.count,
            Self::Mixture(form) => form.components,
        }
    }
}

/// A message of one of the built-in families.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
pub enum AnyValue {
    /// A Gaussian in information form.
    Gaussian(DynamicGaussian),
    /// Weighted particles.
    Particles(Particles),
    /// A mixture of Gaussians.
    Mixture(MixtureMessage),
    /// Values of finitely many states.
    Categorical(Categorical),
}

impl AnyValue {
    fn held(&self) -> &dyn Held {
        match self {
            Self::Gaussian(gaussian) => gaussian,
            Self::Particles(particles) => particles,
            Self::Mixture(mixture) => mixture,
            Self::Categorical(states) => states,
        }
    }
}

impl Clone for AnyValue {
    fn clone(&self) -> Self {
        match self {
            Self::Gaussian(gaussian) => Self::Gaussian(gaussian.clone()),
            Self::Particles(particles) => Self::Particles(particles.clone()),
            Self::Mixture(mixture) => Self::Mixture(mixture.clone()),
            Self::Categorical(states) => Self::Categorical(states.clone()),
        }
    }

    fn clone_from(&mut self, source: &Self) {
        match (self, source) {
            (Self::Gaussian(own), Self::Gaussian(other)) => own.clone_from(other),
            (Self::Particles(own), Self::Particles(other)) => own.clone_from(other),
            (Self::Categorical(own), Self::Categorical(other)) => own.clone_from(other),
            (own, other) => *own = other.clone(),
        }
    }
}

/// A message of any built-in family, with what conversions cost on the way to it.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
pub struct AnyMessage {
    value: AnyValue,
    coordinates: Arc<[Coordinate]>,
    /// Divergence (nats) of the conversions that this message needed; none where there was no conversion.
    loss: Option<f64>,
}

impl Clone for AnyMessage {
    fn clone(&self) -> Self {
        Self { value: self.value.clone(), coordinates: self.coordinates.clone(), loss: self.loss }
    }

    fn clone_from(&mut self, source: &Self) {
        self.value.clone_from(&source.value);
        self.coordinates.clone_from(&source.coordinates);
        self.loss = source.loss;
    }
}

impl AnyMessage {
    /// A Gaussian of this mean and covariance (row-major) on `space`.
    ///
    /// # Errors
    ///
    /// As [`DynamicGaussian::from_moments`], and where the dimension is not the space's.
    pub fn gaussian(space: &Space, mean: &[f64], covariance: &[f64]) -> Result<Self, MessageError> {
        Self::from_gaussian(space, DynamicGaussian::from_moments(mean, covariance)?)
    }

    /// A Gaussian message on `space`.
    ///
    /// # Errors
    ///
    /// Where the dimension is not the space's.
    pub fn from_gaussian(space: &Space, gaussian: DynamicGaussian) -> Result<Self, MessageError> {
        let coordinates = coordinates_of(space);
        if gaussian.dimension() != coordinates.len() {
            let (found, expected) = (gaussian.dimension(), coordinates.len());
            return Err(MessageError::Dimension { what: "the message", found, expected });
        }
        Ok(Self { value: AnyValue::Gaussian(gaussian), coordinates, loss: None })
    }

    /// A message held by particles.
    pub fn from_particles(particles: Particles) -> Self {
        let coordinates = particles.coordinates().into();
        Self { value: AnyValue::Particles(particles), coordinates, loss: None }
    }

    /// A message held by a mixture.
    pub fn from_mixture(mixture: MixtureMessage) -> Self {
        let coordinates = mixture.coordinates().into();
        Self { value: AnyValue::Mixture(mixture), coordinates, loss: None }
    }

    /// A message over finitely many states.
    pub fn from_categorical(states: Categorical) -> Self {
        Self { value: AnyValue::Categorical(states), coordinates: Arc::from([]), loss: None }
    }

    /// The message in its family.
    pub fn value(&self) -> &AnyValue {
        &self.value
    }

    /// The particles, where it is held by particles.
    pub fn particles(&self) -> Option<&Particles> {
        match &self.value {
            AnyValue::Particles(particles) => Some(particles),
            _ => None,
        }
    }

    /// The mixture, where it is held by one.
    pub fn mixture(&self) -> Option<&MixtureMessage> {
        match &self.value {
            AnyValue::Mixture(mixture) => Some(mixture),
            _ => None,
        }
    }

    /// The values of all states, where it is held by them.
    pub fn categorical(&self) -> Option<&Categorical> {
        match &self.value {
            AnyValue::Categorical(states) => Some(states),
            _ => None,
        }
    }

    /// Mean and covariance.
    ///
    /// # Errors
    ///
    /// Where the message has none: improper, vacuous, a likelihood, or over states.
    pub fn moments(&self) -> Result<Moments, MessageError> {
        match &self.value {
            AnyValue::Gaussian(gaussian) => gaussian.moments(),
            AnyValue::Particles(particles) if particles.is_proper() => Ok(particles.moments()),
            AnyValue::Particles(_) => Err(no_distribution()),
            AnyValue::Mixture(mixture) => mixture.moments(),
            AnyValue::Categorical(_) => self.value.held().to_gaussian()?.0.moments(),
        }
    }

    /// The message as a Gaussian, and the divergence (nats) that costs.
    ///
    /// # Errors
    ///
    /// Where particles are a likelihood, which has no moments of its own.
    pub fn to_gaussian(&self) -> Result<(DynamicGaussian, f64), MessageError> {
        self.value.held().to_gaussian()
    }

    /// The message as a sample of `count` particles, and the divergence (nats) that costs.
    ///
    /// # Errors
    ///
    /// Where a Gaussian is improper.
    pub fn to_particles(&self, count: usize, stream: &mut Stream) -> Result<(Particles, f64), MessageError> {
        self.value.held().to_particles(&self.coordinates, count, stream)
    }

    /// The message as a mixture of this form, and the divergence (nats) that costs.
    ///
    /// # Errors
    ///
    /// Where particles are a likelihood.
    pub fn to_mixture(&self, form: &MixtureForm) -> Result<(MixtureMessage, f64), MessageError> {
        self.value.held().to_mixture(&self.coordinates, form)
    }

    fn lose(&mut self, loss: f64) {
        if loss != 0.0 {
            *self.loss.get_or_insert(0.0) += loss;
        }
    }
}

fn coordinates_of(space: &Space) -> Arc<[Coordinate]> {
    space.coordinates().unwrap_or_default().into()
}

impl Message for AnyMessage {
    type Form = AnyForm;

    fn vacuous(space: &Space) -> Self {
        let value = match space {
            Space::Finite(_) => AnyValue::Categorical(Categorical::vacuous(space)),
            _ => AnyValue::Gaussian(DynamicGaussian::flat(space.dimension())),
        };
        Self { value, coordinates: coordinates_of(space), loss: None }
    }

    fn product(
        incoming: Messages<'_, Self>,
        form: &AnyForm,
        stream: &mut Stream,
    ) -> Result<Self, MessageError> {
        let Some(first) = incoming.iter().next() else {
            return Err(MessageError::Unsupported("a product needs at least one message".into()));
        };
        let mut product = first.clone();
        Self::product_into(incoming, form, stream, &mut product)?;
        Ok(product)
    }

    fn product_into(
        incoming: Messages<'_, Self>,
        form: &AnyForm,
        stream: &mut Stream,
        out: &mut Self,
    ) -> Result<(), MessageError> {
        out.loss = None;
        match form {
            AnyForm::Gaussian(_) => gaussian_product(incoming, out),
            AnyForm::Particles(form) => particle_product(incoming, form, stream, out),
            AnyForm::Mixture(form) => mixture::product(incoming, form, stream, out),
            AnyForm::Categorical(form) => categorical::product(incoming, form, stream, out),
        }
    }

    fn quotient(&self, incoming: &Self) -> Option<Self> {
        let mut out = self.clone();
        self.quotient_into(incoming, &mut out).then_some(out)
    }

    fn quotient_into(&self, incoming: &Self, out: &mut Self) -> bool {
        out.coordinates.clone_from(&self.coordinates);
        out.loss = self.loss;
        match (&self.value, &incoming.value) {
            (AnyValue::Gaussian(belief), AnyValue::Gaussian(message)) => {
                if let AnyValue::Gaussian(own) = &mut out.value {
                    return belief.quotient_into(message, own);
                }
                out.value = AnyValue::Gaussian(belief.over(message));
                true
            }
            (AnyValue::Particles(belief), AnyValue::Particles(message)) => {
                if let AnyValue::Particles(own) = &mut out.value {
                    return belief.quotient_into(message, own);
                }
                let quotient = belief.quotient(message);
                quotient.map(|quotient| out.value = AnyValue::Particles(quotient)).is_some()
            }
            (AnyValue::Particles(belief), message) => {
                let mut quotient = belief.clone();
                let (held, logs) = (message.held(), &mut quotient.log_weights);
                let divided = held.add_logs(&self.coordinates, belief.points(), -1.0, logs).is_ok()
                    && quotient.normalise("the quotient of messages").is_ok();
                out.value = AnyValue::Particles(quotient);
                divided
            }
            (AnyValue::Mixture(belief), message) if !matches!(message, AnyValue::Particles(_)) => {
                let read = message.held().to_mixture(&self.coordinates, &MixtureForm::new(usize::MAX));
                let quotient = read.ok().and_then(|(message, _)| belief.quotient(&message));
                quotient.map(|quotient| out.value = AnyValue::Mixture(quotient)).is_some()
            }
            (AnyValue::Categorical(belief), AnyValue::Categorical(message)) => {
                if let AnyValue::Categorical(own) = &mut out.value {
                    return belief.quotient_into(message, own);
                }
                let quotient = belief.quotient(message);
                quotient.map(|quotient| out.value = AnyValue::Categorical(quotient)).is_some()
            }
            (own, message) => {
                out.value.clone_from(own);
                message.held().is_vacuous()
            }
        }
    }

    fn change(&self, previous: &Self) -> f64 {
        match (&self.value, &previous.value) {
            (AnyValue::Gaussian(new), AnyValue::Gaussian(old)) => new.change(old),
            (AnyValue::Particles(new), AnyValue::Particles(old)) => new.change(old),
            (AnyValue::Mixture(new), AnyValue::Mixture(old)) => new.change(old),
            (AnyValue::Categorical(new), AnyValue::Categorical(old)) => new.change(old),
            _ => 1.0,
        }
    }

    fn damp(&mut self, previous: &Self, damping: f64) -> bool {
        match (&mut self.value, &previous.value) {
            (AnyValue::Gaussian(new), AnyValue::Gaussian(old)) => new.damp(old, damping),
            (AnyValue::Particles(new), AnyValue::Particles(old)) => new.damp(old, damping),
            (AnyValue::Mixture(new), AnyValue::Mixture(old)) => new.damp(old, damping),
            (AnyValue::Categorical(new), AnyValue::Categorical(old)) => new.damp(old, damping),
            (_, old) => old.held().is_vacuous(),
        }
    }

    fn check_form(form: &AnyForm, space: &Space) -> Result<(), String> {
        match form {
            AnyForm::Gaussian(form) => DynamicGaussian::check_form(form, space),
            AnyForm::Particles(form) => Particles::check_form(form, space),
            AnyForm::Mixture(form) => MixtureMessage::check_form(form, space),
            AnyForm::Categorical(form) => Categorical::check_form(form, space),
        }
    }

    fn default_form(space: &Space) -> AnyForm {
        match space {
            Space::Finite(_) => AnyForm::Categorical(CategoricalForm::default()),
            _ => AnyForm::default(),
        }
    }

    fn belief_form<'a>(edges: impl Iterator<Item = &'a AnyForm>) -> AnyForm {
        let mut richest = AnyForm::default();
        for form in edges {
            if form.richness() > richest.richness() {
                richest = *form;
            }
        }
        richest
    }

    fn is_proper(&self) -> bool {
        self.value.held().is_distribution()
    }

    fn quality(&self) -> Quality {
        let own = self.value.held().known_quality();
        let conversion_loss = match (own.conversion_loss, self.loss) {
            (Some(own), Some(more)) => Some(own + more),
            (own, more) => own.or(more),
        };
        Quality { conversion_loss, ..own }
    }
}
