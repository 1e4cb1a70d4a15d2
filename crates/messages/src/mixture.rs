//! Mixtures of Gaussians: messages of any shape, with closed-form moments, densities and products.
//!
//! p(x) = Σᵢ wᵢ N(x; mᵢ, Cᵢ), the weights held by their logarithms. A mixture whose components share one covariance
//! (a kernel density) holds it once, and most operations on it are then cheaper. An angular coordinate is read on
//! the branch nearest to a component's mean, which is exact to the mass of that component beyond half a turn.

mod bandwidth;
mod condense;
mod conditional;
mod conversion;
mod density;
mod family;
mod form;
mod kernels;
mod lift;
mod message;
mod modes;
mod parts;
mod potential;
mod product;
mod record;
mod reduction;
mod regions;
mod sample;
mod small;
mod times;
mod tree;

pub use bandwidth::Bandwidth;
pub use conditional::{Conditional, ConditionalDraw};
pub(crate) use conversion::drawn_loss;
pub use density::Evaluator;
pub use family::MixtureFamily;
pub use form::{BandwidthChoice, MixtureForm};
pub use message::MixtureMessage;
pub use modes::{Mode, modes};
pub use potential::Potential;
pub use product::{
    AnnealedGibbs, Auto, Exact, GaussianImportance, Gibbs, GibbsStart, Literal, MixtureImportance,
    MultiscaleGibbs, Pairwise, Pointwise, Product, ProductChoice, ProductMethod, ProductQuality,
};

use crate::vector::exponentials;
use crate::vector::log_sum;
use crate::{DynamicGaussian, Moments};
use record::MixtureRecord;
use serde::{Deserialize, Serialize};
use small::{Small, difference, invert, multiply, wrap_point};
use std::f64::consts::TAU;
use sumprod_graph::{Coordinate, MessageError, Space};

/// A mixture of Gaussians over a continuous variable.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "MixtureRecord", into = "MixtureRecord")]
pub struct Mixture {
    coordinates: Vec<Coordinate>,
    /// Their exponentials sum to one; none is minus infinity.
    log_weights: Vec<f64>,
    /// Component by component.
    means: Vec<f64>,
    /// Row-major, component by component; one alone where all share it.
    covariances: Vec<f64>,
    shared: bool,
}

impl Mixture {
    /// A mixture from log weights (of any total), means (component by component) and covariances (row-major,
    /// component by component). Components of weight zero are left out; angles are wrapped.
    ///
    /// # Errors
    ///
    /// Where there is no component, no weight is positive, sizes do not agree, a number is not finite, or a
    /// covariance is not positive definite.
    pub fn new(
        space: &Space,
        log_weights: Vec<f64>,
        means: Vec<f64>,
        covariances: Vec<f64>,
    ) -> Result<Self, MessageError> {
        Self::checked(space, log_weights, means, covariances, false)
    }

    /// As [`Mixture::new`] with one covariance that all components share: a kernel density.
    ///
    /// # Errors
    ///
    /// As [`Mixture::new`].
    pub fn with_shared_covariance(
        space: &Space,
        log_weights: Vec<f64>,
        means: Vec<f64>,
        covariance: Vec<f64>,
    ) -> Result<Self, MessageError> {
        Self::checked(space, log_weights, means, covariance, true)
    }

    /// The mixture of one component.
    ///
    /// # Errors
    ///
    /// Where the Gaussian is improper or its dimension is not the space's.
    pub fn from_gaussian(space: &Space, gaussian: &DynamicGaussian) -> Result<Self, MessageError> {
        let Moments { mean, covariance } = gaussian.moments()?;
        Self::with_shared_covariance(space, vec![0.0], mean, covariance)
    }

