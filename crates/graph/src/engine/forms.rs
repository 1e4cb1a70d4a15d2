//! The forms of edges and beliefs as a run uses them; they may change between iterations.

use super::Engine;
use crate::{EdgeId, Factor, FactorGraph, GraphError, Message, Port, Topology, VariableId};

/// The forms that messages and beliefs are computed in, by edge and by variable.
pub(super) struct Forms<M: Message> {
    pub(super) edges: Vec<M::Form>,
    pub(super) beliefs: Vec<M::Form>,
    /// Whether all edges are known to have one form.
    pub(super) uniform: bool,
}

impl<M: Message> Forms<M> {
    /// The graph's own.
    pub(super) fn new<F: Factor<M>>(
        graph: &FactorGraph<M, F>,
        topology: &Topology,
    ) -> Result<Self, GraphError> {
        for edge in topology.edges() {
            check(graph, topology, edge, &graph.edge_form[edge.index()])?;
        }
        let belief = |variable: VariableId| {
            graph.belief_form(variable, topology.raw_edges_of_variable(variable.index()))
        };
        let beliefs = graph.variable_ids().map(belief).collect();
        let edges = graph.edge_form.clone();
        let uniform = edges.iter().all(|form| *form == edges[0]);
        Ok(Self { edges, beliefs, uniform })
    }
}

fn check<M: Message, F: Factor<M>>(
    graph: &FactorGraph<M, F>,
    topology: &Topology,
    edge: EdgeId,
    form: &M::Form,
) -> Result<(), GraphError> {
    let variable = topology.variable_of(edge);
    M::check_form(form, graph.space(variable)).map_err(|reason| {
        let factor = topology.factor_of(edge);
        let port: Port = edge.index() - topology.first_edge(factor.index());
        let (factor, variable) = (graph.factor_name(factor), graph.variable_name(variable));
        GraphError::Form { factor, port, variable, reason }
    })
}

impl<M: Message, F: Factor<M>> Engine<'_, M, F> {
    /// Changes how an edge holds its messages from the next one on; the message that stands there stays as it is
    /// until then. The next message has nothing of its kind to be damped with and is sent whole.
    ///
    /// A checkpoint holds no forms: whoever resumes a run sets the changed ones on the graph first.
    ///
    /// # Errors
    ///
    /// Where the edge is unknown, or the family cannot hold messages on its variable in this form.
    pub fn set_edge_form(&mut self, edge: EdgeId, form: M::Form) -> Result<(), GraphError> {
        let count = self.forms.edges.len();
        if edge.index() >= count {
            return Err(GraphError::Unknown { what: "edge", index: edge.index(), count });
        }
        check(self.graph, &self.topology, edge, &form)?;
        if self.forms.edges[edge.index()] != form {
            self.forms.edges[edge.index()] = form;
            self.state.sent[edge.index()] = false;
            self.forms.uniform = false;
        }
        Ok(())
    }

    /// Changes how a variable's belief is held from its next product on.
    ///
    /// # Errors
    ///
    /// Where the handle is unknown.
    pub fn set_belief_form(&mut self, variable: VariableId, form: M::Form) -> Result<(), GraphError> {
        let count = self.forms.beliefs.len();
        let Some(place) = self.forms.beliefs.get_mut(variable.index()) else {
            return Err(GraphError::Unknown { what: "variable", index: variable.index(), count });
        };
        *place = form;
        Ok(())
    }

    /// How an edge holds its messages now.
    ///
    /// # Panics
    ///
    /// Where the handle is of another graph.
    pub fn edge_form(&self, edge: EdgeId) -> &M::Form {
        &self.forms.edges[edge.index()]
    }

    /// How a variable's belief is held now.
    ///
    /// # Panics
    ///
    /// Where the handle is of another graph.
    pub fn belief_form(&self, variable: VariableId) -> &M::Form {
        &self.forms.beliefs[variable.index()]
    }

    /// Changes the share of the old message that updates keep, from the next message on.
    ///
    /// # Errors
    ///
    /// Where it is not at least 0 and below 1.
    pub fn set_damping(&mut self, damping: f64) -> Result<(), GraphError> {
        let options = super::Options { damping, ..self.options };
        options.check()?;
        self.options = options;
        Ok(())
    }
}
