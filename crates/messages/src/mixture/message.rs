//! A mixture as an edge carries it: a density, or a potential that leaves directions open.

use super::potential::Potential;
use super::{Evaluator, Mixture, ProductQuality};
use crate::{DynamicGaussian, Moments};
use serde::{Deserialize, Serialize};
use sumprod_graph::{Coordinate, MessageError};

/// What the message is held by.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
enum Held {
    Density(Mixture),
    Potential(Potential),
}

/// A mixture message: a density where every component is proper, else a potential.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MixtureMessage {
    held: Held,
    /// Divergence (nats) of the reductions and conversions on the way here; none where there was none.
    loss: Option<f64>,
    /// How the product was found that this is.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    product: Option<Box<ProductQuality>>,
}

impl From<Mixture> for MixtureMessage {
    fn from(density: Mixture) -> Self {
        Self { held: Held::Density(density), loss: None, product: None }
    }
}

impl From<Potential> for MixtureMessage {
    fn from(potential: Potential) -> Self {
        Self { held: Held::Potential(potential), loss: None, product: None }
    }
}

impl MixtureMessage {
    /// The message that says nothing.
    pub fn flat(coordinates: &[Coordinate]) -> Self {
        Potential::flat(coordinates).into()
    }

    /// A Gaussian message, proper or not.
    pub fn from_gaussian(coordinates: &[Coordinate], gaussian: &DynamicGaussian) -> Self {
        Potential::from_gaussian(coordinates, gaussian).into()
    }

    /// The density, where it is held by one: of a belief that is a distribution, always.
    pub fn density(&self) -> Option<&Mixture> {
        match &self.held {
            Held::Density(density) => Some(density),
            Held::Potential(_) => None,
        }
    }

    /// The potential, where it is held by one.
    pub fn potential(&self) -> Option<&Potential> {
        match &self.held {
            Held::Potential(potential) => Some(potential),
            Held::Density(_) => None,
        }
    }

    /// Number of components.
    pub fn len(&self) -> usize {
        match &self.held {
            Held::Density(density) => density.len(),
            Held::Potential(potential) => potential.len(),
        }
    }

    /// Whether there is no component, which no message on an edge is.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The coordinates, real or angular.
    pub fn coordinates(&self) -> &[Coordinate] {
        match &self.held {
            Held::Density(density) => density.coordinates(),
            Held::Potential(potential) => potential.coordinates(),
        }
    }

    /// Whether it says nothing.
    pub fn is_flat(&self) -> bool {
        self.potential().is_some_and(Potential::is_flat)
    }

    /// Log of the message at a point, up to a constant.
    ///
    /// # Errors
    ///
    /// Where the point's dimension is not the message's.
    pub fn log_value(&self, point: &[f64]) -> Result<f64, MessageError> {
        match &self.held {
            Held::Density(density) => density.log_density(point),
            Held::Potential(potential) => {
                super::size("the point", point.len(), potential.dimension())?;
                Ok(potential.log_value(point))
            }
        }
    }

    /// [`MixtureMessage::log_value`] at many points (point by point), the constant the same for all. O(M log K) to
    /// O(M K) for M points and K components.
    ///
    /// # Errors
    ///
    /// Where the points' size does not fit `out`.
    pub fn log_values(&self, points: &[f64], out: &mut [f64]) -> Result<(), MessageError> {
        match &self.held {
            Held::Density(density) => Evaluator::new(density).log_densities(points, out),
            Held::Potential(potential) => potential.log_values(points, out),
        }
    }

    /// The message as a density; a copy where it is one already.
    ///
    /// # Errors
    ///
    /// Where a component leaves a direction open.
    pub fn to_density(&self) -> Result<Mixture, MessageError> {
        match &self.held {
            Held::Density(density) => Ok(density.clone()),
            Held::Potential(potential) => potential.to_density().map(|(density, _)| density),
        }
    }

    /// The message as a potential; a copy where it is one already.
    pub fn to_potential(&self) -> Potential {
        match &self.held {
            Held::Density(density) => {
                let all: Vec<usize> = (0..density.dimension()).collect();
                Potential::from_density_on(density.coordinates(), &all, density)
            }
            Held::Potential(potential) => potential.clone(),
        }
    }

    /// Mean and covariance.
    ///
    /// # Errors
    ///
    /// As [`MixtureMessage::to_density`].
    pub fn moments(&self) -> Result<Moments, MessageError> {
        match &self.held {
            Held::Density(density) => Ok(density.moments()),
            Held::Potential(_) => Ok(self.to_density()?.moments()),
        }
    }

    /// How the product was found that this is; none where it is a factor's message, or a product of Gaussians.
    pub fn product_quality(&self) -> Option<&ProductQuality> {
        self.product.as_deref()
    }

    /// Divergence (nats) that reductions and conversions have cost on the way to this message; none where there was
    /// none.
    pub fn loss(&self) -> Option<f64> {
        self.loss
    }

    /// The same message, having cost `loss` nats more.
    #[must_use]
    pub fn costing(mut self, loss: f64) -> Self {
        if loss != 0.0 {
            *self.loss.get_or_insert(0.0) += loss;
        }
        self
    }

    pub(super) fn found_by(mut self, quality: ProductQuality) -> Self {
        self.product = Some(Box::new(quality));
        self
    }

    /// At most `count` components, the loss added to the message's own.
    ///
    /// # Errors
    ///
    /// Where `count` is zero.
    pub fn reduced(&self, count: usize) -> Result<Self, MessageError> {
        let (fewer, loss): (Self, f64) = match &self.held {
            Held::Density(density) => {
                let (fewer, loss) = density.fewer(count, None)?;
                (fewer.into(), loss)
            }
            Held::Potential(potential) => {
                let (fewer, loss) = potential.reduce(count, None)?;
                (fewer.into(), loss)
            }
        };
        let kept = Self { loss: self.loss, product: self.product.clone(), ..fewer };
        Ok(kept.costing(loss))
    }
}
