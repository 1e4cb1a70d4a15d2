//! Figures over many runs: error, consistency, bound.
//!
//! | name | definition |
//! |---|---|
//! | `position_rmse_m` | root of the mean over runs of each run's mean squared position error (nodes and scored steps pooled); `se` by the delta method, absent for a single run |
//! | `rmse_m` | the same of a state that has no position, all components together |
//! | `final_rmse_m` | the same over the last ten scored steps |
//! | `velocity_rmse_mps` | the same of the velocity, where the state has one |
//! | `clock_offset_rmse_s`, `clock_skew_rmse_ppm` | the same of a clock's offset and skew, where the state has one |
//! | `error_quantiles_m` | quantiles of the position error's length, runs, nodes and steps pooled, interpolated linearly |
//! | `per_run_p90_median_m` | median over runs of each run's 90 % error |
//! | `nees` | normalised estimation error squared eᵀP⁻¹e of the position, the velocity, the clock and the whole state: mean, median, degrees of freedom, and the band that the mean keeps to with probability 95 % if the method is consistent |
//! | `coverage95` | share of errors inside the 95 % region of the position, or where the method gives intervals the share of components inside their central 95 % interval |
//! | `coverage95_se` | standard error of that share over runs |
//! | `width95` | mean width of those intervals |
//! | `last_third_over_first_third` | ratio of the position errors (root mean square) in the last and the first third of the steps |
//! | `one_sidedness` | \|mean over steps of the sign of the error\|, averaged over axes, nodes and runs |
//! | `segments` | the same figures over named stretches |
//! | `by_step` | the same figures as arrays over time |
//!
//! What a method reports about itself (`n_eff`, `conversion_loss`, …) stands beside them, averaged over the runs. A
//! figure that does not apply is absent.
//!
//! Source: Bar-Shalom, Li, Kirubarajan, *Estimation with Applications to Tracking and Navigation* (2001), 5.4, for
//! the NEES and its band.

mod by_step;
mod calibration;
pub mod chi_square;
mod sample;
mod summary;

use std::collections::BTreeMap;

use serde::ser::SerializeMap;
use serde::{Serialize, Serializer};

use crate::error::PositioningError;
use crate::results::{MethodRun, RunResult};

pub use by_step::{BoundByStep, ByStep};
pub use calibration::{Calibration, Verdict};
pub use summary::{Nees, NeesBlocks, Quantiles, Statistic, Summary};

use by_step::Bins;
use sample::{Dimensions, Sample};

/// Errors, consistency and bound of a whole campaign; its JSON form is the program's `metrics.json`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// Name of the scenario.
    pub scenario: String,
    /// Seed of the campaign.
    pub seed: u64,
    /// Number of runs.
    pub runs: usize,
    /// The bound of the position error, where one is known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bound: Option<Bound>,
    /// The methods by id, in order.
    #[serde(serialize_with = "as_map")]
    pub methods: Vec<(String, MethodMetrics)>,
}

/// The bound of the position error.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Bound {
    /// Root of the bound's position variance averaged over runs and steps (m).
    pub position_rmse_m: Statistic<f64>,
    /// The same over time.
    pub by_step: BoundByStep,
}

/// The figures of one method.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MethodMetrics {
    /// Wall-clock time of the method (s), summed over the runs.
    pub seconds: f64,
    /// The figures that exist by step as well.
    #[serde(flatten)]
    pub summary: Summary<f64>,
    /// Root mean squared error over the last ten scored steps (m), of the position where there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub final_rmse_m: Option<Statistic<f64>>,
    /// Median over runs of each run's 90 % position error (m).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub per_run_p90_median_m: Option<f64>,
    /// Growth of the error.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub last_third_over_first_third: Option<f64>,
    /// 1 if every error along an axis has the same sign throughout a run, near 0 if signs alternate.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub one_sidedness: Option<f64>,
    /// What the method reports about itself, averaged over the runs.
    #[serde(flatten)]
    pub diagnostics: BTreeMap<String, DiagnosticValue>,
    /// Standard errors of those that are numbers, under the same names; none for a single run.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub standard_errors: BTreeMap<String, DiagnosticValue>,
    /// The figures over named stretches.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub segments: BTreeMap<String, Summary<f64>>,
    /// The figures over time.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub by_step: Option<ByStep>,
    /// Sentences for the reader.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<String>,
}

/// A reported number or array, or several under one name.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(untagged)]
pub enum DiagnosticValue {
    /// One number.
    Number(f64),
    /// Numbers by kind, as in `conversion_loss.range`.
    Group(BTreeMap<String, f64>),
    /// Numbers in order, as in `log_evidence` by step.
    List(Vec<f64>),
    /// Arrays by kind.
    Lists(BTreeMap<String, Vec<f64>>),
}

