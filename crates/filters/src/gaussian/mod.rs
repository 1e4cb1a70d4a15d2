//! Filters whose belief is a mean and a covariance.

mod approximation;
pub(crate) mod checks;
mod imm;
mod kalman;
mod rts;
mod square_root;

pub use approximation::Approximation;
pub use imm::{Imm, ModeRecord};
pub use kalman::{GaussianRecord, Kalman, Prediction, Square};
pub use square_root::SquareRoot;
