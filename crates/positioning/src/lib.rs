//! Positioning with Sumprod: worlds, recorded data, cooperative networks, and the figures that judge them.
//!
//! | module | holds |
//! |---|---|
//! | [`scenario`] | the seam between scenario files and systems: what a system implements to be run |
//! | [`results`] | what one run returns: estimates beside the truth, bounds, diagnostics |
//! | [`metrics`] | error, consistency and bound figures over many runs |
//! | [`campaign`] | runs in parallel, in a fixed order, resumable |
//! | [`error`] | the crate's error |

pub mod campaign;
pub mod error;
pub mod metrics;
pub mod results;
pub mod scenario;

pub use error::PositioningError;
