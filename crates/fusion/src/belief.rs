//! What fusion asks of a family of beliefs: a division that is checked, a power, and how uncertain a belief is.
//!
//! | family | division | power |
//! |---|---|---|
//! | [`Gaussian`], [`DynamicGaussian`] | subtraction of informations, checked to leave none negative | exact |
//! | [`Categorical`] | subtraction of logarithms, where the divisor rules no state out | exact |
//! | [`MixtureMessage`] | by one Gaussian, where every component is narrower than it | component by component |
//! | [`AnyMessage`] | as the family it holds | as the family it holds |

use sumprod_graph::{Message, MessageError};
use sumprod_messages::{
    AnyMessage, AnyValue, Categorical, Cholesky, DynamicGaussian, Gaussian, Mixture, MixtureMessage, Moments,
};

use crate::intersection::{inverse_moments, log_determinant};

/// Negative information that is rounding, relative to the information that was divided.
const ROUNDING: f64 = 1e-9;

/// What an intersection makes small.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Criterion {
    /// The determinant of the covariance; of states, the entropy.
    #[default]
    Determinant,
    /// The trace of the covariance, which needs coordinates of one unit; of states, the entropy.
    Trace,
}

/// A family whose beliefs can be fused.
///
/// # Laws
///
/// What was multiplied in can be removed: of beliefs b and m, `b·m` without `m` is b. `b` to the power 1 is b, to the
/// power 0 it says nothing, and powers add under the product.
pub trait Fusible: Message {
    /// This belief with what is `common` divided out, where a message is left.
    ///
    /// # Errors
    ///
    /// The reason, as part of a sentence: information that turns negative along some direction, a state that was ruled
    /// out, or a divisor that the family cannot divide by.
    fn remove(&self, common: &Self) -> Result<Self, String>;

    /// This belief raised to the power `exponent`, from 0 to 1. Of a mixture it is the power of each component, which
    /// is exact where they are far apart.
    ///
    /// # Errors
    ///
    /// Where the family has no powers.
    fn power(&self, exponent: f64) -> Result<Self, MessageError>;

    /// Half the logarithm of the determinant of the covariance or, by the criterion, that of its trace; of states the
    /// entropy (nats).
    ///
    /// # Errors
    ///
    /// Where the belief is improper.
    fn uncertainty(&self, criterion: Criterion) -> Result<f64, MessageError>;

    /// The inverse covariance intersection with another belief, and the weight found; see
    /// [`crate::intersection::inverse`].
    ///
    /// # Errors
    ///
    /// Where the family is not Gaussian, or a belief is improper.
    fn inverse_intersection(
        &self,
        _other: &Self,
        _criterion: Criterion,
    ) -> Result<(Self, f64), MessageError> {
        Err(MessageError::Unsupported(
            "the inverse covariance intersection is for Gaussian beliefs alone; choose the covariance intersection"
                .into(),
        ))
    }
}

/// Refuses an information (row-major) with a direction more negative than rounding of `divided` explains.
fn check_semidefinite(left: &[f64], divided: impl Fn(usize) -> f64, d: usize) -> Result<(), String> {
    let mut shifted = left.to_vec();
    for k in 0..d {
        shifted[k * d + k] += (ROUNDING * divided(k).abs()).max(f64::MIN_POSITIVE);
    }
    if Cholesky::new(&shifted, d, "what is left").is_ok() {
        return Ok(());
    }
    if let Some(value) = left.iter().find(|value| !value.is_finite()) {
        return Err(format!("an information is {value}"));
    }
    let eigen = nalgebra::DMatrix::from_row_slice(d, d, left).symmetric_eigen();
    let (weakest, value) = eigen.eigenvalues.argmin();
    let direction: Vec<String> =
        eigen.eigenvectors.column(weakest).iter().map(|x| format!("{x:.3}")).collect();
    Err(format!(
        "its information is {value:.3e} along ({}), so the common belief is narrower there than the one it is part of",
        direction.join(", ")
    ))
}

fn spread(covariance: &[f64], d: usize, criterion: Criterion) -> Result<f64, MessageError> {
    match criterion {
        Criterion::Determinant => {
            Ok(0.5 * Cholesky::new(covariance, d, "the covariance of the belief")?.log_determinant())
        }
        Criterion::Trace => Ok(0.5 * (0..d).map(|k| covariance[k * d + k]).sum::<f64>().ln()),
    }
}

