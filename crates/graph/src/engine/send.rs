//! What consecutive factors of a flooding pass send.

use super::flood::Shared;
use super::pass::{Standing, damp, extrinsic, product_error, rule_error};
use super::{Options, Scratch};
use crate::{
    Factor, FactorId, GraphError, Group, Incoming, Message, MessageError, MessageStreams, Outgoing, Port,
    Purpose, Stream,
};
use std::ops::Range;

/// All messages of consecutive factors.
pub(super) fn send<M: Message, F: Factor<M>>(
    shared: &Shared<'_, M, F>,
    standing: Standing<'_, M>,
    factors: Range<usize>,
    scratch: &mut Scratch<M>,
    messages: &mut [M],
    offset: usize,
) -> Result<(), GraphError> {
    if M::GROUP > 1 {
        return send_in_groups(shared, standing, factors, scratch, messages, offset);
    }
    let Shared { graph, topology, options, state, any_guess, .. } = *shared;
    let beliefs = standing.beliefs;
    let Scratch { inputs, output } = scratch;
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
        let before = shared.before().map(|messages| &messages[edges.clone()]);
        if arity == 1 && rule.is_constant() && state.sent[edges.start] {
            if let Some(before) = before {
                own.clone_from_slice(before);
            }
            continue;
        }
        let replaced = before.unwrap_or(own);
        for (port, ((input, message), &variable)) in
            inputs.iter_mut().zip(replaced).zip(variables).enumerate()
        {
            let belief = &beliefs[variable as usize];
            if broadcast {
                input.clone_from(belief);
            } else if any_guess || !belief.quotient_into(message, input) {
                without(shared, standing, variable as usize, edges.start + port, input)?;
            }
        }
        let incoming = Incoming::trusted(inputs, beliefs, variables);
        let streams = MessageStreams::new(options.seed, state.iteration, edges.start as u64);
        let outcome = if options.damping > 0.0 {
            let sent = &state.sent[edges.clone()];
            damped(rule, &incoming, forms, streams, sent, options.damping, (own, before), output)
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
    standing: Standing<'_, M>,
    factors: Range<usize>,
    scratch: &mut Scratch<M>,
    messages: &mut [M],
    offset: usize,
) -> Result<(), GraphError> {
    let Shared { graph, topology, options, state, forms, any_guess, .. } = *shared;
    let beliefs = standing.beliefs;
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
        let before = shared.before().map(|messages| &messages[edges.clone()]);
        let Scratch { inputs, output } = scratch;
        if inputs.len() < edges.len() {
            inputs.resize(edges.len(), output.clone());
        }
        let inputs = &mut inputs[..edges.len()];
        let replaced = before.unwrap_or(own);
        let broadcast = outgoing == Outgoing::Broadcast;
        if shared.divided && !broadcast {
            // The loop of most passes, with nothing in it that may not be done side by side.
            for ((input, message), &variable) in inputs.iter_mut().zip(replaced).zip(variables) {
                beliefs[variable as usize].quotient_into(message, input);
            }
        } else {
            for (place, (input, &variable)) in inputs.iter_mut().zip(variables).enumerate() {
                let belief = &beliefs[variable as usize];
                if broadcast {
                    input.clone_from(belief);
                } else if any_guess || !belief.quotient_into(&replaced[place], input) {
                    without(shared, standing, variable as usize, edges.start + place, input)?;
                }
            }
        }
        let uniform = forms.uniform;
        let forms = &forms.edges[edges.clone()];
        let seen = Group { inputs, beliefs, variables, bounds, forms, uniform, seed, iteration };
        let rules = &graph.factors[members.clone()];
        if let Err((place, source)) = F::many_messages_into(rules, &seen, own) {
            let edge = edges.start + place;
            return Err(failed(shared, topology.factor_of(crate::EdgeId(edge as u32)).index(), edge, source));
        }
        // Messages that are damped are never replaced in place.
        if let (true, Some(before)) = (damping > 0.0, before) {
            let sent = (!shared.all_sent).then_some(&state.sent[edges.clone()]);
            damp_all(own, before, sent, damping)
                .map_err(|source| failed(shared, members.start, edges.start, source))?;
        }
    }
    Ok(())
}

/// Moves new messages towards those that they replace, where these were ever sent.
fn damp_all<M: Message>(
    new: &mut [M],
    old: &[M],
    sent: Option<&[bool]>,
    damping: f64,
) -> Result<(), MessageError> {
    let Some(sent) = sent else {
        return new.iter_mut().zip(old).try_for_each(|(new, old)| damp(new, old, damping));
    };
    for ((new, old), _) in new.iter_mut().zip(old).zip(sent).filter(|(_, sent)| **sent) {
        damp(new, old, damping)?;
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
    (messages, before): (&mut [M], Option<&[M]>),
    output: &mut M,
) -> Result<(), (Port, MessageError)> {
    for (port, slot) in messages.iter_mut().enumerate() {
        let mut outcome = rule.message_into(port, incoming, &forms[port], &mut streams.of(port), output);
        if sent[port] {
            let old = before.map_or(&*slot, |before| &before[port]);
            outcome = outcome.and_then(|()| damp(output, old, damping));
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
    standing: Standing<'_, M>,
    variable: usize,
    edge: usize,
    out: &mut M,
) -> Result<(), GraphError> {
    let Shared { graph, topology, options, state, forms, .. } = *shared;
    if !shared.kept {
        // The family said otherwise, and the other messages may be replaced already.
        let problem = "a message that its family says can be divided out of a belief cannot; Message::can_be_divided_out \
                       must answer as Message::quotient_into does";
        let source = MessageError::Unsupported(problem.to_owned());
        return Err(product_error(graph, variable, state.iteration, source));
    }
    let mut stream = Stream::new(options.seed, state.iteration, Purpose::Extrinsic, edge as u64);
    extrinsic(topology, (state, standing), &forms.beliefs[variable], variable, edge, &mut stream, out)
        .map_err(|source| product_error(graph, variable, state.iteration, source))
}
