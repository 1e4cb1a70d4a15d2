//! What a position does to the links, learnt from the links alone.
//!
//! A column (a direction of a link on a channel) has a mean over the empty room. Its residual, with the walker at
//! excess path length λ, is N(m(λ), v(λ)), m and v by knots, of which a class of columns has one pair each: the columns
//! are classed by fade level, the mean less what the log-distance law says. Between knots the *log likelihood* is
//! interpolated linearly, so that it costs one look-up a link and maximisation keeps its closed form.
//!
//! The columns of a sweep are far from independent: channels and directions of a link see one path, neighbouring links
//! share an end, and what a position does to a link stays as it is while the walker stays. So the log likelihood of a
//! sweep is multiplied by the share of columns that counts as independent: links count as many as the participation
//! ratio (Σ 1)² / Σ c² of their correlations c in the empty room, the columns of a link as one, and sweeps once in the
//! time that residuals stay correlated during the walk.

use std::ops::Range;

use super::area::Area;
use super::grid::Smoothed;
use super::recording::{Pair, Recording, Sweep};
use super::settings::{ModelSettings, WorldSettings};
use crate::error::PositioningError;

/// Excess path lengths (m) at which a profile has its values; constant beyond the last.
pub const KNOTS: [f64; 11] = [0.0, 0.1, 0.25, 0.5, 0.8, 1.2, 1.7, 2.4, 3.4, 5.0, 7.0];

/// Fewest sweeps of the empty room that a mean and a variance are taken from.
const LEAST_EMPTY: usize = 10;
/// Least variance (dB²): strengths are whole decibels.
const LEAST_VARIANCE: f64 = 1.0 / 12.0;
/// Variance (dB²) that a walker on the line adds, and the excess path length (m) over which it falls by e, where
/// maximisation starts.
const FIRST_VARIANCE: f64 = 9.0;
const FIRST_SCALE: f64 = 1.0;
/// Autocorrelations below this are noise.
const LEAST_CORRELATION: f64 = 0.05;

/// Mean and variance of a class's residuals at every knot.
#[derive(Clone, Debug, PartialEq)]
pub struct Profile {
    /// Mean (dB).
    pub shift: [f64; KNOTS.len()],
    /// Variance (dB²).
    pub variance: [f64; KNOTS.len()],
}

/// What is learnt of a recording.
pub struct Calibration {
    nodes: Vec<[f64; 2]>,
    pairs: Vec<Pair>,
    lengths: Vec<f64>,
    /// Mean of each column over the empty room (dBm); NaN where nothing was heard.
    means: Vec<f64>,
    classes: Vec<usize>,
    profiles: Vec<Profile>,
    independent_share: f64,
    walk: Range<usize>,
}

/// Log likelihoods of one sweep at the knots of each pair.
pub struct SweepLogs(Vec<[f64; KNOTS.len()]>);

impl Calibration {
    /// Learns from the empty room, and from the walk without its path. O(rounds · sweeps · cells · pairs).
    ///
    /// # Errors
    /// [`PositioningError::Setting`] where the recording is not empty for long enough, or no longer than that.
    pub fn learn(
        recording: &Recording,
        area: &Area,
        world: &WorldSettings,
        model: &ModelSettings,
    ) -> Result<Self, PositioningError> {
        let sweeps = &recording.sweeps;
        let empty = sweeps.iter().take_while(|sweep| sweep.time < world.empty_until).count();
        if empty < LEAST_EMPTY || empty == sweeps.len() {
            let (at, count) = (world.empty_until, sweeps.len());
            let problem = format!(
                "is {at} s, before which there are {empty} of the recording's {count} sweeps; the empty room needs at least {LEAST_EMPTY}, and the walk some"
            );
            return Err(PositioningError::setting("world.empty_until", problem));
        }
        let pairs = recording.pairs();
        let lengths =
            pairs.iter().map(|pair| distance(recording.nodes[pair.ends[0]], recording.nodes[pair.ends[1]]));
        let lengths: Vec<f64> = lengths.collect();
        let (means, variances): (Vec<f64>, Vec<f64>) =
            (0..recording.columns()).map(|column| moments(&sweeps[..empty], column)).unzip();
        let classes = fade_classes(&means, &pairs, &lengths, model.fade_classes);
        let profiles = first_profiles(&classes, &variances, model.fade_classes);
        let walk = empty..sweeps.len();
        let share = model.independent_share.unwrap_or_else(|| {
            let used = means.iter().filter(|mean| mean.is_finite()).count().max(1) as f64;
            let standard = Standard { means: &means, variances: &variances };
            let links = standard.independent_links(&sweeps[..empty], &pairs);
            (links / used / correlation_time(&sweeps[walk.clone()], means.len())).min(1.0)
        });
        let mut calibration = Self {
            nodes: recording.nodes.clone(),
            pairs,
            lengths,
            means,
            classes,
            profiles,
            independent_share: share,
            walk,
        };
        for _ in 0..model.rounds {
            calibration.maximise(recording, area, model);
        }
        Ok(calibration)
    }

