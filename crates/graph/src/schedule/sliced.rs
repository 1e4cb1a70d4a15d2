//! Time slices: predict, then some rounds among neighbours within the slice, then close it.

use super::{Pass, Refusal, Schedule};
use crate::{EdgeId, GraphError, Topology};

/// Slices in the order of time. In each: the messages from earlier slices (prediction), then `rounds` rounds in
/// which all messages within the slice are sent at once, the first from the predictions alone.
///
/// With [`Sliced::smoothing`] each iteration then goes back in time as well, which a window of several slices
/// needs. Variables without a time take part in the slice of the latest variable they share a factor with.
#[derive(Clone, Debug, Default)]
pub struct Sliced {
    rounds: usize,
    smoothing: bool,
    evidence_first: bool,
    evidence_before_rounds: bool,
    slices: Vec<Slice>,
}

#[derive(Clone, Debug, Default)]
struct Slice {
    /// Messages of factors with a single variable.
    evidence: Vec<EdgeId>,
    prediction: Vec<EdgeId>,
    within: Vec<EdgeId>,
    /// Messages from this slice to earlier ones.
    back: Vec<EdgeId>,
}

impl Sliced {
    /// A filter's schedule with `rounds` rounds within each slice.
    pub fn new(rounds: usize) -> Self {
        Self { rounds, ..Self::default() }
    }

    /// Each iteration also sends messages back in time.
    #[must_use]
    pub fn smoothing(mut self) -> Self {
        self.smoothing = true;
        self
    }

    /// Before the prediction, each slice hears from its factors of a single variable, so that predicted particles
    /// can be drawn where these say. Such factors must not need a point to linearise at.
    #[must_use]
    pub fn evidence_first(mut self) -> Self {
        self.evidence_first = true;
        self
    }

    /// After the prediction, each slice hears from its factors of a single variable once, before the rounds: the
    /// first round then starts from what every variable knows by itself.
    #[must_use]
    pub fn evidence_before_rounds(mut self) -> Self {
        self.evidence_before_rounds = true;
        self
    }
}

impl Schedule for Sliced {
    fn begin(&mut self, topology: &Topology) -> Result<(), Refusal> {
        if self.rounds == 0 {
            return Err(Refusal::Other("a sliced schedule needs at least one round within a slice".into()));
        }
        let variables = (0..topology.variable_count() as u32).map(crate::VariableId);
        let mut times: Vec<f64> = variables.filter_map(|variable| topology.time_of(variable)).collect();
        if let Some(bad) = times.iter().find(|time| !time.is_finite()) {
            return Err(Refusal::Other(format!("a variable's time is {bad}; times must be finite")));
        }
        times.sort_unstable_by(f64::total_cmp);
        times.dedup();
        if times.is_empty() {
            return Err(Refusal::Other(
                "a sliced schedule needs variables with a time, but none has one".into(),
            ));
        }
        self.slices = vec![Slice::default(); times.len()];
        for factor in (0..topology.factor_count() as u32).map(crate::FactorId) {
            let slice_of = |edge: EdgeId| {
                let time = topology.time_of(topology.variable_of(edge))?;
                times.binary_search_by(|other| other.total_cmp(&time)).ok()
            };
            let edges = topology.edges_of_factor(factor);
            let latest = edges.clone().filter_map(slice_of).max().unwrap_or(0);
            let earliest = edges.clone().filter_map(slice_of).min().unwrap_or(0);
            let slice = &mut self.slices[latest];
            if edges.clone().count() == 1 {
                slice.evidence.extend(edges.clone());
            }
            for edge in edges {
                match slice_of(edge) {
                    Some(own) if own < latest => slice.back.push(edge),
                    Some(_) if earliest < latest => slice.prediction.push(edge),
                    _ => slice.within.push(edge),
                }
            }
        }
        Ok(())
    }

    fn iteration(&mut self, _topology: &Topology, pass: &mut dyn Pass) -> Result<f64, GraphError> {
        let mut largest: f64 = 0.0;
        for slice in &self.slices {
            if self.evidence_first {
                largest = largest.max(pass.together(&slice.evidence)?);
            }
            largest = largest.max(pass.together(&slice.prediction)?);
            if self.evidence_before_rounds {
                largest = largest.max(pass.together(&slice.evidence)?);
            }
            for _ in 0..self.rounds {
                largest = largest.max(pass.together(&slice.within)?);
            }
        }
        if self.smoothing {
            // The newest slice is done; every older one first hears from the future, then settles again.
            let mut newer: Option<&Slice> = None;
            for slice in self.slices.iter().rev() {
                if let Some(newer) = newer {
                    largest = largest.max(pass.together(&newer.back)?);
                    for _ in 0..self.rounds {
                        largest = largest.max(pass.together(&slice.within)?);
                    }
                }
                newer = Some(slice);
            }
        }
        Ok(largest)
    }

    fn iterations(&self) -> Option<usize> {
        (!self.smoothing).then_some(1)
    }
}
