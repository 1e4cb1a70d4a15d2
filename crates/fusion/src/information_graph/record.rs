//! An information graph as a list of what happened, which is how it is written and read.
//!
//! ```json
//! [{"node": "low"}, {"node": "high"},
//!  {"observe": {"node": 0, "time": 1.0}},
//!  {"receive": {"node": 1, "time": 2.0, "from": [3]}}]
//! ```
//!
//! Events are numbered as they come about: one for a node's start, two for an observation (itself and the state after
//! it), one for what a node received.

use serde::{Deserialize, Serialize};

use super::{EventId, EventKind, InformationGraph, Link};
use crate::FusionError;

/// What happened.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub(super) enum Happening {
    /// A node was added.
    Node(String),
    /// A node observed.
    Observe {
        /// The node.
        node: usize,
        /// The time (s).
        time: f64,
    },
    /// A node received what others sent at these events.
    Receive {
        /// The receiver.
        node: usize,
        /// The time (s).
        time: f64,
        /// The events.
        from: Vec<EventId>,
    },
}

impl From<InformationGraph> for Vec<Happening> {
    fn from(graph: InformationGraph) -> Self {
        let mut happened = Vec::new();
        for (id, event) in graph.events().filter(|(_, event)| event.kind == EventKind::State) {
            let (node, time) = (event.node, event.time);
            let parents = graph.parents(id);
            let from: Vec<EventId> = parents
                .iter()
                .filter(|(_, link)| *link == Link::Communication)
                .map(|(event, _)| *event)
                .collect();
            happened.push(if parents.is_empty() {
                Happening::Node(graph.names[node].clone())
            } else if parents.iter().any(|(_, link)| *link == Link::Observation) {
                Happening::Observe { node, time }
            } else {
                Happening::Receive { node, time, from }
            });
        }
        happened
    }
}

impl TryFrom<Vec<Happening>> for InformationGraph {
    type Error = FusionError;

    fn try_from(happened: Vec<Happening>) -> Result<Self, FusionError> {
        let mut graph = Self::new();
        for happening in happened {
            match happening {
                Happening::Node(name) => drop(graph.add_node(name)),
                Happening::Observe { node, time } => drop(graph.observe(node, time)?),
                Happening::Receive { node, time, from } => drop(graph.communicate(&from, node, time)?),
            }
        }
        Ok(graph)
    }
}
