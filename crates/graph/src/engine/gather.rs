//! The beliefs of a flooding pass, and how far they moved.

use super::flood::Shared;
use super::pass::{product_error, replace_guess, rule_error};
use crate::{Factor, GraphError, Message, MessageError, Messages, Purpose, Stream};
use std::ops::Range;

/// The beliefs of consecutive variables; returns the largest change of one.
pub(super) fn gather_run<M: Message, F: Factor<M>>(
    shared: &Shared<'_, M, F>,
    variables: Range<usize>,
    messages: &[M],
    previous: &mut M,
    beliefs: &mut [M],
    guessed: &mut [bool],
) -> Result<f64, GraphError> {
    let mut largest: f64 = 0.0;
    for ((variable, belief), guess) in variables.zip(beliefs).zip(guessed) {
        gather(shared, variable, messages, previous, belief, guess, &mut largest)?;
    }
    Ok(largest)
}

/// The belief of one variable; raises `largest` to its change.
#[inline(always)]
pub(super) fn gather<M: Message, F: Factor<M>>(
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
            let change =
                if *guess { moved(edges, messages, shared.before().unwrap_or(messages)) } else { 1.0 };
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
