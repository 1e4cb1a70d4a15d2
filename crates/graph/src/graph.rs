//! The graph that users build and query.

use crate::{Factor, GraphError, Message, Port, Space};
use petgraph::graph::{NodeIndex, UnGraph};
use serde::{Deserialize, Serialize};
use std::collections::HashMap;

/// Handle of a variable in its graph.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct VariableId(pub(crate) u32);

/// Handle of a factor in its graph.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct FactorId(pub(crate) u32);

/// Handle of an edge: a factor's port and the variable there.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct EdgeId(pub(crate) u32);

impl VariableId {
    /// The variable's number, counted from zero in the order of creation.
    pub fn index(self) -> usize {
        self.0 as usize
    }
}

impl FactorId {
    /// The factor's number, counted from zero in the order of creation.
    pub fn index(self) -> usize {
        self.0 as usize
    }
}

impl EdgeId {
    /// The edge's number: edges are counted factor by factor, port by port.
    pub fn index(self) -> usize {
        self.0 as usize
    }
}

/// What a node of the petgraph topology stands for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) enum Kind {
    Variable(VariableId),
    Factor(FactorId),
}

pub(crate) struct Variable<M: Message> {
    name: Option<Box<str>>,
    space: u32,
    pub(crate) time: Option<f64>,
    form: Option<M::Form>,
    pub(crate) prior: Option<M>,
    pub(crate) start: Option<M>,
    node: NodeIndex<u32>,
}

/// What is known of a factor besides its rules, which the engine reads alone.
struct FactorNode {
    name: Option<Box<str>>,
    first_edge: u32,
    node: NodeIndex<u32>,
}

/// Variables and factors, joined by edges that each have a form.
///
/// Generic over the family `M` of messages and the type `F` of its factors: a boxed factor by default, a
/// concrete type to remove the boxing, an `Arc` or a reference to share one factor among many places.
///
/// Building is amortised constant time per variable and per edge.
pub struct FactorGraph<M: Message, F = Box<dyn Factor<M>>> {
    pub(crate) variables: Vec<Variable<M>>,
    pub(crate) factors: Vec<F>,
    factor_nodes: Vec<FactorNode>,
    /// Variable at each edge; edges are numbered factor by factor, port by port.
    pub(crate) edge_variable: Vec<u32>,
    pub(crate) edge_form: Vec<M::Form>,
    spaces: Vec<Space>,
    by_name: HashMap<Box<str>, VariableId>,
    topology: UnGraph<Kind, EdgeId, u32>,
}

impl<M: Message, F: Factor<M>> Default for FactorGraph<M, F> {
    fn default() -> Self {
        Self::new()
    }
}

impl<M: Message, F: Factor<M>> FactorGraph<M, F> {
    /// An empty graph.
    pub fn new() -> Self {
        Self {
            variables: Vec::new(),
            factors: Vec::new(),
            factor_nodes: Vec::new(),
            edge_variable: Vec::new(),
            edge_form: Vec::new(),
            spaces: Vec::new(),
            by_name: HashMap::new(),
            topology: UnGraph::default(),
        }
    }

    /// Adds a variable with a name of its own.
    ///
    /// # Errors
    ///
    /// [`GraphError::DuplicateName`] where the name is taken.
    pub fn variable(&mut self, name: impl Into<String>, space: Space) -> Result<VariableId, GraphError> {
        let name = name.into().into_boxed_str();
        if self.by_name.contains_key(&name) {
            return Err(GraphError::DuplicateName(name.into()));
        }
        let id = self.unnamed_variable(space);
        self.variables[id.index()].name = Some(name.clone());
        self.by_name.insert(name, id);
        Ok(id)
    }

    /// Adds a variable that is called by its number; for graphs too large to name.
    pub fn unnamed_variable(&mut self, space: Space) -> VariableId {
        let id = VariableId(self.variables.len() as u32);
        let known = self.spaces.iter().rposition(|other| *other == space);
        let space = known.unwrap_or_else(|| {
            self.spaces.push(space);
            self.spaces.len() - 1
        }) as u32;
        let node = self.topology.add_node(Kind::Variable(id));
        self.variables.push(Variable {
            name: None,
            space,
            time: None,
            form: None,
            prior: None,
            start: None,
            node,
        });
        id
    }

