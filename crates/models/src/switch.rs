//! Motions of which a variable of finitely many states says which one it is.
//!
//! f(s, x, x') is the density of x' after motion number s from x. With messages p(s), Σ_i w_i N(m_i, P_i) over x and m(x')
//! over the next state it sends
//!
//! - ahead, Σ_s p(s) Σ_i w_i N(f_s(m_i), F_s P_i F_s' + Q_s);
//! - back, Σ_s p(s) m(x') blurred by Q_s and read in x, which has as much weight as m agrees with motion s;
//! - to the switch, for each s the integral of the message over x with what is sent back by motion s.
//!
//! Exact of linear motions as long as the edges' mixtures hold all branches; beyond that they are merged, and the loss is
//! told like that of every mixture.

use crate::rules::mixture::motion::{Retrodiction, predict};
use crate::small::{Matrix, Vector, multiply, symmetrise, transpose, zero_vector, zeros};
use crate::{Motion, Transition};
use sumprod_graph::{Factor, Incoming, Message, MessageError, Port, Stream};
use sumprod_messages::vector::log_sum;
use sumprod_messages::{
    AnyForm, AnyMessage, Categorical, Cholesky, Mixture, MixtureFamily, MixtureForm, MixtureMessage,
    ParticleFamily, Potential,
};

/// The ports of a [`Switch`].
const SWITCH: Port = 0;
const FROM: Port = 1;
const TO: Port = 2;

/// One of several motions from a state to the next, chosen by a variable of as many states.
///
/// Ports: the choice, the state, the next state. Edges to states are held as mixtures of the components that branches may
/// have, or as Gaussians of which each hears a single one.
pub struct Switch<T> {
    motions: Vec<Transition<T>>,
    dimensions: [usize; 3],
}

impl<T: Motion> Switch<T> {
    /// The motions, in the order of the choice's states.
    ///
    /// # Errors
    ///
    /// Where there is none, or they move states of different dimensions.
    pub fn new(motions: Vec<T>) -> Result<Self, MessageError> {
        let Some(expected) = motions.first().map(Motion::dimension) else {
            return Err(MessageError::Unsupported("a switch needs at least one motion".into()));
        };
        if let Some(other) = motions.iter().find(|motion| motion.dimension() != expected) {
            let found = other.dimension();
            return Err(MessageError::Dimension { what: "a motion of the switch", found, expected });
        }
        let dimensions = [motions.len(), expected, expected];
        Ok(Self { motions: motions.into_iter().map(Transition::new).collect(), dimensions })
    }

    /// Logarithms of how likely each motion is, by the message from the switch.
    fn choice<'a>(&self, incoming: &'a Incoming<'_, AnyMessage>) -> Result<&'a [f64], MessageError> {
        match incoming.message(SWITCH).categorical() {
            Some(choice) => Ok(choice.logs()),
            None => Err(MessageError::Unsupported("the choice of a switch must be held by states".into())),
        }
    }

    fn ahead(
        &self,
        incoming: &Incoming<'_, AnyMessage>,
        form: &MixtureForm,
    ) -> Result<(MixtureMessage, f64), MessageError> {
        let (message, loss) = incoming.message(FROM).read_mixture(form)?;
        if message.is_flat() {
            return Ok((MixtureMessage::flat(ParticleFamily::coordinates(incoming.belief(TO))), loss));
        }
        let density = message.to_density()?;
        let choice = Categorical::new(self.choice(incoming)?)?.probabilities();
        let (mut weights, mut means, mut covariances) = (Vec::new(), Vec::new(), Vec::new());
        for (motion, probability) in self.motions.iter().zip(choice).filter(|(_, p)| *p > 0.0) {
            let predicted = predict(&density, |mean, covariance| motion.ahead(mean, mean, covariance))?;
            let branch = predicted.to_density()?;
            weights.extend(branch.log_weights().iter().map(|log| log + probability.ln()));
            for i in 0..branch.len() {
                means.extend_from_slice(branch.mean_of(i));
                covariances.extend_from_slice(branch.covariance_of(i));
            }
        }
        let branches = Mixture::new(&density.space(), weights, means, covariances)?;
        Ok((MixtureMessage::from(branches).reduced(form.components)?, loss))
    }

    /// What the next state's message says of this state under each motion; none where it says nothing.
    fn back(
        &self,
        incoming: &Incoming<'_, AnyMessage>,
        form: &MixtureForm,
    ) -> Result<(Option<Vec<Potential>>, f64), MessageError> {
        let (message, loss) = incoming.message(TO).read_mixture(form)?;
        if message.is_flat() {
            return Ok((None, loss));
        }
        let next = message.to_potential();
        let belief = incoming.belief(FROM);
        let guide = if belief.is_proper() {
            belief.read_mixture(form).ok().and_then(|(belief, _)| belief.to_density().ok())
        } else {
            None
        };
        let each = self.motions.iter().map(|motion| {
            let linearise = |x: &[f64]| motion.linearise(x);
            let noise = |x: &[f64]| motion.motion().noise(x);
            Retrodiction { linearise: &linearise, noise: &noise, guide: guide.clone() }.potential(&next)
        });
        Ok((Some(each.collect::<Result<_, _>>()?), loss))
    }

