//! Products of messages in different forms.

use super::convert::drawn_from_gaussians;
use super::{AnyMessage, AnyValue};
use crate::mixture::{MixtureForm, MixtureMessage};
use crate::particles::{Role, carrier};
use crate::{DynamicGaussian, Particles, ParticlesForm};
use smallvec::SmallVec;
use std::f64::consts::{PI, TAU};
use sumprod_graph::{Coordinate, Message, MessageError, Messages, Stream};

pub(super) fn gaussian_product(
    incoming: Messages<'_, AnyMessage>,
    out: &mut AnyMessage,
) -> Result<(), MessageError> {
    if !matches!(out.value, AnyValue::Gaussian(_)) {
        out.value = AnyValue::Gaussian(DynamicGaussian::default());
    }
    let mut loss = 0.0;
    let mut turns = Turns::new(&out.coordinates);
    if let AnyValue::Gaussian(product) = &mut out.value {
        for (index, message) in incoming.iter().enumerate() {
            let converted;
            let gaussian = match &message.value {
                AnyValue::Gaussian(gaussian) => gaussian,
                value => {
                    let (gaussian, cost) = value.held().to_gaussian()?;
                    loss += cost;
                    converted = gaussian;
                    &converted
                }
            };
            match turns.aligned(gaussian) {
                Some(shifted) if index == 0 => *product = shifted,
                Some(shifted) => product.add(&shifted)?,
                None if index == 0 => product.clone_from(gaussian),
                None => product.add(gaussian)?,
            }
        }
    }
    out.lose(loss);
    Ok(())
}

/// Brings Gaussians on angles to the turn of the first that knows the angle: 3.1 and -3.1 rad are near, not opposite.
struct Turns<'a> {
    coordinates: &'a [Coordinate],
    /// By coordinate, the angle that all are brought to.
    references: SmallVec<[Option<f64>; 6]>,
}

/// Variance up to which a message knows an angle (rad²): three standard deviations make half a turn. What a vaguer one
/// says is a line through the point it was linearised at; its mean may lie turns away, and names no turn.
const KNOWN_ANGLE: f64 = PI * PI / 9.0;

impl<'a> Turns<'a> {
    fn new(coordinates: &'a [Coordinate]) -> Self {
        Self { coordinates, references: SmallVec::from_elem(None, coordinates.len()) }
    }

    /// The message on the references' turns, where it is on others.
    fn aligned(&mut self, gaussian: &DynamicGaussian) -> Option<DynamicGaussian> {
        if !self.coordinates.contains(&Coordinate::Angle) {
            return None;
        }
        let d = gaussian.dimension();
        let factor = gaussian.factor().ok()?;
        let mut mean: SmallVec<[f64; 6]> = SmallVec::from_slice(gaussian.information_vector());
        factor.solve(&mut mean);
        let mut shift: SmallVec<[f64; 6]> = SmallVec::from_elem(0.0, d);
        for index in (0..d).filter(|&index| self.coordinates[index] == Coordinate::Angle) {
            let mut column: SmallVec<[f64; 6]> = SmallVec::from_elem(0.0, d);
            column[index] = 1.0;
            factor.solve(&mut column);
            if column[index] <= KNOWN_ANGLE {
                let reference = *self.references[index].get_or_insert(mean[index]);
                shift[index] = TAU * ((reference - mean[index]) / TAU).round();
            }
        }
        shift.iter().any(|&turn| turn != 0.0).then(|| gaussian.shifted(&shift))
    }
}

