//! The engine: messages and beliefs, computed as a schedule asks.

mod flood;
mod forms;
mod gather;
mod pass;
mod send;
mod state;

pub(crate) use state::State;

use crate::graph::Kind;
use crate::schedule::Refusal;
use crate::{
    EdgeId, Factor, FactorGraph, GraphError, Message, Node, Qualities, Quality, Report, Schedule, Stop,
    Topology, VariableId,
};
use forms::Forms;
use pass::{Run, refresh};

/// What variables send to factors.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Outgoing {
    /// The product of all other messages: sum-product proper.
    #[default]
    Extrinsic,
    /// The belief as it is, the factor's own message included; what SPAWN and its kin send by radio.
    Broadcast,
}

/// How a run is done.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// Seed of every random stream.
    pub seed: u64,
    /// The run has converged when nothing changes by more than this in an iteration: no belief where everything
    /// is sent at once, no message otherwise.
    pub tolerance: f64,
    /// The most iterations a run may take.
    pub max_iterations: usize,
    /// Share of the old message kept at each update, from 0 (none) to below 1; the first message along an edge
    /// has no old one and is sent whole.
    pub damping: f64,
    /// What variables send to factors.
    pub outgoing: Outgoing,
    /// Whether to use rayon's threads; the answer is the same bits either way.
    pub parallel: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            seed: 0,
            tolerance: 1e-9,
            max_iterations: 100,
            damping: 0.0,
            outgoing: Outgoing::Extrinsic,
            parallel: true,
        }
    }
}

impl Options {
    fn check(&self) -> Result<(), GraphError> {
        if !(0.0..1.0).contains(&self.damping) {
            let expected = "damping must be at least 0 and below 1";
            return Err(GraphError::Option { what: "damping", value: self.damping, expected });
        }
        if self.tolerance.is_nan() || self.tolerance < 0.0 {
            let expected = "the tolerance must not be negative";
            return Err(GraphError::Option { what: "tolerance", value: self.tolerance, expected });
        }
        Ok(())
    }
}

/// Number of edges from which a pass is worth spreading over threads.
const PARALLEL_EDGES: usize = 32;
/// Number of beliefs from which bringing them up to date is.
const PARALLEL_BELIEFS: usize = 8;
/// Number of messages up to which a product of the others replaces an inexact quotient.
const FEW_MESSAGES: usize = 8;
/// Number of edges from which a belief is updated by the message that changed, and computed anew once per pass:
/// a hub of n edges costs n, not its square.
const HUB_EDGES: usize = 32;

/// Passes messages on a graph.
///
/// Holds one message per edge (factor to variable) and one belief per variable; what variables send is derived
/// from these. After the first iteration no message of fixed size allocates.
pub struct Engine<'g, M: Message, F = Box<dyn Factor<M>>> {
    graph: &'g FactorGraph<M, F>,
    topology: Topology,
    options: Options,
    state: State<M>,
    forms: Forms<M>,
    flood: flood::Plan<M>,
    scratch: Scratch<M>,
    pending: Vec<M>,
    touched: Vec<u32>,
    /// A belief without a message, and the message that replaces it.
    exchange: [M; 2],
}

/// Storage that a thread computes messages in.
#[derive(Clone)]
struct Scratch<M> {
    inputs: Vec<M>,
    output: M,
}

impl<'g, M: Message, F: Factor<M>> Engine<'g, M, F> {
    /// Compiles the graph. Messages start vacuous; beliefs start from priors, or from starts where given.
    ///
    /// Linear time.
    ///
    /// # Errors
    ///
    /// Where an option is out of range, an edge's form does not suit its variable, or priors have no product.
    pub fn new(graph: &'g FactorGraph<M, F>, options: Options) -> Result<Self, GraphError> {
        let topology = Topology::new(graph);
        let state = State::new(graph, &topology);
        Self::with_state(graph, topology, options, state)
    }

    pub(crate) fn with_state(
        graph: &'g FactorGraph<M, F>,
        topology: Topology,
        options: Options,
        state: State<M>,
    ) -> Result<Self, GraphError> {
        options.check()?;
        let forms = Forms::new(graph, &topology)?;
        let vacuous = state.beliefs.first().cloned().unwrap_or_else(|| M::vacuous(&crate::Space::real(1)));
        let arity = graph.factor_ids().map(|factor| graph.arity(factor)).max().unwrap_or(0);
        let scratch = Scratch { inputs: vec![vacuous.clone(); arity], output: vacuous };
        let flood = flood::Plan::new(&topology, &scratch, options.parallel);
        let mut state = state;
        for variable in 0..topology.variable_count() {
            if std::mem::take(&mut state.stale[variable]) {
                refresh(graph, &topology, &options, &mut state, &forms, variable)?;
            }
        }
        let (pending, touched) = (Vec::new(), Vec::new());
        let exchange = [scratch.output.clone(), scratch.output.clone()];
        Ok(Self { graph, topology, options, state, forms, flood, scratch, pending, touched, exchange })
    }

