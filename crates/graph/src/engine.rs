//! The engine: messages and beliefs, computed as a schedule asks.

mod flood;
mod state;

pub(crate) use state::State;

use crate::graph::Kind;
use crate::schedule::Refusal;
use crate::{
    EdgeId, Factor, FactorGraph, FactorId, GraphError, Incoming, Message, MessageError, Messages, Node, Pass,
    Purpose, Quality, Report, Schedule, Stop, Stream, Topology, VariableId,
};
use rayon::prelude::*;

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
    /// The run has converged when no message changes by more than this in an iteration.
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
/// Number of messages up to which a product of the others replaces an inexact quotient.
const FEW_MESSAGES: usize = 8;

/// Passes messages on a graph.
///
/// Holds one message per edge (factor to variable) and one belief per variable; what variables send is derived
/// from these. After the first iteration no message of fixed size allocates.
pub struct Engine<'g, M: Message, F = Box<dyn Factor<M>>> {
    graph: &'g FactorGraph<M, F>,
    topology: Topology,
    options: Options,
    state: State<M>,
    belief_forms: Vec<M::Form>,
    flood: flood::Plan<M>,
    scratch: Scratch<M>,
    pending: Vec<M>,
    touched: Vec<u32>,
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
        for factor in graph.factor_ids() {
            for (port, edge) in graph.edge_range(factor).enumerate() {
                let variable = VariableId(graph.edge_variable[edge]);
                M::check_form(&graph.edge_form[edge], graph.space(variable)).map_err(|reason| {
                    GraphError::Form {
                        factor: graph.factor_name(factor),
                        port,
                        variable: graph.variable_name(variable),
                        reason,
                    }
                })?;
            }
        }
        let belief_forms: Vec<M::Form> = graph
            .variable_ids()
            .map(|variable| graph.belief_form(variable, topology.raw_edges_of_variable(variable.index())))
            .collect();
        let vacuous = state.beliefs.first().cloned().unwrap_or_else(|| M::vacuous(&crate::Space::real(1)));
        let arity = graph.factor_ids().map(|factor| graph.arity(factor)).max().unwrap_or(0);
        let scratch = Scratch { inputs: vec![vacuous.clone(); arity], output: vacuous };
        let flood = flood::Plan::new(&topology, &scratch, options.parallel);
        let mut state = state;
        for variable in 0..topology.variable_count() {
            if std::mem::take(&mut state.stale[variable]) {
                refresh(graph, &topology, &options, &mut state, &belief_forms, variable)?;
            }
        }
        let (pending, touched) = (Vec::new(), Vec::new());
        Ok(Self { graph, topology, options, state, belief_forms, flood, scratch, pending, touched })
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
        Ok(Report { iterations: changes.len(), changes, stop })
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

/// Brings the belief of `variable` up to date.
fn refresh<M: Message, F: Factor<M>>(
    graph: &FactorGraph<M, F>,
    topology: &Topology,
    options: &Options,
    state: &mut State<M>,
    belief_forms: &[M::Form],
    variable: usize,
) -> Result<(), GraphError> {
    let State { iteration, messages, beliefs, priors, guessed, .. } = state;
    let edges = topology.raw_edges_of_variable(variable);
    let incoming = Messages::new(messages, edges).with_prior(priors[variable].as_ref());
    if incoming.is_empty() {
        return Ok(());
    }
    let mut stream = Stream::new(options.seed, *iteration, Purpose::Belief, variable as u64);
    let (form, belief) = (&belief_forms[variable], &mut beliefs[variable]);
    let outcome = if guessed[variable] {
        replace_guess(incoming, form, &mut stream, belief, &mut guessed[variable])
    } else {
        M::product_into(incoming, form, &mut stream, belief)
    };
    outcome.map_err(|source| product_error(graph, variable, *iteration, source))
}

