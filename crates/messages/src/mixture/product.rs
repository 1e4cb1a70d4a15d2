//! Products of mixtures: exact where they can be, sampled where not, and their quality measured.
//!
//! The product of L mixtures of N components is a mixture of N^L components, one per choice of a label from each
//! input. A choice (i₁ … i_L) has covariance Λ̄⁻¹ with Λ̄ = Σₗ Cₗ⁻¹, mean Λ̄⁻¹ Σₗ Cₗ⁻¹ mₗ and weight
//! Πₗ wₗ N(x; mₗ, Cₗ) / N(x; mean, Λ̄⁻¹) at any x. Methods differ in which choices they visit.

mod annealed;
mod auto;
mod chains;
mod exact;
mod gibbs;
mod importance;
mod literal;
mod multiscale;
mod pairs;
mod pairwise;
mod quality;

pub use annealed::AnnealedGibbs;
pub use auto::{Auto, ProductChoice};
pub use exact::Exact;
pub use gibbs::{Gibbs, GibbsStart};
pub use importance::{GaussianImportance, MixtureImportance, Pointwise};
pub use literal::Literal;
pub use multiscale::MultiscaleGibbs;
pub use pairwise::Pairwise;
pub use quality::ProductQuality;

use super::sample::comb;
use super::{Mixture, Mode, modes};
use crate::{Moments, Particles};
use rand::RngExt;
use std::borrow::Cow;
use sumprod_graph::{MessageError, Stream};

/// A way to multiply mixtures.
///
/// ```
/// use sumprod_graph::{Purpose, Space, Stream};
/// use sumprod_messages::{Auto, Mixture, ProductMethod};
///
/// let line = Space::real(1);
/// let left = Mixture::with_shared_covariance(&line, vec![0.0, 0.0], vec![-3.0, 3.0], vec![0.5])?;
/// let right = Mixture::with_shared_covariance(&line, vec![0.0, 0.0], vec![2.5, 9.0], vec![0.5])?;
/// let mut stream = Stream::new(1, 0, Purpose::User(0), 0);
/// let product = Auto::default().product(&[&left, &right], 1000, &mut stream)?;
/// assert!((product.moments().mean[0] - 2.75).abs() < 1e-6);
/// assert_eq!(product.quality.method, "exact");
/// # Ok::<(), sumprod_graph::MessageError>(())
/// ```
pub trait ProductMethod {
    /// The method's name, as forms and reports write it.
    fn name(&self) -> &'static str;

    /// The product of `inputs` as `samples` points, and as a mixture where the method finds one.
    ///
    /// # Errors
    ///
    /// Where there is no input or no sample, the inputs differ in their coordinates, they have disjoint supports, or
    /// the product is too large for the method.
    fn product(
        &self,
        inputs: &[&Mixture],
        samples: usize,
        stream: &mut Stream,
    ) -> Result<Product, MessageError>;
}

/// A product of mixtures.
#[derive(Clone, Debug, PartialEq)]
pub struct Product {
    /// Points that carry the product, weighted where the method weighs them.
    pub particles: Particles,
    /// The product itself, where the method is exact.
    pub mixture: Option<Mixture>,
    /// A mixture near the product, where the method is not exact but finds one: of the Gaussians that a sampler's last
    /// labels choose, or of what pairs were condensed to. Smoother than the points, and uncorrected by their weights.
    pub near: Option<Mixture>,
    /// Log of the integral of the product of the (normalised) inputs: exact, or an estimate.
    pub log_normaliser: Option<f64>,
    /// How it was found and how good it is.
    pub quality: ProductQuality,
}

impl Product {
    /// Mean and covariance: of the mixture where there is one, else of the points.
    pub fn moments(&self) -> Moments {
        self.mixture.as_ref().map_or_else(|| self.particles.moments(), Mixture::moments)
    }