impl<const D: usize> Fusible for Gaussian<D> {
    fn remove(&self, common: &Self) -> Result<Self, String> {
        let information = self.information() - common.information();
        check_semidefinite(information.as_slice(), |k| self.information()[(k, k)], D)?;
        Ok(Self::from_information(information, self.information_vector() - common.information_vector()))
    }

    fn power(&self, exponent: f64) -> Result<Self, MessageError> {
        Ok(Self::from_information(self.information() * exponent, self.information_vector() * exponent))
    }

    fn uncertainty(&self, criterion: Criterion) -> Result<f64, MessageError> {
        match criterion {
            Criterion::Determinant => Ok(-0.5 * log_determinant(self.information().as_slice(), D)?),
            Criterion::Trace => spread(self.moments()?.1.as_slice(), D, criterion),
        }
    }

    fn inverse_intersection(&self, other: &Self, criterion: Criterion) -> Result<(Self, f64), MessageError> {
        let (moments, weight) = inverse_moments(&self.to_moments()?, &other.to_moments()?, criterion)?;
        let mean = nalgebra::SVector::from_column_slice(&moments.mean);
        let covariance = nalgebra::SMatrix::from_column_slice(&moments.covariance);
        Ok((Self::from_moments(mean, covariance)?, weight))
    }
}

impl Fusible for DynamicGaussian {
    fn remove(&self, common: &Self) -> Result<Self, String> {
        let d = self.dimension();
        if common.dimension() != d {
            return Err(format!("the common belief has {} coordinates, not {d}", common.dimension()));
        }
        let left = self.over(common);
        let mut information = vec![0.0; d * d];
        left.write_matrix(&mut information);
        check_semidefinite(&information, |k| self.information_at(k, k), d)?;
        Ok(left)
    }

    fn power(&self, exponent: f64) -> Result<Self, MessageError> {
        Ok(DynamicGaussian::power(self, exponent))
    }

    fn uncertainty(&self, criterion: Criterion) -> Result<f64, MessageError> {
        match criterion {
            Criterion::Determinant => Ok(-0.5 * self.factor()?.log_determinant()),
            Criterion::Trace => spread(&self.moments()?.covariance, self.dimension(), criterion),
        }
    }

    fn inverse_intersection(&self, other: &Self, criterion: Criterion) -> Result<(Self, f64), MessageError> {
        let (moments, weight) = inverse_moments(&self.moments()?, &other.moments()?, criterion)?;
        Ok((Self::from_moments(&moments.mean, &moments.covariance)?, weight))
    }
}

impl Fusible for Categorical {
    fn remove(&self, common: &Self) -> Result<Self, String> {
        if common.states() != self.states() {
            return Err(format!("the common belief has {} states, not {}", common.states(), self.states()));
        }
        // A state that both rule out stays ruled out, and says nothing of the others.
        let pairs = self.logs().iter().zip(common.logs());
        let logs: Vec<f64> = pairs
            .enumerate()
            .map(|(state, (own, other))| match *other {
                f64::NEG_INFINITY if *own > f64::NEG_INFINITY => Err(format!(
                    "the common belief rules state {state} out, and the one that it is part of does not"
                )),
                f64::NEG_INFINITY => Ok(f64::NEG_INFINITY),
                other => Ok(own - other),
            })
            .collect::<Result<_, _>>()?;
        Self::new(&logs).map_err(|error| error.to_string())
    }

    fn power(&self, exponent: f64) -> Result<Self, MessageError> {
        // What is ruled out stays so, at the power zero as well.
        let logs: Vec<f64> = self
            .logs()
            .iter()
            .map(|&log| if log == f64::NEG_INFINITY { log } else { exponent * log })
            .collect();
        Self::new(&logs)
    }

    fn uncertainty(&self, _criterion: Criterion) -> Result<f64, MessageError> {
        Ok(self.probabilities().iter().filter(|&&p| p > 0.0).map(|p| -p * p.ln()).sum())
    }
}

