//! Factors that every user of positioning expects.

mod acoustic;
mod bearing;
mod checks;
mod constant_velocity;
mod coordinated_turn;
mod displacement;
mod linear;
mod linear_pair;
mod point_in_frame;
pub mod pose;
mod prior;
mod range;
mod range_clique;
mod relative;
mod unicycle;

pub use acoustic::{NodePseudoRange, PseudoRange, RoundTrip, TravelTime};
pub use bearing::{Bearing, RangeBearing};
pub use constant_velocity::ConstantVelocity;
pub use coordinated_turn::CoordinatedTurn;
pub use displacement::Displacement;
pub use linear::LinearGaussian;
pub use linear_pair::LinearPair;
pub use point_in_frame::PointInFrame;
pub use pose::{PosePrior, PosePrior3, PoseResidual, RelativePose, RelativePose3};
pub use prior::Prior;
pub use range::{AnchorRange, CalibratedRange, Range, distance};
pub use range_clique::{CliqueRange, RangeClique};
pub use relative::{AnchorOffset, RelativePosition};
pub use unicycle::Unicycle;
