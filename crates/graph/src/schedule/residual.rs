//! Largest change first.

use super::{Pass, Refusal, Schedule};
use crate::{EdgeId, GraphError, Topology};
use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// Recomputes first the message whose inputs have changed most since it was last computed.
///
/// The priority of a message is the sum of the changes of the messages that flow into it, an upper estimate of
/// its own residual that costs nothing to keep (Sutton and McCallum 2007, "Improved dynamic schedules for
/// belief propagation"). One iteration is as many messages as the graph has edges.
#[derive(Clone, Debug, Default)]
pub struct Residual {
    priority: Vec<f64>,
    queue: BinaryHeap<Entry>,
}

#[derive(Clone, Copy, Debug)]
struct Entry {
    priority: f64,
    edge: EdgeId,
}

impl Ord for Entry {
    fn cmp(&self, other: &Self) -> Ordering {
        self.priority.total_cmp(&other.priority).then_with(|| other.edge.cmp(&self.edge))
    }
}

impl PartialOrd for Entry {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Entry {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Entry {}

impl Residual {
    fn spread(&mut self, topology: &Topology, edge: EdgeId, change: f64) {
        let variable = topology.variable_of(edge);
        for into in topology.edges_of_variable(variable).filter(|&into| into != edge) {
            for next in topology.edges_of_factor(topology.factor_of(into)).filter(|&next| next != into) {
                self.raise(next, change);
            }
        }
    }

    fn raise(&mut self, edge: EdgeId, change: f64) {
        let priority = &mut self.priority[edge.index()];
        *priority += change;
        self.queue.push(Entry { priority: *priority, edge });
    }
}

impl Schedule for Residual {
    fn begin(&mut self, topology: &Topology) -> Result<(), Refusal> {
        // Every message is due once, before any estimate exists.
        self.priority = vec![f64::MAX; topology.edge_count()];
        self.queue = topology.edges().map(|edge| Entry { priority: f64::MAX, edge }).collect();
        Ok(())
    }

    fn iteration(&mut self, topology: &Topology, pass: &mut dyn Pass) -> Result<f64, GraphError> {
        let mut largest: f64 = 0.0;
        let mut computed = 0;
        while computed < topology.edge_count() {
            let Some(entry) = self.queue.pop() else { break };
            // An entry that no longer carries its edge's priority is stale: a newer one is in the queue.
            if entry.priority != self.priority[entry.edge.index()] {
                continue;
            }
            self.priority[entry.edge.index()] = 0.0;
            let change = pass.in_order(&[entry.edge])?;
            largest = largest.max(change);
            computed += 1;
            if change > 0.0 {
                // A damped message is still this far from where it is going.
                let rest = change * pass.damping() / (1.0 - pass.damping());
                if rest > 0.0 {
                    self.raise(entry.edge, rest);
                }
                self.spread(topology, entry.edge, change);
            }
        }
        Ok(largest)
    }
}
