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

use sumprod_graph::{MessageError, Purpose, Space, Stream};

use crate::channel::{Channel, Direction, Known};
use crate::expression::{Terms, express};
use crate::intersection::{self, Split, product};
use crate::{Fusible, FusionError, InformationSet, Intersection, IntersectionKind, Item, Outcome, Rule};

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
        if !(message.time <= self.time + slack) {
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
                match self.remove(place, message)? {
                    Ok(outcome) => Ok(outcome),
                    Err(missing) => self.intersect(message, intersection, Some(missing)),
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

    /// Divides out what both hold; what no belief at hand holds, where that is why it cannot be done.
    fn remove(
        &mut self,
        place: usize,
        message: &Communication<M>,
    ) -> Result<Result<Outcome, InformationSet>, FusionError> {
        let (own, other) = (&self.held, &message.held);
        if other.information.is_subset(&own.information) {
            return Ok(Ok(Outcome::Held));
        }
        let at_hand: Vec<&Known<M>> =
            self.channels.iter().flat_map(Channel::known).chain(&message.forwarded).collect();
        let sets: Vec<&InformationSet> = at_hand.iter().map(|known| &known.information).collect();
        let adopts = own.information.is_subset(&other.information);
        let shared = own.information.intersection(&other.information);
        let news = if adopts {
            None
        } else {
            let Some(terms) = express(&shared, &sets) else {
                let inside = sets.iter().filter(|set| set.is_subset(&shared));
                let covered = inside.fold(InformationSet::new(), |all, set| all.union(set));
                let missing = shared.difference(&covered);
                return Ok(Err(if missing.is_empty() { shared } else { missing }));
            };
            Some((self.over(other, &at_hand, &terms, message.from)?, terms.len()))
        };
        // What both hold, should the last that was sent have arrived there.
        let sent = self.channels[place].sent.last();
        let agreed = match sent.filter(|sent| !sent.information.is_subset(&other.information)) {
            None => other.clone(),
            Some(sent) => {
                let overlap = sent.information.intersection(&other.information);
                let news = match &news {
                    Some((news, _)) if overlap == shared => Some(news.clone()),
                    _ => match express(&overlap, &sets) {
                        Some(terms) => Some(self.over(other, &at_hand, &terms, message.from)?),
                        None => None,
                    },
                };
                match news {
                    Some(news) => Known::new(
                        sent.information.union(&other.information),
                        product(&[sent.belief.clone(), news], &self.form, &mut self.stream())?,
                    ),
                    None => other.clone(),
                }
            }
        };
        let novel = other.information.difference(&own.information);
        let (outcome, news) = match news {
            None => {
                let news = other.belief.remove(&own.belief).ok();
                self.held = other.clone();
                (Outcome::Adopted, news)
            }
            Some((news, terms)) => {
                self.multiply(&news, &message.held.information)?;
                (Outcome::Removed { terms }, Some(news))
            }
        };
        let (form, stream) = (&self.form, self.stream());
        self.channels[place].note_received(
            message.held.clone(),
            agreed,
            news.map(|news| Known::new(novel, news)),
            message.forwarded.clone(),
            |a, b| product(&[a.clone(), b.clone()], form, &mut stream.clone()),
        )?;
        Ok(Ok(outcome))
    }

    /// `other` with the combination `terms` of what is at hand divided out.
    fn over(
        &self,
        other: &Known<M>,
        at_hand: &[&Known<M>],
        terms: &Terms,
        from: usize,
    ) -> Result<M, FusionError> {
        let mut above = vec![other.belief.clone()];
        let mut below = Vec::new();
        for &(k, count) in terms {
            let side = if count > 0 { &mut below } else { &mut above };
            side.extend((0..count.unsigned_abs()).map(|_| at_hand[k].belief.clone()));
        }
        let stream = &mut self.stream();
        let above =
            if above.len() == 1 { other.belief.clone() } else { product(&above, &self.form, stream)? };
        match below.as_slice() {
            [] => Ok(above),
            [common] => self.divide(&above, common, from),
            several => self.divide(&above, &product(several, &self.form, stream)?, from),
        }
    }

    fn divide(&self, belief: &M, common: &M, from: usize) -> Result<M, FusionError> {
        belief.remove(common).map_err(|reason| FusionError::Indivisible {
            place: self.describe(from),
            reason,
            remedy: "start both ends of the edge from the prior that they share and predict separators by the beliefs' \
                     own motion, or choose an intersection, which divides nothing",
        })
    }

    fn divide_edge(&mut self, place: usize, message: &Communication<M>) -> Result<Outcome, FusionError> {
        let channel = &self.channels[place];
        let other = &message.held;
        if channel.received.as_ref().is_some_and(|last| other.information.is_subset(&last.information)) {
            return Ok(Outcome::Held);
        }
        let sent = channel.sent.last();
        let (separator, pending) = match sent {
            Some(sent) if sent.information.is_subset(&other.information) => (sent, None),
            sent => (&channel.agreed, sent),
        };
        let news = self.divide(&other.belief, &separator.belief, message.from)?;
        let agreed = match pending {
            None => other.clone(),
            Some(sent) => Known::new(
                sent.information.union(&other.information),
                product(&[sent.belief.clone(), news.clone()], &self.form, &mut self.stream())?,
            ),
        };
        self.multiply(&news, &other.information)?;
        let channel = &mut self.channels[place];
        channel.agreed = agreed;
        channel.received = Some(other.clone());
        channel.sent.clear();
        Ok(Outcome::Removed { terms: 1 })
    }

    fn multiply_private(&mut self, message: &Communication<M>) -> Result<Outcome, FusionError> {
        let private = &message.private;
        if private.information.is_subset(&self.held.information) {
            return Ok(Outcome::Held);
        }
        let shared = private.information.intersection(&self.held.information);
        if !shared.is_empty() {
            let place = self.describe(message.from);
            return Err(FusionError::Loop { place, shared: shared.to_string() });
        }
        self.multiply(&private.belief, &private.information)?;
        Ok(Outcome::Multiplied)
    }

    fn intersect(
        &mut self,
        message: &Communication<M>,
        how: Intersection,
        looped: Option<InformationSet>,
    ) -> Result<Outcome, FusionError> {
        let other = &message.held;
        let (belief, weight) = match how.kind {
            IntersectionKind::Covariance => {
                let (own, stream) = (&self.held.belief, &mut self.stream());
                intersection::covariance(own, &other.belief, how.criterion, &self.form, stream)?
            }
            IntersectionKind::Inverse => {
                intersection::inverse(&self.held.belief, &other.belief, how.criterion)?
            }
            IntersectionKind::Split => {
                let (own, theirs) = (self.own_parts(other, message.from)?, self.parts(message)?);
                let stream = &mut self.stream();
                let (split, weight) = intersection::split(&own, &theirs, how.criterion, &self.form, stream)?;
                let parts = [split.correlated.clone(), split.independent.clone()];
                let belief = product(&parts, &self.form, stream)?;
                self.split = Some(split);
                (belief, weight)
            }
        };
        self.products += 1;
        self.held.belief = belief;
        self.held.information = self.held.information.union(&other.information);
        self.bounded = true;
        Ok(Outcome::Intersected { weight, looped })
    }

    /// The own belief in two parts, for fusion with `other`: what was observed since the last round is independent of
    /// it unless it holds some of that.
    fn own_parts(&mut self, other: &Known<M>, from: usize) -> Result<Split<M>, FusionError> {
        if !self.fresh.is_disjoint(&other.information) {
            return Ok(self.all_correlated(&self.held.belief));
        }
        if let Some(split) = &self.split {
            return Ok(split.clone());
        }
        let independent = self.own_private()?;
        Ok(Split { correlated: self.divide(&self.held.belief, &independent, from)?, independent })
    }

    /// A neighbour's message in two parts.
    fn parts(&self, message: &Communication<M>) -> Result<Split<M>, FusionError> {
        let Communication { held, private, from, .. } = message;
        if !private.information.is_disjoint(&self.held.information) {
            return Ok(self.all_correlated(&held.belief));
        }
        Ok(Split {
            correlated: self.divide(&held.belief, &private.belief, *from)?,
            independent: private.belief.clone(),
        })
    }

    fn all_correlated(&self, belief: &M) -> Split<M> {
        Split { correlated: belief.clone(), independent: M::vacuous(&self.space) }
    }

    /// The likelihood of what was observed since the last round.
    fn own_private(&mut self) -> Result<M, FusionError> {
        if let Some(private) = &self.private {
            return Ok(private.clone());
        }
        let private =
            self.held.belief.remove(&self.reference).map_err(|reason| FusionError::Indivisible {
                place: format!("node {:?}, its own observations", self.name),
                reason,
                remedy: "let observations be likelihoods, which add information",
            })?;
        self.private = Some(private.clone());
        Ok(private)
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