impl Fusible for MixtureMessage {
    fn remove(&self, common: &Self) -> Result<Self, String> {
        let single = common.len() == 1;
        if !single {
            return Err(format!(
                "the common belief has {} components, and a mixture can be divided by one Gaussian alone",
                common.len()
            ));
        }
        // A density of one component is one Gaussian as well.
        let divisor = match common.density() {
            Some(_) => {
                let moments = common.moments().map_err(|error| error.to_string())?;
                let gaussian = DynamicGaussian::from_moments(&moments.mean, &moments.covariance);
                Self::from_gaussian(common.coordinates(), &gaussian.map_err(|error| error.to_string())?)
            }
            None => common.clone(),
        };
        let belief: Self = self.to_potential().into();
        let left = belief.quotient(&divisor).ok_or("the quotient is no mixture")?;
        let Some(potential) = left.potential() else { return Ok(left) };
        let d = potential.dimension();
        for component in 0..potential.len() {
            let own = belief.potential().filter(|own| own.len() == potential.len());
            let divided = |k: usize| own.map_or(0.0, |own| own.information_of(component)[k * d + k]);
            check_semidefinite(potential.information_of(component), divided, d)
                .map_err(|reason| format!("of component {component} {reason}"))?;
        }
        Ok(left)
    }

    fn power(&self, exponent: f64) -> Result<Self, MessageError> {
        if exponent <= 0.0 {
            return Ok(Self::flat(self.coordinates()));
        }
        let density = self.to_density()?;
        let weights = density.log_weights().iter().enumerate().map(|(k, log)| {
            // ∫ N(x; m, C)^e dx = (2π)^{d(1-e)/2} |C|^{(1-e)/2} e^{-d/2}: the constants are those of all components.
            let spread = log_determinant(density.covariance_of(k), density.dimension())?;
            Ok(exponent * log + 0.5 * (1.0 - exponent) * spread)
        });
        let weights = weights.collect::<Result<Vec<f64>, MessageError>>()?;
        let covariances = (0..density.len())
            .flat_map(|k| density.covariance_of(k).iter().map(|value| value / exponent).collect::<Vec<_>>())
            .collect();
        Ok(Mixture::new(&density.space(), weights, density.means().to_vec(), covariances)?.into())
    }

    fn uncertainty(&self, criterion: Criterion) -> Result<f64, MessageError> {
        let Moments { mean, covariance } = self.moments()?;
        spread(&covariance, mean.len(), criterion)
    }
}

impl Fusible for AnyMessage {
    fn remove(&self, common: &Self) -> Result<Self, String> {
        // The family's own check says why not; the quotient here keeps the coordinates and the losses.
        match (self.value(), common.value()) {
            (AnyValue::Gaussian(belief), AnyValue::Gaussian(common)) => belief.remove(common).map(drop)?,
            (AnyValue::Categorical(belief), AnyValue::Categorical(common)) => {
                return belief.remove(common).map(Self::from_categorical);
            }
            (AnyValue::Mixture(belief), AnyValue::Mixture(common)) => {
                return belief.remove(common).map(Self::from_mixture);
            }
            _ => {}
        }
        self.quotient(common).ok_or_else(|| "beliefs of these forms cannot be divided".to_owned())
    }

    fn power(&self, exponent: f64) -> Result<Self, MessageError> {
        match self.value() {
            AnyValue::Gaussian(gaussian) => {
                let mut power = self.clone();
                let scaled = Fusible::power(gaussian, exponent)?;
                let d = scaled.dimension();
                let mut information = vec![0.0; d * d];
                scaled.write_matrix(&mut information);
                let vector = scaled.information_vector().to_vec();
                sumprod_messages::GaussianFamily::write_information(
                    &mut power,
                    self,
                    &information,
                    &vector,
                    0.0,
                )?;
                Ok(power)
            }
            AnyValue::Categorical(states) => Ok(Self::from_categorical(states.power(exponent)?)),
            AnyValue::Mixture(mixture) => Ok(Self::from_mixture(mixture.power(exponent)?)),
            AnyValue::Particles(_) => Err(MessageError::Unsupported(
                "particles have no power; hold the belief as a Gaussian or a mixture".into(),
            )),
        }
    }

    fn uncertainty(&self, criterion: Criterion) -> Result<f64, MessageError> {
        match self.value() {
            AnyValue::Categorical(states) => states.uncertainty(criterion),
            _ => {
                let Moments { mean, covariance } = self.moments()?;
                spread(&covariance, mean.len(), criterion)
            }
        }
    }
}
