//! One message after the other, in a fixed order.

use super::{Pass, Refusal, Schedule};
use crate::{EdgeId, GraphError, Topology};

/// Every message in every iteration, one after the other in the order of edges and then back, each seeing
/// those before. On a chain built in order one iteration is a forward-backward pass.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Sequential {
    order: Vec<EdgeId>,
}

impl Schedule for Sequential {
    fn begin(&mut self, topology: &Topology) -> Result<(), Refusal> {
        self.order = topology.edges().collect();
        Ok(())
    }

    fn iteration(&mut self, _topology: &Topology, pass: &mut dyn Pass) -> Result<f64, GraphError> {
        let forward = pass.in_order(&self.order)?;
        self.order.reverse();
        let backward = pass.in_order(&self.order);
        self.order.reverse();
        Ok(forward.max(backward?))
    }
}