    /// Adds a factor over `variables`, one per port, every edge in the family's default form.
    ///
    /// `name` says what kind of factor it is; many factors may share a name.
    ///
    /// # Errors
    ///
    /// Where the factor has no port, the number of variables or a dimension does not match its ports, or a
    /// handle is unknown.
    pub fn factor(
        &mut self,
        name: impl Into<String>,
        factor: F,
        variables: &[VariableId],
    ) -> Result<FactorId, GraphError> {
        let name = name.into();
        let name = (!name.is_empty()).then(|| name.into_boxed_str());
        let id = FactorId(self.factors.len() as u32);
        self.check_ports(id, name.as_deref(), &factor, variables)?;
        let node = self.topology.add_node(Kind::Factor(id));
        let first_edge = self.edge_variable.len() as u32;
        for (port, variable) in variables.iter().enumerate() {
            self.topology.add_edge(
                node,
                self.variables[variable.index()].node,
                EdgeId(first_edge + port as u32),
            );
            self.edge_variable.push(variable.0);
            self.edge_form.push(M::default_form(self.space(*variable)));
        }
        self.factors.push(factor);
        self.factor_nodes.push(FactorNode { name, first_edge, node });
        Ok(id)
    }

    fn check_ports(
        &self,
        id: FactorId,
        name: Option<&str>,
        factor: &F,
        variables: &[VariableId],
    ) -> Result<(), GraphError> {
        let name = || factor_label(name, id);
        let dimensions = factor.dimensions();
        if dimensions.is_empty() {
            return Err(GraphError::NoPort(name()));
        }
        if dimensions.len() != variables.len() {
            return Err(GraphError::PortCount {
                factor: name(),
                ports: dimensions.len(),
                variables: variables.len(),
            });
        }
        for (port, (&variable, &expected)) in variables.iter().zip(dimensions).enumerate() {
            self.known(variable)?;
            let found = self.space(variable).dimension();
            if found != expected {
                let variable = self.variable_name(variable);
                return Err(GraphError::PortDimension { factor: name(), port, expected, variable, found });
            }
        }
        Ok(())
    }

    fn known(&self, variable: VariableId) -> Result<(), GraphError> {
        let count = self.variables.len();
        if variable.index() < count {
            return Ok(());
        }
        Err(GraphError::Unknown { what: "variable", index: variable.index(), count })
    }

    /// Chooses how the edge at a factor's port holds its messages.
    ///
    /// # Errors
    ///
    /// Where the handle or port is unknown, or the family cannot hold messages on that variable in this form.
    pub fn set_edge_form(&mut self, factor: FactorId, port: Port, form: M::Form) -> Result<(), GraphError> {
        let edge = self.edge(factor, port)?;
        let variable = VariableId(self.edge_variable[edge.index()]);
        if let Err(reason) = M::check_form(&form, self.space(variable)) {
            let (factor, variable) = (self.factor_name(factor), self.variable_name(variable));
            return Err(GraphError::Form { factor, port, variable, reason });
        }
        self.edge_form[edge.index()] = form;
        Ok(())
    }

    /// Chooses how a variable's belief is held; by default the richest form among its edges.
    ///
    /// # Errors
    ///
    /// Where the handle is unknown.
    pub fn set_belief_form(&mut self, variable: VariableId, form: M::Form) -> Result<(), GraphError> {
        self.known(variable)?;
        self.variables[variable.index()].form = Some(form);
        Ok(())
    }

    /// Pins a message to a variable: evidence that takes part in every product, without a factor.
    ///
    /// # Errors
    ///
    /// Where the handle is unknown.
    pub fn set_prior(&mut self, variable: VariableId, prior: M) -> Result<(), GraphError> {
        self.known(variable)?;
        self.variables[variable.index()].prior = Some(prior);
        Ok(())
    }

