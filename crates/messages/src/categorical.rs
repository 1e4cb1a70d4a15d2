//! Distributions over finitely many states.
//!
//! A message is the logarithms of its values, the largest zero: a state that is ruled out has minus infinity. Where all
//! values are in the range of doubles and a rule sums them, it is the values themselves, and logarithms are taken when
//! asked for; which of the two is held shows in no digit before the twelfth. At a temperature T a factor f sends
//!
//! m(x) = T log Σ_y exp((log f(x, y) + Σ m(y)) / T),
//!
//! which is sum-product at T = 1 and max-product in the limit T = 0. The temperature is part of an edge's form, so that
//! one graph may sum over some variables and maximise over others.

mod family;
mod log_odds;
mod message;
mod passes;
mod states;

pub use family::CategoricalFamily;
pub use log_odds::LogOdds;
pub use states::Categorical;

use serde::{Deserialize, Serialize};
use sumprod_graph::{MessageError, Space};

/// How an edge holds messages over finitely many states.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CategoricalForm {
    /// The temperature of sums over states: 1 for sum-product, 0 for max-product.
    pub temperature: f64,
}

/// A temperature that is not a number is refused by every check of forms.
impl Eq for CategoricalForm {}

impl Default for CategoricalForm {
    fn default() -> Self {
        Self { temperature: 1.0 }
    }
}

impl CategoricalForm {
    /// Sums over states.
    pub fn sum_product() -> Self {
        Self::default()
    }

    /// Maximises over states.
    pub fn max_product() -> Self {
        Self { temperature: 0.0 }
    }

    /// Refuses temperatures that are none, and spaces that are not finite.
    fn check(&self, space: &Space) -> Result<(), String> {
        if !(self.temperature >= 0.0 && self.temperature.is_finite()) {
            let temperature = self.temperature;
            return Err(format!("the temperature is {temperature}; it must be finite and not negative"));
        }
        match space {
            Space::Finite(0) => Err("a variable needs at least one state".into()),
            Space::Finite(_) => Ok(()),
            _ => Err("a categorical message needs a variable of finitely many states".into()),
        }
    }
}

/// Nats below the largest value at which a state no longer shows in any sum of doubles.
const SEEN: f64 = -36.0;

/// The largest change that is told: of states that become possible or impossible.
const APPEARED: f64 = 700.0;

/// What a set of states that all are ruled out is told by.
fn impossible(what: &'static str) -> MessageError {
    MessageError::Impossible { what }
}
