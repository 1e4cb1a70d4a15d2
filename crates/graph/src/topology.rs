//! The graph compiled to flat index arrays: all that schedules and the engine's loop see.

use crate::graph::{EdgeId, VariableId};
use crate::{Factor, FactorGraph, FactorId, Message};
use std::ops::Range;

/// A node of the compiled graph.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Node {
    /// A variable.
    Variable(VariableId),
    /// A factor.
    Factor(FactorId),
}

/// Edges of every factor and every variable, in compressed sparse rows both ways.
///
/// Edges keep the graph's numbers: the edges of one factor are consecutive.
#[derive(Clone, Debug, Default)]
pub struct Topology {
    factor_edges: Vec<u32>,
    edge_variable: Vec<u32>,
    edge_factor: Vec<u32>,
    variable_pointer: Vec<u32>,
    variable_edges: Vec<u32>,
    times: Vec<Option<f64>>,
}

impl Topology {
    /// Compiles a graph; linear time (counting sort of the edges).
    pub fn new<M: Message, F: Factor<M>>(graph: &FactorGraph<M, F>) -> Self {
        let edges = graph.edge_count();
        let mut factor_edges = Vec::with_capacity(graph.factor_count() + 1);
        let mut edge_factor = Vec::with_capacity(edges);
        for factor in graph.factor_ids() {
            let range = graph.edge_range(factor);
            factor_edges.push(range.start as u32);
            edge_factor.extend(range.map(|_| factor.0));
        }
        factor_edges.push(edges as u32);

        let edge_variable = graph.edge_variable.clone();
        let mut variable_pointer = vec![0; graph.variable_count() + 1];
        for &variable in &edge_variable {
            variable_pointer[variable as usize + 1] += 1;
        }
        for variable in 0..graph.variable_count() {
            variable_pointer[variable + 1] += variable_pointer[variable];
        }
        let mut next = variable_pointer.clone();
        let mut variable_edges = vec![0; edges];
        for (edge, &variable) in edge_variable.iter().enumerate() {
            let place = &mut next[variable as usize];
            variable_edges[*place as usize] = edge as u32;
            *place += 1;
        }
        let times = graph.variables.iter().map(|variable| variable.time).collect();
        Self { factor_edges, edge_variable, edge_factor, variable_pointer, variable_edges, times }
    }

    /// Number of variables.
    pub fn variable_count(&self) -> usize {
        self.variable_pointer.len().saturating_sub(1)
    }

    /// Number of factors.
    pub fn factor_count(&self) -> usize {
        self.factor_edges.len().saturating_sub(1)
    }

    /// Number of edges.
    pub fn edge_count(&self) -> usize {
        self.edge_variable.len()
    }

    /// All edges, in order.
    pub fn edges(&self) -> impl Iterator<Item = EdgeId> + use<> {
        (0..self.edge_count() as u32).map(EdgeId)
    }

    /// The variable at an edge.
    pub fn variable_of(&self, edge: EdgeId) -> VariableId {
        VariableId(self.edge_variable[edge.index()])
    }

    /// The factor at an edge.
    pub fn factor_of(&self, edge: EdgeId) -> FactorId {
        FactorId(self.edge_factor[edge.index()])
    }

    /// A factor's edges, port by port.
    pub fn edges_of_factor(
        &self,
        factor: FactorId,
    ) -> impl DoubleEndedIterator<Item = EdgeId> + Clone + use<> {
        (self.factor_edges[factor.index()]..self.factor_edges[factor.index() + 1]).map(EdgeId)
    }

    /// A variable's edges, in order.
    pub fn edges_of_variable(
        &self,
        variable: VariableId,
    ) -> impl DoubleEndedIterator<Item = EdgeId> + Clone + '_ {
        self.raw_edges_of_variable(variable.index()).iter().map(|&edge| EdgeId(edge))
    }

    /// The time of a variable, if it has one (s).
    pub fn time_of(&self, variable: VariableId) -> Option<f64> {
        self.times[variable.index()]
    }

    pub(crate) fn raw_edges_of_variable(&self, variable: usize) -> &[u32] {
        let range = self.variable_pointer[variable] as usize..self.variable_pointer[variable + 1] as usize;
        &self.variable_edges[range]
    }

    pub(crate) fn raw_variables_of_factor(&self, factor: usize) -> &[u32] {
        &self.edge_variable[self.factor_edges[factor] as usize..self.factor_edges[factor + 1] as usize]
    }

    /// The variables of consecutive factors, factor by factor.
    #[inline]
    pub(crate) fn raw_variables_of_factors(&self, factors: Range<usize>) -> impl Iterator<Item = &[u32]> {
        let bounds = &self.factor_edges[factors.start..=factors.end];
        let mut rest = &self.edge_variable[bounds[0] as usize..];
        bounds.windows(2).map(move |bounds| {
            let (own, others) = rest.split_at((bounds[1] - bounds[0]) as usize);
            rest = others;
            own
        })
    }

    /// Where the edges of consecutive factors begin, and where the last one's end.
    pub(crate) fn raw_bounds(&self, factors: Range<usize>) -> &[u32] {
        &self.factor_edges[factors.start..=factors.end]
    }

    /// The variables at consecutive edges.
    pub(crate) fn raw_variables(&self, edges: Range<usize>) -> &[u32] {
        &self.edge_variable[edges]
    }

    pub(crate) fn first_edge(&self, factor: usize) -> usize {
        self.factor_edges[factor] as usize
    }
}
