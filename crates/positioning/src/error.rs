//! The crate's one error, split by whose mistake it is: the input's or the computation's.

use std::error::Error;
use std::path::{Path, PathBuf};

use sumprod_exact::ExactError;
use thiserror::Error as ThisError;

/// Why a scenario cannot be read, prepared, run or judged.
///
/// Every message is one sentence that names the culprit (key, file and line, method, run, step) and, where there
/// is one, the remedy.
#[derive(Debug, ThisError)]
#[non_exhaustive]
pub enum PositioningError {
    /// A key of the scenario has a value that means nothing.
    #[error("`{key}` {problem}")]
    Setting {
        /// Dotted path of the key, for instance `world.process_variance`.
        key: String,
        /// The rest of the sentence: the offending value and what it must be.
        problem: String,
    },

    /// A method was asked for that the scenario does not have.
    #[error("there is no method `{method}` in this scenario; it has {}", known.join(", "))]
    UnknownMethod {
        /// The id asked for.
        method: String,
        /// The ids that exist.
        known: Vec<String>,
    },

    /// A recorded file cannot be used.
    #[error("{}: {problem}", place(path, *line))]
    Data {
        /// The file or folder.
        path: PathBuf,
        /// Line within the file, from 1.
        line: Option<usize>,
        /// What is wrong and what was expected.
        problem: String,
    },

    /// The measurements leave directions of the state free.
    #[error("nothing constrains {what}; {remedy}")]
    Unconstrained {
        /// The free directions, for instance `the position of agents 2 and 3 along x and y`.
        what: String,
        /// Factors that would constrain them.
        remedy: String,
    },

    /// A graph that has no answer.
    #[error("{problem}")]
    Unsolvable {
        /// What stands in the way, and the remedy.
        problem: String,
    },

    /// A method produced an estimate that no metric can be computed from.
    #[error("method `{method}`, step {step}, node {node}: {problem}")]
    Estimate {
        /// The method's id.
        method: String,
        /// The scored step.
        step: u32,
        /// Index of the node.
        node: u32,
        /// The offending number or shape.
        problem: String,
    },

    /// A method failed.
    #[error("method `{method}`: {source}")]
    Method {
        /// The method's id.
        method: String,
        /// What failed inside it.
        source: Box<dyn Error + Send + Sync>,
    },

    /// A run failed; the cause names what failed inside it.
    #[error("run {run}: {source}")]
    Run {
        /// Index of the run, from 0.
        run: u32,
        /// The cause.
        source: Box<PositioningError>,
    },

    /// Results of several runs do not fit together.
    #[error("the runs cannot be summarised: {problem}")]
    Results {
        /// What differs between them.
        problem: String,
    },

    /// A file of ours cannot be written or read back.
    #[error("cannot {doing} {}: {source}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// `create`, `write`, `read`, …
        doing: &'static str,
        /// The operating system's reason.
        source: std::io::Error,
    },

    /// Two invocations write to the same folder.
    #[error("{} is in use by another invocation; wait for it or choose another folder", path.display())]
    InUse {
        /// The locked file.
        path: PathBuf,
    },
}

impl PositioningError {
    /// A value of the scenario that cannot be used: `key` is its dotted path, and `problem` goes on the sentence,
    /// for instance `"is -4 m²/s⁴; a variance must be positive"`.
    pub fn setting(key: impl Into<String>, problem: impl Into<String>) -> Self {
        Self::Setting { key: key.into(), problem: problem.into() }
    }

    /// A recorded file that cannot be used; `line` counts from 1.
    pub fn data(path: &Path, line: Option<usize>, problem: impl Into<String>) -> Self {
        Self::Data { path: path.to_path_buf(), line, problem: problem.into() }
    }

    /// A failure inside a method.
    pub fn method(id: &str, source: impl Into<Box<dyn Error + Send + Sync>>) -> Self {
        Self::Method { method: id.to_owned(), source: source.into() }
    }

    /// Whether the input, not the computation, is at fault.
    pub fn is_input(&self) -> bool {
        match self {
            Self::Setting { .. }
            | Self::UnknownMethod { .. }
            | Self::Data { .. }
            | Self::Unconstrained { .. }
            | Self::Unsolvable { .. }
            | Self::InUse { .. } => true,
            Self::Run { source, .. } => source.is_input(),
            Self::Estimate { .. } | Self::Method { .. } | Self::Results { .. } | Self::File { .. } => false,
        }
    }
}

fn place(path: &Path, line: Option<usize>) -> String {
    match line {
        Some(line) => format!("{}:{line}", path.display()),
        None => path.display().to_string(),
    }
}

/// An error of the exact solver as one of the input, where it is one.
pub(crate) fn unsolvable(error: ExactError) -> PositioningError {
    match error {
        ExactError::File { path, line, problem } => PositioningError::Data { path, line, problem },
        ExactError::Unobservable(free) => {
            let sentences: Vec<String> = free.iter().map(ToString::to_string).collect();
            PositioningError::Unsolvable { problem: sentences.join("; ") }
        }
        other => PositioningError::Unsolvable { problem: other.to_string() },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sentences_name_the_culprit() {
        let error = PositioningError::data(Path::new("a/b.dat"), Some(7), "expected 3 numbers, found 2");
        assert_eq!(error.to_string(), "a/b.dat:7: expected 3 numbers, found 2");
        let error = PositioningError::setting("world.steps", "is 0; it must be at least 1");
        assert_eq!(error.to_string(), "`world.steps` is 0; it must be at least 1");
    }

    #[test]
    fn a_wrong_input_stays_one_inside_a_run() {
        let wrap = |source| PositioningError::Run { run: 3, source: Box::new(source) };
        assert!(wrap(PositioningError::setting("a", "b")).is_input());
        assert!(!wrap(PositioningError::method("kf", "singular innovation")).is_input());
    }
}
