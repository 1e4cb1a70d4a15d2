//! Messages over states as a family of distributions.

use super::passes::{
    damp, largest_difference, largest_ratio, multiply, normalise_logs, normalise_values, quotients,
};
use super::{APPEARED, Categorical, CategoricalForm, SEEN};
use sumprod_graph::{Message, MessageError, Messages, Space, Stream};

impl Categorical {
    /// The product of messages that all have values at hand, into these; false, and the message is arbitrary, where one
    /// has none or the product is out of range.
    fn multiply_values(&mut self, incoming: Messages<'_, Self>) -> bool {
        let (mut first, mut sure) = (true, true);
        incoming.for_each(|message| match message.values() {
            Some(values) if first => {
                self.hold(true, values);
                first = false;
            }
            Some(values) if values.len() == self.states() => multiply(&mut self.numbers, values),
            _ => sure = false,
        });
        sure && normalise_values(&mut self.numbers)
    }

    /// The product by sums of logarithms.
    fn add_logs(&mut self, incoming: Messages<'_, Self>) -> Result<(), MessageError> {
        let (mut first, mut unequal) = (true, None);
        incoming.for_each(|message| {
            if !first && message.states() != self.states() {
                unequal = Some(message.states());
                return;
            }
            message.with_logs(|logs| {
                if first {
                    self.hold(false, logs);
                    first = false;
                } else {
                    for (log, other) in self.numbers.iter_mut().zip(logs) {
                        *log += other;
                    }
                }
            });
        });
        if let Some(found) = unequal {
            let what = "a message over states";
            return Err(MessageError::Dimension { what, found, expected: self.states() });
        }
        self.normalise_logs("the product of messages")
    }

    /// The quotient by differences of logarithms, where the message rules out no state: what it ruled out cannot be
    /// had back.
    fn subtract_logs(&self, incoming: &Self, out: &mut Self) -> bool {
        self.with_logs(|logs| out.hold(false, logs));
        let least = incoming.with_logs(|logs| {
            for (out, log) in out.numbers.iter_mut().zip(logs) {
                *out -= log;
            }
            crate::vector::least(logs)
        });
        // Differences of logarithms up to zero are numbers; their sum may be none.
        let (largest, _) = normalise_logs(&mut out.numbers);
        least > f64::NEG_INFINITY && largest.is_finite()
    }
}

impl Message for Categorical {
    type Form = CategoricalForm;

    fn vacuous(space: &Space) -> Self {
        match space {
            Space::Finite(states) => Self::vacuous_of(*states),
            _ => Self::default(),
        }
    }

    fn product(
        incoming: Messages<'_, Self>,
        form: &CategoricalForm,
        stream: &mut Stream,
    ) -> Result<Self, MessageError> {
        let mut out = Self::default();
        Self::product_into(incoming, form, stream, &mut out)?;
        Ok(out)
    }

    fn product_into(
        incoming: Messages<'_, Self>,
        _form: &CategoricalForm,
        _stream: &mut Stream,
        out: &mut Self,
    ) -> Result<(), MessageError> {
        if out.multiply_values(incoming) { Ok(()) } else { out.add_logs(incoming) }
    }

    fn quotient(&self, incoming: &Self) -> Option<Self> {
        let mut out = Self::default();
        self.quotient_into(incoming, &mut out).then_some(out)
    }

    /// Where the message rules out no state; what it ruled out cannot be had back.
    fn quotient_into(&self, incoming: &Self, out: &mut Self) -> bool {
        if let (Some(own), Some(other)) = (self.values(), incoming.values())
            && own.len() == other.len()
            && quotients(own, other, out.room(own.len(), true))
        {
            return true;
        }
        self.subtract_logs(incoming, out)
    }

    fn can_be_divided_out(&self) -> bool {
        self.valued || self.numbers.iter().all(|&log| log > f64::NEG_INFINITY)
    }

    /// The largest change of a logarithm, of states within 36 nats of the most likely one.
    fn change(&self, previous: &Self) -> f64 {
        let change = match (self.values(), previous.values()) {
            (Some(now), Some(before)) => largest_ratio(now, before, SEEN.exp()),
            _ => self.with_logs(|now| previous.with_logs(|before| largest_difference(now, before, SEEN))),
        };
        if change > APPEARED { APPEARED } else { change }
    }

    /// In the logarithms: what either rules out stays ruled out.
    fn damp(&mut self, previous: &Self, damping: f64) -> bool {
        self.become_logs();
        previous.with_logs(|older| damp(&mut self.numbers, older, damping));
        normalise_logs(&mut self.numbers);
        true
    }

    fn check_form(form: &CategoricalForm, space: &Space) -> Result<(), String> {
        form.check(space)
    }
}
