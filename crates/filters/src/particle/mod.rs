//! Filters whose belief is weighted particles.

mod backward;
mod driven;
mod filter;
mod look_ahead;
mod prior;
mod rao_blackwellised;
mod recovery;
mod summary;
mod weights;

pub use driven::{DrivenFilter, Told};
pub use filter::{ParticleFilter, ParticleRecord};
pub use rao_blackwellised::RaoBlackwellised;
pub use recovery::Recovery;
