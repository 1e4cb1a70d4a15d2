//! The messages of a table, at any temperature.

use super::Table;
use super::questions::{LocalEvidence, Tabulation};
use super::semiring::{LogSums, Maxima, Room, Values, marginalise};
use smallvec::SmallVec;
use std::any::Any;
use sumprod_graph::{Factor, Incoming, MessageError, Port, Stream};
use sumprod_messages::vector::{exp, ln, widest};
use sumprod_messages::{CategoricalFamily, CategoricalForm};

/// Entries that need no storage of their own.
pub(super) type Numbers = SmallVec<[f64; 128]>;

/// The least sum of values that is sure to have lost nothing to underflow; below it logarithms are summed instead.
const LEAST: f64 = 1e-290;

impl Table {
    /// The logarithms of the message to port `to`, up to a constant, from those of all ports (port by port; the receiver's
    /// are arbitrary).
    fn logs_to(&self, to: Port, temperature: f64, incoming: &[f64], out: &mut [f64]) {
        if temperature == 1.0 && self.values_to(to, incoming, out) {
            return;
        }
        let (cardinalities, mut room) = (self.cardinalities(), Room::default());
        if temperature == 0.0 {
            marginalise(Maxima, cardinalities, self.logs(), incoming, to, out, &mut room);
        } else {
            let sums = LogSums { temperature };
            marginalise(sums, cardinalities, self.logs(), incoming, to, out, &mut room);
        }
    }

    /// By sums of values; false where values are too small for them.
    fn values_to(&self, to: Port, incoming: &[f64], out: &mut [f64]) -> bool {
        let mut values = Numbers::from_elem(0.0, incoming.len());
        exponentials(incoming, &mut values);
        if let [first, second] = *self.cardinalities() {
            let weights = if to == 0 { &values[first..first + second] } else { &values[..first] };
            self.strips(to).weighted_sum(weights, out);
        } else {
            marginalise(Values, self.cardinalities(), self.values(), &values, to, out, &mut Room::default());
        }
        let least = out.iter().fold(f64::INFINITY, |least, &value| if value < least { value } else { least });
        if least < LEAST {
            return false;
        }
        logarithms(out);
        true
    }
}

/// e to the power of each entry, zero where it is below the range of doubles.
fn exponentials(logs: &[f64], out: &mut [f64]) {
    struct Exponentials<'a>(&'a [f64], &'a mut [f64]);
    impl pulp::NullaryFnOnce for Exponentials<'_> {
        type Output = ();
        #[inline(always)]
        fn call(self) {
            for (log, out) in self.0.iter().zip(self.1) {
                let value = exp(*log);
                *out = if *log > sumprod_messages::vector::LOWEST_EXPONENT { value } else { 0.0 };
            }
        }
    }
    if logs.len() <= 8 {
        logs.iter().zip(out).for_each(|(log, out)| *out = log.exp());
    } else {
        widest(Exponentials(logs, out));
    }
}

/// The logarithm of each entry, all of them positive and normal.
fn logarithms(values: &mut [f64]) {
    struct Logarithms<'a>(&'a mut [f64]);
    impl pulp::NullaryFnOnce for Logarithms<'_> {
        type Output = ();
        #[inline(always)]
        fn call(self) {
            self.0.iter_mut().for_each(|value| *value = ln(*value));
        }
    }
    if values.len() <= 8 {
        values.iter_mut().for_each(|value| *value = value.ln());
    } else {
        widest(Logarithms(values));
    }
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
        let message = incoming.message(port);
        if message.states() != states {
            let (what, found) = ("a message over states", message.states());
            return Err(MessageError::Dimension { what, found, expected: states });
        }
        message.read_logs(own);
    }
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
