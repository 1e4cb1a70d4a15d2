//! One edge at a time: messages computed together or in order, and the beliefs that follow them.

use super::forms::Forms;
use super::{
    Engine, FEW_MESSAGES, HUB_EDGES, Options, Outgoing, PARALLEL_BELIEFS, PARALLEL_EDGES, Scratch, State,
};
use crate::{
    EdgeId, Factor, FactorGraph, FactorId, GraphError, Incoming, Message, MessageError, Messages, Pass,
    Purpose, Stream, Topology, VariableId,
};
use rayon::prelude::*;

/// Brings the belief of `variable` up to date.
pub(super) fn refresh<M: Message, F: Factor<M>>(
    graph: &FactorGraph<M, F>,
    topology: &Topology,
    options: &Options,
    state: &mut State<M>,
    forms: &Forms<M>,
    variable: usize,
) -> Result<(), GraphError> {
    let State { iteration, messages, beliefs, priors, guessed, .. } = state;
    let evidence = Evidence { messages, prior: priors[variable].as_ref(), iteration: *iteration };
    renew(
        graph,
        topology,
        options,
        forms,
        evidence,
        variable,
        (&mut beliefs[variable], &mut guessed[variable]),
    )
}

/// What a belief is the product of.
struct Evidence<'a, M> {
    messages: &'a [M],
    prior: Option<&'a M>,
    iteration: u64,
}

/// The product of the messages into `variable`, into a belief that is as it was, and whether a start still stands in
/// for it.
fn renew<M: Message, F: Factor<M>>(
    graph: &FactorGraph<M, F>,
    topology: &Topology,
    options: &Options,
    forms: &Forms<M>,
    evidence: Evidence<'_, M>,
    variable: usize,
    (belief, guessed): (&mut M, &mut bool),
) -> Result<(), GraphError> {
    let Evidence { messages, prior, iteration } = evidence;
    let incoming = Messages::new(messages, topology.raw_edges_of_variable(variable)).with_prior(prior);
    if incoming.is_empty() {
        return Ok(());
    }
    let mut stream = Stream::new(options.seed, iteration, Purpose::Belief, variable as u64);
    let form = &forms.beliefs[variable];
    let outcome = if *guessed {
        replace_guess(incoming, form, &mut stream, belief, guessed)
    } else {
        M::product_into(incoming, form, &mut stream, belief)
    };
    outcome.map_err(|source| product_error(graph, variable, iteration, source))
}