    /// Gives a variable's belief a start: where rules linearise or sample before messages have come. It is no
    /// evidence and leaves no trace in the answer of a linear graph.
    ///
    /// # Errors
    ///
    /// Where the handle is unknown.
    pub fn set_start(&mut self, variable: VariableId, start: M) -> Result<(), GraphError> {
        self.known(variable)?;
        self.variables[variable.index()].start = Some(start);
        Ok(())
    }

    /// Gives a variable a time (s); variables of one time form a slice.
    ///
    /// # Errors
    ///
    /// Where the handle is unknown.
    pub fn set_time(&mut self, variable: VariableId, time: f64) -> Result<(), GraphError> {
        self.known(variable)?;
        self.variables[variable.index()].time = Some(time);
        Ok(())
    }

    /// The variable with this name.
    pub fn find(&self, name: &str) -> Option<VariableId> {
        self.by_name.get(name).copied()
    }

    /// All variables, in the order of creation.
    pub fn variable_ids(&self) -> impl Iterator<Item = VariableId> + use<M, F> {
        (0..self.variables.len() as u32).map(VariableId)
    }

    /// All factors, in the order of creation.
    pub fn factor_ids(&self) -> impl Iterator<Item = FactorId> + use<M, F> {
        (0..self.factors.len() as u32).map(FactorId)
    }

    /// Number of variables.
    pub fn variable_count(&self) -> usize {
        self.variables.len()
    }

    /// Number of factors.
    pub fn factor_count(&self) -> usize {
        self.factors.len()
    }

    /// Number of edges.
    pub fn edge_count(&self) -> usize {
        self.edge_variable.len()
    }

    /// The space of a variable.
    ///
    /// # Panics
    ///
    /// Where the handle is of another graph.
    pub fn space(&self, variable: VariableId) -> &Space {
        &self.spaces[self.variables[variable.index()].space as usize]
    }

    /// A variable's name, or one made of its number.
    pub fn variable_name(&self, variable: VariableId) -> String {
        let name = self.variables.get(variable.index()).and_then(|v| v.name.as_deref());
        name.map_or_else(|| format!("variable {}", variable.0), str::to_owned)
    }

    /// A factor's name with its number.
    pub fn factor_name(&self, factor: FactorId) -> String {
        factor_label(self.factor_nodes.get(factor.index()).and_then(|f| f.name.as_deref()), factor)
    }

    /// The name a factor was given, shared by all of its kind; empty if none.
    pub fn factor_kind(&self, factor: FactorId) -> &str {
        self.factor_nodes.get(factor.index()).and_then(|f| f.name.as_deref()).unwrap_or("")
    }

    /// The edge at a factor's port.
    ///
    /// # Errors
    ///
    /// Where the factor or port is unknown.
    pub fn edge(&self, factor: FactorId, port: Port) -> Result<EdgeId, GraphError> {
        let Some(node) = self.factor_nodes.get(factor.index()) else {
            return Err(GraphError::Unknown {
                what: "factor",
                index: factor.index(),
                count: self.factors.len(),
            });
        };
        let arity = self.arity(factor);
        if port >= arity {
            return Err(GraphError::NoSuchPort { factor: self.factor_name(factor), port, last: arity - 1 });
        }
        Ok(EdgeId(node.first_edge + port as u32))
    }

