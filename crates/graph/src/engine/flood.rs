//! Every message at once: the pass that large graphs spend their time in.
//!
//! Each factor reads the beliefs as they stood and its own previous messages alone, so its new messages can
//! replace the old in place; where a message may not be divided out of a belief, the others are multiplied as they
//! stood, and new messages go to storage of their own. Factors are cut into runs of consecutive edges that threads take
//! whole; every message is computed alone, so the cut does not show in the answer.
//!
//! On one thread a variable's belief is updated as soon as its last factor has sent: nobody reads the old one any more,
//! and the messages are still in the cache. On many, all factors send before the first belief is updated.
//!
//! What the pass reports as change is the beliefs': one comparison per variable instead of one per message, and
//! at the end of a pass every message has met its belief.

use super::forms::Forms;
use super::gather::{gather, gather_run};
use super::pass::Standing;
use super::send::send;
use super::{Engine, Options, PARALLEL_EDGES, Scratch, State};
use crate::{Factor, FactorGraph, GraphError, Message, Outgoing, Topology};
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
    /// The messages before the last pass, whose storage the next one writes to where it may not do so in place.
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

    /// Whether all factors sent; the first in order that failed.
    fn sent(&mut self) -> Result<(), GraphError> {
        self.runs.iter_mut().try_for_each(|run| std::mem::replace(&mut run.outcome, Ok(())))
    }

    /// The largest change of a belief; the first in order that failed.
    fn gathered(&mut self) -> Result<f64, GraphError> {
        let mut largest: f64 = 0.0;
        for run in &mut self.variables {
            largest = largest.max(std::mem::replace(&mut run.outcome, Ok(0.0))?);
        }
        Ok(largest)
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
pub(super) struct Shared<'a, M: Message, F> {
    pub(super) graph: &'a FactorGraph<M, F>,
    pub(super) topology: &'a Topology,
    pub(super) options: &'a Options,
    pub(super) state: &'a State<M>,
    /// Whether the state keeps the messages as they stood; else they are replaced in place.
    pub(super) kept: bool,
    pub(super) forms: &'a Forms<M>,
    /// Whether a start stands in for any belief.
    pub(super) any_guess: bool,
    /// Whether every message as it stood can be divided out of its belief.
    pub(super) divided: bool,
    /// Whether every edge was sent a message before.
    pub(super) all_sent: bool,
}

impl<'a, M: Message, F> Shared<'a, M, F> {
    /// The messages as they stood, where they are kept.
    pub(super) fn before(&self) -> Option<&'a [M]> {
        self.kept.then_some(&self.state.messages)
    }
}

impl<M: Message, F> Clone for Shared<'_, M, F> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<M: Message, F> Copy for Shared<'_, M, F> {}

pub(super) fn everything<M: Message, F: Factor<M>>(
    engine: &mut Engine<'_, M, F>,
    topology: &Topology,
) -> Result<f64, GraphError> {
    let Engine { graph, options, state, forms, flood, scratch, exchange: [previous, _], .. } = engine;
    let any_guess = state.guessed.contains(&true);
    // Dividing needs beliefs that are products; extrinsic products read the messages as they stood.
    let divided = !any_guess && (M::ALWAYS_DIVIDES || every(&state.messages, M::can_be_divided_out));
    let multiplied = options.outgoing == Outgoing::Extrinsic && !divided;
    // Groups are damped on their way from one storage to the other.
    let kept = any_guess || multiplied || (options.damping > 0.0 && M::GROUP > 1);
    let mut messages = std::mem::take(&mut state.messages);
    if kept {
        state.messages = messages;
        messages = std::mem::take(&mut flood.previous);
        if messages.len() != state.messages.len() {
            messages.clone_from(&state.messages);
        }
    }
    let (mut beliefs, mut guessed) = (std::mem::take(&mut state.beliefs), std::mem::take(&mut state.guessed));
    let all_sent = every(&state.sent, |&sent| sent);
    let shared = Shared { graph, topology, options, state, kept, forms, any_guess, divided, all_sent };
    let outcome = if flood.parallel || any_guess {
        in_turn(&shared, flood, &mut messages, &mut beliefs, &mut guessed)
    } else {
        interleaved(&shared, &flood.done, scratch, previous, &mut messages, &mut beliefs, &guessed)
    };
    (state.beliefs, state.guessed) = (beliefs, guessed);
    if kept && outcome.is_err() {
        // Messages not reached are those of the pass before the last.
        flood.previous = messages;
    } else {
        flood.previous = std::mem::replace(&mut state.messages, messages);
    }
    if outcome.is_ok() {
        state.sent.fill(true);
    }
    outcome
}