    /// Share of the columns of a sweep that counts as independent.
    pub fn independent_share(&self) -> f64 {
        self.independent_share
    }

    /// The profiles, by class of rising fade level.
    pub fn profiles(&self) -> &[Profile] {
        &self.profiles
    }

    /// The sweeps in which there is a walker.
    pub fn walk(&self) -> Range<usize> {
        self.walk.clone()
    }

    /// Log likelihoods of a sweep at the knots, tempered.
    pub fn sweep(&self, sweep: &Sweep) -> SweepLogs {
        let logs = self.pairs.iter().map(|pair| {
            let mut logs = [0.0; KNOTS.len()];
            for &column in &pair.columns {
                let residual = sweep.strengths[column] - self.means[column];
                if residual.is_nan() {
                    continue;
                }
                let profile = &self.profiles[self.classes[column]];
                for (log, (shift, variance)) in
                    logs.iter_mut().zip(profile.shift.iter().zip(&profile.variance))
                {
                    *log -= 0.5 * ((residual - shift).powi(2) / variance + variance.ln());
                }
            }
            logs.map(|log| self.independent_share * log)
        });
        SweepLogs(logs.collect())
    }

    /// Log likelihood of a position (m). O(nodes + pairs).
    pub fn log_likelihood(&self, logs: &SweepLogs, point: &[f64]) -> f64 {
        let mut sum = 0.0;
        self.each_place(point, |pair, Place { knot, share }| {
            let logs = &logs.0[pair];
            sum += logs[knot] + share * (logs[knot + 1] - logs[knot]);
        });
        sum
    }

    /// Calls `with` for every pair with the place of its excess path length between the knots.
    fn each_place(&self, point: &[f64], mut with: impl FnMut(usize, Place)) {
        let far: Vec<f64> = self.nodes.iter().map(|node| distance(*node, [point[0], point[1]])).collect();
        for (index, (pair, length)) in self.pairs.iter().zip(&self.lengths).enumerate() {
            with(index, Place::of(far[pair.ends[0]] + far[pair.ends[1]] - length));
        }
    }

    /// One round: the posterior of each position under the present profiles, then the profiles of largest expected
    /// log likelihood.
    fn maximise(&mut self, recording: &Recording, area: &Area, model: &ModelSettings) {
        let sweeps = &recording.sweeps[self.walk.clone()];
        let smoothed = Smoothed::of(self, area, sweeps, model.wander_variance);
        let places: Vec<Vec<Place>> = (0..area.len())
            .map(|cell| {
                let mut places = Vec::with_capacity(self.pairs.len());
                self.each_place(&area.middle(cell), |_, place| places.push(place));
                places
            })
            .collect();
        let mut sums = vec![[[0.0; 3]; KNOTS.len()]; self.profiles.len()];
        for (sweep, density) in sweeps.iter().zip(smoothed.densities()) {
            let mut masses = vec![[0.0; KNOTS.len()]; self.pairs.len()];
            for (mass, places) in density.iter().zip(&places).filter(|(mass, _)| **mass > 1e-12) {
                for (masses, place) in masses.iter_mut().zip(places) {
                    masses[place.knot] += mass * (1.0 - place.share);
                    masses[place.knot + 1] += mass * place.share;
                }
            }
            for (pair, masses) in self.pairs.iter().zip(&masses) {
                for &column in &pair.columns {
                    let residual = sweep.strengths[column] - self.means[column];
                    if residual.is_nan() {
                        continue;
                    }
                    for (sums, mass) in sums[self.classes[column]].iter_mut().zip(masses) {
                        sums[0] += mass;
                        sums[1] += mass * residual;
                        sums[2] += mass * residual * residual;
                    }
                }
            }
        }
        for (profile, sums) in self.profiles.iter_mut().zip(&sums) {
            for (knot, [mass, first, second]) in sums.iter().enumerate().filter(|(_, sums)| sums[0] > 1.0) {
                let shift = first / mass;
                profile.shift[knot] = shift;
                profile.variance[knot] = (second / mass - shift * shift).max(LEAST_VARIANCE);
            }
        }
    }
}

/// Where an excess path length lies: a share of the way from a knot to the next.
#[derive(Clone, Copy)]
struct Place {
    knot: usize,
    share: f64,
}

impl Place {
    fn of(excess: f64) -> Self {
        let knot = KNOTS[1..KNOTS.len() - 1].iter().take_while(|knot| **knot <= excess).count();
        let share = (excess - KNOTS[knot]) / (KNOTS[knot + 1] - KNOTS[knot]);
        Self { knot, share: share.clamp(0.0, 1.0) }
    }
}

fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// Mean and variance of a column where packets were heard.
fn moments(sweeps: &[Sweep], column: usize) -> (f64, f64) {
    let heard = || sweeps.iter().map(|sweep| sweep.strengths[column]).filter(|value| value.is_finite());
    let count = heard().count() as f64;
    let mean = heard().sum::<f64>() / count;
    (mean, heard().map(|value| (value - mean).powi(2)).sum::<f64>() / count)
}