    /// The points as `count` of equal weights, by a comb over the weights; points repeat where weights differ.
    ///
    /// # Errors
    ///
    /// Where `count` is zero.
    pub fn equally_weighted(&self, count: usize, stream: &mut Stream) -> Result<Particles, MessageError> {
        let d = self.particles.dimension();
        let mut points = Vec::with_capacity(count * d);
        let mut sum = 0.0;
        let cumulative: Vec<f64> = self
            .particles
            .weights()
            .iter()
            .map(|weight| {
                sum += weight;
                sum
            })
            .collect();
        for index in comb(&cumulative, count, stream.fast().random()) {
            points.extend_from_slice(self.particles.point(index));
        }
        Particles::equally_weighted(&sumprod_graph::Space::new(self.particles.coordinates()), points)
    }

    /// The modes of the product of `inputs` with the share of this product's weight in the basin of each, climbing
    /// from at most `points` of its points; their number, and that of each input, go into the quality record.
    ///
    /// # Errors
    ///
    /// As [`modes`].
    pub fn find_modes(
        &mut self,
        inputs: &[&Mixture],
        points: usize,
        stream: &mut Stream,
    ) -> Result<Vec<Mode>, MessageError> {
        let climbers = self.equally_weighted(points.max(1), stream)?;
        let found = modes(inputs, &climbers)?;
        let before: Result<Vec<usize>, MessageError> =
            inputs.iter().map(|input| Ok(input.modes(points.max(1), stream)?.len())).collect();
        self.quality.modes_before = Some(before?);
        self.quality.modes_after = Some(found.len());
        Ok(found)
    }
}

/// The first input, if there is one and all live on the same coordinates.
pub(super) fn check_inputs<'a>(inputs: &[&'a Mixture]) -> Result<&'a Mixture, MessageError> {
    let Some(first) = inputs.first() else {
        return Err(MessageError::Unsupported("a product of mixtures needs at least one mixture".into()));
    };
    for input in inputs {
        first.check_like(input, "a mixture of the product")?;
    }
    Ok(first)
}

fn check<'a>(inputs: &[&'a Mixture], samples: usize) -> Result<&'a Mixture, MessageError> {
    if samples == 0 {
        let reason = "a product of mixtures was asked for 0 samples; ask for at least 1";
        return Err(MessageError::Unsupported(reason.into()));
    }
    check_inputs(inputs)
}

/// The inputs with every mixture of one component multiplied into another exactly, and the log normaliser of that.
fn absorb<'a>(inputs: &[&'a Mixture]) -> Result<(Vec<Cow<'a, Mixture>>, f64), MessageError> {
    let mut many: Vec<Cow<'a, Mixture>> =
        inputs.iter().filter(|input| input.len() > 1).map(|input| Cow::Borrowed(*input)).collect();
    let mut log_normaliser = 0.0;
    let mut single: Option<Cow<'a, Mixture>> = None;
    for input in inputs.iter().filter(|input| input.len() == 1) {
        single = Some(match single {
            None => Cow::Borrowed(*input),
            Some(other) => {
                let product = pairs::multiply(&other, input, f64::INFINITY)?;
                log_normaliser += product.log_normaliser;
                Cow::Owned(product.mixture)
            }
        });
    }
    if let Some(single) = single {
        let smallest = (0..many.len()).min_by_key(|&l| many[l].len());
        match smallest {
            None => many.push(single),
            Some(l) => {
                let product = pairs::multiply(&single, &many[l], f64::INFINITY)?;
                log_normaliser += product.log_normaliser;
                many[l] = Cow::Owned(product.mixture);
            }
        }
    }
    Ok((many, log_normaliser))
}

/// Number of label choices, as a real number since it overflows integers.
fn choices(inputs: &[impl AsRef<Mixture>]) -> f64 {
    inputs.iter().map(|input| input.as_ref().len() as f64).product()
}

impl AsRef<Mixture> for Mixture {
    fn as_ref(&self) -> &Mixture {
        self
    }
}
