//! What can go wrong, said with the names and numbers a user knows.

use crate::observability::FreeDirections;
use std::path::{Path, PathBuf};
use sumprod_graph::{GraphError, MessageError};
use thiserror::Error;

/// Why a graph could not be solved or read.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum ExactError {
    /// A factor that has no residual, or not at this point.
    #[error("factor {factor:?} cannot be linearised: {source}")]
    Factor {
        /// The factor.
        factor: String,
        /// The reason.
        source: MessageError,
    },
    /// A prior that is no Gaussian.
    #[error("the prior of variable {variable:?} cannot be solved jointly: {source}")]
    Prior {
        /// The variable.
        variable: String,
        /// The reason.
        source: MessageError,
    },
    /// A belief that messages leave without a covariance.
    #[error(
        "the belief of variable {variable:?} is no distribution: {source}; allow more rounds of messages"
    )]
    Belief {
        /// The variable.
        variable: String,
        /// The reason.
        source: MessageError,
    },
    /// A variable that no Gaussian holds.
    #[error("variable {variable:?} has {states} states; a joint Gaussian solve needs continuous variables")]
    Finite {
        /// The variable.
        variable: String,
        /// Its number of states.
        states: usize,
    },
    /// A continuous variable where states are needed.
    #[error("variable {variable:?} is continuous; a junction tree needs variables of finitely many states")]
    Continuous {
        /// The variable.
        variable: String,
    },
    /// A factor that is no function of finitely many states.
    #[error(
        "factor {factor:?} has no table of values; a junction tree needs factors over finitely many states"
    )]
    NoTable {
        /// The factor.
        factor: String,
    },
    /// Cliques that are too large.
    #[error(
        "the graph is too wide for a junction tree: with the clique of {} ({} variables) its tables have {entries:.3e} \
         entries or more, and {most} are allowed; allow more, or use message passing", few(variables), variables.len()
    )]
    TooWide {
        /// The variables of the clique with which the tree grew too large.
        variables: Vec<String>,
        /// Entries of all cliques so far.
        entries: f64,
        /// The most that are allowed.
        most: usize,
    },
    /// A graph whose factors contradict.
    #[error(
        "no joint state is possible: the factors around {} rule each other out; look for zeros in their tables",
        few(variables)
    )]
    Impossible {
        /// Variables of the clique at which nothing was left.
        variables: Vec<String>,
    },
    /// A number that must be finite is not.
    #[error("{what} is {value}; {remedy}")]
    NotFinite {
        /// Which number, with the factor or variable it belongs to.
        what: String,
        /// Its value.
        value: f64,
        /// What to do.
        remedy: &'static str,
    },
    /// Directions that nothing constrains.
    #[error("the graph cannot be solved: {}", .0.iter().map(ToString::to_string).collect::<Vec<_>>().join("; "))]
    Unobservable(Vec<FreeDirections>),
    /// The information matrix lost its definiteness to rounding, with no direction free.
    #[error(
        "the information of variable {variable:?} is not positive definite in double precision (pivot {pivot:.1e}), \
         though every direction is constrained; bring the factors' variances closer together"
    )]
    Rounding {
        /// The variable at the failing pivot.
        variable: String,
        /// The pivot, relative to the diagonal.
        pivot: f64,
    },
    /// A handle or size that does not belong to this graph.
    #[error("{0}")]
    Request(String),
    /// The iteration ended without convergence.
    #[error(
        "no convergence after {iterations} iterations: cost {cost:.9e}, last decrease {decrease:.1e}; {remedy}"
    )]
    NotConverged {
        /// Iterations made.
        iterations: usize,
        /// The cost reached.
        cost: f64,
        /// The last relative decrease.
        decrease: f64,
        /// What to try.
        remedy: &'static str,
    },
    /// The system is too large for memory or for its index type.
    #[error("the sparse solve failed: {0}")]
    Sparse(String),
    /// A file that cannot be used.
    #[error("{}: {problem}", place(path, *line))]
    File {
        /// The file.
        path: PathBuf,
        /// Line within it, from 1.
        line: Option<usize>,
        /// What is wrong, and what was expected.
        problem: String,
    },
    /// The graph refuses what it was given.
    #[error("{0}")]
    Graph(#[from] GraphError),
}

impl ExactError {
    /// A file that cannot be used; `line` counts from 1.
    pub(crate) fn file(path: &Path, line: Option<usize>, problem: impl Into<String>) -> Self {
        Self::File { path: path.to_path_buf(), line, problem: problem.into() }
    }
}

/// Names for a sentence, the first few of many.
fn few(names: &[String]) -> String {
    const SHOWN: usize = 6;
    let shown = names.iter().take(SHOWN).map(String::as_str).collect::<Vec<_>>().join(", ");
    if names.len() > SHOWN { format!("{shown}, …") } else { shown }
}

fn place(path: &Path, line: Option<usize>) -> String {
    match line {
        Some(line) => format!("{}:{line}", path.display()),
        None => path.display().to_string(),
    }
}
