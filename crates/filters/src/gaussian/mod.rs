//! Filters whose belief is a mean and a covariance.

mod approximation;
pub(crate) mod checks;
mod kalman;

pub use approximation::Approximation;
pub use kalman::{GaussianRecord, Kalman, Prediction, Square};
