//! A family of distributions that edges can carry.

use crate::{MessageError, Space, Stream};

/// What is known of a message's or belief's quality; what does not apply is absent.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Quality {
    /// Effective sample size of a weighted sample.
    pub effective_sample_size: Option<f64>,
    /// Divergence (nats) that conversions between families have cost on the way to this message.
    pub conversion_loss: Option<f64>,
    /// Number of components of a mixture.
    pub components: Option<usize>,
    /// Number of modes of a mixture, where they were looked for.
    pub modes: Option<usize>,
    /// How the product was found, where there was a choice.
    pub product: Option<ProductOutcome>,
}

/// How a product of messages was found, and how good it is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ProductOutcome {
    /// Name of the method.
    pub method: &'static str,
    /// Why that method, where it was chosen automatically.
    pub reason: Option<&'static str>,
    /// Share of the labels that the last sweep of a sampler changed: near zero where it is stuck.
    pub label_change: Option<f64>,
    /// Divergence (nats) from the exact product, or its estimate.
    pub divergence: Option<f64>,
    /// The most modes that a factor of the product has, where they were looked for.
    pub modes_before: Option<usize>,
    /// Number of modes of the product, where they were looked for.
    pub modes_after: Option<usize>,
}

/// The messages into one variable: its prior, if any, and one per edge.
#[derive(Debug)]
pub struct Messages<'a, M> {
    prior: Option<&'a M>,
    messages: &'a [M],
    edges: &'a [u32],
    /// Position in `edges` that is left out; `usize::MAX` leaves out none.
    skip: usize,
}

impl<M> Clone for Messages<'_, M> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<M> Copy for Messages<'_, M> {}

impl<'a, M> Messages<'a, M> {
    /// Some messages, in order.
    pub fn new(messages: &'a [M], edges: &'a [u32]) -> Self {
        Self { prior: None, messages, edges, skip: usize::MAX }
    }

    pub(crate) fn with_prior(mut self, prior: Option<&'a M>) -> Self {
        self.prior = prior;
        self
    }

    pub(crate) fn without(mut self, edge: u32) -> Self {
        self.skip = self.edges.iter().position(|&other| other == edge).unwrap_or(usize::MAX);
        self
    }

