//! Information graphs: who knew what when, as data.
//!
//! A node's state at a time is an event; so is an observation. Information flows along links from earlier events to
//! later ones: from a node's state to its next, from an observation to its sensor, and by communications between nodes.
//! What an event holds is the union of what its predecessors hold. From that follow, for any graph that is built by hand
//! or recorded from a run, what several parents have in common, which paths are redundant, and the plan of exact fusion:
//! which recorded beliefs to multiply and which to divide out.
//!
//! Source: Chong, Mori, "Graphical models for nonlinear distributed estimation" (2004).

mod draw;
mod record;

use std::collections::BTreeSet;

use petgraph::Direction::Incoming;
use petgraph::graph::{DiGraph, NodeIndex};
use petgraph::visit::EdgeRef;
use serde::{Deserialize, Serialize};
use sumprod_graph::{MessageError, Purpose, Space, Stream};

use crate::expression::{Terms, express};
use crate::intersection::product;
use crate::{Fusible, FusionError, InformationSet, Item};

/// An event of an information graph, numbered in the order in which it was added.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct EventId(usize);

impl EventId {
    /// Its number.
    pub fn index(self) -> usize {
        self.0
    }
}

/// What kind of event it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EventKind {
    /// The state of a node.
    State,
    /// An observation.
    Observation(Item),
}

/// An event.
#[derive(Clone, Debug, PartialEq)]
pub struct Event {
    /// Its node.
    pub node: usize,
    /// Its time (s).
    pub time: f64,
    /// Its kind.
    pub kind: EventKind,
    /// What it holds.
    pub information: InformationSet,
}

/// How information flows from an event to another.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Link {
    /// A node keeps what it held.
    Memory,
    /// A node observes.
    Observation,
    /// A node sends to another.
    Communication,
}

/// What several events have in common.
#[derive(Clone, Debug, PartialEq)]
pub struct Common {
    /// What all hold.
    pub information: InformationSet,
    /// The largest events before them that hold nothing else.
    pub events: Vec<EventId>,
    /// Whether those together hold all of it.
    pub complete: bool,
}

/// How an event's belief is made of those of earlier events.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// Events and how often their beliefs are multiplied; negative is divided out.
    pub terms: Vec<(EventId, i32)>,
    /// Those among them that the node has neither been at nor received, so that somebody must forward them.
    pub forwarded: Vec<EventId>,
}

/// A communication that brings what the receiver holds by another path.
#[derive(Clone, Debug, PartialEq)]
pub struct Redundancy {
    /// What was sent.
    pub from: EventId,
    /// What it became part of.
    pub to: EventId,
    /// What came again, the prior left out.
    pub information: InformationSet,
    /// Whether events that the node has been at or received hold just that, so that it can divide it out by itself.
    pub removable: bool,
}

/// An information graph.
///
/// ```
/// use sumprod_fusion::InformationGraph;
///
/// let mut graph = InformationGraph::new();
/// let [low, left, right, high] = ["low", "left", "right", "high"].map(|name| graph.add_node(name));
/// let seen = graph.observe(low, 1.0)?;
/// for node in [left, right] {
///     graph.observe(node, 1.0)?;
/// }
/// // The same observation reaches the top by two paths.
/// let left = graph.communicate(&[seen], left, 2.0)?;
/// let right = graph.communicate(&[seen], right, 2.0)?;
/// let top = graph.communicate(&[left, right], high, 3.0)?;
/// let common = graph.common(&[left, right])?;
/// assert_eq!(common.events, [seen]);
/// assert_eq!(graph.redundancies().len(), 1);
/// // The top needs the belief of the low node to divide it out.
/// assert_eq!(graph.plan(top)?.forwarded, [seen]);
/// # Ok::<(), sumprod_fusion::FusionError>(())
/// ```
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(try_from = "Vec<record::Happening>", into = "Vec<record::Happening>")]
pub struct InformationGraph {
    names: Vec<String>,
    graph: DiGraph<Event, Link>,
    /// By node, its last state.
    latest: Vec<usize>,
    /// By node, the number of observations.
    observed: Vec<u64>,
}

