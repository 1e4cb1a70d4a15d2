//! What a run returns.

use std::fmt;

/// Why a run stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stop {
    /// The largest change of a message fell below the tolerance.
    Converged,
    /// The schedule had nothing left to do: its answer is final.
    Finished,
    /// The iteration cap was reached first.
    IterationLimit,
}

/// What a run returns: how many iterations, how the messages changed, and why it stopped.
#[derive(Clone, Debug, PartialEq)]
pub struct Report {
    /// Iterations done.
    pub iterations: usize,
    /// The largest change of any message, by iteration.
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
        let change = self.changes.last().copied().unwrap_or(0.0);
        match self.stop {
            Stop::Converged => write!(formatter, "converged after {} iterations", self.iterations)?,
            Stop::Finished => write!(formatter, "finished after {} iterations", self.iterations)?,
            Stop::IterationLimit => {
                write!(formatter, "stopped at the cap of {} iterations", self.iterations)?
            }
        }
        write!(formatter, ", last change {change:.2e}")
    }
}
