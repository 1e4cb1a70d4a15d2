//! Positioning with Sumprod: worlds, recorded data, cooperative networks, and the figures that judge them.
//!
//! | module | holds |
//! |---|---|
//! | [`scenario`] | the seam between scenario files and systems: what a system implements to be run |
//! | [`results`] | what one run returns: estimates beside the truth, bounds, diagnostics |
//! | [`metrics`] | error, consistency and bound figures over many runs |
//! | [`campaign`] | runs in parallel, in a fixed order, resumable |
//! | [`form`] | how scenario files spell the form of an edge |
//! | [`association`] | which tracks of two biased sensors are the same target's |
//! | [`cooperation`] | agents that locate themselves by ranges to each other and to anchors |
//! | [`static_network`] | agents that stand still and locate themselves by ranges alone |
//! | [`pmpa`] | one target among known nodes: Kalman, particle and message-passing filters |
//! | [`product`] | products of recorded mixtures, by several methods |
//! | [`range_slam`] | landmarks located by ranges alone, by mixtures |
//! | [`fusion`] | one target seen by nodes that tell each other what they believe |
//! | [`wsn`] | one target among range sensors: iterated Kalman, particle and optimizer-driven filters |
//! | [`robots`] | robots located on recorded data |
//! | [`kcpf`] | the growth model and the coordinated turn of the knowledge-board paper |
//! | [`walk`] | a person tracked by the links of a recorded radio network |
//! | [`seafloor`] | an instrument at the bottom of the sea, located by a ship's pings |
//! | [`underwater`] | nodes in the sea that locate themselves and set their clocks by sound |
//! | [`error`] | the crate's error |

pub mod association;
pub mod campaign;
pub mod cooperation;
mod costs;
pub mod error;
pub mod form;
pub mod fusion;
pub mod graphs;
pub mod kcpf;
pub mod metrics;
pub mod pmpa;
pub mod product;
pub mod range_slam;
pub mod results;
pub mod robots;
pub mod scenario;
pub mod seafloor;
pub mod static_network;
mod tracking;
pub mod underwater;
pub mod walk;
pub mod wsn;

pub use error::PositioningError;
