//! A factor's rules for one family of messages.

use crate::{Message, MessageError, MessageStreams, Stream};
use std::any::Any;

/// The place of a variable in a factor's argument list, from zero.
pub type Port = usize;

/// What a factor sees when it computes a message: the messages and the beliefs at its ports.
#[derive(Debug)]
pub struct Incoming<'a, M> {
    messages: &'a [M],
    beliefs: &'a [M],
    variables: &'a [u32],
}

impl<'a, M> Incoming<'a, M> {
    /// One message per port, and beliefs looked up by the variable at each port.
    ///
    /// # Panics
    ///
    /// Where the slices differ in length, or a variable has no belief.
    pub fn new(messages: &'a [M], beliefs: &'a [M], variables: &'a [u32]) -> Self {
        assert!(messages.len() >= variables.len(), "one message per port");
        assert!(variables.iter().all(|&v| (v as usize) < beliefs.len()), "one belief per variable");
        Self { messages, beliefs, variables }
    }

    pub(crate) fn trusted(messages: &'a [M], beliefs: &'a [M], variables: &'a [u32]) -> Self {
        Self { messages, beliefs, variables }
    }

    /// Number of ports.
    pub fn arity(&self) -> usize {
        self.variables.len()
    }

    /// The message from the variable at `port`: what all others there say of it (or, broadcast, its belief).
    /// Arbitrary at the port that the message is for.
    pub fn message(&self, port: Port) -> &'a M {
        &self.messages[port]
    }

    /// The belief of the variable at `port`: where to linearise, or, at the receiving port, where to sample.
    pub fn belief(&self, port: Port) -> &'a M {
        &self.beliefs[self.variables[port] as usize]
    }
}

/// Consecutive factors and what they see: inputs and forms of their edges, in order.
#[derive(Debug)]
pub struct Group<'a, M: Message> {
    pub(crate) inputs: &'a [M],
    pub(crate) beliefs: &'a [M],
    /// The variable at each edge.
    pub(crate) variables: &'a [u32],
    /// Where each factor's edges begin, and where the last one's end; counted as the graph counts edges.
    pub(crate) bounds: &'a [u32],
    pub(crate) forms: &'a [M::Form],
    /// Whether the forms are known to be equal.
    pub(crate) uniform: bool,
    pub(crate) seed: u64,
    pub(crate) iteration: u64,
}

impl<'a, M: Message> Group<'a, M> {
    /// The messages from the variables, edge by edge.
    pub fn inputs(&self) -> &'a [M] {
        self.inputs
    }

    /// The forms of the edges.
    pub fn forms(&self) -> &'a [M::Form] {
        self.forms
    }

    /// The form of all edges, where it is one; none also of a group without edges.
    pub fn common_form(&self) -> Option<&'a M::Form> {
        let first = self.forms.first()?;
        (self.uniform || self.forms.iter().all(|form| form == first)).then_some(first)
    }
}

/// One factor's rules for one family of messages.
///
/// A factor knows nothing of the graph: it sees ports, and the messages and beliefs at them.
pub trait Factor<M: Message>: Send + Sync {
    /// The dimension of each port, in order; its length is the number of ports.
    fn dimensions(&self) -> &[usize];

    /// The message to port `to`: this factor times the messages from all other ports, summed over their
    /// variables, held in `form`.
    ///
    /// # Errors
    ///
    /// Where the rule does not exist for these messages, or numbers do not allow it.
    fn message(
        &self,
        to: Port,
        incoming: &Incoming<'_, M>,
        form: &M::Form,
        stream: &mut Stream,
    ) -> Result<M, MessageError>;

    /// [`Factor::message`] into `out`, whose storage may be reused; what `out` holds on entry is arbitrary.
    ///
    /// # Errors
    ///
    /// As [`Factor::message`].
    fn message_into(
        &self,
        to: Port,
        incoming: &Incoming<'_, M>,
        form: &M::Form,
        stream: &mut Stream,
        out: &mut M,
    ) -> Result<(), MessageError> {
        *out = self.message(to, incoming, form, stream)?;
        Ok(())
    }

