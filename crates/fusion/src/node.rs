//! A fusion node: it observes, predicts, sends what it holds, and fuses what it receives without counting twice.
//!
//! On a communication edge the exchange
//!
//! b_i ← b_i b_j / c_ij,   c_ij ← what both hold then
//!
//! is sum-product: with one copy of the state at every node and equality on every edge, c_ij is the separator, and
//! b_j / c_ij the message from j to i. It is exact on a tree in any order, however often and however late. Every
//! message carries the identity of its information, by which the receiver finds what both hold: the last separator, a
//! belief that it sent and that arrived, or a combination of recorded beliefs by inclusion and exclusion.
//!
//! Prediction moves separators by the same motion as beliefs. That is exact where every step exchanges, or without
//! process noise; else the common process noise counts once for each node, and the belief is a little over-confident.
//!
//! Sources: Grime, Durrant-Whyte, "Data fusion in decentralized sensor networks" (1994), the channel filter; Wang, Peng,
//! Zhu, "Removing redundant information by Bayesian algorithm" (2018).

mod fuse;

use sumprod_graph::{MessageError, Purpose, Space, Stream};

use crate::channel::{Channel, Direction, Known};
use crate::intersection::{Split, product};
use crate::{Fusible, FusionError, InformationSet, Item, Outcome, Rule};

/// Times closer than this share of their size are equal.
const SAME_TIME: f64 = 1e-12;

/// What one node sends another.
#[derive(Clone, Debug, PartialEq)]
pub struct Communication<M> {
    /// The sender.
    pub from: usize,
    /// The receiver.
    pub to: usize,
    /// The time that its beliefs speak of (s).
    pub time: f64,
    /// All that the sender holds.
    pub held: Known<M>,
    /// What the sender observed itself since its last round, as a likelihood.
    pub private: Known<M>,
    /// Beliefs of shared parents that go along.
    pub forwarded: Vec<Known<M>>,
    /// Whether an intersection was part of it, so that it is a bound and no posterior.
    pub bounded: bool,
}

/// A fusion node.
///
/// ```
/// use nalgebra::{Matrix1, Vector1};
/// use sumprod_fusion::{Direction, FusionNode, InformationSet, Item, Known, Rule};
/// use sumprod_graph::Space;
/// use sumprod_messages::Gaussian;
///
/// // Two nodes share a prior of variance 4; each measures with variance 4.
/// let prior = Known::new(InformationSet::prior(), Gaussian::from_moments(Vector1::new(0.0), Matrix1::new(4.0))?);
/// let mut nodes = ["low", "high"].map(|name| FusionNode::new(name, Space::real(1), prior.clone(), Rule::Removal));
/// nodes[0].connect(1, Direction::Both, prior.clone());
/// nodes[1].connect(0, Direction::Both, prior);
/// for (source, node) in nodes.iter_mut().enumerate() {
///     let likelihood = Gaussian::from_information(Matrix1::new(0.25), Vector1::new(0.5));
///     node.observe(Item::new(source as u32, 0), &likelihood)?;
/// }
/// let message = nodes[0].send(0, 1)?;
/// // The second arrival of the same message changes nothing.
/// for _ in 0..2 {
///     nodes[1].receive(&message, |belief, _| Ok(*belief))?;
/// }
/// let (mean, variance) = nodes[1].belief().moments()?;
/// assert!((variance[0] - 1.0 / 0.75).abs() < 1e-12 && (mean[0] - 1.0 / 0.75).abs() < 1e-12);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct FusionNode<M: Fusible> {
    name: String,
    space: Space,
    form: M::Form,
    rule: Rule,
    time: f64,
    held: Known<M>,
    /// What it held at the end of its last round.
    reference: M,
    /// What it observed itself since.
    fresh: InformationSet,
    /// The likelihood of that; none where a prediction came between, so that it must be had by division.
    private: Option<M>,
    /// Whether a message of this round has been sent or received.
    talked: bool,
    /// The parts of the belief in a round that splits.
    split: Option<Split<M>>,
    bounded: bool,
    channels: Vec<Channel<M>>,
    seed: u64,
    products: u64,
}

impl<M: Fusible> FusionNode<M> {
    /// A node that holds `prior` at time zero.
    pub fn new(name: impl Into<String>, space: Space, prior: Known<M>, rule: Rule) -> Self {
        Self {
            name: name.into(),
            form: M::default_form(&space),
            private: Some(M::vacuous(&space)),
            talked: false,
            space,
            rule,
            time: 0.0,
            reference: prior.belief.clone(),
            held: prior,
            fresh: InformationSet::new(),
            split: None,
            bounded: false,
            channels: Vec::new(),
            seed: 0,
            products: 0,
        }
    }

    /// The same, holding products in this form; `seed` is that of products that draw.
    #[must_use]
    pub fn with_form(self, form: M::Form, seed: u64) -> Self {
        Self { form, seed, ..self }
    }