impl InformationGraph {
    /// A graph without nodes.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a node, which holds the common prior at time zero.
    pub fn add_node(&mut self, name: impl Into<String>) -> usize {
        let node = self.names.len();
        self.names.push(name.into());
        let start = Event { node, time: 0.0, kind: EventKind::State, information: InformationSet::prior() };
        self.latest.push(self.graph.add_node(start).index());
        self.observed.push(0);
        node
    }

    /// Names of the nodes.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// Number of events.
    pub fn len(&self) -> usize {
        self.graph.node_count()
    }

    /// Whether there is no event.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The events in the order in which they were added.
    pub fn events(&self) -> impl Iterator<Item = (EventId, &Event)> {
        self.graph.node_indices().map(|index| (EventId(index.index()), &self.graph[index]))
    }

    /// An event.
    ///
    /// # Errors
    ///
    /// Where there is none of this number.
    pub fn event(&self, event: EventId) -> Result<&Event, FusionError> {
        let (index, count) = (event.0, self.len());
        self.graph.node_weight(NodeIndex::new(index)).ok_or(FusionError::Unknown {
            what: "event",
            index,
            count,
        })
    }

    /// The last state of a node.
    ///
    /// # Errors
    ///
    /// Where there is no such node.
    pub fn latest(&self, node: usize) -> Result<EventId, FusionError> {
        let count = self.names.len();
        let unknown = FusionError::Unknown { what: "node", index: node, count };
        self.latest.get(node).map(|&event| EventId(event)).ok_or(unknown)
    }

    /// A node makes its next observation; its state after that.
    ///
    /// # Errors
    ///
    /// Where there is no such node, or the time is before that of its last state.
    pub fn observe(&mut self, node: usize, time: f64) -> Result<EventId, FusionError> {
        let before = self.state_at(node, time)?;
        let item = Item::new(node as u32, self.observed[node]);
        self.observed[node] += 1;
        let information = InformationSet::of([item]);
        let kind = EventKind::Observation(item);
        let seen = self.graph.add_node(Event { node, time, kind, information });
        Ok(self.advance(before, node, time, &[(seen.index(), Link::Observation)]))
    }

    /// A node receives what others sent at these events; its state after that. Several are fused at once.
    ///
    /// # Errors
    ///
    /// Where there is no such node or event, the time is before that of the node's last state, or an event is of a
    /// later time.
    pub fn communicate(&mut self, from: &[EventId], to: usize, time: f64) -> Result<EventId, FusionError> {
        let before = self.state_at(to, time)?;
        for sent in from {
            let Event { time: sent, node, .. } = *self.event(*sent)?;
            if sent > time {
                let place = format!("node {:?}, message from {:?}", self.names[to], self.names[node]);
                return Err(FusionError::FromTheFuture { place, sent, now: time });
            }
        }
        let links: Vec<(usize, Link)> = from.iter().map(|event| (event.0, Link::Communication)).collect();
        Ok(self.advance(before, to, time, &links))
    }

    fn state_at(&self, node: usize, time: f64) -> Result<EventId, FusionError> {
        let before = self.latest(node)?;
        let now = self.event(before)?.time;
        if !(time.is_finite() && time >= now) {
            return Err(FusionError::Backwards { node: self.names[node].clone(), now, to: time });
        }
        Ok(before)
    }

    fn advance(&mut self, before: EventId, node: usize, time: f64, links: &[(usize, Link)]) -> EventId {
        let links = [(before.0, Link::Memory)].into_iter().chain(links.iter().copied());
        let parents: Vec<(NodeIndex, Link)> =
            links.map(|(event, link)| (NodeIndex::new(event), link)).collect();
        let sets = parents.iter().map(|(parent, _)| &self.graph[*parent].information);
        let information = sets.fold(InformationSet::new(), |all, set| all.union(set));
        let state = self.graph.add_node(Event { node, time, kind: EventKind::State, information });
        for (parent, link) in parents {
            self.graph.add_edge(parent, state, link);
        }
        self.latest[node] = state.index();
        EventId(state.index())
    }

