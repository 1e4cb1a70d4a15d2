//! Exact inference on trees: every message once towards a root, then once away from it.

use super::{Pass, Refusal, Schedule};
use crate::{EdgeId, GraphError, Node, Topology, VariableId};

/// Forward-backward on a tree or forest: each message is computed once, after all those it depends on.
///
/// Refuses a graph with a loop, and names the loop. Nonlinear rules may want more iterations: each further one
/// starts from the beliefs of the one before, which on a chain is an iterated Kalman smoother.
///
/// Linear time and no recursion, so that a chain of a million variables is no deeper than one of ten.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ForwardBackward {
    order: Vec<EdgeId>,
    sweeps: usize,
}

impl ForwardBackward {
    /// One pass: exact where every rule is.
    pub fn new() -> Self {
        Self::default()
    }

    /// Up to `sweeps` passes, for rules that depend on the beliefs (linearisation); the engine's tolerance
    /// stops them earlier.
    pub fn iterated(sweeps: usize) -> Self {
        Self { order: Vec::new(), sweeps }
    }
}

impl Schedule for ForwardBackward {
    fn begin(&mut self, topology: &Topology) -> Result<(), Refusal> {
        self.order = tree_order(topology)?;
        Ok(())
    }

    fn iteration(&mut self, _topology: &Topology, pass: &mut dyn Pass) -> Result<f64, GraphError> {
        pass.in_order(&self.order)
    }

    fn iterations(&self) -> Option<usize> {
        Some(self.sweeps.max(1))
    }
}

/// Where a node was reached from in the depth-first walk.
const ROOT: u32 = u32::MAX;
const UNSEEN: u32 = u32::MAX - 1;

/// The edges in an order in which each factor-to-variable message follows all those it depends on.
///
/// The root of each component is its last variable, so that on a chain built in order the first pass is the
/// filter and the second the smoother.
fn tree_order(topology: &Topology) -> Result<Vec<EdgeId>, Refusal> {
    // The edge by which each variable and factor was first reached.
    let mut variable_from = vec![UNSEEN; topology.variable_count()];
    let mut factor_from = vec![UNSEEN; topology.factor_count()];
    let mut outward = Vec::with_capacity(topology.edge_count());
    let mut stack = Vec::new();
    for root in (0..topology.variable_count() as u32).rev() {
        if variable_from[root as usize] != UNSEEN {
            continue;
        }
        variable_from[root as usize] = ROOT;
        stack.push(VariableId(root));
        while let Some(variable) = stack.pop() {
            // Inward messages come in the reverse of this order: evidence last, when the others have given rules
            // that linearise a point to do so.
            let alone = |edge: &EdgeId| topology.edges_of_factor(topology.factor_of(*edge)).count() == 1;
            let edges = topology.edges_of_variable(variable);
            for towards in edges.clone().filter(alone).chain(edges.filter(|edge| !alone(edge))) {
                if towards.0 == variable_from[variable.index()] {
                    continue;
                }
                let factor = topology.factor_of(towards);
                if factor_from[factor.index()] != UNSEEN {
                    return Err(Refusal::Loop(loop_through(topology, &variable_from, &factor_from, towards)));
                }
                factor_from[factor.index()] = towards.0;
                outward.push((towards, true));
                for edge in topology.edges_of_factor(factor).filter(|&edge| edge != towards) {
                    let next = topology.variable_of(edge);
                    if variable_from[next.index()] != UNSEEN {
                        return Err(Refusal::Loop(loop_through(
                            topology,
                            &variable_from,
                            &factor_from,
                            edge,
                        )));
                    }
                    variable_from[next.index()] = edge.0;
                    outward.push((edge, false));
                    stack.push(next);
                }
            }
        }
    }
    // Towards the root first: a factor's message to the variable nearer the root, deepest first.
    let inward = outward.iter().rev().filter(|(_, towards_root)| *towards_root);
    let away = outward.iter().filter(|(_, towards_root)| !*towards_root);
    Ok(inward.chain(away).map(|&(edge, _)| edge).collect())
}

/// The loop that `closing` closes: both ends' paths to where they meet.
fn loop_through(
    topology: &Topology,
    variable_from: &[u32],
    factor_from: &[u32],
    closing: EdgeId,
) -> Vec<Node> {
    let path = |mut node: Node| {
        let mut path = vec![node];
        loop {
            let from = match node {
                Node::Variable(variable) => variable_from[variable.index()],
                Node::Factor(factor) => factor_from[factor.index()],
            };
            if from == ROOT || from == UNSEEN {
                return path;
            }
            node = match node {
                Node::Variable(_) => Node::Factor(topology.factor_of(EdgeId(from))),
                Node::Factor(_) => Node::Variable(topology.variable_of(EdgeId(from))),
            };
            path.push(node);
        }
    };
    let mut one = path(Node::Variable(topology.variable_of(closing)));
    let mut other = path(Node::Factor(topology.factor_of(closing)));
    let mut meeting = None;
    while let (Some(a), Some(b)) = (one.last(), other.last()) {
        if a != b {
            break;
        }
        meeting = one.pop();
        other.pop();
    }
    one.extend(meeting);
    one.extend(other.into_iter().rev());
    one
}
