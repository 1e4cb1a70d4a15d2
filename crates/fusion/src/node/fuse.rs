//! What each rule makes of a message.

use super::{Communication, FusionNode};
use crate::channel::{Channel, Known};
use crate::expression::express;
use crate::intersection::{self, Split, product};
use crate::{Fusible, FusionError, InformationSet, Intersection, IntersectionKind, Outcome};

impl<M: Fusible> FusionNode<M> {
    /// Divides out what both hold; what no belief at hand holds, where that is why it cannot be done.
    pub(super) fn remove(
        &mut self,
        place: usize,
        message: &Communication<M>,
    ) -> Result<Result<Outcome, InformationSet>, FusionError> {
        let (own, other) = (&self.held, &message.held);
        if other.information.is_subset(&own.information) {
            return Ok(Ok(Outcome::Held));
        }
        let channel = &self.channels[place];
        let at_hand: Vec<&Known<M>> =
            self.channels.iter().flat_map(Channel::known).chain(&message.forwarded).collect();
        let by_side: Vec<&Known<M>> = channel.by_side().collect();
        let adopts = own.information.is_subset(&other.information);
        let shared = own.information.intersection(&other.information);
        let news = if adopts {
            None
        } else {
            let Some(terms) = written(&shared, &at_hand, &by_side) else {
                let inside = at_hand.iter().filter(|known| known.information.is_subset(&shared));
                let covered = inside.fold(InformationSet::new(), |all, known| all.union(&known.information));
                let missing = shared.difference(&covered);
                return Ok(Err(if missing.is_empty() { shared } else { missing }));
            };
            Some((self.over(other, &terms, message.from)?, terms.len()))
        };
        // What both hold, should the last that was sent have arrived there.
        let sent = channel.sent.last();
        let agreed = match sent.filter(|sent| !sent.information.is_subset(&other.information)) {
            None => other.clone(),
            Some(sent) => {
                let overlap = sent.information.intersection(&other.information);
                let news = match &news {
                    Some((news, _)) if overlap == shared => Some(news.clone()),
                    _ => match written(&overlap, &at_hand, &by_side) {
                        Some(terms) => Some(self.over(other, &terms, message.from)?),
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

    /// `other` with a combination of known beliefs divided out.
    fn over(&self, other: &Known<M>, terms: &[(&Known<M>, i32)], from: usize) -> Result<M, FusionError> {
        let mut above = vec![other.belief.clone()];
        let mut below = Vec::new();
        for (known, count) in terms {
            let side = if *count > 0 { &mut below } else { &mut above };
            side.extend((0..count.unsigned_abs()).map(|_| known.belief.clone()));
        }
        let stream = &mut self.stream();
        let above = match above.as_slice() {
            [alone] => alone.clone(),
            several => product(several, &self.form, stream)?,
        };
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

    pub(super) fn divide_edge(
        &mut self,
        place: usize,
        message: &Communication<M>,
    ) -> Result<Outcome, FusionError> {
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

    pub(super) fn multiply_private(&mut self, message: &Communication<M>) -> Result<Outcome, FusionError> {
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

    pub(super) fn intersect(
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
    pub(super) fn own_private(&mut self) -> Result<M, FusionError> {
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
}

/// What makes up a set: the one belief that is just that, else one from either side of the edge, else any combination of
/// what is at hand.
fn written<'a, M>(
    target: &InformationSet,
    at_hand: &[&'a Known<M>],
    by_side: &[&'a Known<M>],
) -> Option<Vec<(&'a Known<M>, i32)>> {
    if let Some(known) = at_hand.iter().find(|known| known.information == *target) {
        return Some(vec![(known, 1)]);
    }
    [by_side, at_hand].into_iter().find_map(|beliefs| {
        let sets: Vec<&InformationSet> = beliefs.iter().map(|known| &known.information).collect();
        let terms = express(target, &sets)?;
        Some(terms.into_iter().map(|(k, count)| (beliefs[k], count)).collect())
    })
}