/// The product of `incoming`; the start keeps standing in for a belief that is not yet a distribution.
fn replace_guess<M: Message>(
    incoming: Messages<'_, M>,
    form: &M::Form,
    stream: &mut Stream,
    belief: &mut M,
    guessed: &mut bool,
) -> Result<(), MessageError> {
    let mut product = belief.clone();
    M::product_into(incoming, form, stream, &mut product)?;
    if product.is_proper() {
        *belief = product;
        *guessed = false;
    }
    Ok(())
}

fn product_error<M: Message, F: Factor<M>>(
    graph: &FactorGraph<M, F>,
    variable: usize,
    iteration: u64,
    source: MessageError,
) -> GraphError {
    GraphError::Product { variable: graph.variable_name(VariableId(variable as u32)), iteration, source }
}

fn rule_error<M: Message, F: Factor<M>>(
    graph: &FactorGraph<M, F>,
    factor: FactorId,
    edge: usize,
    iteration: u64,
    source: MessageError,
) -> GraphError {
    let port = edge - graph.edge_range(factor).start;
    let variable = graph.variable_name(VariableId(graph.edge_variable[edge]));
    GraphError::Rule { factor: graph.factor_name(factor), port, variable, iteration, source }
}

/// A pass over a borrowed topology, so that schedules can read it while the engine works.
struct Run<'e, 'g, M: Message, F> {
    engine: &'e mut Engine<'g, M, F>,
    topology: &'e Topology,
}

impl<M: Message, F: Factor<M>> Run<'_, '_, M, F> {
    fn refresh(&mut self, variable: usize) -> Result<(), GraphError> {
        let Engine { graph, state, belief_forms, options, .. } = &mut *self.engine;
        refresh(graph, self.topology, options, state, belief_forms, variable)
    }
}

/// Computes the message along `edge` into `scratch.output`; returns how far it moved.
fn compute<M: Message, F: Factor<M>>(
    graph: &FactorGraph<M, F>,
    topology: &Topology,
    options: &Options,
    state: &State<M>,
    belief_forms: &[M::Form],
    scratch: &mut Scratch<M>,
    edge: EdgeId,
) -> Result<f64, GraphError> {
    let factor = topology.factor_of(edge);
    let iteration = state.iteration;
    let first = topology.first_edge(factor.index());
    let variables = topology.raw_variables_of_factor(factor.index());
    for (port, &variable) in variables.iter().enumerate() {
        let (into, variable) = (first + port, variable as usize);
        if into == edge.index() {
            continue;
        }
        let input = &mut scratch.inputs[port];
        if options.outgoing == Outgoing::Broadcast {
            input.clone_from(&state.beliefs[variable]);
            continue;
        }
        let mut stream = Stream::new(options.seed, iteration, Purpose::Extrinsic, into as u64);
        extrinsic(topology, state, &belief_forms[variable], variable, into, &mut stream, input)
            .map_err(|source| product_error(graph, variable, iteration, source))?;
    }
    let incoming = Incoming::trusted(&scratch.inputs, &state.beliefs, variables);
    let mut stream = Stream::new(options.seed, iteration, Purpose::Message, edge.index() as u64);
    let (to, form) = (edge.index() - first, &graph.edge_form[edge.index()]);
    let rule = &graph.factors[factor.index()];
    rule.message_into(to, &incoming, form, &mut stream, &mut scratch.output)
        .map_err(|source| rule_error(graph, factor, edge.index(), iteration, source))?;
    let previous = &state.messages[edge.index()];
    let damping = if state.sent[edge.index()] { options.damping } else { 0.0 };
    settle(&mut scratch.output, previous, damping)
        .map_err(|source| rule_error(graph, factor, edge.index(), iteration, source))
}

/// Moves a new message towards the old one.
fn damp<M: Message>(message: &mut M, previous: &M, damping: f64) -> Result<(), MessageError> {
    if message.damp(previous, damping) {
        return Ok(());
    }
    Err(MessageError::Unsupported("messages of this form cannot be damped; set damping to 0".into()))
}