    /// Iterates over the messages, the prior first; the order is fixed, so that sums are too.
    pub fn iter(self) -> impl Iterator<Item = &'a M> {
        let Self { prior, messages, edges, skip } = self;
        let kept = edges.iter().enumerate().filter(move |(position, _)| *position != skip);
        prior.into_iter().chain(kept.map(move |(_, &edge)| &messages[edge as usize]))
    }

    /// Calls `visit` with each message in the order of [`Messages::iter`]; the loop of choice for light messages.
    #[inline]
    pub fn for_each(self, mut visit: impl FnMut(&'a M)) {
        let Self { prior, messages, edges, skip } = self;
        if let Some(prior) = prior {
            visit(prior);
        }
        if skip == usize::MAX {
            for &edge in edges {
                visit(&messages[edge as usize]);
            }
            return;
        }
        for (position, &edge) in edges.iter().enumerate() {
            if position != skip {
                visit(&messages[edge as usize]);
            }
        }
    }

    /// Number of messages.
    pub fn len(&self) -> usize {
        self.edges.len() + usize::from(self.prior.is_some()) - usize::from(self.skip != usize::MAX)
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// A family of distributions over one variable.
///
/// # Laws
///
/// Up to normalisation, and within the family's stated approximation: [`Message::product`] commutes and has
/// [`Message::vacuous`] as its identity; [`Message::quotient`] undoes it; [`Message::change`] of a message and
/// itself is zero.
pub trait Message: Clone + Send + Sync + 'static {
    /// How an edge of this family holds its messages.
    type Form: Clone + Default + PartialEq + Send + Sync;

    /// Whether [`Message::quotient`] is as accurate as the product of the remaining messages. Where it is not
    /// (subtraction loses digits), passes that visit one edge at a time multiply instead of dividing.
    const EXACT_QUOTIENT: bool = false;

    /// Whether [`Message::quotient`] never fails. Where it may, and [`Message::can_be_divided_out`] tells no better, a
    /// pass that sends every message at once keeps the messages as they stood, to multiply those that it cannot divide.
    const ALWAYS_DIVIDES: bool = false;

    /// The most messages whose inputs a pass over the whole graph prepares before it asks their factors
    /// ([`crate::Factor::many_messages_into`]). Families of one number gain from many; one holds the fewest in memory.
    const GROUP: usize = 1;

    /// The message that says nothing about a variable of this space: the identity of the product.
    fn vacuous(space: &Space) -> Self;

    /// The product of `incoming`, held in `form`. `incoming` has at least one message.
    ///
    /// # Errors
    ///
    /// Where the family has no such product, for instance of particles with disjoint supports.
    fn product(
        incoming: Messages<'_, Self>,
        form: &Self::Form,
        stream: &mut Stream,
    ) -> Result<Self, MessageError>;

    /// [`Message::product`] into `out`, whose storage may be reused; on entry `out` holds the belief as it was.
    ///
    /// # Errors
    ///
    /// As [`Message::product`].
    fn product_into(
        incoming: Messages<'_, Self>,
        form: &Self::Form,
        stream: &mut Stream,
        out: &mut Self,
    ) -> Result<(), MessageError> {
        *out = Self::product(incoming, form, stream)?;
        Ok(())
    }

    /// [`Message::product_into`], raising `largest` to how far the belief moved if that is more, and to NaN if it is
    /// not a number; `previous` is storage. A family may answer without measuring a move that is plainly smaller.
    ///
    /// # Errors
    ///
    /// As [`Message::product`].
    fn update(
        incoming: Messages<'_, Self>,
        form: &Self::Form,
        stream: &mut Stream,
        belief: &mut Self,
        previous: &mut Self,
        largest: &mut f64,
    ) -> Result<(), MessageError> {
        previous.clone_from(belief);
        Self::product_into(incoming, form, stream, belief)?;
        let change = belief.change(previous);
        if change > *largest || change.is_nan() {
            *largest = change;
        }
        Ok(())
    }

    /// This belief with one incoming message taken out, where the family can divide.
    fn quotient(&self, _incoming: &Self) -> Option<Self> {
        None
    }

    /// [`Message::quotient`] into `out`; false where the family cannot divide, and `out` is then arbitrary.
    fn quotient_into(&self, incoming: &Self, out: &mut Self) -> bool {
        self.quotient(incoming).map(|quotient| *out = quotient).is_some()
    }

    /// Whether [`Message::quotient_into`] of any belief that this message is part of succeeds. A pass that sends every
    /// message at once replaces them in place where this holds of all.
    fn can_be_divided_out(&self) -> bool {
        Self::ALWAYS_DIVIDES
    }

    /// How far this message is from `previous`: zero if equal, finite, and of order one for a change of order
    /// one standard deviation. Convergence and residual schedules read it.
    fn change(&self, previous: &Self) -> f64;

    /// Moves this message towards `previous`, keeping the share `damping` (0 to 1) of it; false where the
    /// family cannot be damped.
    fn damp(&mut self, _previous: &Self, _damping: f64) -> bool {
        false
    }

    /// Whether `form` can hold messages on `space`.
    ///
    /// # Errors
    ///
    /// The reason, as the end of a sentence.
    fn check_form(_form: &Self::Form, _space: &Space) -> Result<(), String> {
        Ok(())
    }

    /// The form of edges to variables of this space, unless the user chose one.
    fn default_form(_space: &Space) -> Self::Form {
        Self::Form::default()
    }

    /// The form of a belief whose edges have these forms, unless the user chose one: the richest among them.
    fn belief_form<'a>(edges: impl Iterator<Item = &'a Self::Form>) -> Self::Form {
        edges.into_iter().next().cloned().unwrap_or_default()
    }

    /// Whether this is a distribution, with a mean to linearise at; asked of beliefs that a start stands in for.
    fn is_proper(&self) -> bool {
        true
    }

    /// What is known of this message's quality.
    fn quality(&self) -> Quality {
        Quality::default()
    }
}
