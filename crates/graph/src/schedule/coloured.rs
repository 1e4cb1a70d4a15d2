//! One variable after the other in each iteration, those that do not touch at the same time.

use super::{Pass, Refusal, Schedule};
use crate::{EdgeId, GraphError, Topology, VariableId};

/// Every variable hears all its factors anew, one variable after the other and each from the beliefs as those before
/// have left them: the order of Gauss and Seidel, in which news crosses a network in fewer iterations than by
/// [`Flooding`](super::Flooding).
///
/// Variables are coloured greedily in the order of creation such that no two of a factor share a colour; those of one
/// colour do not depend on each other and are sent together, on as many threads as there are.
/// Colouring costs the sum over factors of their number of ports squared.
#[derive(Clone, Debug, Default)]
pub struct Coloured {
    rounds: Option<usize>,
    /// The edges to send along; all without.
    among: Option<Vec<EdgeId>>,
    /// The edges into the variables of each colour.
    colours: Vec<Vec<EdgeId>>,
}

impl Coloured {
    /// Rounds along all edges until the messages have converged.
    pub fn new() -> Self {
        Self::default()
    }

    /// Ends after this many rounds.
    pub fn rounds(self, rounds: usize) -> Self {
        Self { rounds: Some(rounds), ..self }
    }

    /// Sends along these edges alone; what stands on the others still counts.
    pub fn among(self, edges: impl IntoIterator<Item = EdgeId>) -> Self {
        Self { among: Some(edges.into_iter().collect()), ..self }
    }
}

/// The colour of each variable: the smallest that no variable before it has with which it shares a factor that sends
/// along a wanted edge.
fn colour(topology: &Topology, wanted: &[bool]) -> Vec<usize> {
    let mut colours: Vec<usize> = Vec::with_capacity(topology.variable_count());
    // Which variable last found a colour taken.
    let mut taken: Vec<usize> = Vec::new();
    for variable in 0..topology.variable_count() {
        for edge in topology.raw_edges_of_variable(variable) {
            let factor = topology.factor_of(EdgeId(*edge));
            if !topology.edges_of_factor(factor).any(|edge| wanted[edge.index()]) {
                continue;
            }
            for &other in topology.raw_variables_of_factor(factor.index()) {
                if let Some(&colour) = colours.get(other as usize) {
                    taken[colour] = variable;
                }
            }
        }
        let free = taken.iter().position(|&by| by != variable).unwrap_or(taken.len());
        if free == taken.len() {
            taken.push(usize::MAX);
        }
        colours.push(free);
    }
    colours
}

impl Schedule for Coloured {
    fn begin(&mut self, topology: &Topology) -> Result<(), Refusal> {
        let mut wanted = vec![self.among.is_none(); topology.edge_count()];
        for edge in self.among.iter().flatten() {
            let count = wanted.len();
            let Some(place) = wanted.get_mut(edge.index()) else {
                let reason = format!("edge {} is not in this graph, which has {count}", edge.index());
                return Err(Refusal::Other(reason));
            };
            *place = true;
        }
        self.colours.clear();
        for (variable, colour) in colour(topology, &wanted).into_iter().enumerate() {
            if self.colours.len() <= colour {
                self.colours.resize(colour + 1, Vec::new());
            }
            let edges = topology.edges_of_variable(VariableId(variable as u32));
            self.colours[colour].extend(edges.filter(|edge| wanted[edge.index()]));
        }
        self.colours.retain(|edges| !edges.is_empty());
        Ok(())
    }

    fn iteration(&mut self, _topology: &Topology, pass: &mut dyn Pass) -> Result<f64, GraphError> {
        let mut largest: f64 = 0.0;
        for edges in &self.colours {
            largest = largest.max(pass.together(edges)?);
        }
        Ok(largest)
    }

    fn iterations(&self) -> Option<usize> {
        self.rounds
    }
}
