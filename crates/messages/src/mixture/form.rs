//! How an edge holds mixtures.

use super::{Auto, Bandwidth, ProductChoice, ProductMethod};
use serde::{Deserialize, Serialize};

/// How wide the kernels are that a sample is read with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum BandwidthChoice {
    /// [`Bandwidth::LeaveOneOut`]: the default, because what is held as a mixture may have several modes.
    #[default]
    LeaveOneOut,
    /// [`Bandwidth::Silverman`].
    Silverman,
}

impl BandwidthChoice {
    /// The rule.
    pub fn rule(self) -> Bandwidth {
        match self {
            Self::LeaveOneOut => Bandwidth::LeaveOneOut,
            Self::Silverman => Bandwidth::Silverman,
        }
    }
}

/// How an edge holds mixtures, and how a belief of this form multiplies them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MixtureForm {
    /// The most components a message or belief keeps; fewer where fewer say the same.
    pub components: usize,
    /// How messages are multiplied.
    #[serde(default)]
    pub product: ProductChoice,
    /// How wide the kernels are that particles are read with.
    #[serde(default)]
    pub bandwidth: BandwidthChoice,
    /// Points by which a product that is not exact is found or checked.
    #[serde(default = "points")]
    pub samples: usize,
}

fn points() -> usize {
    500
}

impl Default for MixtureForm {
    fn default() -> Self {
        Self::new(50)
    }
}

impl MixtureForm {
    /// At most `components` components, multiplied by [`Auto`].
    pub fn new(components: usize) -> Self {
        Self {
            components,
            product: ProductChoice::default(),
            bandwidth: BandwidthChoice::default(),
            samples: points(),
        }
    }

    /// The same with another way to multiply.
    #[must_use]
    pub fn with_product(self, product: ProductChoice) -> Self {
        Self { product, ..self }
    }

    /// The method of product. `Auto` enumerates no more label choices than a reduction to so few components is worth.
    pub(super) fn method(&self) -> Box<dyn ProductMethod> {
        match self.product {
            ProductChoice::Auto => {
                let enumerate = self.components.saturating_mul(ENUMERATED).clamp(1_000, 20_000);
                Box::new(Auto { enumerate, ..Auto::default() })
            }
            other => other.method(),
        }
    }
}

/// Label choices enumerated per component that is kept.
const ENUMERATED: usize = 50;
