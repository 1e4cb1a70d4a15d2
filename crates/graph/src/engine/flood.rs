//! Every message at once: the pass that large graphs spend their time in.
//!
//! Each factor reads the beliefs as they stood and its own previous messages alone, so its new messages can
//! replace the old in place. Factors are cut into runs of consecutive edges that threads take whole; every
//! message is computed alone, so the cut does not show in the answer.
//!
//! What the pass reports as change is the beliefs': one comparison per variable instead of one per message, and
//! at the end of a pass every message has met its belief.

use super::pass::{damp, extrinsic, product_error, replace_guess, rule_error};
use super::{Engine, Options, PARALLEL_EDGES, Scratch, State};
use crate::{
    Factor, FactorGraph, FactorId, GraphError, Incoming, Message, MessageError, Messages, Outgoing, Purpose,
    Stream, Topology,
};
use std::ops::Range;

/// Factors and variables per run: long enough that splitting costs nothing, short enough to share out.
const RUN_LENGTH: usize = 4096;

/// How a flooding pass is cut, with the storage of each run.
pub(super) struct Plan<M> {
    runs: Vec<FactorRun<M>>,
    variables: Vec<VariableRun<M>>,
    /// The messages as they stood, kept where inputs may have to be multiplied from them.
    previous: Vec<M>,
    parallel: bool,
}

struct FactorRun<M> {
    factors: Range<usize>,
    scratch: Scratch<M>,
    outcome: Result<(), GraphError>,
}

struct VariableRun<M> {
    variables: Range<usize>,
    /// Storage for the belief as it was.
    previous: M,
    outcome: Result<f64, GraphError>,
}

impl<M: Message> Plan<M> {
    pub(super) fn new(topology: &Topology, scratch: &Scratch<M>, parallel: bool) -> Self {
        let small = topology.edge_count() < PARALLEL_EDGES;
        let run = |factors| FactorRun { factors, scratch: scratch.clone(), outcome: Ok(()) };
        let over = |variables| VariableRun { variables, previous: scratch.output.clone(), outcome: Ok(0.0) };
        Self {
            runs: cut(topology.factor_count(), small).map(run).collect(),
            variables: cut(topology.variable_count(), small).map(over).collect(),
            previous: Vec::new(),
            parallel: parallel && !small,
        }
    }
}

/// Consecutive runs of `count` things; one run if they are few.
fn cut(count: usize, small: bool) -> impl Iterator<Item = Range<usize>> {
    let length = if small { count.max(1) } else { run_length(count) };
    (0..count).step_by(length).map(move |start| start..(start + length).min(count))
}

/// Short runs for small graphs of heavy messages, long ones for large graphs of light messages.
fn run_length(count: usize) -> usize {
    (count / 16).clamp(4, RUN_LENGTH)
}

/// What every run reads.
struct Shared<'a, M: Message, F> {
    graph: &'a FactorGraph<M, F>,
    topology: &'a Topology,
    options: &'a Options,
    beliefs: &'a [M],
    state: &'a State<M>,
    /// The messages as they stood, where a start still stands in for a belief.
    previous: &'a [M],
    belief_forms: &'a [M::Form],
}

pub(super) fn everything<M: Message, F: Factor<M>>(
    engine: &mut Engine<'_, M, F>,
    topology: &Topology,
) -> Result<f64, GraphError> {
    let Engine { graph, options, state, belief_forms, flood, .. } = engine;
    let any_guess = state.guessed.contains(&true);
    let mut messages = std::mem::take(&mut state.messages);
    if any_guess || (options.outgoing == Outgoing::Extrinsic && !M::ALWAYS_DIVIDES) {
        // Dividing needs beliefs that are products; extrinsic products read the messages as they stood.
        state.messages = std::mem::take(&mut flood.previous);
        state.messages.clone_from(&messages);
    }
    let beliefs = &state.beliefs;
    let shared = Shared { graph, topology, options, beliefs, state, previous: &[], belief_forms };
    visit_factors(&shared, &mut flood.runs, &mut messages, 0, any_guess, flood.parallel);
    flood.previous = std::mem::replace(&mut state.messages, messages);
    for run in &mut flood.runs {
        std::mem::replace(&mut run.outcome, Ok(()))?;
    }
    state.sent.fill(true);
    let (mut beliefs, mut guessed) = (std::mem::take(&mut state.beliefs), std::mem::take(&mut state.guessed));
    let previous = &flood.previous;
    let shared = Shared { graph, topology, options, beliefs: &[], state, previous, belief_forms };
    visit_variables(&shared, &mut flood.variables, &mut beliefs, &mut guessed, 0, flood.parallel);
    (state.beliefs, state.guessed) = (beliefs, guessed);
    let mut largest: f64 = 0.0;
    for run in &mut flood.variables {
        largest = largest.max(std::mem::replace(&mut run.outcome, Ok(0.0))?);
    }
    Ok(largest)
}

