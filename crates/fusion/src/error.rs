//! The crate's error.

use sumprod_graph::MessageError;
use thiserror::Error;

/// Why beliefs cannot be fused.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum FusionError {
    /// What is left after a division is no message.
    #[error("{place}: dividing out what is common leaves no message: {reason}; {remedy}")]
    Indivisible {
        /// Where, for instance `node 3, message from node 2`.
        place: String,
        /// What is left.
        reason: String,
        /// What to do about it.
        remedy: &'static str,
    },
    /// Two beliefs share information that no belief at hand is made of.
    #[error(
        "{place}: both hold {shared}, which came by more than one path, and no recorded belief holds just that; remove a link of the loop, let the sender forward the shared belief, or choose the automatic rule, which falls back to an intersection"
    )]
    Loop {
        /// Where, as in [`FusionError::Indivisible`].
        place: String,
        /// What both hold.
        shared: String,
    },
    /// A message was sent after it was received.
    #[error(
        "{place}: the message is from time {sent} and the receiver is at {now}; predict the receiver to the message's time first, or set the clocks right"
    )]
    FromTheFuture {
        /// Where, as in [`FusionError::Indivisible`].
        place: String,
        /// Time of the message (s).
        sent: f64,
        /// Time of the receiver (s).
        now: f64,
    },
    /// A node was taken back in time.
    #[error(
        "node {node:?} is at time {now} and cannot be predicted to {to}; keep times ascending and finite"
    )]
    Backwards {
        /// The node.
        node: String,
        /// Its time (s).
        now: f64,
        /// The time asked for (s).
        to: f64,
    },
    /// A node or an event that does not exist.
    #[error("there is no {what} {index} (there are {count}); use what was returned when it was added")]
    Unknown {
        /// `node`, `neighbour` or `event`.
        what: &'static str,
        /// Its number.
        index: usize,
        /// How many there are.
        count: usize,
    },
    /// Two nodes that are not joined.
    #[error("node {node:?} has no channel to node {neighbour}; connect them first")]
    NotConnected {
        /// The node.
        node: String,
        /// The number of the other.
        neighbour: usize,
    },
    /// Beliefs of this family cannot be fused so.
    #[error("{0}")]
    Unsupported(String),
    /// A product or a conversion failed.
    #[error(transparent)]
    Message(#[from] MessageError),
}