    /// Parents of an event with their links, in the order in which they were given.
    fn parents(&self, event: EventId) -> Vec<(EventId, Link)> {
        let edges = self.graph.edges_directed(NodeIndex::new(event.0), Incoming);
        let mut parents: Vec<_> = edges.map(|e| (e.id(), EventId(e.source().index()), *e.weight())).collect();
        parents.sort_by_key(|(id, ..)| *id);
        parents.into_iter().map(|(_, parent, link)| (parent, link)).collect()
    }

    /// The events before an event, ascending; O(events + links).
    fn ancestors(&self, of: &[EventId]) -> BTreeSet<EventId> {
        let mut seen = BTreeSet::new();
        let mut open: Vec<EventId> = of.to_vec();
        while let Some(event) = open.pop() {
            for (parent, _) in self.parents(event) {
                if seen.insert(parent) {
                    open.push(parent);
                }
            }
        }
        seen
    }

    /// What several events have in common, and the largest events, before them or among them, that hold nothing else.
    ///
    /// # Errors
    ///
    /// Where there is no such event.
    pub fn common(&self, events: &[EventId]) -> Result<Common, FusionError> {
        let mut shared: Option<InformationSet> = None;
        for event in events {
            let own = &self.event(*event)?.information;
            shared = Some(shared.map_or_else(|| own.clone(), |shared| shared.intersection(own)));
        }
        let information = shared.unwrap_or_default();
        let mut candidates = self.ancestors(events);
        candidates.extend(events);
        let set = |event: &EventId| &self.graph[NodeIndex::new(event.0)].information;
        candidates.retain(|event| set(event).is_subset(&information));
        let mut largest: Vec<EventId> = Vec::new();
        // Of equal ones the first that was there.
        for event in &candidates {
            let larger = |other: &EventId| {
                set(event).is_subset(set(other)) && (set(event) != set(other) || other < event)
            };
            if !candidates.iter().any(larger) {
                largest.push(*event);
            }
        }
        let covered = largest.iter().fold(InformationSet::new(), |all, event| all.union(set(event)));
        Ok(Common { complete: covered == information, information, events: largest })
    }

    /// How the belief of an event is made of those of the events before it: parents one after the other, what each
    /// shares with those before it divided out.
    ///
    /// # Errors
    ///
    /// [`FusionError::Loop`] where parents share what no event before them holds.
    pub fn plan(&self, event: EventId) -> Result<Plan, FusionError> {
        self.event(event)?;
        let parents: Vec<EventId> = self.parents(event).into_iter().map(|(parent, _)| parent).collect();
        // What the node has itself comes first.
        let own = self.own_events(event);
        let foreign = self.ancestors(&[event]).into_iter().filter(|event| !own.contains(event));
        let at_hand: Vec<EventId> = own.iter().copied().chain(foreign).collect();
        let terms = self.terms(event, &parents, &at_hand)?;
        let forwarded = terms.iter().map(|(event, _)| *event).filter(|event| !own.contains(event)).collect();
        Ok(Plan { terms, forwarded })
    }

    fn terms(
        &self,
        event: EventId,
        parents: &[EventId],
        at_hand: &[EventId],
    ) -> Result<Vec<(EventId, i32)>, FusionError> {
        let set = |event: EventId| &self.graph[NodeIndex::new(event.0)].information;
        let sets: Vec<&InformationSet> = at_hand.iter().map(|event| set(*event)).collect();
        let mut sum = std::collections::BTreeMap::<EventId, i32>::new();
        let mut held = InformationSet::new();
        for parent in parents {
            let own = set(*parent);
            if own.is_subset(&held) {
                continue;
            }
            if held.is_subset(own) {
                held.clone_from(own);
                sum = [(*parent, 1)].into();
                continue;
            }
            let shared = held.intersection(own);
            let terms: Terms = express(&shared, &sets).ok_or_else(|| FusionError::Loop {
                place: format!("event {} of node {:?}", event.0, self.name_of(event)),
                shared: shared.to_string(),
            })?;
            *sum.entry(*parent).or_default() += 1;
            for (k, count) in terms {
                *sum.entry(at_hand[k]).or_default() -= count;
            }
            held = held.union(own);
        }
        Ok(sum.into_iter().filter(|(_, count)| *count != 0).collect())
    }