    /// Runs a schedule until it has finished, the messages have converged, or the cap is reached.
    ///
    /// # Errors
    ///
    /// Where the schedule refuses the graph, or a message or product cannot be computed; the error names it.
    pub fn run(&mut self, schedule: &mut dyn Schedule) -> Result<Report, GraphError> {
        schedule.begin(&self.topology).map_err(|refusal| self.explain(refusal))?;
        let cap = self.options.max_iterations;
        let finished = schedule.iterations();
        let mut changes = Vec::with_capacity(cap.min(finished.unwrap_or(cap)).min(1024));
        let topology = std::mem::take(&mut self.topology);
        let outcome = self.iterate(&topology, schedule, &mut changes);
        self.topology = topology;
        let stop = outcome?;
        Ok(Report { iterations: changes.len(), changes, stop, quality: self.qualities() })
    }

    fn iterate(
        &mut self,
        topology: &Topology,
        schedule: &mut dyn Schedule,
        changes: &mut Vec<f64>,
    ) -> Result<Stop, GraphError> {
        let finished = schedule.iterations();
        loop {
            if finished.is_some_and(|last| changes.len() >= last) {
                return Ok(Stop::Finished);
            }
            if changes.len() >= self.options.max_iterations {
                return Ok(Stop::IterationLimit);
            }
            self.state.iteration += 1;
            let change = schedule.iteration(topology, &mut Run { engine: self, topology })?;
            changes.push(change);
            if change <= self.options.tolerance {
                return Ok(Stop::Converged);
            }
        }
    }

    fn explain(&self, refusal: Refusal) -> GraphError {
        let label = |node: &Node| match node {
            Node::Variable(variable) => self.graph.label(Kind::Variable(*variable)),
            Node::Factor(factor) => self.graph.label(Kind::Factor(*factor)),
        };
        match refusal {
            Refusal::Loop(nodes) => GraphError::Loop(nodes.iter().map(label).collect()),
            Refusal::Other(reason) => GraphError::Schedule(reason),
        }
    }

    /// The belief of a variable: the product of its prior and all messages into it.
    ///
    /// # Panics
    ///
    /// Where the handle is of another graph.
    pub fn belief(&self, variable: VariableId) -> &M {
        &self.state.beliefs[variable.index()]
    }

    /// Whether a variable's belief is a product of messages; false where its start still stands in, because
    /// nothing, or too little, is known of the variable.
    ///
    /// # Panics
    ///
    /// Where the handle is of another graph.
    pub fn is_determined(&self, variable: VariableId) -> bool {
        !self.state.guessed[variable.index()] && self.belief(variable).is_proper()
    }

    /// A factor's message along an edge.
    ///
    /// # Panics
    ///
    /// Where the handle is of another graph.
    pub fn message(&self, edge: EdgeId) -> &M {
        &self.state.messages[edge.index()]
    }

    /// What is known of the quality of the message along an edge.
    pub fn edge_quality(&self, edge: EdgeId) -> Quality {
        self.message(edge).quality()
    }

    /// What is known of all messages and beliefs as they stand. A belief found by a product of several modes is told
    /// how many the messages into it had.
    fn qualities(&self) -> Qualities {
        let unknown = Quality::default();
        let mut known = Qualities::default();
        for edge in self.topology.edges() {
            let quality = self.message(edge).quality();
            if quality != unknown {
                known.edges.push((edge, quality));
            }
        }
        for index in 0..self.topology.variable_count() {
            let mut quality = self.state.beliefs[index].quality();
            if quality == unknown {
                continue;
            }
            if let Some(product) = &mut quality.product {
                let edges = self.topology.raw_edges_of_variable(index).iter();
                let before =
                    edges.filter_map(|&edge| known.edge(EdgeId(edge)).and_then(|message| message.modes));
                product.modes_before = product.modes_before.or(before.max());
                product.modes_after = product.modes_after.or(quality.modes);
            }
            known.beliefs.push((VariableId(index as u32), quality));
        }
        known
    }

    /// The graph this engine runs on.
    pub fn graph(&self) -> &'g FactorGraph<M, F> {
        self.graph
    }

    /// The compiled graph.
    pub fn topology(&self) -> &Topology {
        &self.topology
    }

    pub(crate) fn seed(&self) -> u64 {
        self.options.seed
    }

    pub(crate) fn state(&self) -> &State<M> {
        &self.state
    }

    pub(crate) fn into_state(self) -> State<M> {
        self.state
    }
}
