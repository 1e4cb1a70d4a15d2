//! Every message at once: the pass that large graphs spend their time in.
//!
//! Each factor reads the beliefs as they stood and its own previous messages alone, so its new messages can
//! replace the old in place. Factors are cut into runs of consecutive edges that threads take whole; every
//! message is computed alone, so the cut does not show in the answer.
//!
//! On one thread, and where messages can be divided out of beliefs, a variable's belief is updated as soon as its last
//! factor has sent: nobody reads the old one any more, and the messages are still in the cache. Otherwise all factors
//! send before the first belief is updated.
//!
//! What the pass reports as change is the beliefs': one comparison per variable instead of one per message, and
//! at the end of a pass every message has met its belief.

use super::forms::Forms;
use super::pass::{damp, extrinsic, product_error, replace_guess, rule_error};
use super::{Engine, Options, PARALLEL_EDGES, Scratch, State};
use crate::{
    Factor, FactorGraph, FactorId, GraphError, Group, Incoming, Message, MessageError, MessageStreams,
    Messages, Outgoing, Port, Purpose, Stream, Topology,
};
use std::ops::Range;

/// Factors and variables per run: long enough that splitting costs nothing, short enough to share out.
const RUN_LENGTH: usize = 4096;

/// Factors between updates of beliefs on one thread: what they send stays in the nearest caches.
const STRIDE: usize = 64;

/// How a flooding pass is cut, with the storage of each run.
pub(super) struct Plan<M> {
    runs: Vec<FactorRun<M>>,
    variables: Vec<VariableRun<M>>,
    /// For one thread: the variables by the stride of factors after which nothing more is sent to them.
    done: Done,
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
            done: if parallel && !small { Done::default() } else { Done::new(topology) },
            previous: Vec::new(),
            parallel: parallel && !small,
        }
    }
}

/// The variables in the order in which their last factor sends.
#[derive(Default)]
struct Done {
    variables: Vec<u32>,
    /// Where the variables of each stride of factors begin.
    starts: Vec<u32>,
}

impl Done {
    /// A counting sort; linear time. Variables without factors come with the first stride.
    fn new(topology: &Topology) -> Self {
        let strides = topology.factor_count().div_ceil(STRIDE).max(1);
        let stride = |variable: usize| match topology.raw_edges_of_variable(variable).last() {
            Some(&edge) => topology.factor_of(crate::EdgeId(edge)).index() / STRIDE,
            None => 0,
        };
        let mut starts = vec![0; strides + 1];
        for variable in 0..topology.variable_count() {
            starts[stride(variable) + 1] += 1;
        }
        for index in 0..strides {
            starts[index + 1] += starts[index];
        }
        let mut next = starts.clone();
        let mut variables = vec![0; topology.variable_count()];
        for variable in 0..topology.variable_count() {
            let place = &mut next[stride(variable)];
            variables[*place as usize] = variable as u32;
            *place += 1;
        }
        Self { variables, starts }
    }

