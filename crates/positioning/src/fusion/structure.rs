//! Who talks to whom.

use serde::{Deserialize, Serialize};

use super::method::{Exchange, Links, MethodSettings};

/// The kinds of structure.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum StructureKind {
    /// Every sensor's node talks to one centre, which has no sensor.
    Star,
    /// Two groups of sensors, which share the one in the middle, each with a fusion node; above them a third.
    Hierarchy,
    /// Every sensor's node talks to two others, in a ring.
    Ring,
}

impl StructureKind {
    pub(super) fn least_sensors(self) -> u32 {
        match self {
            Self::Star => 1,
            Self::Hierarchy | Self::Ring => 3,
        }
    }
}

/// Nodes and their links. The nodes of sensors come first, in the sensors' order.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Structure {
    /// Its kind.
    pub kind: StructureKind,
    /// Names of the nodes.
    pub names: Vec<String>,
    /// Number of sensors.
    pub sensors: usize,
    /// The node where everything is collected.
    pub top: usize,
    /// Links from a lower node to a higher one, lowest first.
    upward: Vec<(usize, usize)>,
    /// The links that close loops among neighbours.
    closing: Vec<(usize, usize)>,
}

/// Messages that are sent at once, by sender and receiver.
pub(super) type Phase = Vec<(usize, usize)>;

impl Structure {
    /// The structure of this kind and number of sensors.
    pub fn new(kind: StructureKind, sensors: usize) -> Self {
        let leaves = || (1..=sensors).map(|number| format!("sensor {number}"));
        let (names, top, upward, closing): (Vec<String>, _, Vec<_>, _) = match kind {
            StructureKind::Star => {
                let names = leaves().chain(["centre".to_owned()]).collect();
                (names, sensors, (0..sensors).map(|leaf| (leaf, sensors)).collect(), Vec::new())
            }
            StructureKind::Hierarchy => {
                let (low, high, top) = (sensors, sensors + 1, sensors + 2);
                let names = leaves().chain(["F1", "F2", "F3"].map(str::to_owned)).collect();
                let shared = sensors / 2;
                let upward = (0..=shared)
                    .map(|leaf| (leaf, low))
                    .chain((shared..sensors).map(|leaf| (leaf, high)))
                    .chain([(low, top), (high, top)])
                    .collect();
                (names, top, upward, Vec::new())
            }
            StructureKind::Ring => {
                let path = (1..sensors).rev().map(|node| (node, node - 1)).collect();
                ((0..sensors).map(|node| format!("node {node}")).collect(), 0, path, vec![(sensors - 1, 0)])
            }
        };
        Self { kind, names, sensors, top, upward, closing }
    }

    /// The links that a method uses, from lower to higher.
    pub(super) fn links(&self, method: &MethodSettings) -> Vec<(usize, usize)> {
        let closing: &[_] = if method.links == Links::All { &self.closing } else { &[] };
        self.upward.iter().chain(closing).copied().collect()
    }

    /// Children of a node that have another parent as well, over the links given.
    pub(super) fn shared_children(node: usize, links: &[(usize, usize)]) -> Vec<usize> {
        let parents = |child: usize| links.iter().filter(|(lower, _)| *lower == child).count();
        links
            .iter()
            .filter(|(child, parent)| *parent == node && parents(*child) > 1)
            .map(|(child, _)| *child)
            .collect()
    }

    /// Whether a method's message from one node to another goes down from the top.
    pub(super) fn distributes(&self, method: &MethodSettings, from: usize, to: usize) -> bool {
        method.exchange == Exchange::CollectAndDistribute && self.upward.contains(&(to, from))
    }

    /// The messages of one exchange, phase by phase.
    pub(super) fn phases(&self, method: &MethodSettings) -> Vec<Phase> {
        let links = self.links(method);
        if method.exchange == Exchange::Neighbours {
            return vec![links.iter().flat_map(|&(a, b)| [(a, b), (b, a)]).collect()];
        }
        let mut phases: Vec<Phase> = Vec::new();
        for &(child, parent) in &links {
            match phases.last_mut() {
                Some(phase) if phase.iter().all(|(_, to)| *to == parent) => phase.push((child, parent)),
                _ => phases.push(vec![(child, parent)]),
            }
        }
        if method.exchange == Exchange::CollectAndDistribute {
            let down: Vec<Phase> = phases
                .iter()
                .rev()
                .map(|phase| phase.iter().map(|&(child, parent)| (parent, child)).collect())
                .collect();
            phases.extend(down);
        }
        phases
    }
}