    fn state(
        &self,
        to: Port,
        incoming: &Incoming<'_, AnyMessage>,
        form: &MixtureForm,
    ) -> Result<(MixtureMessage, f64), MessageError> {
        if to == TO {
            return self.ahead(incoming, form);
        }
        let (each, loss) = self.back(incoming, form)?;
        let coordinates = ParticleFamily::coordinates(incoming.belief(FROM));
        let Some(each) = each else { return Ok((MixtureMessage::flat(coordinates), loss)) };
        let mut all = Potential::new(coordinates);
        for (potential, log) in each.iter().zip(self.choice(incoming)?) {
            for k in 0..potential.len() {
                let value = potential.log_value_of(k) + log;
                let (centre, gradient) = (potential.centre_of(k), potential.gradient_of(k));
                all.push(value, centre, gradient, potential.information_of(k));
            }
        }
        let all = MixtureMessage::from(all.checked("a component of the message")?);
        Ok((all.reduced(form.components)?, loss))
    }

    /// Logarithms of how well each motion agrees with both states' messages.
    fn evidence(&self, incoming: &Incoming<'_, AnyMessage>) -> Result<Vec<f64>, MessageError> {
        let form = MixtureForm::new(usize::MAX);
        let (Some(each), _) = self.back(incoming, &form)? else { return Ok(vec![0.0; self.motions.len()]) };
        let (from, _) = incoming.message(FROM).read_mixture(&form)?;
        if from.is_flat() {
            // A state of which nothing is known agrees with any.
            return Ok(vec![0.0; self.motions.len()]);
        }
        let density = from.to_density()?;
        each.iter().map(|potential| log_overlap(&density, potential)).collect()
    }
}

/// log ∫ Σ_i w_i N(x; m_i, P_i) Σ_j exp(a_j + g_j'δ - ½ δ'Λ_jδ) dx, δ = x - c_j: with P = L L' and h = g - Λ (m - c),
/// each pair gives exp(a + g'(m - c) - ½ (m - c)'Λ(m - c) + ½ h'L M⁻¹ L'h) / √|M|, M = I + L'ΛL.
fn log_overlap(density: &Mixture, potential: &Potential) -> Result<f64, MessageError> {
    let d = density.dimension();
    let space = density.space();
    let mut terms = Vec::with_capacity(density.len() * potential.len());
    for i in 0..density.len() {
        let factor = Cholesky::new(density.covariance_of(i), d, "the covariance of a component")?;
        let mut lower = zeros(d * d);
        for column in 0..d {
            let (mut unit, mut scaled) = (zero_vector(d), zero_vector(d));
            unit[column] = 1.0;
            factor.multiply_lower(&unit, &mut scaled);
            (0..d).for_each(|row| lower[row * d + column] = scaled[row]);
        }
        let upper = transpose(&lower, d, d);
        for j in 0..potential.len() {
            let information = potential.information_of(j);
            let mut delta: Vector =
                density.mean_of(i).iter().zip(potential.centre_of(j)).map(|(m, c)| m - c).collect();
            space.wrap(&mut delta);
            let pulled = multiply(information, &delta, d, 1);
            let gradient = potential.gradient_of(j);
            let slope: Vector = gradient.iter().zip(&pulled).map(|(g, p)| g - p).collect();
            let at_mean: f64 = (0..d).map(|k| delta[k] * (gradient[k] - 0.5 * pulled[k])).sum();
            let mut inner: Matrix = multiply(&multiply(&upper, information, d, d), &lower, d, d);
            (0..d).for_each(|k| inner[k * d + k] += 1.0);
            symmetrise(&mut inner, d);
            let inner = Cholesky::new(&inner, d, "the overlap of two states' messages")?;
            let mut whitened = multiply(&upper, &slope, d, 1);
            let gain = inner.squared_length(&mut whitened);
            let log = density.log_weights()[i] + potential.log_value_of(j) + at_mean;
            terms.push(log + 0.5 * (gain - inner.log_determinant()));
        }
    }
    Ok(log_sum(&terms))
}

impl<T: Motion> Factor<AnyMessage> for Switch<T> {
    fn dimensions(&self) -> &[usize] {
        &self.dimensions
    }

    fn message(
        &self,
        to: Port,
        incoming: &Incoming<'_, AnyMessage>,
        form: &AnyForm,
        _stream: &mut Stream,
    ) -> Result<AnyMessage, MessageError> {
        if to == SWITCH {
            return Ok(AnyMessage::from_categorical(Categorical::new(&self.evidence(incoming)?)?));
        }
        let mut out = incoming.belief(to).clone();
        match form {
            AnyForm::Mixture(form) => {
                let (message, loss) = self.state(to, incoming, form)?;
                out.write_mixture(incoming.belief(to), message, loss);
                Ok(out)
            }
            AnyForm::Gaussian(_) => {
                // All branches as one: what a single Gaussian can hold.
                let (message, loss) = self.state(to, incoming, &MixtureForm::new(1))?;
                out.write_mixture(incoming.belief(to), message, loss);
                Ok(out)
            }
            other => {
                let name = other.name();
                let reason = format!("a switch sends no {name} to a state; hold the edge as a mixture");
                Err(MessageError::Unsupported(reason))
            }
        }
    }
}