    /// The variables at a factor's ports, in order.
    pub fn ports(&self, factor: FactorId) -> impl Iterator<Item = VariableId> + '_ {
        self.edge_range(factor).map(|edge| VariableId(self.edge_variable[edge]))
    }

    /// A factor's rules.
    ///
    /// # Panics
    ///
    /// Where the handle is of another graph.
    pub fn rules(&self, factor: FactorId) -> &F {
        &self.factors[factor.index()]
    }

    /// The message pinned to a variable.
    pub fn prior(&self, variable: VariableId) -> Option<&M> {
        self.variables.get(variable.index()).and_then(|v| v.prior.as_ref())
    }

    /// The start of a variable's belief.
    pub fn start(&self, variable: VariableId) -> Option<&M> {
        self.variables.get(variable.index()).and_then(|v| v.start.as_ref())
    }

    /// The form of an edge.
    pub fn edge_form(&self, edge: EdgeId) -> &M::Form {
        &self.edge_form[edge.index()]
    }

    /// The factors that touch a variable, each once per port, in the order of creation.
    pub fn factors_of(&self, variable: VariableId) -> Vec<FactorId> {
        let node = self.variables[variable.index()].node;
        let mut factors: Vec<FactorId> = self
            .topology
            .neighbors(node)
            .filter_map(|neighbour| match self.topology[neighbour] {
                Kind::Factor(factor) => Some(factor),
                Kind::Variable(_) => None,
            })
            .collect();
        factors.sort_unstable();
        factors
    }

    /// The other variables that share a factor with this one, in the order of creation.
    pub fn neighbours(&self, variable: VariableId) -> Vec<VariableId> {
        let factors = self.factors_of(variable).into_iter();
        let mut others: Vec<VariableId> =
            factors.flat_map(|f| self.ports(f)).filter(|&v| v != variable).collect();
        others.sort_unstable();
        others.dedup();
        others
    }

    /// The connected components, each a list of variables; both in the order of creation.
    ///
    /// Near-linear time (union-find).
    pub fn components(&self) -> Vec<Vec<VariableId>> {
        let mut sets = petgraph::unionfind::UnionFind::<u32>::new(self.topology.node_count());
        for edge in self.topology.edge_indices() {
            if let Some((a, b)) = self.topology.edge_endpoints(edge) {
                sets.union(a.index() as u32, b.index() as u32);
            }
        }
        let mut place = HashMap::new();
        let mut components: Vec<Vec<VariableId>> = Vec::new();
        for (index, variable) in self.variables.iter().enumerate() {
            let root = sets.find_mut(variable.node.index() as u32);
            let slot = *place.entry(root).or_insert_with(|| {
                components.push(Vec::new());
                components.len() - 1
            });
            components[slot].push(VariableId(index as u32));
        }
        components
    }

    /// Number of independent loops: zero for a tree or forest.
    pub fn loop_count(&self) -> usize {
        let nodes = self.topology.node_count();
        let components = petgraph::algo::connected_components(&self.topology);
        self.topology.edge_count() + components - nodes
    }

    /// The petgraph topology, for questions this type does not answer; variables and factors are its nodes.
    pub fn petgraph(&self) -> UnGraph<String, usize, u32> {
        self.topology.map(|_, kind| self.label(*kind), |_, edge| edge.index())
    }

    pub(crate) fn label(&self, kind: Kind) -> String {
        match kind {
            Kind::Variable(variable) => self.variable_name(variable),
            Kind::Factor(factor) => self.factor_name(factor),
        }
    }

    pub(crate) fn arity(&self, factor: FactorId) -> usize {
        self.edge_range(factor).len()
    }

    pub(crate) fn edge_range(&self, factor: FactorId) -> std::ops::Range<usize> {
        let next = self.factor_nodes.get(factor.index() + 1);
        let end = next.map_or(self.edge_variable.len(), |next| next.first_edge as usize);
        self.factor_nodes[factor.index()].first_edge as usize..end
    }

    pub(crate) fn belief_form(&self, variable: VariableId, edges: &[u32]) -> M::Form {
        let chosen = self.variables[variable.index()].form.clone();
        chosen.unwrap_or_else(|| M::belief_form(edges.iter().map(|&edge| &self.edge_form[edge as usize])))
    }

    pub(crate) fn node_of(&self, factor: FactorId) -> NodeIndex<u32> {
        self.factor_nodes[factor.index()].node
    }

    pub(crate) fn structure(&self) -> &UnGraph<Kind, EdgeId, u32> {
        &self.topology
    }
}

fn factor_label(name: Option<&str>, id: FactorId) -> String {
    match name {
        Some(name) => format!("{name} #{}", id.0),
        None => format!("factor {}", id.0),
    }
}
