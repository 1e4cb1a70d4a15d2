//! Fusion of beliefs that share information, and association of the tracks that they describe.
//!
//! | module | holds |
//! |---|---|
//! | [`association`] | which tracks of two sensors are of the same target, and the sensors' biases |
//! | [`information`] | sets of observations: what a belief is made of |
//! | [`expression`] | a set written by others, by inclusion and exclusion |
//! | [`belief`] | what a family of beliefs must be able to do: checked division, powers |
//! | [`intersection`] | covariance intersection, split and inverse |
//! | [`node`] | nodes that observe, predict, send and fuse |
//! | [`channel`] | what both ends of a communication edge hold |
//! | [`rule`] | how a node fuses, and what became of a message |
//! | [`information_graph`] | who knew what when: redundant paths, plans, a drawing |
//! | [`error`] | the crate's error |

pub mod association;
pub mod belief;
pub mod channel;
pub mod error;
pub mod expression;
pub mod information;
pub mod information_graph;
pub mod intersection;
pub mod node;
pub mod rule;

pub use belief::{Criterion, Fusible};
pub use channel::{Direction, Known};
pub use error::FusionError;
pub use information::{InformationSet, Item};
pub use information_graph::InformationGraph;
pub use node::{Communication, FusionNode};
pub use rule::{Intersection, IntersectionKind, Outcome, Rule};
