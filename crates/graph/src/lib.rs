//! Factor graphs and the engine that passes messages on them.
//!
//! This crate knows no numbers: a message is whatever implements [`Message`], a factor whatever implements
//! [`Factor`] for that family. It holds
//!
//! - [`FactorGraph`]: variables with a [`Space`], factors with ports, edges with a form, on a petgraph topology;
//! - [`Topology`]: the same graph compiled to flat index arrays, which is all that the engine's loop sees;
//! - [`Engine`]: computes messages and beliefs as a [`Schedule`] asks, in parallel and reproducibly;
//! - [`Window`]: time-sliced graphs, from a filter (one slice) to a fixed-lag smoother (several);
//! - [`Stream`]: counter-based random numbers, named by what they are drawn for.
//!
//! The equations are those of Kschischang, Frey and Loeliger (2001), "Factor graphs and the sum-product
//! algorithm": a variable sends a factor the product of its other incoming messages, a factor sends a variable
//! its own function summed over all other variables.

mod checkpoint;
mod dot;
mod engine;
mod error;
mod factor;
mod graph;
mod message;
mod report;
pub mod schedule;
mod space;
mod stream;
mod topology;
mod window;

pub use checkpoint::Checkpoint;
pub use engine::{Engine, Options, Outgoing};
pub use error::{GraphError, MessageError};
pub use factor::{Factor, Group, Incoming, Port};
pub use graph::{EdgeId, FactorGraph, FactorId, VariableId};
pub use message::{Message, Messages, ProductOutcome, Quality};
pub use report::{Qualities, Report, Stop};
pub use schedule::{Pass, Schedule};
pub use space::{Coordinate, Space, wrap_angle};
pub use stream::{FastStream, MessageStreams, Purpose, Stream};
pub use topology::{Node, Topology};
pub use window::{Window, WindowVariable};
