//! What a run returns.

use std::fmt;

/// Why a run stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stop {
    /// The largest change of an iteration fell below the tolerance.
    Converged,
    /// The schedule had nothing left to do: its answer is final.
    Finished,
    /// The iteration cap was reached first.
    IterationLimit,
}

/// What a run returns: how many iterations, how much each changed, and why it stopped.
#[derive(Clone, Debug, PartialEq)]
pub struct Report {
    /// Iterations done.
    pub iterations: usize,
    /// The largest change by iteration: of a belief where everything was sent at once, else of a message.
    pub changes: Vec<f64>,
    /// Why the run stopped.
    pub stop: Stop,
}

impl Report {
    /// Whether the answer stands: the messages converged, or the schedule was exact.
    pub fn converged(&self) -> bool {
        self.stop != Stop::IterationLimit
    }
}

impl fmt::Display for Report {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let iterations = match self.iterations {
            1 => "1 iteration".to_owned(),
            count => format!("{count} iterations"),
        };
        let change = self.changes.last().copied().unwrap_or(0.0);
        match self.stop {
            Stop::Converged => write!(formatter, "converged after {iterations}, last change {change:.2e}"),
            Stop::Finished => write!(formatter, "finished after {iterations}"),
            Stop::IterationLimit => {
                write!(
                    formatter,
                    "stopped at the cap of {iterations} before convergence, last change {change:.2e}"
                )
            }
        }
    }
}