/// The product of `incoming`; the start keeps standing in for a belief that is not yet a distribution.
pub(super) fn replace_guess<M: Message>(
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

#[cold]
pub(super) fn product_error<M: Message, F: Factor<M>>(
    graph: &FactorGraph<M, F>,
    variable: usize,
    iteration: u64,
    source: MessageError,
) -> GraphError {
    GraphError::Product { variable: graph.variable_name(VariableId(variable as u32)), iteration, source }
}

#[cold]
pub(super) fn rule_error<M: Message, F: Factor<M>>(
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
pub(super) struct Run<'e, 'g, M: Message, F> {
    pub(super) engine: &'e mut Engine<'g, M, F>,
    pub(super) topology: &'e Topology,
}

impl<M: Message, F: Factor<M>> Run<'_, '_, M, F> {
    fn refresh(&mut self, variable: usize) -> Result<(), GraphError> {
        let Engine { graph, state, forms, options, .. } = &mut *self.engine;
        refresh(graph, self.topology, options, state, forms, variable)
    }
}

/// Computes the message along `edge` into `scratch.output`; returns how far it moved.
fn compute<M: Message, F: Factor<M>>(
    graph: &FactorGraph<M, F>,
    topology: &Topology,
    options: &Options,
    state: &State<M>,
    forms: &Forms<M>,
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
        extrinsic(
            topology,
            (state, Standing { beliefs: &state.beliefs, guessed: &state.guessed }),
            &forms.beliefs[variable],
            variable,
            into,
            &mut stream,
            input,
        )
        .map_err(|source| product_error(graph, variable, iteration, source))?;
    }
    let incoming = Incoming::trusted(&scratch.inputs, &state.beliefs, variables);
    let mut stream = Stream::new(options.seed, iteration, Purpose::Message, edge.index() as u64);
    let (to, form) = (edge.index() - first, &forms.edges[edge.index()]);
    let rule = &graph.factors[factor.index()];
    rule.message_into(to, &incoming, form, &mut stream, &mut scratch.output)
        .map_err(|source| rule_error(graph, factor, edge.index(), iteration, source))?;
    let previous = &state.messages[edge.index()];
    let damping = if state.sent[edge.index()] { options.damping } else { 0.0 };
    settle(&mut scratch.output, previous, damping)
        .map_err(|source| rule_error(graph, factor, edge.index(), iteration, source))
}

/// Moves a new message towards the old one.
pub(super) fn damp<M: Message>(message: &mut M, previous: &M, damping: f64) -> Result<(), MessageError> {
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

/// The beliefs as they stand, and for which of them a start stands in.
pub(super) struct Standing<'a, M> {
    pub(super) beliefs: &'a [M],
    pub(super) guessed: &'a [bool],
}

impl<M> Clone for Standing<'_, M> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<M> Copy for Standing<'_, M> {}

/// What `variable` sends along `edge`: its belief without that edge's message.
pub(super) fn extrinsic<M: Message>(
    topology: &Topology,
    (state, standing): (&State<M>, Standing<'_, M>),
    form: &M::Form,
    variable: usize,
    edge: usize,
    stream: &mut Stream,
    out: &mut M,
) -> Result<(), MessageError> {
    let edges = topology.raw_edges_of_variable(variable);
    let others = Messages::new(&state.messages, edges).with_prior(state.priors[variable].as_ref());
    let Standing { beliefs, guessed } = standing;
    let divide = !guessed[variable] && (M::EXACT_QUOTIENT || others.len() > FEW_MESSAGES);
    if divide && beliefs[variable].quotient_into(&state.messages[edge], out) {
        return Ok(());
    }
    let others = others.without(edge as u32);
    if others.is_empty() {
        out.clone_from(&state.vacuous[state.vacuous_of[variable] as usize]);
        return Ok(());
    }
    // A product may read the belief it replaces (the particles that carry it).
    out.clone_from(&beliefs[variable]);
    M::product_into(others, form, stream, out)
}

impl<M: Message, F: Factor<M>> Pass for Run<'_, '_, M, F> {
    fn damping(&self) -> f64 {
        self.engine.options.damping
    }

    fn everything(&mut self) -> Result<f64, GraphError> {
        super::flood::everything(self.engine, self.topology)
    }

    fn together(&mut self, edges: &[EdgeId]) -> Result<f64, GraphError> {
        let Engine { graph, options, state, forms, scratch, pending, touched, .. } = &mut *self.engine;
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
                        let change = compute(graph, topology, options, state, forms, scratch, edge)?;
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
                largest = largest.max(compute(graph, topology, options, state, forms, scratch, edge)?);
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
        if self.engine.options.parallel && self.engine.touched.len() >= PARALLEL_BELIEFS {
            self.refresh_touched()?;
            return Ok(largest);
        }
        for index in 0..self.engine.touched.len() {
            self.refresh(self.engine.touched[index] as usize)?;
        }
        Ok(largest)
    }

    fn in_order(&mut self, edges: &[EdgeId]) -> Result<f64, GraphError> {
        let mut largest: f64 = 0.0;
        self.engine.touched.clear();
        for &edge in edges {
            let Engine { graph, options, state, forms, scratch, .. } = &mut *self.engine;
            largest = largest.max(compute(graph, self.topology, options, state, forms, scratch, edge)?);
            std::mem::swap(&mut state.messages[edge.index()], &mut scratch.output);
            state.sent[edge.index()] = true;
            let variable = self.topology.variable_of(edge).index();
            if self.replace_in_hub(edge, variable)? {
                self.engine.touched.push(variable as u32);
            } else {
                self.refresh(variable)?;
            }
        }
        self.engine.touched.sort_unstable();
        self.engine.touched.dedup();
        for index in 0..self.engine.touched.len() {
            self.refresh(self.engine.touched[index] as usize)?;
        }
        Ok(largest)
    }
}

impl<M: Message, F: Factor<M>> Run<'_, '_, M, F> {
    /// Brings the beliefs of all touched variables up to date, each on whichever thread is free.
    fn refresh_touched(&mut self) -> Result<(), GraphError> {
        let Engine { graph, options, state, forms, scratch, pending, touched, .. } = &mut *self.engine;
        let (touched, topology) = (touched.as_slice(), self.topology);
        if pending.len() < touched.len() {
            pending.resize(touched.len(), scratch.output.clone());
        }
        let State { iteration, messages, beliefs, priors, guessed, .. } = state;
        for (slot, &variable) in pending.iter_mut().zip(touched) {
            std::mem::swap(slot, &mut beliefs[variable as usize]);
        }
        let (messages, priors, before) = (messages.as_slice(), priors.as_slice(), guessed.as_slice());
        let outcomes: Vec<Result<bool, GraphError>> = touched
            .par_iter()
            .zip(pending.par_iter_mut())
            .map(|(&variable, belief)| {
                let variable = variable as usize;
                let mut guessed = before[variable];
                let prior = priors[variable].as_ref();
                let evidence = Evidence { messages, prior, iteration: *iteration };
                renew(graph, topology, options, forms, evidence, variable, (belief, &mut guessed))?;
                Ok(guessed)
            })
            .collect();
        for (slot, &variable) in pending.iter_mut().zip(touched) {
            std::mem::swap(slot, &mut beliefs[variable as usize]);
        }
        for (outcome, &variable) in outcomes.into_iter().zip(touched) {
            guessed[variable as usize] = outcome?;
        }
        Ok(())
    }

    /// Replaces one message, of which the old one is in the scratch, in the belief of a variable with many edges;
    /// false where the belief must be computed anew.
    fn replace_in_hub(&mut self, edge: EdgeId, variable: usize) -> Result<bool, GraphError> {
        let Engine { graph, options, state, forms, scratch, exchange, .. } = &mut *self.engine;
        let edges = self.topology.raw_edges_of_variable(variable);
        if !M::ALWAYS_DIVIDES || edges.len() < HUB_EDGES || state.guessed[variable] {
            return Ok(false);
        }
        let belief = &mut state.beliefs[variable];
        if !belief.quotient_into(&scratch.output, &mut exchange[0]) {
            return Ok(false);
        }
        exchange[1].clone_from(&state.messages[edge.index()]);
        let mut stream = Stream::new(options.seed, state.iteration, Purpose::Belief, variable as u64);
        let pair = Messages::new(&exchange[..], &[0, 1]);
        M::product_into(pair, &forms.beliefs[variable], &mut stream, belief)
            .map_err(|source| product_error(graph, variable, state.iteration, source))?;
        Ok(true)
    }
}
