//! The messages of a table, at any temperature.

use super::Table;
use super::questions::{LocalEvidence, Tabulation};
use super::semiring::{LogSums, Maxima, Room, Values, marginalise};
use super::strips::Combine;
use smallvec::SmallVec;
use std::any::Any;
use sumprod_graph::{Factor, Incoming, MessageError, Port, Stream};
use sumprod_messages::{CategoricalFamily, CategoricalForm};

/// The most entries of a row that are summed in storage of fixed size.
const FIXED: usize = 64;

/// Entries that need no storage of their own.
pub(super) type Numbers = SmallVec<[f64; 128]>;

impl Table {
    /// The message to port `to` by sums of values, into `out`; false where values are too small for them.
    fn sum_values<M: CategoricalFamily>(
        &self,
        to: Port,
        incoming: &Incoming<'_, M>,
        out: &mut M,
    ) -> Result<bool, MessageError> {
        let cardinalities = self.cardinalities();
        let [_, _] = *cardinalities else {
            let mut values = Numbers::from_elem(0.0, cardinalities.iter().sum());
            read(cardinalities, to, incoming, &mut values, M::read_values)?;
            let mut sent = Numbers::from_elem(0.0, cardinalities[to]);
            marginalise(Values, cardinalities, self.values(), &values, to, &mut sent, &mut Room::default());
            return out.write_values(incoming.belief(to), &sent);
        };
        let (message, strips) = (incoming.message(1 - to), self.strips(Combine::Sum, to));
        check_states(message, cardinalities[1 - to])?;
        // Of fixed size where that is enough: it is not moved.
        let (mut fixed, mut larger) = ([0.0; FIXED], Vec::new());
        let sent = if strips.stride() <= FIXED {
            &mut fixed[..strips.stride()]
        } else {
            larger.resize(strips.stride(), 0.0);
            &mut larger[..]
        };
        if let Some(values) = message.values() {
            strips.combine(Combine::Sum, values, sent);
        } else {
            let mut values = Numbers::from_elem(0.0, cardinalities[1 - to]);
            message.read_values(&mut values);
            strips.combine(Combine::Sum, &values, sent);
        }
        out.write_values(incoming.belief(to), &sent[..cardinalities[to]])
    }

    /// The message to port `to` by logarithms at any temperature, into `out`.
    fn sum_logs<M: CategoricalFamily>(
        &self,
        to: Port,
        temperature: f64,
        incoming: &Incoming<'_, M>,
        out: &mut M,
    ) -> Result<(), MessageError> {
        let (cardinalities, mut sent) = (self.cardinalities(), Numbers::new());
        let mut logs = Numbers::from_elem(0.0, cardinalities.iter().sum());
        read(cardinalities, to, incoming, &mut logs, M::read_logs)?;
        if let ([first, _], 0.0) = (cardinalities, temperature) {
            let strips = self.strips(Combine::Maximum, to);
            sent.resize(strips.stride(), 0.0);
            let weights = if to == 0 { &logs[*first..] } else { &logs[..*first] };
            strips.combine(Combine::Maximum, weights, &mut sent);
        } else {
            sent.resize(cardinalities[to], 0.0);
            let (logs, room) = (&logs, &mut Room::default());
            if temperature == 0.0 {
                marginalise(Maxima, cardinalities, self.logs(), logs, to, &mut sent, room);
            } else {
                marginalise(LogSums { temperature }, cardinalities, self.logs(), logs, to, &mut sent, room);
            }
        }
        out.write_logs(incoming.belief(to), &sent[..cardinalities[to]])
    }
}

/// The temperature of an edge's form.
pub(super) fn temperature<M: CategoricalFamily>(form: &M::Form) -> Result<f64, MessageError> {
    let form = M::categorical_form(form);
    let needed = "an edge of a factor over finitely many states must be held in categorical form";
    form.map(|CategoricalForm { temperature }| temperature)
        .ok_or_else(|| MessageError::Unsupported(needed.into()))
}

/// What `of` reads of the messages at all ports, port by port; zeros at the receiver's.
pub(super) fn read<M: CategoricalFamily>(
    cardinalities: &[usize],
    to: Port,
    incoming: &Incoming<'_, M>,
    numbers: &mut [f64],
    of: impl Fn(&M, &mut [f64]),
) -> Result<(), MessageError> {
    let mut rest = numbers;
    for (port, &states) in cardinalities.iter().enumerate() {
        let own;
        (own, rest) = rest.split_at_mut(states);
        if port == to {
            own.fill(0.0);
            continue;
        }
        let message = incoming.message(port);
        check_states(message, states)?;
        of(message, own);
    }
    Ok(())
}

/// Refuses a message of another number of states.
fn check_states<M: CategoricalFamily>(message: &M, expected: usize) -> Result<(), MessageError> {
    let (what, found) = ("a message over states", message.states());
    if found == expected { Ok(()) } else { Err(MessageError::Dimension { what, found, expected }) }
}

impl<M: CategoricalFamily> Factor<M> for Table {
    fn dimensions(&self) -> &[usize] {
        self.cardinalities()
    }

    fn message(
        &self,
        to: Port,
        incoming: &Incoming<'_, M>,
        form: &M::Form,
        stream: &mut Stream,
    ) -> Result<M, MessageError> {
        let mut out = incoming.belief(to).clone();
        self.message_into(to, incoming, form, stream, &mut out)?;
        Ok(out)
    }

    fn message_into(
        &self,
        to: Port,
        incoming: &Incoming<'_, M>,
        form: &M::Form,
        _stream: &mut Stream,
        out: &mut M,
    ) -> Result<(), MessageError> {
        let temperature = temperature::<M>(form)?;
        if temperature == 1.0 && self.sum_values(to, incoming, out)? {
            return Ok(());
        }
        self.sum_logs(to, temperature, incoming, out)
    }

    fn is_constant(&self) -> bool {
        self.cardinalities().len() == 1
    }

    fn answer(&self, question: &mut dyn Any) -> bool {
        if let Some(question) = question.downcast_mut::<Tabulation>() {
            question.offer(self.cardinalities(), || self.clone());
            return true;
        }
        let Some(question) = question.downcast_mut::<LocalEvidence>() else { return false };
        let mut out = [0.0];
        let sums = LogSums { temperature: 1.0 };
        let ports = self.cardinalities().len();
        // Past the last port: the sum over all joint states.
        let (cardinalities, logs) = (self.cardinalities(), self.logs());
        marginalise(sums, cardinalities, logs, &question.logs, ports + 1, &mut out, &mut Room::default());
        question.log_sum = self.peak() + out[0];
        true
    }
}