    /// The strides' factors and the variables done after each.
    fn strides(&self, factors: usize) -> impl Iterator<Item = (Range<usize>, &[u32])> {
        self.starts.windows(2).enumerate().map(move |(index, bounds)| {
            let stride = index * STRIDE..((index + 1) * STRIDE).min(factors);
            (stride, &self.variables[bounds[0] as usize..bounds[1] as usize])
        })
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
    state: &'a State<M>,
    /// The messages as they stood, where a start still stands in for a belief.
    previous: &'a [M],
    forms: &'a Forms<M>,
}

pub(super) fn everything<M: Message, F: Factor<M>>(
    engine: &mut Engine<'_, M, F>,
    topology: &Topology,
) -> Result<f64, GraphError> {
    let any_guess = engine.state.guessed.contains(&true);
    if M::ALWAYS_DIVIDES && !engine.flood.parallel && !any_guess {
        return interleaved(engine, topology);
    }
    let Engine { graph, options, state, forms, flood, .. } = engine;
    let mut messages = std::mem::take(&mut state.messages);
    if any_guess || (options.outgoing == Outgoing::Extrinsic && !M::ALWAYS_DIVIDES) {
        // Dividing needs beliefs that are products; extrinsic products read the messages as they stood.
        state.messages = std::mem::take(&mut flood.previous);
        state.messages.clone_from(&messages);
    }
    let shared = Shared { graph, topology, options, state, previous: &[], forms };
    visit_factors(&shared, &state.beliefs, &mut flood.runs, &mut messages, 0, any_guess, flood.parallel);
    flood.previous = std::mem::replace(&mut state.messages, messages);
    for run in &mut flood.runs {
        std::mem::replace(&mut run.outcome, Ok(()))?;
    }
    state.sent.fill(true);
    let (mut beliefs, mut guessed) = (std::mem::take(&mut state.beliefs), std::mem::take(&mut state.guessed));
    let previous = &flood.previous;
    let shared = Shared { graph, topology, options, state, previous, forms };
    visit_variables(&shared, &mut flood.variables, &mut beliefs, &mut guessed, 0, flood.parallel);
    (state.beliefs, state.guessed) = (beliefs, guessed);
    let mut largest: f64 = 0.0;
    for run in &mut flood.variables {
        largest = largest.max(std::mem::replace(&mut run.outcome, Ok(0.0))?);
    }
    Ok(largest)
}

/// On one thread, with beliefs that are products and can be divided: each is updated after its last factor.
fn interleaved<M: Message, F: Factor<M>>(
    engine: &mut Engine<'_, M, F>,
    topology: &Topology,
) -> Result<f64, GraphError> {
    let Engine { graph, options, state, forms, flood, scratch, exchange: [previous, _], .. } = engine;
    let mut messages = std::mem::take(&mut state.messages);
    let mut beliefs = std::mem::take(&mut state.beliefs);
    let shared = Shared { graph, topology, options, state, previous: &[], forms };
    let mut largest: f64 = 0.0;
    let outcome = flood.done.strides(topology.factor_count()).try_for_each(|(factors, variables)| {
        send(&shared, &beliefs, factors, scratch, &mut messages, 0, false)?;
        for &variable in variables {
            let (variable, guess) = (variable as usize, &mut false);
            gather(&shared, variable, &messages, previous, &mut beliefs[variable], guess, &mut largest)?;
        }
        Ok(())
    });
    (state.messages, state.beliefs) = (messages, beliefs);
    state.sent.fill(true);
    outcome.map(|()| largest)
}

/// Halves the runs until one is left; the depth is the logarithm of their number.
fn visit_factors<M: Message, F: Factor<M>>(
    shared: &Shared<'_, M, F>,
    beliefs: &[M],
    runs: &mut [FactorRun<M>],
    messages: &mut [M],
    offset: usize,
    any_guess: bool,
    parallel: bool,
) {
    match runs {
        [] => {}
        [run] => {
            run.outcome =
                send(shared, beliefs, run.factors.clone(), &mut run.scratch, messages, offset, any_guess)
        }
        _ => {
            let (left, right) = runs.split_at_mut(runs.len() / 2);
            let middle = shared.topology.first_edge(right[0].factors.start);
            let (near, far) = messages.split_at_mut(middle - offset);
            let mut first = || visit_factors(shared, beliefs, left, near, offset, any_guess, parallel);
            let mut second = || visit_factors(shared, beliefs, right, far, middle, any_guess, parallel);
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
    beliefs: &[M],
    factors: Range<usize>,
    scratch: &mut Scratch<M>,
    messages: &mut [M],
    offset: usize,
    any_guess: bool,
) -> Result<(), GraphError> {
    if M::GROUP > 1 {
        return send_in_groups(shared, beliefs, factors, scratch, messages, offset, any_guess);
    }
    let Shared { graph, topology, options, state, .. } = *shared;
    let Scratch { inputs, output, .. } = scratch;
    let broadcast = options.outgoing == Outgoing::Broadcast;
    let mut first = topology.first_edge(factors.start);
    let mut rest = (&mut messages[first - offset..], &shared.forms.edges[first..]);
    let rules = graph.factors[factors.clone()].iter();
    let variables = topology.raw_variables_of_factors(factors.clone());
    for ((factor, rule), variables) in factors.zip(rules).zip(variables) {
        let arity = variables.len();
        let (own, forms);
        ((own, rest.0), (forms, rest.1)) = (rest.0.split_at_mut(arity), rest.1.split_at(arity));
        let edges = first..first + arity;
        first = edges.end;
        if arity == 1 && rule.is_constant() && state.sent[edges.start] {
            continue;
        }
        for (port, (input, &variable)) in inputs.iter_mut().zip(variables).enumerate() {
            let belief = &beliefs[variable as usize];
            if broadcast {
                input.clone_from(belief);
            } else if any_guess || !belief.quotient_into(&own[port], input) {
                without(shared, variable as usize, edges.start + port, input)?;
            }
        }
        let incoming = Incoming::trusted(inputs, beliefs, variables);
        let streams = MessageStreams::new(options.seed, state.iteration, edges.start as u64);
        let outcome = if options.damping > 0.0 {
            damped(rule, &incoming, forms, streams, &state.sent[edges.clone()], options.damping, own, output)
        } else {
            rule.all_messages_into(&incoming, forms, streams, own)
        };
        if let Err((port, source)) = outcome {
            return Err(failed(shared, factor, edges.start + port, source));
        }
    }
    Ok(())
}

/// As [`send`], of families that want the inputs of many factors at once.
fn send_in_groups<M: Message, F: Factor<M>>(
    shared: &Shared<'_, M, F>,
    beliefs: &[M],
    factors: Range<usize>,
    scratch: &mut Scratch<M>,
    messages: &mut [M],
    offset: usize,
    any_guess: bool,
) -> Result<(), GraphError> {
    let Shared { graph, topology, options, state, forms, .. } = *shared;
    let Options { seed, damping, outgoing, .. } = *options;
    let iteration = state.iteration;
    let mut from = factors.start;
    while from < factors.end {
        let bounds = topology.raw_bounds(from..factors.end);
        let first = bounds[0] as usize;
        let fitting = bounds.partition_point(|&end| end as usize - first <= M::GROUP) - 1;
        let members = from..from + fitting.max(1);
        from = members.end;
        let bounds = &bounds[..=members.len()];
        let edges = first..bounds[members.len()] as usize;
        let variables = topology.raw_variables(edges.clone());
        let own = &mut messages[edges.start - offset..edges.end - offset];
        let Scratch { inputs, output, group } = scratch;
        if group.len() < edges.len() {
            group.resize(edges.len(), output.clone());
        }
        if inputs.len() < edges.len() {
            inputs.resize(edges.len(), output.clone());
        }
        let inputs = &mut inputs[..edges.len()];
        let broadcast = outgoing == Outgoing::Broadcast;
        let mut divided = !any_guess;
        for ((input, message), &variable) in inputs.iter_mut().zip(&*own).zip(variables) {
            if broadcast {
                input.clone_from(&beliefs[variable as usize]);
            } else {
                divided &= beliefs[variable as usize].quotient_into(message, input);
            }
        }
        if !broadcast && !divided {
            for (place, (input, &variable)) in inputs.iter_mut().zip(variables).enumerate() {
                if any_guess || !beliefs[variable as usize].quotient_into(&own[place], input) {
                    without(shared, variable as usize, edges.start + place, input)?;
                }
            }
        }
        let forms = &forms.edges[edges.clone()];
        let seen = Group { inputs, beliefs, variables, bounds, forms, seed, iteration };
        let rules = &graph.factors[members.clone()];
        let new = if damping > 0.0 { &mut group[..edges.len()] } else { &mut *own };
        if let Err((place, source)) = F::many_messages_into(rules, &seen, new) {
            let edge = edges.start + place;
            return Err(failed(shared, topology.factor_of(crate::EdgeId(edge as u32)).index(), edge, source));
        }
        if damping > 0.0 {
            for ((new, old), &sent) in group.iter_mut().zip(own).zip(&state.sent[edges.clone()]) {
                if sent {
                    damp(new, old, damping)
                        .map_err(|source| failed(shared, members.start, edges.start, source))?;
                }
                old.clone_from(new);
            }
        }
    }
    Ok(())
}

#[cold]
fn failed<M: Message, F: Factor<M>>(
    shared: &Shared<'_, M, F>,
    factor: usize,
    edge: usize,
    source: MessageError,
) -> GraphError {
    rule_error(shared.graph, FactorId(factor as u32), edge, shared.state.iteration, source)
}

/// As [`Factor::all_messages_into`], each message moved towards the one it replaces if that was ever sent.
#[allow(clippy::too_many_arguments, reason = "the inputs of a rule, and what damping adds")]
#[inline(never)]
fn damped<M: Message, F: Factor<M>>(
    rule: &F,
    incoming: &Incoming<'_, M>,
    forms: &[M::Form],
    streams: MessageStreams,
    sent: &[bool],
    damping: f64,
    messages: &mut [M],
    output: &mut M,
) -> Result<(), (Port, MessageError)> {
    for (port, slot) in messages.iter_mut().enumerate() {
        let mut outcome = rule.message_into(port, incoming, &forms[port], &mut streams.of(port), output);
        if sent[port] {
            outcome = outcome.and_then(|()| damp(output, slot, damping));
        }
        outcome.map_err(|error| (port, error))?;
        std::mem::swap(slot, output);
    }
    Ok(())
}

/// The slow way to what a variable sends: the product of the other messages.
#[cold]
fn without<M: Message, F: Factor<M>>(
    shared: &Shared<'_, M, F>,
    variable: usize,
    edge: usize,
    out: &mut M,
) -> Result<(), GraphError> {
    let Shared { graph, topology, options, state, forms, .. } = *shared;
    let mut stream = Stream::new(options.seed, state.iteration, Purpose::Extrinsic, edge as u64);
    extrinsic(topology, state, &forms.beliefs[variable], variable, edge, &mut stream, out)
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
        [run] => run.outcome = gather_run(shared, run.variables.clone(), &mut run.previous, beliefs, guessed),
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
fn gather_run<M: Message, F: Factor<M>>(
    shared: &Shared<'_, M, F>,
    variables: Range<usize>,
    previous: &mut M,
    beliefs: &mut [M],
    guessed: &mut [bool],
) -> Result<f64, GraphError> {
    let mut largest: f64 = 0.0;
    for ((variable, belief), guess) in variables.zip(beliefs).zip(guessed) {
        gather(shared, variable, &shared.state.messages, previous, belief, guess, &mut largest)?;
    }
    Ok(largest)
}

/// The belief of one variable; raises `largest` to its change.
#[inline(always)]
fn gather<M: Message, F: Factor<M>>(
    shared: &Shared<'_, M, F>,
    variable: usize,
    messages: &[M],
    previous: &mut M,
    belief: &mut M,
    guess: &mut bool,
    largest: &mut f64,
) -> Result<(), GraphError> {
    let Shared { graph, topology, options, state, forms, .. } = *shared;
    let edges = topology.raw_edges_of_variable(variable);
    let incoming = Messages::new(messages, edges).with_prior(state.priors[variable].as_ref());
    if incoming.is_empty() {
        return Ok(());
    }
    let mut stream = Stream::new(options.seed, state.iteration, Purpose::Belief, variable as u64);
    let form = &forms.beliefs[variable];
    let outcome = if *guess {
        // Whatever replaces a guess is news; while nothing does, the messages tell whether they still move.
        replace_guess(incoming, form, &mut stream, belief, guess).map(|()| {
            let change = if *guess { moved(edges, messages, shared.previous) } else { 1.0 };
            *largest = larger(*largest, change);
        })
    } else {
        M::update(incoming, form, &mut stream, belief, previous, largest)
    };
    match outcome {
        Ok(()) if !largest.is_nan() => Ok(()),
        Ok(()) => Err(not_finite(shared, variable, messages)),
        Err(source) => Err(product_error(graph, variable, state.iteration, source)),
    }
}

/// The larger of two, and NaN if the second is.
fn larger(a: f64, b: f64) -> f64 {
    if b > a || b.is_nan() { b } else { a }
}

/// The largest change of the messages along `edges`, and NaN if any is.
fn moved<M: Message>(edges: &[u32], messages: &[M], previous: &[M]) -> f64 {
    let change = |&edge: &u32| messages[edge as usize].change(&previous[edge as usize]);
    edges.iter().map(change).fold(0.0, larger)
}

/// A belief is not finite: blames the first message into it that is not, else the product.
#[cold]
fn not_finite<M: Message, F: Factor<M>>(
    shared: &Shared<'_, M, F>,
    variable: usize,
    messages: &[M],
) -> GraphError {
    let Shared { graph, topology, state, .. } = *shared;
    let edges = topology.raw_edges_of_variable(variable);
    let bad = edges.iter().map(|&edge| edge as usize).find(|&edge| {
        let message = &messages[edge];
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