    fn checked(
        space: &Space,
        log_weights: Vec<f64>,
        means: Vec<f64>,
        covariances: Vec<f64>,
        shared: bool,
    ) -> Result<Self, MessageError> {
        let (Space::Continuous(_) | Space::Se2, Some(coordinates)) = (space, space.coordinates()) else {
            return Err(MessageError::Unsupported("a mixture needs a continuous variable".into()));
        };
        let (d, count) = (coordinates.len(), log_weights.len());
        if d == 0 {
            return Err(MessageError::Unsupported("a mixture needs a variable with coordinates".into()));
        }
        if count == 0 {
            return Err(MessageError::Unsupported("a mixture needs at least one component".into()));
        }
        let matrices = if shared { 1 } else { count };
        size("the mixture's means", means.len(), count * d)?;
        size("the mixture's covariances", covariances.len(), matrices * d * d)?;
        if let Some(&value) = log_weights.iter().find(|log| log.is_nan() || **log == f64::INFINITY) {
            return Err(MessageError::NotFinite { what: "a log weight of a mixture", value });
        }
        finite("a mean of a mixture", &means)?;
        finite("a covariance of a mixture", &covariances)?;
        let mut inverse = Small::from_elem(0.0, d * d);
        for matrix in covariances.chunks_exact(d * d) {
            if invert(matrix, d, &mut inverse).is_none() {
                let what = "a covariance of a mixture";
                crate::Cholesky::new(matrix, d, what)?;
                return Err(MessageError::NotPositiveDefinite {
                    what,
                    pivot: d - 1,
                    value: matrix[d * d - 1],
                });
            }
        }
        let mut mixture = Self { coordinates: coordinates.to_vec(), log_weights, means, covariances, shared };
        mixture.symmetrise();
        mixture.drop_zero_weights();
        mixture.normalise("the mixture")?;
        for mean in mixture.means.chunks_exact_mut(d) {
            wrap_point(&mixture.coordinates, mean);
        }
        Ok(mixture)
    }

    /// From parts that are right by construction, of any total weight; returns the log of that total.
    fn assemble(
        coordinates: &[Coordinate],
        log_weights: Vec<f64>,
        means: Vec<f64>,
        covariances: Vec<f64>,
        shared: bool,
    ) -> Result<(Self, f64), MessageError> {
        let coordinates = coordinates.to_vec();
        let mut mixture = Self { coordinates, log_weights, means, covariances, shared };
        let total = mixture.normalise("the product of mixtures")?;
        Ok((mixture, total))
    }

    fn symmetrise(&mut self) {
        let d = self.coordinates.len();
        for matrix in self.covariances.chunks_exact_mut(d * d) {
            for row in 0..d {
                for column in 0..row {
                    matrix[column * d + row] = matrix[row * d + column];
                }
            }
        }
    }

    fn drop_zero_weights(&mut self) {
        if self.log_weights.contains(&f64::NEG_INFINITY) {
            let kept: Vec<usize> = (0..self.len()).filter(|&i| self.log_weights[i].is_finite()).collect();
            if !kept.is_empty() {
                *self = self.select(&kept);
            }
        }
    }

    /// The components of these numbers, with their weights as they are.
    fn select(&self, components: &[usize]) -> Self {
        let d = self.dimension();
        Self {
            coordinates: self.coordinates.clone(),
            log_weights: components.iter().map(|&i| self.log_weights[i]).collect(),
            means: components.iter().flat_map(|&i| self.mean_of(i)).copied().collect(),
            covariances: if self.shared {
                self.covariances.clone()
            } else {
                components.iter().flat_map(|&i| &self.covariances[i * d * d..][..d * d]).copied().collect()
            },
            shared: self.shared,
        }
    }

    /// The first of the components with the largest weight.
    fn heaviest(&self) -> usize {
        // The largest first, by itself, which needs no number to be carried along.
        let largest = crate::vector::largest(&self.log_weights);
        self.log_weights.iter().position(|&log| log == largest).unwrap_or(0)
    }

    /// Makes the weights sum to one and returns the log of their total.
    fn normalise(&mut self, what: &'static str) -> Result<f64, MessageError> {
        let total = match self.log_weights.iter().find(|log| log.is_nan()) {
            Some(&value) => value,
            None => log_sum(&self.log_weights),
        };
        if total.is_nan() {
            return Err(MessageError::NotFinite { what: "a log weight of a mixture", value: total });
        }
        if !total.is_finite() {
            let remedy = "give at least one component a positive weight";
            return Err(MessageError::NoWeight { what, largest: total, remedy });
        }
        self.log_weights.iter_mut().for_each(|log| *log -= total);
        Ok(total)
    }

    /// Number of components.
    pub fn len(&self) -> usize {
        self.log_weights.len()
    }

    /// Whether there is no component, which no constructor allows.
    pub fn is_empty(&self) -> bool {
        self.log_weights.is_empty()
    }

    /// Number of coordinates.
    pub fn dimension(&self) -> usize {
        self.coordinates.len()
    }

    /// The coordinates, real or angular.
    pub fn coordinates(&self) -> &[Coordinate] {
        &self.coordinates
    }

    /// The variable's space.
    pub fn space(&self) -> Space {
        Space::new(self.coordinates.clone())
    }

    /// Log weights, component by component; their exponentials sum to one.
    pub fn log_weights(&self) -> &[f64] {
        &self.log_weights
    }

