//! The crate's one error.

use sumprod_graph::MessageError;
use sumprod_optimizers::OptimizerError;
use thiserror::Error;

/// Why a filter cannot be made or cannot go on; steps count predictions from zero.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum FilterError {
    /// A prior that is no distribution.
    #[error("the prior cannot be used: {0}")]
    Prior(MessageError),
    /// An option out of its range.
    #[error("{what} is {value}; {expected}")]
    Setting {
        /// Which option.
        what: &'static str,
        /// Its value.
        value: f64,
        /// What is expected.
        expected: &'static str,
    },
    /// A prediction or a correction that cannot be computed.
    #[error("step {step}: {source}")]
    Step {
        /// Predictions before.
        step: u64,
        /// What went wrong.
        source: MessageError,
    },
    /// A measurement that no particle explains.
    #[error("step {step}: none of {count} particles explains the measurement ({how}); {remedy}")]
    Unexplained {
        /// Predictions before.
        step: u64,
        /// Number of particles.
        count: usize,
        /// How far it is from the nearest.
        how: String,
        /// What to do about it.
        remedy: &'static str,
    },
    /// Particles that cannot be reselected.
    #[error("step {step}: {source}")]
    Optimizer {
        /// Predictions before.
        step: u64,
        /// What went wrong.
        source: OptimizerError,
    },
}

impl FilterError {
    pub(crate) fn step(step: u64) -> impl Fn(MessageError) -> Self {
        move |source| Self::Step { step, source }
    }
}