pub(super) fn particle_product(
    incoming: Messages<'_, AnyMessage>,
    form: &ParticlesForm,
    stream: &mut Stream,
    out: &mut AnyMessage,
) -> Result<(), MessageError> {
    let all: SmallVec<[&AnyMessage; 16]> = incoming.iter().collect();
    // What can be read anywhere weighs the points of what cannot.
    let functions = || {
        let held =
            all.iter().filter(|message| message.particles().is_none()).map(|message| message.value.held());
        held.filter(|held| !held.is_vacuous())
    };
    let sets = all.iter().filter_map(|message| message.particles());
    let carried = carrier(sets.clone());
    let base = match carried {
        Some(sample) if sample.role() == Role::Sample => sample,
        // Likelihoods on points drawn from a known density: those points carry the product by importance.
        Some(values) if values.support.log_proposal.is_some() && functions().next().is_some() => values,
        Some(values) if functions().next().is_none() => values,
        _ => return drawn_product(&all, form, stream, out),
    };
    let mut product = match &mut out.value {
        // The storage of the old belief serves the new one.
        AnyValue::Particles(old) => std::mem::take(old),
        _ => Particles::default(),
    };
    product.clone_from(base);
    for other in sets.filter(|other| !std::ptr::eq(*other, base)) {
        product.absorb(other)?;
    }
    for function in functions() {
        function.add_logs(&out.coordinates, &product.support.points, 1.0, &mut product.log_weights)?;
    }
    if base.role() == Role::Likelihood
        && functions().next().is_some()
        && let Some(log_proposal) = &base.support.log_proposal
    {
        for (log, proposal) in product.log_weights.iter_mut().zip(log_proposal) {
            *log -= proposal;
        }
        product.role = Role::Sample;
    }
    product.normalise("the product of messages")?;
    out.value = AnyValue::Particles(product);
    Ok(())
}

/// No points yet, or only likelihoods whose points have no known density: points are drawn from the product of
/// the other messages. A product that is not yet a distribution stays as it is.
fn drawn_product(
    all: &[&AnyMessage],
    form: &ParticlesForm,
    stream: &mut Stream,
    out: &mut AnyMessage,
) -> Result<(), MessageError> {
    let mut product = DynamicGaussian::flat(out.coordinates.len());
    let mut mixtures = Vec::new();
    for message in all {
        match &message.value {
            AnyValue::Gaussian(gaussian) => product.add(gaussian)?,
            AnyValue::Mixture(mixture) => mixtures.push(mixture.clone()),
            AnyValue::Particles(_) => {}
            AnyValue::Categorical(_) => product.add(&message.value.held().to_gaussian()?.0)?,
        }
    }
    let (mut particles, loss) = if mixtures.is_empty() {
        if !Message::is_proper(&product) {
            out.value = AnyValue::Gaussian(product);
            return Ok(());
        }
        drawn_from_gaussians(&product, &out.coordinates, form.count, stream)?
    } else {
        mixtures.push(MixtureMessage::from_gaussian(&out.coordinates, &product));
        let edges: Vec<u32> = (0..mixtures.len() as u32).collect();
        let form_of_product = MixtureForm { samples: form.count, ..MixtureForm::default() };
        let product = MixtureMessage::product(Messages::new(&mixtures, &edges), &form_of_product, stream)?;
        if !Message::is_proper(&product) {
            out.value = AnyValue::Mixture(product);
            return Ok(());
        }
        let (particles, loss) = product.to_particles(form.count, stream)?;
        (particles, loss + product.loss().unwrap_or(0.0))
    };
    for other in all.iter().filter_map(|message| message.particles()) {
        particles.absorb(other)?;
    }
    particles.normalise("the product of messages")?;
    out.value = AnyValue::Particles(particles);
    out.lose(loss);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::AnyForm;
    use sumprod_graph::{Purpose, Space};

    fn product_of(messages: &[AnyMessage]) -> f64 {
        let edges: Vec<u32> = (0..messages.len() as u32).collect();
        let mut stream = Stream::new(1, 0, Purpose::Belief, 0);
        let product =
            AnyMessage::product(Messages::new(messages, &edges), &AnyForm::gaussian(), &mut stream).unwrap();
        product.moments().unwrap().mean[1]
    }

    #[test]
    fn only_messages_that_know_an_angle_meet_on_one_turn() {
        let space = Space::new([Coordinate::Real, Coordinate::Angle]);
        let message = |heading: f64, variance: f64| {
            AnyMessage::gaussian(&space, &[0.0, heading], &[1.0, 0.0, 0.0, variance]).unwrap()
        };
        let (sharp, other_turn) = (message(3.0, 0.01), message(3.2 - TAU, 0.01));
        assert!((product_of(&[sharp.clone(), other_turn]) - 3.1).abs() < 1e-12);
        // A line whose mean is four radians off with a standard deviation of two is no other turn.
        let vague = message(7.0, 4.0);
        let linear = (3.0 / 0.01 + 7.0 / 4.0) / (1.0 / 0.01 + 1.0 / 4.0);
        assert!((product_of(&[sharp.clone(), vague.clone()]) - linear).abs() < 1e-12);
        assert!((product_of(&[vague, sharp]) - linear).abs() < 1e-12);
    }
}
