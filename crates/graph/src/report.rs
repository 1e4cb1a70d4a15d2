//! What a run returns.

use crate::{EdgeId, Quality, VariableId};
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
    /// What is known of the messages' and beliefs' quality at the end.
    pub quality: Qualities,
}

/// What is known of messages and beliefs at the end of a run; those of which nothing is (a Gaussian that nothing was
/// converted to) are left out.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Qualities {
    /// By edge, of the message from its factor to its variable, in the order of the edges.
    pub edges: Vec<(EdgeId, Quality)>,
    /// By variable, of its belief, in the order of the variables.
    pub beliefs: Vec<(VariableId, Quality)>,
}

impl Qualities {
    /// Of the message along an edge, where something is known of it. O(log E).
    pub fn edge(&self, edge: EdgeId) -> Option<&Quality> {
        let place = self.edges.binary_search_by_key(&edge.index(), |(other, _)| other.index()).ok()?;
        self.edges.get(place).map(|(_, quality)| quality)
    }

    /// Of the belief of a variable, where something is known of it. O(log V).
    pub fn belief(&self, variable: VariableId) -> Option<&Quality> {
        let place = self.beliefs.binary_search_by_key(&variable.index(), |(other, _)| other.index()).ok()?;
        self.beliefs.get(place).map(|(_, quality)| quality)
    }
}

/// The worst of each figure in one line; nothing where nothing is known.
impl fmt::Display for Qualities {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let messages = self.edges.iter().map(|(_, quality)| quality);
        let beliefs = self.beliefs.iter().map(|(_, quality)| quality);
        let least = |values: &mut dyn Iterator<Item = f64>| values.reduce(f64::min);
        let most = |values: &mut dyn Iterator<Item = f64>| values.reduce(f64::max);
        let products = || beliefs.clone().filter_map(|quality| quality.product);
        let mut parts = Vec::new();
        if let Some(n) = least(&mut beliefs.clone().filter_map(|quality| quality.effective_sample_size)) {
            parts.push(format!("least effective sample size {n:.0}"));
        }
        let losses = messages.chain(beliefs.clone()).filter_map(|quality| quality.conversion_loss);
        if let Some(loss) = most(&mut losses.into_iter()) {
            parts.push(format!("conversions cost at most {loss:.2e} nats"));
        }
        if let Some(divergence) = most(&mut products().filter_map(|product| product.divergence)) {
            parts.push(format!("products are within {divergence:.2e} nats"));
        }
        if let Some(change) = least(&mut products().filter_map(|product| product.label_change)) {
            parts.push(format!("sweeps change at least {:.0} % of the labels", 100.0 * change));
        }
        formatter.write_str(&parts.join(", "))
    }
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
            Stop::Converged => write!(formatter, "converged after {iterations}, last change {change:.2e}")?,
            Stop::Finished => write!(formatter, "finished after {iterations}")?,
            Stop::IterationLimit => {
                write!(
                    formatter,
                    "stopped at the cap of {iterations} before convergence, last change {change:.2e}"
                )?;
            }
        }
        match self.quality.to_string() {
            known if known.is_empty() => Ok(()),
            known => write!(formatter, "; {known}"),
        }
    }
}
