//! One end of a communication edge: the beliefs that both ends may hold.
//!
//! On a tree the belief of what both hold is the separator of the sum-product algorithm, and dividing it out leaves the
//! message; beliefs that were sent and may or may not have arrived are kept beside it, so that messages may be delayed,
//! lost, repeated or overtaken.

use sumprod_graph::MessageError;

use crate::{Fusible, InformationSet};

/// Beliefs kept by a channel beyond the newest; older ones are forgotten.
const MEMORY: usize = 64;

/// A belief and what it is made of.
#[derive(Clone, Debug, PartialEq)]
pub struct Known<M> {
    /// What it is made of.
    pub information: InformationSet,
    /// The belief.
    pub belief: M,
}

impl<M> Known<M> {
    /// A belief made of this.
    pub fn new(information: InformationSet, belief: M) -> Self {
        Self { information, belief }
    }
}

/// Which way messages go.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// Both ways.
    Both,
    /// From this node to the neighbour alone.
    Outgoing,
    /// From the neighbour to this node alone.
    Incoming,
}

/// A node's end of a communication edge.
#[derive(Clone, Debug)]
pub(crate) struct Channel<M> {
    pub neighbour: usize,
    pub direction: Direction,
    /// Neighbours whose last message goes along with what is sent here.
    pub forwards: Vec<usize>,
    /// What both ends hold, if all that was sent has arrived.
    pub agreed: Known<M>,
    /// What was sent and is not known to have arrived, oldest first.
    pub sent: Vec<Known<M>>,
    /// The neighbour's last message.
    pub received: Option<Known<M>>,
    /// What both ends held at first.
    base: Known<M>,
    /// The base and all that came from the neighbour's side.
    inbound: Known<M>,
    /// The base and what was sent from this side: what arrived last, then what may have arrived, oldest first.
    outbound: Vec<Known<M>>,
    /// Beliefs that the neighbour's last two messages brought along.
    pub forwarded: [Vec<Known<M>>; 2],
}

impl<M: Fusible> Channel<M> {
    pub fn new(neighbour: usize, direction: Direction, common: Known<M>) -> Self {
        Self {
            neighbour,
            direction,
            forwards: Vec::new(),
            agreed: common.clone(),
            sent: Vec::new(),
            received: None,
            base: common.clone(),
            inbound: common.clone(),
            outbound: vec![common],
            forwarded: [Vec::new(), Vec::new()],
        }
    }

    /// Every belief kept, those first that nearly always are what both ends hold.
    pub fn known(&self) -> impl Iterator<Item = &Known<M>> {
        std::iter::once(&self.agreed)
            .chain(self.sent.iter().rev())
            .chain(&self.received)
            .chain(self.forwarded.iter().flatten())
            .chain(self.by_side())
    }

    /// What was sent from either side, and the base of both: on a tree two of these with the third divided out are all
    /// that the ends can have in common, whatever was lost on the way. Exact of a state that stands still.
    pub fn by_side(&self) -> impl Iterator<Item = &Known<M>> {
        self.outbound.iter().rev().chain([&self.inbound, &self.base])
    }

    /// Moves every belief kept.
    pub fn advance(
        &mut self,
        step: &mut impl FnMut(&M) -> Result<M, MessageError>,
    ) -> Result<(), MessageError> {
        let all = [&mut self.agreed, &mut self.base, &mut self.inbound]
            .into_iter()
            .chain(&mut self.sent)
            .chain(&mut self.outbound)
            .chain(&mut self.received)
            .chain(self.forwarded.iter_mut().flatten());
        for known in all {
            known.belief = step(&known.belief)?;
        }
        Ok(())
    }

    /// Notes what was sent, where an answer may come.
    pub fn note_sent(
        &mut self,
        held: &Known<M>,
        multiply: impl Fn(&M, &M) -> Result<M, MessageError>,
    ) -> Result<(), MessageError> {
        let known = self.sent.last().is_some_and(|last| last.information == held.information);
        if self.direction == Direction::Outgoing || known {
            return Ok(());
        }
        // What cannot be told apart by side, as after a prediction with noise, is left to the beliefs as they were sent.
        if let Ok(own) = held.belief.remove(&self.inbound.belief) {
            let theirs = self.inbound.information.difference(&self.base.information);
            let belief = multiply(&own, &self.base.belief)?;
            self.outbound.push(Known::new(held.information.difference(&theirs), belief));
            trim(&mut self.outbound);
        }
        self.sent.push(held.clone());
        trim(&mut self.sent);
        Ok(())
    }

    /// Notes a message that brought `news`, and that both ends hold `agreed` if all that was sent has arrived.
    pub fn note_received(
        &mut self,
        message: Known<M>,
        agreed: Known<M>,
        news: Option<Known<M>>,
        forwarded: Vec<Known<M>>,
        multiply: impl Fn(&M, &M) -> Result<M, MessageError>,
    ) -> Result<(), MessageError> {
        if let Some(news) = news {
            self.inbound.belief = multiply(&self.inbound.belief, &news.belief)?;
            self.inbound.information = self.inbound.information.union(&news.information);
        }
        // What was sent arrived if the message is made of it.
        self.sent.retain(|sent| !sent.information.is_subset(&message.information));
        let arrived = |known: &Known<M>| known.information.is_subset(&message.information);
        if let Some(last) = self.outbound.iter().rposition(arrived) {
            self.outbound.drain(..last);
        }
        self.agreed = agreed;
        self.received = Some(message);
        self.forwarded.swap(0, 1);
        self.forwarded[0] = forwarded;
        Ok(())
    }
}

/// Keeps the first, which has arrived, and the newest.
fn trim<T>(beliefs: &mut Vec<T>) {
    let surplus = beliefs.len().saturating_sub(MEMORY);
    if surplus > 0 {
        beliefs.drain(1..=surplus);
    }
}
