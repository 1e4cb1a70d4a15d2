//! Products of mixture messages of any rank, by methods that know densities alone.
//!
//! A message that leaves directions open has no covariance, but its product with a prior has. A wide Gaussian h is
//! taken out of a density, whose every component knows at least twice as much, and spread over the k potentials:
//!
//! p Π uₗ = (p / h) Π (uₗ h^(1/k)).
//!
//! Both sides are the same function, and on the right every factor is a density.

use super::potential::Potential;
use super::small::{Small, difference, invert, multiply};
use super::times::Local;
use super::{Mixture, MixtureForm, MixtureMessage, Product};
use std::borrow::Cow;
use sumprod_graph::{Coordinate, MessageError, Stream};

/// The product of `messages`, at most the form's number of components.
pub(super) fn product(
    messages: &[&MixtureMessage],
    coordinates: &[Coordinate],
    form: &MixtureForm,
    stream: &mut Stream,
) -> Result<MixtureMessage, MessageError> {
    let loss: f64 = messages.iter().filter_map(|message| message.loss()).sum();
    let mut densities: Vec<Cow<'_, Mixture>> = Vec::new();
    let mut potentials: Vec<Cow<'_, Potential>> = Vec::new();
    let mut single: Option<Potential> = None;
    for message in messages {
        super::size("a message of the product", message.coordinates().len(), coordinates.len())?;
        if let Some(density) = message.density() {
            densities.push(Cow::Borrowed(density));
        }
        match message.potential() {
            Some(potential) if potential.len() > 1 => potentials.push(Cow::Borrowed(potential)),
            Some(potential) => {
                single = Some(match single {
                    Some(own) => own.times_single(potential.local(0), 1.0),
                    None => potential.clone(),
                });
            }
            None => {}
        }
    }
    if let Some(single) = single {
        if let Some(density) = densities.first_mut() {
            if !single.is_flat() {
                *density = Cow::Owned(density.times_local(single.local(0))?.0);
            }
        } else if let Ok((density, _)) = single.to_density() {
            densities.push(Cow::Owned(density));
        } else if let Some(potential) = potentials.first_mut() {
            *potential = Cow::Owned(potential.times_single(single.local(0), 1.0));
        } else {
            return Ok(MixtureMessage::from(single.checked("the product of messages")?).costing(loss));
        }
    }
    if densities.is_empty() {
        let proper: Result<Vec<Mixture>, MessageError> =
            potentials.iter().map(|potential| Ok(potential.to_density()?.0)).collect();
        match proper {
            Ok(proper) => densities.extend(proper.into_iter().map(Cow::Owned)),
            Err(_) => return open_product(&potentials, form).map(|product| product.costing(loss)),
        }
    } else {
        lift(&mut densities, &potentials)?;
    }
    finish(&densities, form, stream).map(|product| product.costing(loss))
}