/// Damps a new message and measures how far it moved.
fn settle<M: Message>(message: &mut M, previous: &M, damping: f64) -> Result<f64, MessageError> {
    if damping > 0.0 {
        damp(message, previous, damping)?;
    }
    let change = message.change(previous);
    if change.is_nan() {
        return Err(MessageError::NotFinite { what: "the change of the message", value: change });
    }
    Ok(change)
}

/// What `variable` sends along `edge`: its belief without that edge's message.
fn extrinsic<M: Message>(
    topology: &Topology,
    state: &State<M>,
    form: &M::Form,
    variable: usize,
    edge: usize,
    stream: &mut Stream,
    out: &mut M,
) -> Result<(), MessageError> {
    let edges = topology.raw_edges_of_variable(variable);
    let others = Messages::new(&state.messages, edges).with_prior(state.priors[variable].as_ref());
    let divide = !state.guessed[variable] && (M::EXACT_QUOTIENT || others.len() > FEW_MESSAGES);
    if divide && state.beliefs[variable].quotient_into(&state.messages[edge], out) {
        return Ok(());
    }
    let others = others.without(edge as u32);
    if others.is_empty() {
        out.clone_from(&state.vacuous[state.vacuous_of[variable] as usize]);
        return Ok(());
    }
    // A product may read the belief it replaces (the particles that carry it).
    out.clone_from(&state.beliefs[variable]);
    M::product_into(others, form, stream, out)
}

impl<M: Message, F: Factor<M>> Pass for Run<'_, '_, M, F> {
    fn damping(&self) -> f64 {
        self.engine.options.damping
    }

    fn everything(&mut self) -> Result<f64, GraphError> {
        flood::everything(self.engine, self.topology)
    }

    fn together(&mut self, edges: &[EdgeId]) -> Result<f64, GraphError> {
        let Engine { graph, options, state, belief_forms, scratch, pending, touched, .. } = &mut *self.engine;
        let topology = self.topology;
        if pending.len() < edges.len() {
            pending.resize(edges.len(), scratch.output.clone());
        }
        let mut largest: f64 = 0.0;
        if options.parallel && edges.len() >= PARALLEL_EDGES {
            // Collected as results, so that of several errors the first in order is returned.
            let changes: Vec<Result<f64, GraphError>> = edges
                .par_iter()
                .zip(pending.par_iter_mut())
                .map_init(
                    || scratch.clone(),
                    |scratch, (&edge, slot)| {
                        let change = compute(graph, topology, options, state, belief_forms, scratch, edge)?;
                        std::mem::swap(slot, &mut scratch.output);
                        Ok(change)
                    },
                )
                .collect();
            for change in changes {
                largest = largest.max(change?);
            }
        } else {
            for (&edge, slot) in edges.iter().zip(pending.iter_mut()) {
                largest = largest.max(compute(graph, topology, options, state, belief_forms, scratch, edge)?);
                std::mem::swap(slot, &mut scratch.output);
            }
        }
        touched.clear();
        for (&edge, slot) in edges.iter().zip(pending.iter_mut()) {
            std::mem::swap(&mut state.messages[edge.index()], slot);
            state.sent[edge.index()] = true;
            touched.push(topology.variable_of(edge).0);
        }
        touched.sort_unstable();
        touched.dedup();
        for index in 0..self.engine.touched.len() {
            self.refresh(self.engine.touched[index] as usize)?;
        }
        Ok(largest)
    }

    fn in_order(&mut self, edges: &[EdgeId]) -> Result<f64, GraphError> {
        let mut largest: f64 = 0.0;
        for &edge in edges {
            let Engine { graph, options, state, belief_forms, scratch, .. } = &mut *self.engine;
            largest =
                largest.max(compute(graph, self.topology, options, state, belief_forms, scratch, edge)?);
            std::mem::swap(&mut state.messages[edge.index()], &mut scratch.output);
            state.sent[edge.index()] = true;
            self.refresh(self.topology.variable_of(edge).index())?;
        }
        Ok(largest)
    }
}