impl Report {
    /// Computes every figure that applies. O(n log n) in the number n of estimates.
    ///
    /// # Errors
    /// [`PositioningError::Results`] if there is no run, if a run lacks a method that the first run has, or if a
    /// diagnostic is not finite.
    pub fn new(scenario: &str, seed: u64, runs: &[RunResult]) -> Result<Self, PositioningError> {
        let first = runs.first().ok_or_else(|| broken("there is no run".into()))?;
        let mut methods = Vec::with_capacity(first.methods.len());
        for id in first.methods.iter().map(|method| &method.id) {
            methods.push((id.clone(), MethodMetrics::new(id, runs)?));
        }
        Ok(Self { scenario: scenario.to_owned(), seed, runs: runs.len(), bound: Bound::new(runs), methods })
    }

    /// The figures of one method.
    pub fn method(&self, id: &str) -> Option<&MethodMetrics> {
        self.methods.iter().find(|(name, _)| name == id).map(|(_, metrics)| metrics)
    }
}

impl Bound {
    fn new(runs: &[RunResult]) -> Option<Self> {
        let per_run: Vec<f64> = runs
            .iter()
            .filter(|run| !run.bound.is_empty())
            .map(|run| mean(run.bound.iter().map(|step| step.position_variance)))
            .collect();
        if per_run.is_empty() {
            return None;
        }
        let position_rmse_m = Statistic { mean: mean(per_run).sqrt(), se: None };
        Some(Self { position_rmse_m, by_step: BoundByStep::new(runs) })
    }
}

impl MethodMetrics {
    /// A number that the system reports under this name, `group.kind` for one of a group.
    #[must_use]
    pub fn diagnostic(&self, name: &str) -> Option<f64> {
        number(&self.diagnostics, name)
    }

    /// The standard error of that number; `None` for a single run.
    #[must_use]
    pub fn standard_error(&self, name: &str) -> Option<f64> {
        number(&self.standard_errors, name)
    }

    fn new(id: &str, runs: &[RunResult]) -> Result<Self, PositioningError> {
        let mine = collect(id, runs)?;
        let samples: Vec<Sample> =
            mine.iter().enumerate().flat_map(|(run, method)| sample::samples(run, method)).collect();
        let dimensions = Dimensions::of(&mine[0].layout);
        let bins = Bins::new(samples.iter().map(|sample| sample.step));
        let segments = runs[0]
            .segments
            .iter()
            .filter_map(|segment| {
                let inside = |sample: &&Sample| (segment.first..=segment.last).contains(&sample.step);
                let chosen: Vec<Sample> = samples.iter().filter(inside).copied().collect();
                let summary = (!chosen.is_empty()).then(|| Summary::new(&chosen, dimensions))?;
                Some((segment.name.clone(), summary))
            })
            .collect();
        Ok(Self {
            seconds: mine.iter().map(|method| method.seconds).sum(),
            summary: Summary::new(&samples, dimensions),
            final_rmse_m: by_step::final_rmse(&samples, &bins),
            per_run_p90_median_m: summary::per_run_p90_median(&samples),
            last_third_over_first_third: by_step::last_third_over_first_third(&samples, &bins),
            one_sidedness: sample::one_sidedness(&samples, dimensions.position),
            diagnostics: grouped(id, &mine)?,
            standard_errors: standard_errors(id, &mine)?,
            segments,
            by_step: ByStep::new(&samples, dimensions, &bins, &mine),
            notes: notes(&mine),
        })
    }
}

fn collect<'a>(id: &str, runs: &'a [RunResult]) -> Result<Vec<&'a MethodRun>, PositioningError> {
    let mut mine: Vec<&MethodRun> = Vec::with_capacity(runs.len());
    for run in runs {
        let method = run
            .methods
            .iter()
            .find(|method| method.id == id)
            .ok_or_else(|| broken(format!("run {} has no method `{id}`", run.run)))?;
        if mine.first().is_some_and(|first| first.layout != method.layout) {
            return Err(broken(format!("method `{id}` has another state layout in run {}", run.run)));
        }
        mine.push(method);
    }
    Ok(mine)
}

/// Averages each named number and array over the runs that report it, and groups names at their dot.
fn grouped(id: &str, mine: &[&MethodRun]) -> Result<BTreeMap<String, DiagnosticValue>, PositioningError> {
    let mut groups = BTreeMap::new();
    let means = numbers(id, mine)?.into_iter().map(|(name, values)| (name, mean(values))).collect();
    gather(id, means, DiagnosticValue::Number, DiagnosticValue::Group, &mut groups)?;
    gather(id, lists(id, mine)?, DiagnosticValue::List, DiagnosticValue::Lists, &mut groups)?;
    Ok(groups)
}