/// The product of densities, held as the form asks.
fn finish(
    densities: &[Cow<'_, Mixture>],
    form: &MixtureForm,
    stream: &mut Stream,
) -> Result<MixtureMessage, MessageError> {
    if let [density] = densities {
        let (fewer, loss) = density.fewer(form.components, None)?;
        return Ok(MixtureMessage::from(fewer).costing(loss));
    }
    let inputs: Vec<&Mixture> = densities.iter().map(AsRef::as_ref).collect();
    let Product { particles, mixture, near, quality, .. } =
        form.method().product(&inputs, form.samples, stream)?;
    let (held, loss) = match mixture.or(near) {
        Some(mixture) => {
            let (fewer, loss) = mixture.fewer(form.components, None)?;
            (MixtureMessage::from(fewer), loss)
        }
        None => MixtureMessage::from_particles(&particles, form)?,
    };
    Ok(held.costing(loss).found_by(quality))
}

/// Makes densities of `potentials`, with a wide Gaussian that is taken out of the first density.
fn lift(
    densities: &mut Vec<Cow<'_, Mixture>>,
    potentials: &[Cow<'_, Potential>],
) -> Result<(), MessageError> {
    let Some(base) = densities.first_mut() else { return Ok(()) };
    if potentials.is_empty() {
        return Ok(());
    }
    let wide = Wide::beside(base);
    let negative: Small = wide.information.iter().map(|entry| -entry).collect();
    let flat = Small::from_elem(0.0, wide.centre.len());
    let out = Local { centre: &wide.centre, gradient: &flat, information: &negative };
    *base = Cow::Owned(base.times_local(out)?.0);
    let share = Local { information: &wide.information, ..out };
    for potential in potentials {
        let lifted = potential.times_single(share, 1.0 / potentials.len() as f64);
        densities.push(Cow::Owned(lifted.to_density()?.0));
    }
    Ok(())
}

/// A Gaussian that knows at most half of what any component of a mixture knows.
struct Wide {
    centre: Small,
    information: Small,
}

impl Wide {
    fn beside(density: &Mixture) -> Self {
        let d = density.dimension();
        let moments = density.moments();
        let mut information = Small::from_elem(0.0, d * d);
        if invert(&moments.covariance, d, &mut information).is_none() {
            information.iter_mut().for_each(|entry| *entry = 0.0);
        }
        // The largest eigenvalue of P⁻¹ Cᵢ is at most its trace.
        let matrices = if density.shared_covariance().is_some() { 1 } else { density.len() };
        let ratio = (0..matrices)
            .map(|i| information.iter().zip(density.covariance_of(i)).map(|(a, b)| a * b).sum::<f64>())
            .fold(1.0, f64::max);
        information.iter_mut().for_each(|entry| *entry *= 0.5 / ratio);
        Self { centre: Small::from_slice(&moments.mean), information }
    }
}

/// The product of potentials that stays improper: all pairs, the form's number of them kept after each factor.
fn open_product(
    potentials: &[Cow<'_, Potential>],
    form: &MixtureForm,
) -> Result<MixtureMessage, MessageError> {
    let mut loss = 0.0;
    let mut product: Option<Potential> = None;
    for potential in potentials {
        let next = match product {
            None => potential.as_ref().clone(),
            Some(own) => {
                let mut pairs = Potential::new(own.coordinates());
                for k in 0..potential.len() {
                    let grown = own.times_single(potential.local(k), 1.0);
                    for i in 0..grown.len() {
                        push_at_summit(&grown, i, potential.log_value_of(k), &mut pairs);
                    }
                }
                let (fewer, cost) =
                    pairs.checked("the product of messages")?.reduce(form.components, None)?;
                loss += cost;
                fewer
            }
        };
        product = Some(next);
    }
    let Some(product) = product else {
        return Err(MessageError::Unsupported("a product needs at least one message".into()));
    };
    if let Ok((density, _)) = product.to_density() {
        let (fewer, cost) = density.fewer(form.components, None)?;
        return Ok(MixtureMessage::from(fewer).costing(loss + cost));
    }
    Ok(MixtureMessage::from(product).costing(loss))
}

/// Adds one component of `from`, its value raised by `log`, written about the top of its own ridge where that can be
/// found: far from there its value is no measure of what it weighs.
fn push_at_summit(from: &Potential, component: usize, log: f64, to: &mut Potential) {
    let d = from.dimension();
    let Local { centre, gradient, information } = from.local(component);
    // A ridge has no single top: a little information about the centre chooses one, and is not kept.
    let scale = (0..d).map(|k| information[k * d + k]).fold(0.0, f64::max);
    let mut damped = Small::from_slice(information);
    (0..d).for_each(|k| damped[k * d + k] += 1e-9 * scale + f64::MIN_POSITIVE);
    let mut inverse = Small::from_elem(0.0, d * d);
    let (mut step, mut pulled) = (Small::from_elem(0.0, d), Small::from_elem(0.0, d));
    if invert(&damped, d, &mut inverse).is_some() {
        multiply(&inverse, gradient, &mut step);
    }
    multiply(information, &step, &mut pulled);
    let summit: Small = centre.iter().zip(&step).map(|(c, s)| c + s).collect();
    let gain: f64 = (0..d).map(|k| step[k] * (gradient[k] - 0.5 * pulled[k])).sum();
    let left: Small = gradient.iter().zip(&pulled).map(|(g, p)| g - p).collect();
    let mut wrapped = Small::from_elem(0.0, d);
    difference(from.coordinates(), &summit, centre, &mut wrapped);
    if wrapped.iter().zip(&step).all(|(a, b)| (a - b).abs() < 1e-9 * (1.0 + b.abs())) {
        to.push(from.log_value_of(component) + log + gain, &summit, &left, information);
    } else {
        to.push(from.log_value_of(component) + log, centre, gradient, information);
    }
}
