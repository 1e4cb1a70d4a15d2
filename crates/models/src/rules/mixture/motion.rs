//! Mixtures through a motion, component by component.
//!
//! Ahead, N(m, P) becomes N(f(m), F P F' + B B'). Back, a component exp(a + g'δ - ½ δ'Λδ), δ = y - c, is averaged over
//! the noise z of y = f(x̄) + F (x - x̄) + B z: with M = I + B'ΛB it becomes
//!
//! Λ̃ = Λ - ΛBM⁻¹B'Λ,   g̃ = g - ΛBM⁻¹B'g,   ã = a - ½ ln |M| + ½ g'BM⁻¹B'g,
//!
//! whatever the rank of Λ and of B, and then is read in x.

use crate::ProcessNoise;
use crate::small::{Matrix, Vector, multiply, symmetrise, transpose, zeros};
use sumprod_graph::{Coordinate, MessageError, wrap_angle};
use sumprod_messages::{Cholesky, Mixture, MixtureMessage, Potential};

/// The predicted mixture; `ahead` gives the next state's mean and covariance.
pub(crate) fn predict(
    density: &Mixture,
    ahead: impl Fn(&[f64], &[f64]) -> (Vector, Matrix),
) -> Result<MixtureMessage, MessageError> {
    let (mut means, mut covariances) = (Vec::new(), Vec::new());
    for i in 0..density.len() {
        let (mean, covariance) = ahead(density.mean_of(i), density.covariance_of(i));
        means.extend(mean);
        covariances.extend(covariance);
    }
    let predicted = Mixture::new(&density.space(), density.log_weights().to_vec(), means, covariances)?;
    Ok(predicted.into())
}

/// What a message about the next state says of this one.
pub(crate) struct Retrodiction<'a> {
    /// The next state and the Jacobian there.
    pub(crate) linearise: &'a dyn Fn(&[f64]) -> (Vector, Matrix),
    pub(crate) noise: &'a dyn Fn(&[f64]) -> ProcessNoise,
    /// What is known of this state: where to linearise.
    pub(crate) guide: Option<Mixture>,
}

impl Retrodiction<'_> {
    pub(crate) fn message(&self, next: &Potential) -> Result<MixtureMessage, MessageError> {
        Ok(self.potential(next)?.checked("a component of the message")?.into())
    }

    /// The same before it is scaled: its values tell how well the motion agrees with the message.
    pub(crate) fn potential(&self, next: &Potential) -> Result<Potential, MessageError> {
        let d = next.dimension();
        let origin = Vector::from_elem(0.0, d);
        let places: Vec<&[f64]> = match &self.guide {
            Some(guide) => (0..guide.len()).map(|i| guide.mean_of(i)).collect(),
            None => vec![&origin],
        };
        let ahead: Vec<(Vector, Matrix)> = places.iter().map(|place| (self.linearise)(place)).collect();
        let mut message = Potential::new(next.coordinates());
        for k in 0..next.len() {
            let reach = |i: &usize| {
                local_value(next, k, &offset(next.coordinates(), &ahead[*i].0, next.centre_of(k)))
            };
            // Each component is linearised where it is most likely to have come from.
            let chosen = (0..places.len()).max_by(|a, b| reach(a).total_cmp(&reach(b))).unwrap_or(0);
            self.component(next, k, places[chosen], &ahead[chosen], &mut message)?;
        }
        Ok(message)
    }

    fn component(
        &self,
        next: &Potential,
        k: usize,
        place: &[f64],
        (ahead, jacobian): &(Vector, Matrix),
        out: &mut Potential,
    ) -> Result<(), MessageError> {
        let d = next.dimension();
        let noise = (self.noise)(place);
        let sources = noise.sources();
        let factor = Matrix::from_slice(noise.factor());
        let back = transpose(&factor, d, sources);
        let information = next.information_of(k);
        // Rows B'Λ, and M = I + B'ΛB.
        let seen = multiply(&back, information, d, d);
        let mut inner = multiply(&seen, &factor, d, sources);
        (0..sources).for_each(|i| inner[i * sources + i] += 1.0);
        symmetrise(&mut inner, sources);
        let inner = Cholesky::new(&inner, sources, "the message blurred by the process noise")?;
        let mut pulled = multiply(&back, next.gradient_of(k), d, 1);
        let mut whitened = pulled.clone();
        let gain = inner.squared_length(&mut whitened);
        inner.solve(&mut pulled);
        let mut inverse = zeros(sources * sources);
        inner.inverse(&mut inverse);
        let carried = multiply(&transpose(&seen, sources, d), &inverse, sources, sources);
        let removed = multiply(&carried, &seen, sources, d);
        let mut blurred: Matrix = information.iter().zip(&removed).map(|(a, b)| a - b).collect();
        symmetrise(&mut blurred, d);
        let lost = multiply(&transpose(&seen, sources, d), &pulled, sources, 1);
        let gradient: Vector = next.gradient_of(k).iter().zip(&lost).map(|(g, l)| g - l).collect();
        let delta = offset(next.coordinates(), ahead, next.centre_of(k));
        let pulled = multiply(&blurred, &delta, d, 1);
        let at_place: f64 = (0..d).map(|i| delta[i] * (gradient[i] - 0.5 * pulled[i])).sum();
        let value = next.log_value_of(k) + 0.5 * (gain - inner.log_determinant()) + at_place;
        let left: Vector = gradient.iter().zip(&pulled).map(|(g, p)| g - p).collect();
        let turned = transpose(jacobian, d, d);
        let own = multiply(&turned, &left, d, 1);
        let mut seen_here = multiply(&multiply(&turned, &blurred, d, d), jacobian, d, d);
        symmetrise(&mut seen_here, d);
        out.push(value, place, &own, &seen_here);
        Ok(())
    }
}

fn offset(coordinates: &[Coordinate], a: &[f64], b: &[f64]) -> Vector {
    let differences = a.iter().zip(b).zip(coordinates);
    differences
        .map(|((a, b), kind)| if *kind == Coordinate::Angle { wrap_angle(a - b) } else { a - b })
        .collect()
}

/// Log of one component at an offset from its centre.
fn local_value(potential: &Potential, component: usize, delta: &[f64]) -> f64 {
    let d = delta.len();
    let pulled = multiply(potential.information_of(component), delta, d, 1);
    (0..d).map(|i| delta[i] * (potential.gradient_of(component)[i] - 0.5 * pulled[i])).sum()
}
