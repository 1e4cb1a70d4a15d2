//! The figures of a set of samples, as numbers or, over time, as arrays.

use std::collections::BTreeMap;

use serde::Serialize;

use super::sample::{Dimensions, Sample};
use super::{chi_square, mean};

/// A mean and its standard error.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Statistic<T> {
    /// The value.
    pub mean: T,
    /// Its standard error over runs; absent for a single run.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub se: Option<T>,
}

/// Quantiles of the position error (m).
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Quantiles<T> {
    /// 50 %.
    pub p50: T,
    /// 80 %.
    pub p80: T,
    /// 90 %.
    pub p90: T,
    /// 95 %.
    pub p95: T,
}

/// Normalised estimation error squared of one block of the state.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Nees<T> {
    /// Its mean; `dof` if the method is consistent.
    pub mean: T,
    /// Its median, which a few collapsed estimates do not ruin.
    pub median: T,
    /// Degrees of freedom.
    pub dof: usize,
    /// Band that the mean keeps to with probability 95 % if the method is consistent. Runs alone count as independent,
    /// since errors of successive steps and of cooperating nodes are correlated; absent for a single run.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub band95: Option<[f64; 2]>,
    /// Number of estimates whose covariance is singular on this block and which are left out; absent if none is.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub singular: Option<usize>,
}

/// NEES of the blocks that the state has.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct NeesBlocks<T> {
    /// Of the position.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub position: Option<Nees<T>>,
    /// Of the velocity.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub velocity: Option<Nees<T>>,
    /// Of the clock.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub clock: Option<Nees<T>>,
    /// Of the whole state.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub state: Option<Nees<T>>,
}

/// Figures of a set of samples (`T` is a number), or of each step (`T` is an array).
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary<T> {
    /// Root mean squared position error (m).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub position_rmse_m: Option<Statistic<T>>,
    /// Root mean squared error of a state that has no position and no angle (m).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rmse_m: Option<Statistic<T>>,
    /// Root mean squared velocity error (m/s).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub velocity_rmse_mps: Option<Statistic<T>>,
    /// Root mean squared error of a clock's offset (s).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub clock_offset_rmse_s: Option<Statistic<T>>,
    /// Root mean squared error of a clock's skew (ppm).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub clock_skew_rmse_ppm: Option<Statistic<T>>,
    /// Quantiles of the position error (m).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub error_quantiles_m: Option<Quantiles<T>>,
    /// Consistency.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub nees: Option<NeesBlocks<T>>,
    /// Share of positions inside their 95 % region, or of components inside their 95 % intervals.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub coverage95: Option<T>,
    /// Standard error of that share over runs; absent for a single run.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub coverage95_se: Option<T>,
    /// Mean width of the 95 % intervals (m).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub width95: Option<T>,
}

impl Summary<f64> {
    pub(super) fn new(samples: &[Sample], dimensions: Dimensions) -> Self {
        let blocks = NeesBlocks {
            position: nees(samples, dimensions.position, |sample| sample.position_nees),
            velocity: nees(samples, dimensions.velocity, |sample| sample.velocity_nees),
            clock: nees(samples, dimensions.clock, |sample| sample.clock_nees),
            state: nees(samples, dimensions.state, |sample| sample.state_nees),
        };
        let any = blocks != NeesBlocks::default();
        let scored = dimensions.scored > 0 && !samples.is_empty();
        let widths: Option<Vec<f64>> = samples.iter().map(|sample| sample.width).collect();
        Self {
            position_rmse_m: rmse(samples, |sample| sample.position_squared),
            rmse_m: rmse(samples, |sample| sample.state_squared.filter(|_| dimensions.angular == 0)),
            velocity_rmse_mps: rmse(samples, |sample| sample.velocity_squared),
            clock_offset_rmse_s: rmse(samples, |sample| sample.clock_squared.map(|[offset, _]| offset)),
            clock_skew_rmse_ppm: rmse(samples, |sample| sample.clock_squared.map(|[_, skew]| skew)),
            error_quantiles_m: quantiles(samples),
            nees: any.then_some(blocks),
            coverage95: scored.then(|| mean(samples.iter().map(|sample| sample.covered))),
            coverage95_se: if scored { coverage_error(samples) } else { None },
            width95: widths.filter(|widths| !widths.is_empty()).map(mean),
        }
    }
}