/// Whether all are so: without a branch for each, and no further than the stretch of the first that is not.
fn every<T>(all: &[T], so: impl Fn(&T) -> bool) -> bool {
    all.chunks(1024).all(|stretch| stretch.iter().fold(true, |every, one| every & so(one)))
}

/// All factors, then all variables, on however many threads.
fn in_turn<M: Message, F: Factor<M>>(
    shared: &Shared<'_, M, F>,
    plan: &mut Plan<M>,
    messages: &mut [M],
    beliefs: &mut [M],
    guessed: &mut [bool],
) -> Result<f64, GraphError> {
    let standing = Standing { beliefs, guessed };
    visit_factors(shared, standing, &mut plan.runs, messages, 0, plan.parallel);
    plan.sent()?;
    visit_variables(shared, &mut plan.variables, messages, beliefs, guessed, 0, plan.parallel);
    plan.gathered()
}

/// On one thread, with beliefs that are products: each is updated after its last factor.
fn interleaved<M: Message, F: Factor<M>>(
    shared: &Shared<'_, M, F>,
    done: &Done,
    scratch: &mut Scratch<M>,
    previous: &mut M,
    messages: &mut [M],
    beliefs: &mut [M],
    guessed: &[bool],
) -> Result<f64, GraphError> {
    let mut largest: f64 = 0.0;
    // As in turn: a factor's failure is told before a product's, and of several the first.
    let mut failed: Option<(usize, GraphError)> = None;
    for (factors, variables) in done.strides(shared.topology.factor_count()) {
        send(shared, Standing { beliefs, guessed }, factors, scratch, messages, 0)?;
        for &variable in variables {
            let (variable, guess) = (variable as usize, &mut false);
            let belief = &mut beliefs[variable];
            if let Err(error) = gather(shared, variable, messages, previous, belief, guess, &mut largest)
                && failed.as_ref().is_none_or(|(first, _)| variable < *first)
            {
                failed = Some((variable, error));
            }
        }
    }
    failed.map_or(Ok(largest), |(_, error)| Err(error))
}

/// Halves the runs until one is left; the depth is the logarithm of their number.
fn visit_factors<M: Message, F: Factor<M>>(
    shared: &Shared<'_, M, F>,
    standing: Standing<'_, M>,
    runs: &mut [FactorRun<M>],
    messages: &mut [M],
    offset: usize,
    parallel: bool,
) {
    match runs {
        [] => {}
        [run] => {
            run.outcome = send(shared, standing, run.factors.clone(), &mut run.scratch, messages, offset)
        }
        _ => {
            let (left, right) = runs.split_at_mut(runs.len() / 2);
            let middle = shared.topology.first_edge(right[0].factors.start);
            let (near, far) = messages.split_at_mut(middle - offset);
            let mut first = || visit_factors(shared, standing, left, near, offset, parallel);
            let mut second = || visit_factors(shared, standing, right, far, middle, parallel);
            if parallel {
                rayon::join(first, second);
            } else {
                first();
                second();
            }
        }
    }
}

/// Halves the runs of variables as [`visit_factors`] does those of factors.
fn visit_variables<M: Message, F: Factor<M>>(
    shared: &Shared<'_, M, F>,
    runs: &mut [VariableRun<M>],
    messages: &[M],
    beliefs: &mut [M],
    guessed: &mut [bool],
    offset: usize,
    parallel: bool,
) {
    match runs {
        [] => {}
        [run] => {
            let variables = run.variables.clone();
            run.outcome = gather_run(shared, variables, messages, &mut run.previous, beliefs, guessed);
        }
        _ => {
            let (left, right) = runs.split_at_mut(runs.len() / 2);
            let middle = right[0].variables.start;
            let (near, far) = beliefs.split_at_mut(middle - offset);
            let (near_guessed, far_guessed) = guessed.split_at_mut(middle - offset);
            let mut first = || visit_variables(shared, left, messages, near, near_guessed, offset, parallel);
            let mut second = || visit_variables(shared, right, messages, far, far_guessed, middle, parallel);
            if parallel {
                rayon::join(first, second);
            } else {
                first();
                second();
            }
        }
    }
}
