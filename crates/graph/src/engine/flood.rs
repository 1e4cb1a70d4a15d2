//! Every message at once: the pass that large graphs spend their time in.
//!
//! Each factor reads the beliefs as they stood and its own previous messages alone, so its new messages can
//! replace the old in place. Factors are cut into runs of consecutive edges that threads take whole; every
//! message is computed alone, so the cut does not show in the answer.

use super::{
    Engine, Options, PARALLEL_EDGES, Scratch, State, extrinsic, multiply, product_error, rule_error, settle,
};
use crate::{
    Factor, FactorGraph, FactorId, GraphError, Incoming, Message, Messages, Outgoing, Purpose, Stream,
    Topology,
};
use std::ops::Range;

/// Factors and variables per run: long enough that splitting costs nothing, short enough to share out.
const RUN_LENGTH: usize = 4096;

/// How a flooding pass is cut, with the storage of each run.
pub(super) struct Plan<M> {
    runs: Vec<FactorRun<M>>,
    parallel: bool,
}

struct FactorRun<M> {
    factors: Range<usize>,
    scratch: Scratch<M>,
    outcome: Result<f64, GraphError>,
    /// Whether its constant factors have sent their message.
    warm: bool,
}

impl<M: Message> Plan<M> {
    pub(super) fn new(topology: &Topology, scratch: &Scratch<M>, parallel: bool) -> Self {
        let count = topology.factor_count();
        let length = if topology.edge_count() < PARALLEL_EDGES { count.max(1) } else { run_length(count) };
        let mut starts: Vec<usize> = (0..count).step_by(length).collect();
        starts.push(count);
        let run = |factors| FactorRun { factors, scratch: scratch.clone(), outcome: Ok(0.0), warm: false };
        let runs = starts.windows(2).map(|pair| run(pair[0]..pair[1])).collect();
        Self { runs, parallel: parallel && topology.edge_count() >= PARALLEL_EDGES }
    }
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
    belief_forms: &'a [M::Form],
}

pub(super) fn everything<M: Message, F: Factor<M>>(
    engine: &mut Engine<'_, M, F>,
    topology: &Topology,
) -> Result<f64, GraphError> {
    let Engine { graph, options, state, belief_forms, flood, .. } = engine;
    let any_guess = state.guessed.contains(&true);
    let mut messages = std::mem::take(&mut state.messages);
    if any_guess {
        // Dividing needs beliefs that are products; extrinsic products read the messages as they stood.
        state.messages.clone_from(&messages);
    }
    let shared = Shared { graph, topology, options, beliefs: &state.beliefs, state, belief_forms };
    visit_factors(&shared, &mut flood.runs, &mut messages, 0, any_guess, flood.parallel);
    state.messages = messages;
    let mut largest: f64 = 0.0;
    for run in &mut flood.runs {
        largest = largest.max(std::mem::replace(&mut run.outcome, Ok(0.0))?);
    }
    let (mut beliefs, mut guessed) = (std::mem::take(&mut state.beliefs), std::mem::take(&mut state.guessed));
    let shared = Shared { graph, topology, options, beliefs: &[], state, belief_forms };
    let outcome = visit_variables(&shared, &mut beliefs, &mut guessed, 0, flood.parallel);
    (state.beliefs, state.guessed) = (beliefs, guessed);
    outcome?;
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
            run.outcome = send(
                shared,
                run.factors.clone(),
                &mut run.scratch,
                &mut run.warm,
                messages,
                offset,
                any_guess,
            )
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
    warm: &mut bool,
    messages: &mut [M],
    offset: usize,
    any_guess: bool,
) -> Result<f64, GraphError> {
    let Shared { graph, topology, options, beliefs, .. } = *shared;
    let iteration = shared.state.iteration;
    let mut largest: f64 = 0.0;
    for factor in factors {
        let rule = &graph.factors[factor].factor;
        if *warm && rule.is_constant() {
            continue;
        }
        let first = topology.first_edge(factor);
        let variables = topology.raw_variables_of_factor(factor);
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
            let change = rule
                .message_into(port, &incoming, form, &mut stream, &mut scratch.output)
                .and_then(|()| settle(&mut scratch.output, slot, options.damping))
                .map_err(|source| rule_error(graph, FactorId(factor as u32), edge, iteration, source))?;
            largest = largest.max(change);
            std::mem::swap(slot, &mut scratch.output);
        }
    }
    *warm = true;
    Ok(largest)
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

fn visit_variables<M: Message, F: Factor<M>>(
    shared: &Shared<'_, M, F>,
    beliefs: &mut [M],
    guessed: &mut [bool],
    offset: usize,
    parallel: bool,
) -> Result<(), GraphError> {
    let middle = beliefs.len() / 2;
    if parallel && beliefs.len() > run_length(shared.topology.variable_count()) {
        let (near, far) = beliefs.split_at_mut(middle);
        let (near_guessed, far_guessed) = guessed.split_at_mut(middle);
        let (first, second) = rayon::join(
            || visit_variables(shared, near, near_guessed, offset, parallel),
            || visit_variables(shared, far, far_guessed, offset + middle, parallel),
        );
        return first.and(second);
    }
    let Shared { graph, topology, options, state, belief_forms, .. } = *shared;
    for (index, (belief, guess)) in beliefs.iter_mut().zip(guessed).enumerate() {
        let variable = offset + index;
        let edges = topology.raw_edges_of_variable(variable);
        let incoming = Messages::new(&state.messages, edges).with_prior(state.priors[variable].as_ref());
        let mut stream = Stream::new(options.seed, state.iteration, Purpose::Belief, variable as u64);
        multiply(incoming, &belief_forms[variable], &mut stream, belief, guess)
            .map_err(|source| product_error(graph, variable, state.iteration, source))?;
    }
    Ok(())
}
