//! The figures over time.

use std::collections::BTreeMap;

use serde::Serialize;

use super::sample::{Dimensions, Sample};
use super::summary::rmse;
use super::{Statistic, Summary, mean};
use crate::results::{MethodRun, RunResult};

/// Steps beyond this are gathered into bins of equal width, so that arrays of a long recording stay readable.
const MOST_BINS: usize = 1000;

/// Number of steps that `final_rmse_m` is over.
const FINAL_STEPS: usize = 10;

/// Figures of one method over time; all arrays have one entry a step, or a bin of steps beyond a thousand.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ByStep {
    /// Mean time of the entry's estimates (s).
    pub time_s: Vec<f64>,
    /// The figures.
    #[serde(flatten)]
    pub summary: Summary<Vec<f64>>,
    /// What the method reports about itself by step, averaged over the runs.
    #[serde(flatten)]
    pub diagnostics: BTreeMap<String, Vec<f64>>,
}

/// The bound over time.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BoundByStep {
    /// Time (s).
    pub time_s: Vec<f64>,
    /// Root of the position variance averaged over the runs (m).
    pub position_rmse_m: Statistic<Vec<f64>>,
}

/// Distinct scored steps, gathered into at most a thousand bins.
pub(super) struct Bins {
    steps: Vec<u32>,
    width: usize,
}

impl Bins {
    pub fn new(steps: impl Iterator<Item = u32>) -> Self {
        let mut steps: Vec<u32> = steps.collect();
        steps.sort_unstable();
        steps.dedup();
        let width = steps.len().div_ceil(MOST_BINS).max(1);
        Self { steps, width }
    }

    fn rank(&self, step: u32) -> Option<usize> {
        self.steps.binary_search(&step).ok()
    }

    fn bin(&self, step: u32) -> Option<usize> {
        self.rank(step).map(|rank| rank / self.width)
    }

    fn len(&self) -> usize {
        self.steps.len().div_ceil(self.width)
    }
}

impl ByStep {
    pub(super) fn new(
        samples: &[Sample],
        dimensions: Dimensions,
        bins: &Bins,
        mine: &[&MethodRun],
    ) -> Option<Self> {
        if bins.len() < 2 {
            return None;
        }
        let mut gathered: Vec<Vec<Sample>> = vec![Vec::new(); bins.len()];
        for sample in samples {
            if let Some(bin) = bins.bin(sample.step) {
                gathered[bin].push(*sample);
            }
        }
        let rows: Vec<_> = gathered.iter().map(|samples| Summary::new(samples, dimensions)).collect();
        Some(Self {
            time_s: gathered.iter().map(|samples| mean(samples.iter().map(|sample| sample.time))).collect(),
            summary: Summary::transpose(&rows),
            diagnostics: diagnostics(bins, mine),
        })
    }
}

fn diagnostics(bins: &Bins, mine: &[&MethodRun]) -> BTreeMap<String, Vec<f64>> {
    let mut sums: BTreeMap<&str, Vec<(f64, usize)>> = BTreeMap::new();
    for series in mine.iter().flat_map(|method| &method.series) {
        let row = sums.entry(&series.name).or_insert_with(|| vec![(0.0, 0); bins.len()]);
        for (&step, &value) in series.steps.iter().zip(&series.values) {
            if let Some(bin) = bins.bin(step).filter(|_| value.is_finite()) {
                row[bin].0 += value;
                row[bin].1 += 1;
            }
        }
    }
    sums.into_iter()
        .filter(|(_, row)| row.iter().all(|&(_, count)| count > 0))
        .map(|(name, row)| (name.to_owned(), row.iter().map(|&(sum, count)| sum / count as f64).collect()))
        .collect()
}

impl BoundByStep {
    pub(super) fn new(runs: &[RunResult]) -> Self {
        let steps = || runs.iter().flat_map(|run| &run.bound);
        let bins = Bins::new(steps().map(|step| step.step));
        let mut gathered: Vec<Vec<(f64, f64)>> = vec![Vec::new(); bins.len()];
        for step in steps() {
            if let Some(bin) = bins.bin(step.step) {
                gathered[bin].push((step.time, step.position_variance));
            }
        }
        let root = |rows: &Vec<(f64, f64)>| mean(rows.iter().map(|row| row.1)).sqrt();
        Self {
            time_s: gathered.iter().map(|rows| mean(rows.iter().map(|row| row.0))).collect(),
            position_rmse_m: Statistic { mean: gathered.iter().map(root).collect(), se: None },
        }
    }
}

/// Root mean squared error over the last steps; absent where there are no others.
pub(super) fn final_rmse(samples: &[Sample], bins: &Bins) -> Option<Statistic<f64>> {
    let first = bins.steps.len().checked_sub(FINAL_STEPS).filter(|&first| first > 0)?;
    let chosen: Vec<Sample> =
        samples.iter().filter(|sample| sample.step >= bins.steps[first]).copied().collect();
    rmse(&chosen, |sample| sample.position_squared.or(sample.state_squared))
}

/// Ratio of the root mean squared position errors in the last and the first third of the steps.
pub(super) fn last_third_over_first_third(samples: &[Sample], bins: &Bins) -> Option<f64> {
    let third = bins.steps.len() / 3;
    if third == 0 {
        return None;
    }
    let square = |inside: &dyn Fn(usize) -> bool| {
        let chosen = samples.iter().filter(|sample| bins.rank(sample.step).is_some_and(inside));
        mean(chosen.filter_map(|sample| sample.position_squared))
    };
    let ratio = (square(&|rank| rank >= bins.steps.len() - third) / square(&|rank| rank < third)).sqrt();
    ratio.is_finite().then_some(ratio)
}
