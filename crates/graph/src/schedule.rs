//! Schedules: which messages are recomputed, in which order.

mod coloured;
mod flooding;
mod forward_backward;
mod residual;
mod sequential;
mod sliced;

pub use coloured::Coloured;
pub use flooding::Flooding;
pub use forward_backward::ForwardBackward;
pub use residual::Residual;
pub use sequential::Sequential;
pub use sliced::Sliced;

use crate::{EdgeId, GraphError, Node, Topology};

/// What a schedule can ask of the engine. Every call returns the largest change of the messages it computed.
///
/// A message here is a factor's message along an edge; what variables send is derived from their beliefs. A
/// variable's belief is brought up to date as soon as a message into it has changed.
pub trait Pass {
    /// Share of the old message kept at each update: how much of a change is still to come.
    fn damping(&self) -> f64 {
        0.0
    }

    /// Every message, all from the beliefs as they stand; returns the largest change of a belief.
    ///
    /// # Errors
    ///
    /// The first message or product, in the order of edges and variables, that could not be computed.
    fn everything(&mut self) -> Result<f64, GraphError>;

    /// These edges' messages, all from the beliefs as they stand.
    ///
    /// # Errors
    ///
    /// As [`Pass::everything`].
    fn together(&mut self, edges: &[EdgeId]) -> Result<f64, GraphError>;

    /// These edges' messages one after the other, each seeing those before.
    ///
    /// # Errors
    ///
    /// As [`Pass::everything`].
    fn in_order(&mut self, edges: &[EdgeId]) -> Result<f64, GraphError>;
}

/// Why a schedule cannot run on a graph; the engine adds the names.
#[derive(Clone, Debug, PartialEq)]
pub enum Refusal {
    /// The graph has this loop, given by its nodes in order.
    Loop(Vec<Node>),
    /// Any other reason.
    Other(String),
}

/// Decides which messages are recomputed, in which order.
pub trait Schedule {
    /// Looks at the graph before the first iteration, and refuses it where it cannot run.
    ///
    /// # Errors
    ///
    /// The reason.
    fn begin(&mut self, _topology: &Topology) -> Result<(), Refusal> {
        Ok(())
    }

    /// One iteration; returns the largest change that its passes returned.
    ///
    /// # Errors
    ///
    /// Whatever the pass returned.
    fn iteration(&mut self, topology: &Topology, pass: &mut dyn Pass) -> Result<f64, GraphError>;

    /// Number of iterations after which nothing is left to do, where the schedule knows it.
    fn iterations(&self) -> Option<usize> {
        None
    }
}
