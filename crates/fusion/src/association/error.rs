//! Why tracks cannot be associated.

use thiserror::Error;

/// Why tracks cannot be associated. Each message is one sentence with the culprit and the remedy.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum AssociationError {
    /// Coordinates that make no tracks.
    #[error("the tracks cannot be used: {problem}")]
    Tracks {
        /// What is wrong, with the track's index.
        problem: String,
    },

    /// Two sets that cannot be compared.
    #[error(
        "the first tracks have {first:?} scans and coordinates a scan, the second {second:?}; both sets need the same"
    )]
    Shapes {
        /// Scans and coordinates of the first set.
        first: [usize; 2],
        /// Scans and coordinates of the second set.
        second: [usize; 2],
    },

    /// A parameter that means nothing.
    #[error("`{name}` {problem}")]
    Parameter {
        /// The parameter's name.
        name: &'static str,
        /// The rest of the sentence: the value and what it must be.
        problem: String,
    },

    /// So many tracks compete within one gate that their assignment would not fit.
    #[error(
        "{first} and {second} tracks compete within the gate of {gate}, and at most {limit} pairs can be weighed together; narrow the gate"
    )]
    Crowded {
        /// Tracks of the first set that hang together.
        first: usize,
        /// Tracks of the second set.
        second: usize,
        /// The gate.
        gate: f64,
        /// Largest number of entries of an assignment's matrix.
        limit: usize,
    },

    /// The field's equations have no solution.
    #[error("the displacement field cannot be solved for: {problem}")]
    Field {
        /// What stands in the way.
        problem: String,
    },
}

impl AssociationError {
    pub(super) fn parameter(name: &'static str, problem: impl Into<String>) -> Self {
        Self::Parameter { name, problem: problem.into() }
    }
}