/// Halves the runs until one is left; the depth is the logarithm of their number.
fn visit_factors<M: Message, F: Factor<M>>(
    shared: &Shared<'_, M, F>,
    runs: &mut [FactorRun<M>],
    messages: &mut [M],
    offset: usize,
    any_guess: bool,
    parallel: bool,
) {
    match runs {
        [] => {}
        [run] => {
            run.outcome = send(shared, run.factors.clone(), &mut run.scratch, messages, offset, any_guess)
        }
        _ => {
            let (left, right) = runs.split_at_mut(runs.len() / 2);
            let middle = shared.topology.first_edge(right[0].factors.start);
            let (near, far) = messages.split_at_mut(middle - offset);
            let mut first = || visit_factors(shared, left, near, offset, any_guess, parallel);
            let mut second = || visit_factors(shared, right, far, middle, any_guess, parallel);
            if parallel {
                rayon::join(first, second);
            } else {
                first();
                second();
            }
        }
    }
}

/// All messages of consecutive factors, in place.
fn send<M: Message, F: Factor<M>>(
    shared: &Shared<'_, M, F>,
    factors: Range<usize>,
    scratch: &mut Scratch<M>,
    messages: &mut [M],
    offset: usize,
    any_guess: bool,
) -> Result<(), GraphError> {
    let Shared { graph, topology, options, beliefs, state, .. } = *shared;
    let iteration = state.iteration;
    for factor in factors {
        let rule = &graph.factors[factor];
        let first = topology.first_edge(factor);
        let variables = topology.raw_variables_of_factor(factor);
        if variables.len() == 1 && rule.is_constant() && state.sent[first] {
            continue;
        }
        for (port, &variable) in variables.iter().enumerate() {
            let belief = &beliefs[variable as usize];
            let input = &mut scratch.inputs[port];
            if options.outgoing == Outgoing::Broadcast {
                input.clone_from(belief);
            } else if any_guess || !belief.quotient_into(&messages[first + port - offset], input) {
                without(shared, variable as usize, first + port, input)?;
            }
        }
        let incoming = Incoming::trusted(&scratch.inputs, beliefs, variables);
        for port in 0..variables.len() {
            let edge = first + port;
            let mut stream = Stream::new(options.seed, iteration, Purpose::Message, edge as u64);
            let slot = &mut messages[edge - offset];
            let form = &graph.edge_form[edge];
            let outcome = if options.damping > 0.0 && state.sent[edge] {
                rule.message_into(port, &incoming, form, &mut stream, &mut scratch.output).and_then(|()| {
                    damp(&mut scratch.output, slot, options.damping)?;
                    std::mem::swap(slot, &mut scratch.output);
                    Ok(())
                })
            } else {
                rule.message_into(port, &incoming, form, &mut stream, slot)
            };
            outcome.map_err(|source| rule_error(graph, FactorId(factor as u32), edge, iteration, source))?;
        }
    }
    Ok(())
}

