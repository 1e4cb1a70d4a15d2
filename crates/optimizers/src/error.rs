//! The crate's one error.

use sumprod_graph::MessageError;
use thiserror::Error;

/// Why particles cannot be reselected or moved.
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
    /// Points and values that do not match.
    #[error("{points} numbers are not {values} points of {dimension} coordinates")]
    Rows {
        /// Numbers given.
        points: usize,
        /// Values asked for.
        values: usize,
        /// Coordinates of a point.
        dimension: usize,
    },
    /// A log density that is NaN or +inf.
    #[error("the {what} at {point:?} is {value}; it must be finite, or -inf where the density is zero")]
    Density {
        /// Which density.
        what: &'static str,
        /// Its value.
        value: f64,
        /// The point.
        point: Vec<f64>,
    },
    /// A likelihood that is zero at every point.
    #[error(
        "none of the {count} particles explains the measurement: the likelihood is 0 at all of them; use more particles, a wider noise, or a recovery policy"
    )]
    Unexplained {
        /// Number of points.
        count: usize,
    },
    /// A parameter of a move outside its range.
    #[error("{what} is {value}; {must}")]
    Parameter {
        /// Which parameter.
        what: &'static str,
        /// Its value.
        value: f64,
        /// What it must be.
        must: &'static str,
    },
    /// The chosen particles are no message.
    #[error(transparent)]
    Message(#[from] MessageError),
}
