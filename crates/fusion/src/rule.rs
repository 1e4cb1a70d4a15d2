//! How a node fuses what it receives.

use serde::{Deserialize, Serialize};

use crate::{Criterion, InformationSet};

/// How a node fuses what it receives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rule {
    /// What both hold is found by its identity and divided out: exact, or an error where no belief at hand holds just
    /// that.
    Removal,
    /// What the edge carried before is divided out, whatever came by other edges: the channel filter. Exact on trees;
    /// on a loop information is counted again.
    Edge,
    /// What the sender observed itself since its last round is multiplied in, and nothing else: exact of the
    /// observations of neighbours.
    Private,
    /// Everything is multiplied, as if nothing were shared.
    Naive,
    /// The intersection, always.
    Intersection(Intersection),
    /// [`Rule::Removal`] where it is possible, and from the first loop on the intersection.
    Automatic(Intersection),
}

/// Which intersection.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum IntersectionKind {
    /// [`crate::intersection::covariance`].
    Covariance,
    /// [`crate::intersection::split`]: what both observed themselves since their last round is independent.
    #[default]
    Split,
    /// [`crate::intersection::inverse`].
    Inverse,
}

/// An intersection and what it makes small.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Intersection {
    /// Which one.
    pub kind: IntersectionKind,
    /// What it makes small.
    pub criterion: Criterion,
}

impl Rule {
    /// Whether what a node observed itself is told apart from what it heard.
    pub(crate) fn splits(self) -> bool {
        match self {
            Self::Private => true,
            Self::Intersection(how) | Self::Automatic(how) => how.kind == IntersectionKind::Split,
            Self::Removal | Self::Edge | Self::Naive => false,
        }
    }

    /// Whether beliefs are kept that later messages may share.
    pub(crate) fn remembers(self) -> bool {
        matches!(self, Self::Removal | Self::Edge | Self::Automatic(_))
    }
}

/// What became of a message.
#[derive(Clone, Debug, PartialEq)]
pub enum Outcome {
    /// All of it was held already: it is a repetition, or older than what came before.
    Held,
    /// It holds all that the receiver did, and took its place.
    Adopted,
    /// What is shared was divided out, by so many recorded beliefs.
    Removed {
        /// Number of recorded beliefs that make up what is shared.
        terms: usize,
    },
    /// It was multiplied in as it stands, or what is private of it.
    Multiplied,
    /// It was fused by an intersection.
    Intersected {
        /// The weight of the receiver's belief, from 0 to 1.
        weight: f64,
        /// Where the automatic rule gave removal up in this step: what came by more than one path; nothing where a
        /// division left no message instead.
        looped: Option<InformationSet>,
    },
}
