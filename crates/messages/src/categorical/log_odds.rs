//! Distributions over two states, as one number: for graphs of binary variables alone.

use super::{CategoricalForm, SEEN, impossible};
use crate::vector::greater;
use serde::{Deserialize, Serialize};
use sumprod_graph::{Message, MessageError, Messages, Space, Stream};

/// The log odds log(p(1) / p(0)) of a variable of two states; infinite where one is ruled out.
///
/// A product is a sum and a quotient a difference of one number, so that messages of many factors are computed at once,
/// lane by lane.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LogOdds(pub f64);

impl LogOdds {
    /// The probability of state 1.
    pub fn probability(self) -> f64 {
        1.0 / (1.0 + (-self.0).exp())
    }

    /// The more likely state, 0 if they are equal.
    pub fn most_likely(self) -> usize {
        usize::from(self.0 > 0.0)
    }
}

/// A move that matters: past [`SEEN`] either way there is no more to be seen of the lesser state.
#[inline(always)]
fn moved(now: f64, before: f64) -> f64 {
    let clamp = |x: f64| x.clamp(SEEN, -SEEN);
    (clamp(now) - clamp(before)).abs()
}

impl Message for LogOdds {
    type Form = CategoricalForm;
    const GROUP: usize = 512;

    fn vacuous(_space: &Space) -> Self {
        Self(0.0)
    }

    fn product(
        incoming: Messages<'_, Self>,
        _form: &CategoricalForm,
        _stream: &mut Stream,
    ) -> Result<Self, MessageError> {
        // Four sums in turn: one would wait for itself at every message.
        let mut sums = [0.0; 4];
        incoming.for_each(|message| {
            let [a, b, c, d] = sums;
            sums = [b, c, d, a + message.0];
        });
        let sum = (sums[0] + sums[1]) + (sums[2] + sums[3]);
        if sum.is_nan() {
            let mut contrary = [false; 2];
            incoming.for_each(|message| {
                contrary[0] |= message.0 == f64::NEG_INFINITY;
                contrary[1] |= message.0 == f64::INFINITY;
            });
            if contrary == [true; 2] {
                return Err(impossible("the product of messages"));
            }
            return Err(MessageError::NotFinite { what: "the log odds", value: sum });
        }
        Ok(Self(sum))
    }

    fn quotient(&self, incoming: &Self) -> Option<Self> {
        incoming.0.is_finite().then_some(Self(self.0 - incoming.0))
    }

    #[inline(always)]
    fn quotient_into(&self, incoming: &Self, out: &mut Self) -> bool {
        out.0 = self.0 - incoming.0;
        incoming.0.is_finite()
    }

    fn can_be_divided_out(&self) -> bool {
        self.0.is_finite()
    }

    fn change(&self, previous: &Self) -> f64 {
        moved(self.0, previous.0)
    }

    #[inline(always)]
    fn damp(&mut self, previous: &Self, damping: f64) -> bool {
        self.0 = (1.0 - damping) * self.0 + damping * previous.0;
        true
    }

    #[inline(always)]
    fn update(
        incoming: Messages<'_, Self>,
        form: &CategoricalForm,
        stream: &mut Stream,
        belief: &mut Self,
        _previous: &mut Self,
        largest: &mut f64,
    ) -> Result<(), MessageError> {
        let product = Self::product(incoming, form, stream)?;
        *largest = greater(moved(product.0, belief.0), *largest);
        *belief = product;
        Ok(())
    }

    fn check_form(form: &CategoricalForm, space: &Space) -> Result<(), String> {
        form.check(space)?;
        match space.dimension() {
            2 => Ok(()),
            states => Err(format!("log odds hold variables of 2 states, this one has {states}")),
        }
    }
}