    fn name_of(&self, event: EventId) -> &str {
        self.graph
            .node_weight(NodeIndex::new(event.0))
            .and_then(|event| self.names.get(event.node))
            .map_or("", String::as_str)
    }

    /// The states that a node has been at before an event, and what it received and observed.
    fn own_events(&self, event: EventId) -> BTreeSet<EventId> {
        let mut own = BTreeSet::new();
        let mut at = Some(event);
        while let Some(state) = at {
            let parents = self.parents(state);
            own.extend(parents.iter().map(|(parent, _)| *parent));
            at = parents.iter().find(|(_, link)| *link == Link::Memory).map(|(parent, _)| *parent);
        }
        own
    }

    /// The communications that bring what their receiver holds by another path.
    pub fn redundancies(&self) -> Vec<Redundancy> {
        let set = |event: EventId| &self.graph[NodeIndex::new(event.0)].information;
        let mut found = Vec::new();
        for index in self.graph.node_indices() {
            let to = EventId(index.index());
            let mut held = InformationSet::new();
            for (from, link) in self.parents(to) {
                let shared = held.intersection(set(from));
                held = held.union(set(from));
                let information = shared.difference(&InformationSet::prior());
                if link != Link::Communication || information.is_empty() {
                    continue;
                }
                let own = self.own_events(to);
                let sets: Vec<&InformationSet> = own.iter().map(|event| set(*event)).collect();
                let removable = express(&shared, &sets).is_some();
                found.push(Redundancy { from, to, information, removable });
            }
        }
        found
    }

    /// The nodes that never send.
    pub fn silent(&self) -> Vec<usize> {
        let mut silent: Vec<usize> = (0..self.names.len()).collect();
        for edge in self.graph.edge_references().filter(|edge| *edge.weight() == Link::Communication) {
            let node = self.graph[edge.source()].node;
            silent.retain(|other| *other != node);
        }
        silent
    }

    /// The belief of every event on a state that stands still, by its plan, in the order of the events: of
    /// observations the likelihood itself. Exact wherever a plan exists.
    ///
    /// # Errors
    ///
    /// As [`InformationGraph::plan`], and where a product or a division fails.
    pub fn beliefs<M: Fusible>(
        &self,
        space: &Space,
        prior: &M,
        likelihood: impl Fn(Item) -> Result<M, MessageError>,
    ) -> Result<Vec<M>, FusionError> {
        let form = M::default_form(space);
        let mut beliefs: Vec<M> = Vec::with_capacity(self.len());
        for index in self.graph.node_indices() {
            let event = EventId(index.index());
            let belief = match self.graph[index].kind {
                EventKind::Observation(item) => likelihood(item)?,
                EventKind::State => {
                    let stream = &mut Stream::new(0, 0, Purpose::Belief, index.index() as u64);
                    let mut above = Vec::new();
                    let mut below = Vec::new();
                    for (term, count) in self.plan(event)?.terms {
                        let side = if count > 0 { &mut above } else { &mut below };
                        side.extend((0..count.unsigned_abs()).map(|_| beliefs[term.0].clone()));
                    }
                    let mut belief =
                        if above.is_empty() { prior.clone() } else { product(&above, &form, stream)? };
                    for common in &below {
                        belief = belief.remove(common).map_err(|reason| FusionError::Indivisible {
                            place: format!("event {} of node {:?}", event.0, self.name_of(event)),
                            reason,
                            remedy: "give every node the same prior, and likelihoods that add information",
                        })?;
                    }
                    belief
                }
            };
            beliefs.push(belief);
        }
        Ok(beliefs)
    }
}