/// The slow way to what a variable sends: the product of the other messages.
fn without<M: Message, F: Factor<M>>(
    shared: &Shared<'_, M, F>,
    variable: usize,
    edge: usize,
    out: &mut M,
) -> Result<(), GraphError> {
    let Shared { graph, topology, options, state, belief_forms, .. } = *shared;
    let mut stream = Stream::new(options.seed, state.iteration, Purpose::Extrinsic, edge as u64);
    extrinsic(topology, state, &belief_forms[variable], variable, edge, &mut stream, out)
        .map_err(|source| product_error(graph, variable, state.iteration, source))
}

/// Halves the runs of variables as [`visit_factors`] does those of factors.
fn visit_variables<M: Message, F: Factor<M>>(
    shared: &Shared<'_, M, F>,
    runs: &mut [VariableRun<M>],
    beliefs: &mut [M],
    guessed: &mut [bool],
    offset: usize,
    parallel: bool,
) {
    match runs {
        [] => {}
        [run] => run.outcome = gather(shared, run.variables.clone(), &mut run.previous, beliefs, guessed),
        _ => {
            let (left, right) = runs.split_at_mut(runs.len() / 2);
            let middle = right[0].variables.start;
            let (near, far) = beliefs.split_at_mut(middle - offset);
            let (near_guessed, far_guessed) = guessed.split_at_mut(middle - offset);
            let mut first = || visit_variables(shared, left, near, near_guessed, offset, parallel);
            let mut second = || visit_variables(shared, right, far, far_guessed, middle, parallel);
            if parallel {
                rayon::join(first, second);
            } else {
                first();
                second();
            }
        }
    }
}

/// The beliefs of consecutive variables; returns the largest change of one.
fn gather<M: Message, F: Factor<M>>(
    shared: &Shared<'_, M, F>,
    variables: Range<usize>,
    previous: &mut M,
    beliefs: &mut [M],
    guessed: &mut [bool],
) -> Result<f64, GraphError> {
    let Shared { graph, topology, options, state, belief_forms, .. } = *shared;
    let mut largest: f64 = 0.0;
    for ((variable, belief), guess) in variables.zip(beliefs).zip(guessed) {
        let edges = topology.raw_edges_of_variable(variable);
        let incoming = Messages::new(&state.messages, edges).with_prior(state.priors[variable].as_ref());
        if incoming.is_empty() {
            continue;
        }
        let mut stream = Stream::new(options.seed, state.iteration, Purpose::Belief, variable as u64);
        let form = &belief_forms[variable];
        let outcome = if *guess {
            // Whatever replaces a guess is news; while nothing does, the messages tell whether they still move.
            replace_guess(incoming, form, &mut stream, belief, guess).map(|()| match *guess {
                true => moved(edges, &state.messages, shared.previous),
                false => 1.0,
            })
        } else {
            M::update(incoming, form, &mut stream, belief, previous)
        };
        let change = outcome.map_err(|source| product_error(graph, variable, state.iteration, source))?;
        if change.is_nan() {
            return Err(not_finite(shared, variable));
        }
        largest = largest.max(change);
    }
    Ok(largest)
}

/// The largest change of the messages along `edges`, and NaN if any is.
fn moved<M: Message>(edges: &[u32], messages: &[M], previous: &[M]) -> f64 {
    let change = |&edge: &u32| messages[edge as usize].change(&previous[edge as usize]);
    let larger = |a: f64, b: f64| if b > a || b.is_nan() { b } else { a };
    edges.iter().map(change).fold(0.0, larger)
}

/// A belief is not finite: blames the first message into it that is not, else the product.
fn not_finite<M: Message, F: Factor<M>>(shared: &Shared<'_, M, F>, variable: usize) -> GraphError {
    let Shared { graph, topology, state, .. } = *shared;
    let edges = topology.raw_edges_of_variable(variable);
    let bad = edges.iter().map(|&edge| edge as usize).find(|&edge| {
        let message = &state.messages[edge];
        message.change(message).is_nan()
    });
    let source = MessageError::NotFinite { what: "the change of the message", value: f64::NAN };
    match bad {
        Some(edge) => {
            rule_error(graph, topology.factor_of(crate::EdgeId(edge as u32)), edge, state.iteration, source)
        }
        None => product_error(graph, variable, state.iteration, source),
    }
}