    /// Opens a channel to a neighbour with whom `common` is shared, usually the prior.
    pub fn connect(&mut self, neighbour: usize, direction: Direction, common: Known<M>) {
        self.channels.retain(|channel| channel.neighbour != neighbour);
        self.channels.push(Channel::new(neighbour, direction, common));
    }

    /// Lets the last message of each of `sources` go along with what is sent to a neighbour that hears of them by
    /// another path as well: what both paths share is then known there.
    ///
    /// # Errors
    ///
    /// Where there is no channel to one of them.
    pub fn forward(&mut self, sources: &[usize], neighbour: usize) -> Result<(), FusionError> {
        for source in sources {
            self.place_of(*source)?;
        }
        let place = self.place_of(neighbour)?;
        self.channels[place].forwards = sources.to_vec();
        Ok(())
    }

    /// Its name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// How it fuses.
    pub fn rule(&self) -> Rule {
        self.rule
    }

    /// Its belief.
    pub fn belief(&self) -> &M {
        &self.held.belief
    }

    /// What the belief is made of.
    pub fn information(&self) -> &InformationSet {
        &self.held.information
    }

    /// The time that the belief speaks of (s).
    pub fn time(&self) -> f64 {
        self.time
    }

    /// Whether an intersection was part of the belief, which then is a bound and no posterior.
    pub fn is_bounded(&self) -> bool {
        self.bounded
    }

    /// Multiplies in an observation of its own, unless it holds it already; true if it was new.
    ///
    /// # Errors
    ///
    /// Where the product fails.
    pub fn observe(&mut self, item: Item, likelihood: &M) -> Result<bool, FusionError> {
        if self.held.information.contains(item) {
            return Ok(false);
        }
        self.held.belief = self.product(&self.held.belief.clone(), likelihood)?;
        self.held.information.insert(item);
        self.fresh.insert(item);
        if let Some(private) = self.private.take() {
            self.private = Some(self.product(&private, likelihood)?);
        }
        if let Some(split) = self.split.take() {
            let independent = self.product(&split.independent, likelihood)?;
            self.split = Some(Split { independent, ..split });
        }
        Ok(true)
    }

    /// Ends a round of messages, then moves the belief and all that is shared with neighbours to time `to` by `step`.
    ///
    /// # Errors
    ///
    /// Where the time is before the node's or not finite, or `step` fails.
    pub fn predict(
        &mut self,
        to: f64,
        mut step: impl FnMut(&M) -> Result<M, MessageError>,
    ) -> Result<(), FusionError> {
        if !(to.is_finite() && to >= self.time) {
            return Err(FusionError::Backwards { node: self.name.clone(), now: self.time, to });
        }
        self.end_round();
        if !self.fresh.is_empty() {
            self.private = None;
        }
        self.held.belief = step(&self.held.belief)?;
        self.reference = step(&self.reference)?;
        if self.remembers() {
            self.channels.iter_mut().try_for_each(|channel| channel.advance(&mut step))?;
        }
        self.time = to;
        Ok(())
    }

    /// Ends a round of messages: what was observed before it is no longer private. Prediction does so by itself.
    pub fn end_round(&mut self) {
        if std::mem::take(&mut self.talked) {
            self.reference = self.held.belief.clone();
            self.fresh = InformationSet::new();
            self.private = Some(M::vacuous(&self.space));
            self.split = None;
        }
    }

    /// Whether beliefs are kept to be divided out: a bound has no use for them.
    fn remembers(&self) -> bool {
        self.rule.remembers() && !self.bounded
    }

    /// What the node, number `own`, has to say to a neighbour.
    ///
    /// # Errors
    ///
    /// Where there is no channel to it.
    pub fn send(&mut self, own: usize, neighbour: usize) -> Result<Communication<M>, FusionError> {
        let place = self.place_of(neighbour)?;
        let private = self.own_private();
        let private = if self.rule.splits() {
            Known::new(self.fresh.clone(), private?)
        } else {
            // Of use to neighbours of another rule, where it can be had.
            private.map_or_else(
                |_| Known::new(InformationSet::new(), M::vacuous(&self.space)),
                |private| Known::new(self.fresh.clone(), private),
            )
        };
        self.talked = true;
        let mut forwarded = Vec::new();
        for source in self.channels[place].forwards.clone() {
            let from = self.place_of(source)?;
            forwarded.extend(self.channels[from].received.clone());
        }
        if self.remembers() {
            let (form, stream) = (&self.form, self.stream());
            self.channels[place]
                .note_sent(&self.held, |a, b| product(&[a.clone(), b.clone()], form, &mut stream.clone()))?;
        }
        Ok(Communication {
            from: own,
            to: neighbour,
            time: self.time,
            held: self.held.clone(),
            private,
            forwarded,
            bounded: self.bounded,
        })
    }