/// The number of this name, `group.kind` for one of a group.
fn number(groups: &BTreeMap<String, DiagnosticValue>, name: &str) -> Option<f64> {
    let (group, kind) = name.split_once('.').unwrap_or((name, ""));
    match groups.get(group)? {
        DiagnosticValue::Number(value) if kind.is_empty() => Some(*value),
        DiagnosticValue::Group(kinds) => kinds.get(kind).copied(),
        _ => None,
    }
}

/// The standard error of each named number that several runs report, grouped as the numbers.
fn standard_errors(
    id: &str,
    mine: &[&MethodRun],
) -> Result<BTreeMap<String, DiagnosticValue>, PositioningError> {
    let error = |(name, values): (_, Vec<f64>)| {
        let count = values.len() as f64;
        let middle = mean(values.iter().copied());
        let squares: f64 = values.iter().map(|value| (value - middle).powi(2)).sum();
        (values.len() > 1).then(|| (name, (squares / (count - 1.0) / count).sqrt()))
    };
    let errors = numbers(id, mine)?.into_iter().filter_map(error).collect();
    let mut groups = BTreeMap::new();
    gather(id, errors, DiagnosticValue::Number, DiagnosticValue::Group, &mut groups)?;
    Ok(groups)
}

/// Adds values under their names, those with a dot as groups of one kind of value.
fn gather<T>(
    id: &str,
    named: BTreeMap<&str, T>,
    alone: fn(T) -> DiagnosticValue,
    together: fn(BTreeMap<String, T>) -> DiagnosticValue,
    groups: &mut BTreeMap<String, DiagnosticValue>,
) -> Result<(), PositioningError> {
    let mut dotted: BTreeMap<&str, BTreeMap<String, T>> = BTreeMap::new();
    let mut taken = None;
    for (name, value) in named {
        match name.split_once('.') {
            Some((group, kind)) => {
                dotted.entry(group).or_default().insert(kind.to_owned(), value);
            }
            None if groups.insert(name.to_owned(), alone(value)).is_some() => taken = Some(name),
            None => {}
        }
    }
    for (group, kinds) in dotted {
        if groups.insert(group.to_owned(), together(kinds)).is_some() {
            taken = Some(group);
        }
    }
    taken.map_or(Ok(()), |name| Err(broken(format!("method `{id}` reports two things as {name}"))))
}

/// The values of each named number, in the order of the runs that report it.
fn numbers<'a>(id: &str, mine: &[&'a MethodRun]) -> Result<BTreeMap<&'a str, Vec<f64>>, PositioningError> {
    let mut named: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
    for diagnostic in mine.iter().flat_map(|method| &method.diagnostics) {
        if !diagnostic.value.is_finite() {
            let problem = format!("method `{id}` reports {} = {}", diagnostic.name, diagnostic.value);
            return Err(broken(problem));
        }
        named.entry(&diagnostic.name).or_default().push(diagnostic.value);
    }
    Ok(named)
}

fn lists<'a>(id: &str, mine: &[&'a MethodRun]) -> Result<BTreeMap<&'a str, Vec<f64>>, PositioningError> {
    let mut sums: BTreeMap<&str, (Vec<f64>, usize)> = BTreeMap::new();
    for list in mine.iter().flat_map(|method| &method.lists) {
        if let Some(value) = list.values.iter().find(|value| !value.is_finite()) {
            return Err(broken(format!("method `{id}` reports {value} in {}", list.name)));
        }
        let (sum, count) = sums.entry(&list.name).or_insert_with(|| (vec![0.0; list.values.len()], 0));
        if sum.len() != list.values.len() {
            return Err(broken(format!("method `{id}` reports {} of different lengths", list.name)));
        }
        sum.iter_mut().zip(&list.values).for_each(|(sum, value)| *sum += value);
        *count += 1;
    }
    let average = |(name, (sum, count)): (_, (Vec<f64>, usize))| {
        (name, sum.iter().map(|value| value / count as f64).collect())
    };
    Ok(sums.into_iter().map(average).collect())
}

fn notes(mine: &[&MethodRun]) -> Vec<String> {
    let mut unique: Vec<String> = Vec::new();
    for note in mine.iter().flat_map(|method| &method.notes) {
        if !unique.contains(note) {
            unique.push(note.clone());
        }
    }
    unique
}

fn broken(problem: String) -> PositioningError {
    PositioningError::Results { problem }
}

fn mean(values: impl IntoIterator<Item = f64>) -> f64 {
    let (sum, count) = values.into_iter().fold((0.0, 0usize), |(sum, count), value| (sum + value, count + 1));
    sum / count as f64
}

fn as_map<S: Serializer>(methods: &[(String, MethodMetrics)], serializer: S) -> Result<S::Ok, S::Error> {
    let mut map = serializer.serialize_map(Some(methods.len()))?;
    for (id, metrics) in methods {
        map.serialize_entry(id, metrics)?;
    }
    map.end()
}

#[cfg(test)]
mod tests;