/// Classes of equal count by fade level: the mean less a + b log₁₀ d fitted to all columns.
fn fade_classes(means: &[f64], pairs: &[Pair], lengths: &[f64], classes: usize) -> Vec<usize> {
    let mut regressors = vec![0.0; means.len()];
    for (pair, length) in pairs.iter().zip(lengths) {
        pair.columns.iter().for_each(|&column| regressors[column] = length.max(1e-3).log10());
    }
    let heard: Vec<usize> = (0..means.len()).filter(|&column| means[column].is_finite()).collect();
    let average = |values: &[f64]| heard.iter().map(|&c| values[c]).sum::<f64>() / heard.len().max(1) as f64;
    let (x, y) = (average(&regressors), average(means));
    let (mut xx, mut xy) = (0.0, 0.0);
    for &column in &heard {
        xx += (regressors[column] - x).powi(2);
        xy += (regressors[column] - x) * (means[column] - y);
    }
    let slope = if xx > 0.0 { xy / xx } else { 0.0 };
    let fade = |column: usize| means[column] - y - slope * (regressors[column] - x);
    let mut order = heard;
    order.sort_by(|&a, &b| fade(a).total_cmp(&fade(b)));
    let mut class = vec![0; means.len()];
    for (rank, column) in order.iter().enumerate() {
        class[*column] = rank * classes / order.len();
    }
    class
}

/// The empty room's variance and a walker's, in every class.
fn first_profiles(classes: &[usize], variances: &[f64], count: usize) -> Vec<Profile> {
    (0..count)
        .map(|class| {
            let members = classes.iter().zip(variances).filter(|(c, v)| **c == class && v.is_finite());
            let (sum, count) = members.fold((0.0, 0.0), |(sum, count), (_, v)| (sum + v, count + 1.0));
            let still = if count > 0.0 { (sum / count).max(LEAST_VARIANCE) } else { 1.0 };
            let variance = KNOTS.map(|excess| still + FIRST_VARIANCE * (-excess / FIRST_SCALE).exp());
            Profile { shift: [0.0; KNOTS.len()], variance }
        })
        .collect()
}

/// Residuals of the empty room in their deviations.
struct Standard<'a> {
    means: &'a [f64],
    variances: &'a [f64],
}

impl Standard<'_> {
    /// How many links count as independent: n² / Σ c² over the correlations c of the n links' mean residuals, less
    /// what T sweeps of independent links would leave in the sum, n (n - 1) / T.
    fn independent_links(&self, sweeps: &[Sweep], pairs: &[Pair]) -> f64 {
        let series: Vec<Vec<f64>> = pairs
            .iter()
            .filter_map(|pair| standardised(sweeps.iter().map(|sweep| self.mean_residual(sweep, pair))))
            .collect();
        let (n, t) = (series.len() as f64, sweeps.len() as f64);
        let mut squares = 0.0;
        for a in &series {
            for b in &series {
                let correlation = a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>() / t;
                squares += correlation * correlation;
            }
        }
        let squares = squares - n * (n - 1.0) / t;
        if squares > 0.0 { (n * n / squares).clamp(1.0, n.max(1.0)) } else { n.max(1.0) }
    }

    fn mean_residual(&self, sweep: &Sweep, pair: &Pair) -> f64 {
        let (mut sum, mut count) = (0.0, 0.0);
        for &column in &pair.columns {
            let residual = (sweep.strengths[column] - self.means[column]) / self.variances[column].sqrt();
            if residual.is_finite() {
                sum += residual;
                count += 1.0;
            }
        }
        if count > 0.0 { sum / count } else { 0.0 }
    }
}

/// A series less its mean in its deviations; none where it does not vary.
fn standardised(series: impl Iterator<Item = f64>) -> Option<Vec<f64>> {
    let mut series: Vec<f64> = series.collect();
    let count = series.len() as f64;
    let mean = series.iter().sum::<f64>() / count;
    let deviation = (series.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / count).sqrt();
    if deviation.is_nan() || deviation <= 1e-9 {
        return None;
    }
    series.iter_mut().for_each(|x| *x = (*x - mean) / deviation);
    Some(series)
}

/// Sweeps that a residual stays correlated for: 1 + 2 Σ r(lag) up to the first lag at which the columns' mean
/// autocorrelation r is noise.
fn correlation_time(sweeps: &[Sweep], columns: usize) -> f64 {
    let series: Vec<Vec<f64>> = (0..columns)
        .filter_map(|column| {
            let (mean, variance) = moments(sweeps, column);
            let deviation = variance.sqrt();
            (deviation > 1e-9)
                .then(|| sweeps.iter().map(|sweep| (sweep.strengths[column] - mean) / deviation).collect())
        })
        .collect();
    let mut time = 1.0;
    for lag in 1..sweeps.len() {
        let (mut sum, mut count) = (0.0, 0.0);
        for series in &series {
            for product in series.iter().zip(&series[lag..]).map(|(a, b)| a * b).filter(|x| x.is_finite()) {
                sum += product;
                count += 1.0;
            }
        }
        let correlation = sum / count;
        if correlation.is_nan() || correlation < LEAST_CORRELATION {
            break;
        }
        time += 2.0 * correlation;
    }
    time
}
