//! Factors that every user of positioning expects.

mod bearing;
mod checks;
mod constant_velocity;
mod displacement;
mod linear;
mod linear_pair;
mod prior;
mod range;
mod relative;
mod unicycle;

pub use bearing::{Bearing, RangeBearing};
pub use constant_velocity::ConstantVelocity;
pub use displacement::Displacement;
pub use linear::LinearGaussian;
pub use linear_pair::LinearPair;
pub use prior::Prior;
pub use range::{AnchorRange, CalibratedRange, Range, distance};
pub use relative::{AnchorOffset, RelativePosition};
pub use unicycle::Unicycle;