    /// Fuses a message. One that is late is moved to the node's time by `step`, which is given a belief and the time
    /// that it speaks of.
    ///
    /// # Errors
    ///
    /// Where the message comes from the future or from a node without a channel, where [`Rule::Removal`] meets a loop,
    /// or where what is left after a division is no message. The belief is then as it was.
    pub fn receive(
        &mut self,
        message: &Communication<M>,
        step: impl Fn(&M, f64) -> Result<M, MessageError>,
    ) -> Result<Outcome, FusionError> {
        let place = self.place_of(message.from)?;
        let slack = SAME_TIME * (self.time.abs() + message.time.abs());
        if message.time.is_nan() || message.time > self.time + slack {
            let (sent, now) = (message.time, self.time);
            return Err(FusionError::FromTheFuture { place: self.describe(message.from), sent, now });
        }
        let late;
        let message = if message.time < self.time - slack {
            if self.rule == Rule::Private {
                return Err(FusionError::Unsupported(format!(
                    "{}: it is from time {}, and a likelihood of the past is none of the present; choose the removal \
                     rule for messages that are late",
                    self.describe(message.from),
                    message.time
                )));
            }
            late = moved(message, |belief| step(belief, message.time))?;
            &late
        } else {
            message
        };
        if self.rule.splits() {
            self.own_private()?;
        }
        self.talked = true;
        if self.rule == Rule::Removal && message.bounded {
            return Err(FusionError::Unsupported(format!(
                "{}: it is a bound by an intersection, in which nothing can be divided out; choose the automatic rule \
                 for all nodes",
                self.describe(message.from)
            )));
        }
        match self.rule {
            Rule::Removal => self.remove(place, message)?.map_err(|missing| FusionError::Loop {
                place: self.describe(message.from),
                shared: missing.to_string(),
            }),
            Rule::Edge => self.divide_edge(place, message),
            Rule::Private => self.multiply_private(message),
            Rule::Naive => {
                self.multiply(&message.held.belief, &message.held.information)?;
                Ok(Outcome::Multiplied)
            }
            Rule::Intersection(intersection) => self.intersect(message, intersection, None),
            Rule::Automatic(intersection) => {
                if self.bounded || message.bounded {
                    return self.intersect(message, intersection, None);
                }
                match self.remove(place, message) {
                    Ok(Ok(outcome)) => Ok(outcome),
                    Ok(Err(missing)) => self.intersect(message, intersection, Some(missing)),
                    Err(FusionError::Indivisible { .. }) => {
                        self.intersect(message, intersection, Some(InformationSet::new()))
                    }
                    Err(error) => Err(error),
                }
            }
        }
    }

    /// Takes over what another node of the same time holds in place of its own belief, whatever is lost by that: feedback
    /// as it was before anybody removed what is redundant.
    ///
    /// # Errors
    ///
    /// Where the message is of another time.
    pub fn adopt(&mut self, message: &Communication<M>) -> Result<Outcome, FusionError> {
        if (message.time - self.time).abs() > SAME_TIME * (self.time.abs() + message.time.abs()) {
            let (sent, now) = (message.time, self.time);
            return Err(FusionError::FromTheFuture { place: self.describe(message.from), sent, now });
        }
        self.talked = true;
        self.held = message.held.clone();
        self.bounded = message.bounded;
        Ok(Outcome::Adopted)
    }

    fn multiply(&mut self, news: &M, information: &InformationSet) -> Result<(), FusionError> {
        self.held.belief = self.product(&self.held.belief.clone(), news)?;
        self.held.information = self.held.information.union(information);
        Ok(())
    }

    fn product(&mut self, a: &M, b: &M) -> Result<M, MessageError> {
        let fused = product(&[a.clone(), b.clone()], &self.form, &mut self.stream());
        self.products += 1;
        fused
    }

    fn stream(&self) -> Stream {
        Stream::new(self.seed, self.products, Purpose::Belief, 0)
    }

    fn place_of(&self, neighbour: usize) -> Result<usize, FusionError> {
        self.channels
            .iter()
            .position(|channel| channel.neighbour == neighbour)
            .ok_or_else(|| FusionError::NotConnected { node: self.name.clone(), neighbour })
    }

    fn describe(&self, from: usize) -> String {
        format!("node {:?}, time {}, message from node {from}", self.name, self.time)
    }
}

/// A message with every belief moved.
fn moved<M: Fusible>(
    message: &Communication<M>,
    step: impl Fn(&M) -> Result<M, MessageError>,
) -> Result<Communication<M>, MessageError> {
    let known = |known: &Known<M>| Ok(Known::new(known.information.clone(), step(&known.belief)?));
    Ok(Communication {
        held: known(&message.held)?,
        // A likelihood of the past is none of the present: what is private is told as correlated.
        private: Known::new(message.held.information.clone(), message.private.belief.clone()),
        forwarded: message.forwarded.iter().map(known).collect::<Result<_, MessageError>>()?,
        ..*message
    })
}