impl Summary<Vec<f64>> {
    /// Turns the summaries of the steps into arrays. A figure that some step lacks is left out.
    pub(super) fn transpose(rows: &[Summary<f64>]) -> Self {
        let statistic = |of: fn(&Summary<f64>) -> Option<&Statistic<f64>>| {
            let mean = column(rows, |row| of(row).map(|statistic| statistic.mean))?;
            Some(Statistic { mean, se: column(rows, |row| of(row).and_then(|statistic| statistic.se)) })
        };
        let quantile =
            |of: fn(&Quantiles<f64>) -> f64| column(rows, |row| row.error_quantiles_m.as_ref().map(of));
        let block = |of: fn(&NeesBlocks<f64>) -> Option<&Nees<f64>>| {
            let first = rows.first()?.nees.as_ref().and_then(of)?;
            let nees = |row: &Summary<f64>, number: fn(&Nees<f64>) -> f64| {
                row.nees.as_ref().and_then(of).map(number)
            };
            Some(Nees {
                mean: column(rows, |row| nees(row, |block| block.mean))?,
                median: column(rows, |row| nees(row, |block| block.median))?,
                dof: first.dof,
                band95: first.band95,
                singular: None,
            })
        };
        let blocks = NeesBlocks {
            position: block(|blocks| blocks.position.as_ref()),
            velocity: block(|blocks| blocks.velocity.as_ref()),
            clock: block(|blocks| blocks.clock.as_ref()),
            state: block(|blocks| blocks.state.as_ref()),
        };
        let any = blocks != NeesBlocks::default();
        let quantiles = || {
            Some(Quantiles {
                p50: quantile(|q| q.p50)?,
                p80: quantile(|q| q.p80)?,
                p90: quantile(|q| q.p90)?,
                p95: quantile(|q| q.p95)?,
            })
        };
        Self {
            position_rmse_m: statistic(|row| row.position_rmse_m.as_ref()),
            rmse_m: statistic(|row| row.rmse_m.as_ref()),
            velocity_rmse_mps: statistic(|row| row.velocity_rmse_mps.as_ref()),
            clock_offset_rmse_s: statistic(|row| row.clock_offset_rmse_s.as_ref()),
            clock_skew_rmse_ppm: statistic(|row| row.clock_skew_rmse_ppm.as_ref()),
            error_quantiles_m: quantiles(),
            nees: any.then_some(blocks),
            coverage95: column(rows, |row| row.coverage95),
            coverage95_se: column(rows, |row| row.coverage95_se),
            width95: column(rows, |row| row.width95),
        }
    }
}

fn column(rows: &[Summary<f64>], of: impl Fn(&Summary<f64>) -> Option<f64>) -> Option<Vec<f64>> {
    rows.iter().map(of).collect()
}

/// r = √m̄ with m̄ the mean over runs of each run's mean square; by the delta method se(r) = se(m̄) / 2r.
pub(super) fn rmse(samples: &[Sample], squared: impl Fn(&Sample) -> Option<f64>) -> Option<Statistic<f64>> {
    let per_run = per_run(samples, squared);
    if per_run.is_empty() {
        return None;
    }
    let squares: Vec<f64> = per_run.into_iter().map(mean).collect();
    let n = squares.len() as f64;
    let square = mean(squares.iter().copied());
    let root = square.sqrt();
    let se = (squares.len() > 1 && root > 0.0).then(|| {
        let variance = squares.iter().map(|value| (value - square).powi(2)).sum::<f64>() / (n - 1.0);
        (variance / n).sqrt() / (2.0 * root)
    });
    Some(Statistic { mean: root, se })
}

/// Standard error over runs of the share of covered errors.
fn coverage_error(samples: &[Sample]) -> Option<f64> {
    let shares: Vec<f64> = per_run(samples, |sample| Some(sample.covered)).into_iter().map(mean).collect();
    let n = shares.len() as f64;
    let share = mean(shares.iter().copied());
    let squares: f64 = shares.iter().map(|value| (value - share).powi(2)).sum();
    (shares.len() > 1).then(|| (squares / (n - 1.0) / n).sqrt())
}

fn per_run(samples: &[Sample], value: impl Fn(&Sample) -> Option<f64>) -> Vec<Vec<f64>> {
    let mut runs: BTreeMap<usize, Vec<f64>> = BTreeMap::new();
    for sample in samples {
        if let Some(value) = value(sample) {
            runs.entry(sample.run).or_default().push(value);
        }
    }
    runs.into_values().collect()
}

/// Median over runs of each run's 90 % position error (m).
pub(super) fn per_run_p90_median(samples: &[Sample]) -> Option<f64> {
    let runs = per_run(samples, |sample| sample.position_squared.map(f64::sqrt));
    let p90 = runs.into_iter().filter_map(|mut errors| quantile(&mut errors, 0.9));
    quantile(&mut p90.collect::<Vec<_>>(), 0.5)
}

fn quantiles(samples: &[Sample]) -> Option<Quantiles<f64>> {
    let mut errors: Vec<f64> =
        samples.iter().filter_map(|sample| sample.position_squared.map(f64::sqrt)).collect();
    Some(Quantiles {
        p50: quantile(&mut errors, 0.5)?,
        p80: quantile(&mut errors, 0.8)?,
        p90: quantile(&mut errors, 0.9)?,
        p95: quantile(&mut errors, 0.95)?,
    })
}

/// Quantile by linear interpolation between order statistics: rank (n − 1)·p.
fn quantile(values: &mut [f64], probability: f64) -> Option<f64> {
    if values.is_empty() {
        return None;
    }
    let rank = (values.len() - 1) as f64 * probability;
    let below = rank.floor() as usize;
    let (_, &mut low, above) = values.select_nth_unstable_by(below, f64::total_cmp);
    let high = above.iter().copied().fold(f64::INFINITY, f64::min);
    let fraction = rank - below as f64;
    Some(if fraction > 0.0 { low + fraction * (high - low) } else { low })
}

fn nees(samples: &[Sample], dof: usize, of: impl Fn(&Sample) -> Option<f64>) -> Option<Nees<f64>> {
    if dof == 0 {
        return None;
    }
    let mut values: Vec<f64> = samples.iter().filter_map(&of).collect();
    let singular = samples.len() - values.len();
    let runs = per_run(samples, &of).len();
    Some(Nees {
        median: quantile(&mut values, 0.5)?,
        mean: mean(values),
        dof,
        band95: if runs > 1 { chi_square::mean_band95(dof, runs) } else { None },
        singular: (singular > 0).then_some(singular),
    })
}
