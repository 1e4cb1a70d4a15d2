//! Why a graph cannot be solved: the directions that no factor constrains, in the user's words.
//!
//! A direction v is free where J v = 0 for every factor's Jacobian J. The null space is found by inverse iteration on the
//! information scaled to a unit diagonal, and judged by the sum of |J v|² itself, which keeps the digits that v'A v loses.
//! It is then told as motions of the whole (translation, rotation, scale) where it is one, each tried on the factors, and
//! as coordinates of variables where it is not.

mod gauge;
mod mirror;
mod null_space;
mod words;

pub use mirror::{Mirror, MirrorImage, mirror_images};

use crate::{ExactError, Problem, Values};
use null_space::NullSpace;
use std::fmt;

/// Directions of a connected part of the graph that nothing constrains.
#[derive(Clone, Debug, PartialEq)]
pub struct FreeDirections {
    /// The variables that move, by name, in the order of the graph.
    pub variables: Vec<String>,
    /// How they move: `the position along x`, `the heading`.
    pub directions: Vec<String>,
    /// Dimension of the free subspace; a lower bound where it is very large.
    pub dimension: usize,
    /// Factors that would constrain them.
    pub remedy: String,
    /// Whether no factor joins these variables to others that are constrained.
    pub apart: bool,
}

impl fmt::Display for FreeDirections {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let apart = if self.apart { ", which no factor joins to the others" } else { "" };
        let variables = words::names(&self.variables);
        write!(
            f,
            "nothing constrains {} of {variables}{apart}; {}",
            words::list(&self.directions),
            self.remedy
        )
    }
}

/// All directions at these values that no factor constrains, part by part of the graph; none where it can be solved.
///
/// The work of one factorisation and some twenty solves for each dozen free directions.
///
/// # Errors
///
/// Where a factor cannot be linearised.
pub fn free_directions(problem: &Problem<'_>, values: &Values) -> Result<Vec<FreeDirections>, ExactError> {
    let space = NullSpace::new(problem, values)?;
    if space.dimension() == 0 {
        return Ok(Vec::new());
    }
    let components = problem.components();
    let mut found = Vec::new();
    for component in &components {
        let basis = space.within(problem, component);
        if !basis.is_empty() {
            found.push(gauge::describe(problem, values, &space, component, basis, components.len() > 1)?);
        }
    }
    Ok(found)
}

/// Why a factorisation failed at a variable.
pub(crate) fn explain(problem: &Problem<'_>, values: &Values, variable: usize) -> ExactError {
    match free_directions(problem, values) {
        Err(error) => error,
        Ok(free) if free.is_empty() => {
            ExactError::Rounding { variable: problem.variable_name(variable), pivot: f64::EPSILON }
        }
        Ok(free) => ExactError::Unobservable(free),
    }
}
