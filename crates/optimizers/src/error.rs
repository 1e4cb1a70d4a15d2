//! The crate's one error.

use sumprod_graph::MessageError;
use thiserror::Error;

/// Why particles cannot be reselected.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum OptimizerError {
    /// No particle is to be chosen, or there is none to choose from.
    #[error("{what} is 0; it must be at least 1")]
    Empty {
        /// Which number.
        what: &'static str,
    },
    /// A weight that is negative or not finite.
    #[error("weight {index} is {value}; weights must be finite and not negative")]
    Weight {
        /// Its index.
        index: usize,
        /// Its value.
        value: f64,
    },
    /// Weights without a positive, finite sum.
    #[error("the weights sum to {total}; at least one must be positive, and their sum finite")]
    Total {
        /// The sum.
        total: f64,
    },
    /// Particles that stand for a function.
    #[error("these particles hold the values of a likelihood, not a sample; only a sample can be reselected")]
    Likelihood,
    /// A share outside its range.
    #[error("the share of the effective sample size is {value}; it must lie between 0 and 1")]
    Share {
        /// Its value.
        value: f64,
    },
    /// The chosen particles are no message.
    #[error(transparent)]
    Message(#[from] MessageError),
}