    /// Weights, component by component; they sum to one.
    pub fn weights(&self) -> Vec<f64> {
        let mut weights = Vec::new();
        exponentials(&self.log_weights, 0.0, &mut weights);
        weights
    }

    /// The means, one after the other.
    pub fn means(&self) -> &[f64] {
        &self.means
    }

    /// The mean of one component.
    pub fn mean_of(&self, component: usize) -> &[f64] {
        let d = self.dimension();
        &self.means[component * d..(component + 1) * d]
    }

    /// The covariance of one component, row-major.
    pub fn covariance_of(&self, component: usize) -> &[f64] {
        let entries = self.dimension() * self.dimension();
        let start = if self.shared { 0 } else { component * entries };
        &self.covariances[start..start + entries]
    }

    /// The covariance that all components share, row-major; none where each has its own.
    pub fn shared_covariance(&self) -> Option<&[f64]> {
        self.shared.then_some(self.covariances.as_slice())
    }

    /// Mean and covariance of the mixture; the mean of an angle is the direction of the mean vector, and the
    /// covariance is about it. O(N d²).
    pub fn moments(&self) -> Moments {
        let d = self.dimension();
        let weights = self.weights();
        let mut mean = vec![0.0; d];
        for (k, kind) in self.coordinates.iter().enumerate() {
            let values = weights.iter().zip(self.means.iter().skip(k).step_by(d));
            mean[k] = match kind {
                Coordinate::Real => values.map(|(weight, x)| weight * x).sum(),
                Coordinate::Angle => {
                    let (sine, cosine) = values.enumerate().fold((0.0, 0.0), |(s, c), (i, (weight, x))| {
                        // The mean resultant length of a wrapped normal of this variance.
                        let length = weight * (-0.5 * self.covariance_of(i)[k * d + k]).exp();
                        (s + length * x.sin(), c + length * x.cos())
                    });
                    sine.atan2(cosine)
                }
            };
        }
        let mut covariance = vec![0.0; d * d];
        let mut offset = Small::from_elem(0.0, d);
        for (i, weight) in weights.iter().enumerate() {
            difference(&self.coordinates, self.mean_of(i), &mean, &mut offset);
            let kernel = self.covariance_of(i);
            for row in 0..d {
                for column in 0..d {
                    covariance[row * d + column] +=
                        weight * (kernel[row * d + column] + offset[row] * offset[column]);
                }
            }
        }
        Moments { mean, covariance }
    }

    /// Log density at one point; minus infinity only where it underflows the logarithm itself. O(N d²): for many
    /// points use [`Evaluator`].
    ///
    /// # Errors
    ///
    /// Where the point's dimension is not the mixture's.
    pub fn log_density(&self, point: &[f64]) -> Result<f64, MessageError> {
        let d = self.dimension();
        size("the point", point.len(), d)?;
        let mut inverse = Small::from_elem(0.0, d * d);
        let (mut offset, mut scaled) = (Small::from_elem(0.0, d), Small::from_elem(0.0, d));
        let mut log_determinant = 0.0;
        let mut logs = Vec::with_capacity(self.len());
        for i in 0..self.len() {
            if i == 0 || !self.shared {
                log_determinant = invert(self.covariance_of(i), d, &mut inverse).unwrap_or(f64::INFINITY);
            }
            difference(&self.coordinates, point, self.mean_of(i), &mut offset);
            multiply(&inverse, &offset, &mut scaled);
            let squared: f64 = scaled.iter().zip(&offset).map(|(a, b)| a * b).sum();
            logs.push(self.log_weights[i] - 0.5 * (squared + log_determinant));
        }
        Ok(log_sum(&logs) - 0.5 * d as f64 * TAU.ln())
    }

    /// Whether `other` lives on the same coordinates.
    fn check_like(&self, other: &Self, what: &'static str) -> Result<(), MessageError> {
        size(what, other.dimension(), self.dimension())?;
        if self.coordinates != other.coordinates {
            let reason = "the mixtures differ in which coordinates are angles";
            return Err(MessageError::Unsupported(reason.into()));
        }
        Ok(())
    }
}

fn size(what: &'static str, found: usize, expected: usize) -> Result<(), MessageError> {
    if found == expected { Ok(()) } else { Err(MessageError::Dimension { what, found, expected }) }
}

fn finite(what: &'static str, values: &[f64]) -> Result<(), MessageError> {
    match values.iter().find(|value| !value.is_finite()) {
        Some(&value) => Err(MessageError::NotFinite { what, value }),
        None => Ok(()),
    }
}