    /// The messages to all ports, into `out` port by port, all from the same inputs.
    ///
    /// One call a factor: where the factor is behind a pointer this is what a pass over a large graph dispatches.
    ///
    /// # Errors
    ///
    /// The first port whose message failed, and why; the messages after it are arbitrary.
    fn all_messages_into(
        &self,
        incoming: &Incoming<'_, M>,
        forms: &[M::Form],
        streams: MessageStreams,
        out: &mut [M],
    ) -> Result<(), (Port, MessageError)> {
        for (to, (out, form)) in out.iter_mut().zip(forms).enumerate() {
            self.message_into(to, incoming, form, &mut streams.of(to), out).map_err(|error| (to, error))?;
        }
        Ok(())
    }

    /// The messages of consecutive factors into `out`, edge by edge, all from the same inputs: what a pass over the whole
    /// graph calls of families that gather many ([`Message::GROUP`]). A graph of one concrete type of factor pays for
    /// dispatch once per group, and its rule may work on all edges in one loop.
    ///
    /// # Errors
    ///
    /// The first edge of the group whose message failed, and why.
    fn many_messages_into(
        factors: &[Self],
        group: &Group<'_, M>,
        out: &mut [M],
    ) -> Result<(), (usize, MessageError)>
    where
        Self: Sized,
    {
        let first = group.bounds.first().map_or(0, |&first| first as usize);
        for (factor, bounds) in factors.iter().zip(group.bounds.windows(2)) {
            let edges = bounds[0] as usize - first..bounds[1] as usize - first;
            let incoming = Incoming::trusted(
                &group.inputs[edges.clone()],
                group.beliefs,
                &group.variables[edges.clone()],
            );
            let streams = MessageStreams::new(group.seed, group.iteration, u64::from(bounds[0]));
            let forms = &group.forms[edges.clone()];
            factor
                .all_messages_into(&incoming, forms, streams, &mut out[edges.clone()])
                .map_err(|(port, error)| (edges.start + port, error))?;
        }
        Ok(())
    }

    /// Whether the message to a single port depends on nothing but this factor, so that once is enough.
    fn is_constant(&self) -> bool {
        false
    }

    /// Answers a question of a crate that knows what factors mean, which this one does not: a factor recognises a
    /// question by its type, and writes the answer into it. False where it has none.
    ///
    /// Joint solves ask for the residual and its derivative in this way.
    fn answer(&self, _question: &mut dyn Any) -> bool {
        false
    }
}

macro_rules! forward {
    ($($pointer:ty),*) => {$(
        impl<M: Message, F: Factor<M> + ?Sized> Factor<M> for $pointer {
            fn dimensions(&self) -> &[usize] {
                (**self).dimensions()
            }
            fn message(
                &self,
                to: Port,
                incoming: &Incoming<'_, M>,
                form: &M::Form,
                stream: &mut Stream,
            ) -> Result<M, MessageError> {
                (**self).message(to, incoming, form, stream)
            }
            fn message_into(
                &self,
                to: Port,
                incoming: &Incoming<'_, M>,
                form: &M::Form,
                stream: &mut Stream,
                out: &mut M,
            ) -> Result<(), MessageError> {
                (**self).message_into(to, incoming, form, stream, out)
            }
            fn all_messages_into(
                &self,
                incoming: &Incoming<'_, M>,
                forms: &[M::Form],
                streams: MessageStreams,
                out: &mut [M],
            ) -> Result<(), (Port, MessageError)> {
                (**self).all_messages_into(incoming, forms, streams, out)
            }
            fn is_constant(&self) -> bool {
                (**self).is_constant()
            }
            fn answer(&self, question: &mut dyn Any) -> bool {
                (**self).answer(question)
            }
        }
    )*};
}

forward!(Box<F>, std::sync::Arc<F>, &F);
