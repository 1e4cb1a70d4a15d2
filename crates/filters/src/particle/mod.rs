//! Filters whose belief is weighted particles.

mod filter;
mod prior;
mod recovery;
mod summary;
mod weights;

pub use filter::{ParticleFilter, ParticleRecord};
pub use recovery::Recovery;
