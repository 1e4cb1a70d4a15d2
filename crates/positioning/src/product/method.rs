//! The `[method.ID]` tables: which product, and how many points of it.

use serde::{Deserialize, Serialize};
use sumprod_messages::{AnnealedGibbs, Gibbs, MultiscaleGibbs, ProductChoice, ProductMethod};

use crate::error::PositioningError;
use crate::form::at_least_one;

/// Most points or sweeps that can be asked for: beyond lies a slip of the keyboard, not a wish.
const MOST: usize = 10_000_000;

/// One `[method.ID]` table.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MethodSettings {
    /// The way to multiply.
    #[serde(default)]
    pub product: ProductChoice,
    /// Number of points that carry the product.
    #[serde(default = "two_thousand")]
    pub samples: usize,
    /// Gibbs sweeps a chain, at every level of a multiscale product; the method's own number where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sweeps: Option<usize>,
}

fn two_thousand() -> usize {
    2000
}

impl MethodSettings {
    /// The way to multiply, with these settings.
    pub fn method(&self) -> Box<dyn ProductMethod> {
        match (self.product, self.sweeps) {
            (ProductChoice::Gibbs, Some(sweeps)) => Box::new(Gibbs { sweeps, ..Gibbs::default() }),
            (ProductChoice::AnnealedGibbs, Some(sweeps)) => {
                Box::new(AnnealedGibbs { sweeps, ..AnnealedGibbs::default() })
            }
            (ProductChoice::MultiscaleGibbs, Some(sweeps)) => {
                Box::new(MultiscaleGibbs { sweeps, ..MultiscaleGibbs::default() })
            }
            (product, _) => product.method(),
        }
    }

    /// Its name, as forms write it.
    pub fn name(&self) -> &'static str {
        self.product.method().name()
    }

    /// Checks the values of method `id`.
    ///
    /// # Errors
    /// [`PositioningError::Setting`] naming the key.
    pub fn validate(&self, id: &str) -> Result<(), PositioningError> {
        let counts = [("samples", Some(self.samples), "sample"), ("sweeps", self.sweeps, "sweep")];
        for (key, count, what) in counts {
            let Some(count) = count else { continue };
            let key = format!("method.{id}.{key}");
            at_least_one(&key, count, what)?;
            if count > MOST {
                let problem = format!("is {count}; at most {MOST} {what}s are allowed");
                return Err(PositioningError::setting(key, problem));
            }
        }
        let sweeps = matches!(
            self.product,
            ProductChoice::Gibbs | ProductChoice::AnnealedGibbs | ProductChoice::MultiscaleGibbs
        );
        if self.sweeps.is_some() && !sweeps {
            let problem = format!("belongs to the Gibbs samplers, and `product` is \"{}\"", self.name());
            return Err(PositioningError::setting(format!("method.{id}.sweeps"), problem));
        }
        Ok(())
    }
}
