//! All messages at once.

use super::{Pass, Schedule};
use crate::{GraphError, Topology};

/// Every message in every iteration, each from the beliefs of the iteration before; runs in parallel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Flooding;

impl Schedule for Flooding {
    fn iteration(&mut self, _topology: &Topology, pass: &mut dyn Pass) -> Result<f64, GraphError> {
        pass.everything()
    }
}
