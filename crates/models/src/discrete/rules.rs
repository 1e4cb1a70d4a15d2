//! The messages of a table, at any temperature.

use super::Table;
use super::questions::{LocalEvidence, Tabulation};
use super::strips::Combine;
use super::semiring::{LogSums, Maxima, Room, Values, marginalise};
use smallvec::SmallVec;
use std::any::Any;
use sumprod_graph::{Factor, Incoming, MessageError, Port, Stream};
use sumprod_messages::vector::{largest, least, ln, vanishing_exp, widest};
use sumprod_messages::{CategoricalFamily, CategoricalForm};

/// Entries that need no storage of their own.
pub(super) type Numbers = SmallVec<[f64; 128]>;

/// The least sum of values that is sure to have lost nothing to underflow; below it logarithms are summed instead.
const LEAST: f64 = 1e-290;

impl Table {
    /// The logarithms of the message to port `to`, up to a constant, from those of all ports (port by port; the receiver's
    /// are arbitrary).
    fn logs_to(&self, to: Port, temperature: f64, incoming: &[f64], out: &mut [f64]) {
        let (cardinalities, mut room) = (self.cardinalities(), Room::default());
        if temperature == 0.0 {
            marginalise(Maxima, cardinalities, self.logs(), incoming, to, out, &mut room);
            return;
        }
        // A pair's values were summed before.
        if temperature == 1.0 && cardinalities.len() != 2 {
            let mut values = Numbers::from_slice(incoming);
            exponentials(&mut values);
            marginalise(Values, cardinalities, self.values(), &values, to, out, &mut room);
            if logarithms(out) {
                return;
            }
        }
        let sums = LogSums { temperature };
        marginalise(sums, cardinalities, self.logs(), incoming, to, out, &mut room);
    }

    /// As [`Table::logs_to`] of a table of two ports, from the other port's logarithms, which it spoils; none where
    /// values are too small to be summed. `out` is longer by what fills up rows.
    fn pair_to<'a>(&self, to: Port, how: Combine, incoming: &mut [f64], out: &'a mut Numbers) -> Option<&'a [f64]> {
        let strips = self.strips(how, to);
        out.resize(strips.stride(), 0.0);
        if how == Combine::Sum {
            exponentials(incoming);
        }
        strips.combine(how, incoming, out);
        let own = &mut out[..self.cardinalities()[to]];
        (how == Combine::Maximum || logarithms(own)).then_some(own)
    }
}

/// e to the power of each entry, zero where it is below the range of doubles.
fn exponentials(logs: &mut [f64]) {
    struct Exponentials<'a>(&'a mut [f64]);
    impl pulp::NullaryFnOnce for Exponentials<'_> {
        type Output = ();
        #[inline(always)]
        fn call(self) {
            for log in self.0 {
                *log = vanishing_exp(*log);
            }
        }
    }
    if logs.len() <= 8 {
        logs.iter_mut().for_each(|log| *log = log.exp());
    } else {
        widest(Exponentials(logs));
    }
}

/// The logarithm of each entry over the largest; false, and the entries as they were, where one is too small to have
/// lost nothing.
fn logarithms(values: &mut [f64]) -> bool {
    struct Logarithms<'a>(&'a mut [f64]);
    impl pulp::NullaryFnOnce for Logarithms<'_> {
        type Output = bool;
        #[inline(always)]
        fn call(self) -> bool {
            let (least, largest) = (least(self.0), largest(self.0));
            if least < LEAST {
                return false;
            }
            let shift = ln(largest);
            for value in self.0 {
                *value = ln(*value) - shift;
            }
            true
        }
    }
    if values.len() > 8 {
        return widest(Logarithms(values));
    }
    let sure = values.iter().all(|&value| value >= LEAST);
    if sure {
        values.iter_mut().for_each(|value| *value = value.ln());
    }
    sure
}

/// The temperature of an edge's form.
pub(super) fn temperature<M: CategoricalFamily>(form: &M::Form) -> Result<f64, MessageError> {
    let form = M::categorical_form(form);
    let needed = "an edge of a factor over finitely many states must be held in categorical form";
    form.map(|CategoricalForm { temperature }| temperature)
        .ok_or_else(|| MessageError::Unsupported(needed.into()))
}

/// The logarithms of the messages at all ports, port by port; zeros at the receiver's.
pub(super) fn read<M: CategoricalFamily>(
    cardinalities: &[usize],
    to: Port,
    incoming: &Incoming<'_, M>,
    logs: &mut [f64],
) -> Result<(), MessageError> {
    let mut rest = logs;
    for (port, &states) in cardinalities.iter().enumerate() {
        let own;
        (own, rest) = rest.split_at_mut(states);
        if port == to {
            own.fill(0.0);
            continue;
        }
        read_port(states, incoming.message(port), own)?;
    }
    Ok(())
}

/// The logarithms of one message, which has this many states.
fn read_port<M: CategoricalFamily>(states: usize, message: &M, logs: &mut [f64]) -> Result<(), MessageError> {
    if message.states() != states {
        let (what, found) = ("a message over states", message.states());
        return Err(MessageError::Dimension { what, found, expected: states });
    }
    message.read_logs(logs);
    Ok(())
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
        let (temperature, cardinalities) = (temperature::<M>(form)?, self.cardinalities());
        let how = if temperature == 0.0 { Combine::Maximum } else { Combine::Sum };
        if cardinalities.len() == 2 && (temperature == 0.0 || temperature == 1.0) {
            let states = cardinalities[1 - to];
            let (mut logs, mut sent) = (Numbers::new(), Numbers::new());
            logs.resize(states, 0.0);
            read_port(states, incoming.message(1 - to), &mut logs)?;
            if let Some(sent) = self.pair_to(to, how, &mut logs, &mut sent) {
                return out.write_logs(incoming.belief(to), sent);
            }
        }
        let mut logs = Numbers::from_elem(0.0, cardinalities.iter().sum());
        read(cardinalities, to, incoming, &mut logs)?;
        let mut sent = Numbers::from_elem(0.0, cardinalities[to]);
        self.logs_to(to, temperature, &logs, &mut sent);
        out.write_logs(incoming.belief(to), &sent)
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
