//! Factors for positions on a lattice of the plane ([`sumprod_messages::LatticeMessage`]).
//!
//! | factor | says |
//! |---|---|
//! | [`LatticeRange`] | a measured distance, to another position or to an anchor |
//! | [`Silence`] | that two did not measure each other, so that they are hardly within reach |
//!
//! Along an edge in lattice form a message is evaluated at the cells of the receiver's belief, in the manner of Ihler
//! and McAllester, "Particle belief propagation" (2009); to a receiver without cells it is the ring of those it
//! reaches. Along a Gaussian edge a range is the linearised rule of the same residual, and silence says nothing.

mod range;
mod sender;
mod silence;

pub use range::LatticeRange;
pub use silence::Silence;
