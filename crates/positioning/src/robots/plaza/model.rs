//! The chain of a Plaza recording: one state at each row of odometry.
//!
//! The state is [x, y, θ, b, a, c]: position (m), heading (rad), gyro bias (rad/s), and the scale error and offset
//! (m) of the ranges, which all beacons share. Without calibration it is [x, y, θ], and the other three are zero.
//! The heading counts its turns: it never jumps along a chain, so that its coordinate is a real one.

use serde::{Deserialize, Serialize};
use sumprod_filters::{Correct, FilterError, RaoBlackwellised};
use sumprod_graph::Space;
use sumprod_messages::Moments;
use sumprod_models::library::distance;
use sumprod_models::{Block, Cluster, Motion, Noise, ProcessNoise, Real, Residual};

use super::recording::{OdometryRow, Recording};
use crate::PositioningError;
use crate::robots::chain::Chain;
use crate::robots::particles::Parts;

/// Ranges this little after a slice still belong to it (s): files round their times.
const ROUNDING: f64 = 1e-6;

/// Variances of the state that the first true pose starts.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Start {
    /// Of the position along each axis (m²).
    pub position_variance: f64,
    /// Of the heading (rad²).
    pub heading_variance: f64,
    /// Covariance of the pose [x, y, heading] (m, m, rad), where it is more than these variances.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pose_covariance: Option<[[f64; 3]; 3]>,
    /// Of the gyro bias (rad²/s²).
    pub gyro_bias_variance: f64,
    /// Of the scale error of the ranges.
    pub range_scale_variance: f64,
    /// Of the offset of the ranges (m²).
    pub range_offset_variance: f64,
}

/// Variances by which the state wanders.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Drift {
    /// Across the track (m² a metre driven).
    pub across_variance: f64,
    /// Along the track (m² a metre driven).
    pub along_variance: f64,
    /// Of the position along each axis (m²/s).
    pub position_variance: f64,
    /// Of the heading (rad²/s).
    pub heading_variance: f64,
    /// Of the gyro bias (rad²/s³).
    pub gyro_bias_variance: f64,
    /// Of the scale error of the ranges (1/s).
    pub range_scale_variance: f64,
    /// Of the offset of the ranges (m²/s).
    pub range_offset_variance: f64,
}

/// The noise of the ranges.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sensor {
    /// Variance, or squared scale of a Student-t distribution (m²).
    pub range_variance: f64,
    /// Degrees of freedom of a Student-t distribution; Gaussian if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub degrees_of_freedom: Option<f64>,
}

impl Sensor {
    /// The noise of a range.
    ///
    /// # Errors
    /// [`PositioningError::Setting`] where a number is out of range.
    pub fn noise(&self) -> Result<Noise, PositioningError> {
        let noise = Noise::isotropic(1, self.range_variance).map_err(|error| {
            PositioningError::setting("sensor.range_variance", format!("is unusable: {error}"))
        })?;
        match self.degrees_of_freedom {
            None => Ok(noise),
            Some(nu) => noise.student_t(nu).map_err(|error| {
                PositioningError::setting("sensor.degrees_of_freedom", format!("is unusable: {error}"))
            }),
        }
    }
}

/// What was driven from one slice to the next.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Leg {
    /// Distance (m).
    pub distance: f64,
    /// Change of the heading by the gyro (rad).
    pub turn: f64,
    /// Duration (s).
    pub duration: f64,
}

impl Leg {
    /// The first `fraction` of the leg.
    pub fn part(&self, fraction: f64) -> Self {
        Self {
            distance: fraction * self.distance,
            turn: fraction * self.turn,
            duration: fraction * self.duration,
        }
    }
}

/// Odometry with a gyro bias: with φ = Δθ - b Δt and u = θ + φ/2, x' = x + d cos u, y' = y + d sin u, θ' = θ + φ.
#[derive(Clone, Copy, Debug)]
pub struct BiasedOdometry {
    leg: Leg,
    drift: Drift,
    calibrated: bool,
}

impl BiasedOdometry {
    /// The motion along a leg, of the six coordinates or, without calibration, of the pose alone.
    pub fn new(leg: Leg, drift: Drift, calibrated: bool) -> Self {
        Self { leg, drift, calibrated }
    }

    fn turn<T: Real>(&self, state: &[T]) -> T {
        turn(&self.leg, bias(self.calibrated, state))
    }
}

fn turn<T: Real>(leg: &Leg, bias: T) -> T {
    -bias * leg.duration + leg.turn
}

fn bias<T: Real>(calibrated: bool, state: &[T]) -> T {
    if calibrated { state[3] } else { T::zero() }
}

fn dimension(calibrated: bool) -> usize {
    if calibrated { 6 } else { 3 }
}

impl Motion for BiasedOdometry {
    fn dimension(&self) -> usize {
        dimension(self.calibrated)
    }

    fn step<T: Real>(&self, state: &[T], next: &mut [T]) {
        let turn = self.turn(state);
        let course = state[2] + turn * 0.5;
        next.copy_from_slice(state);
        next[0] = state[0] + course.cos() * self.leg.distance;
        next[1] = state[1] + course.sin() * self.leg.distance;
        next[2] = state[2] + turn;
    }

    fn noise(&self, state: &[f64]) -> ProcessNoise {
        let Drift { across_variance, along_variance, position_variance, .. } = self.drift;
        let (metres, seconds) = (self.leg.distance.abs(), self.leg.duration);
        let (sine, cosine) = (state[2] + 0.5 * self.turn(state)).sin_cos();
        let along = (along_variance * metres + position_variance * seconds).sqrt();
        let across = (across_variance * metres + position_variance * seconds).sqrt();
        let d = self.dimension();
        let mut factor = vec![0.0; d * d];
        (factor[0], factor[1]) = (cosine * along, -sine * across);
        (factor[d], factor[d + 1]) = (sine * along, cosine * across);
        let wander = [
            self.drift.heading_variance,
            self.drift.gyro_bias_variance,
            self.drift.range_scale_variance,
            self.drift.range_offset_variance,
        ];
        for (index, variance) in (2..d).zip(wander) {
            factor[index * d + index] = (variance * seconds).sqrt();
        }
        ProcessNoise::from_factor(d, &factor)
    }
}

/// A range taken a fraction f of the last leg before the slice: r = (1 + a) |p - f d e(u) - q| + c - z, with q the
/// beacon and u = θ - f φ / 2 the chord's course.
#[derive(Clone, Debug)]
pub struct BackedRange {
    measured: f64,
    beacon: [f64; 2],
    /// What was driven from the measurement to the slice.
    since: Leg,
    calibrated: bool,
    dimensions: [usize; 1],
    noise: Noise,
}

impl BackedRange {
    /// A range (m) to a beacon (m), since which `since` was driven up to the slice.
    pub fn new(measured: f64, beacon: [f64; 2], since: Leg, calibrated: bool, noise: Noise) -> Self {
        Self { measured, beacon, since, calibrated, dimensions: [dimension(calibrated)], noise }
    }
}

impl Residual for BackedRange {
    fn dimensions(&self) -> &[usize] {
        &self.dimensions
    }

    fn noise(&self) -> &Noise {
        &self.noise
    }

    fn residual<T: Real>(&self, x: &[&[T]], out: &mut [T]) {
        let state = x[0];
        let course = state[2] - turn(&self.since, bias(self.calibrated, state)) * 0.5;
        let east = state[0] - course.cos() * self.since.distance - self.beacon[0];
        let north = state[1] - course.sin() * self.since.distance - self.beacon[1];
        let range = distance(east, north);
        let read = if self.calibrated { range * (state[4] + 1.0) + state[5] } else { range };
        out[0] = read - self.measured;
    }
}

/// The chain of one recording.
#[derive(Clone, Debug)]
pub struct PlazaChain<'a> {
    recording: &'a Recording,
    times: Vec<f64>,
    start: Moments,
    drift: Drift,
    noise: Noise,
    calibrated: bool,
    /// Ranges of each slice, as indices; empty without ranges.
    ranges: Vec<std::ops::Range<usize>>,
}

impl<'a> PlazaChain<'a> {
    /// The chain with slice 0 at the first true pose and one at each row of odometry; a range goes to the first
    /// slice at or after it, so that no slice hears from its future.
    ///
    /// # Errors
    /// [`PositioningError::Setting`] for a noise that is none.
    pub fn new(
        recording: &'a Recording,
        start: &Start,
        drift: Drift,
        sensor: &Sensor,
        calibrated: bool,
        with_ranges: bool,
    ) -> Result<Self, PositioningError> {
        let noise = sensor.noise()?;
        let first = &recording.truth[0];
        let times: Vec<f64> =
            std::iter::once(first.time).chain(recording.odometry.iter().map(|row| row.time)).collect();
        let first_after = |time: f64| recording.ranges.partition_point(|range| range.time <= time + ROUNDING);
        let slice = |k: usize| if k == 0 { 0..0 } else { first_after(times[k - 1])..first_after(times[k]) };
        let ranges = if with_ranges { (0..times.len()).map(slice).collect() } else { Vec::new() };
        Ok(Self {
            recording,
            start: prior(first.pose, start, calibrated),
            times,
            drift,
            noise,
            calibrated,
            ranges,
        })
    }

    /// What was driven to a slice (from 1).
    pub fn leg(&self, slice: usize) -> Leg {
        let OdometryRow { distance, turn, .. } = self.recording.odometry[slice - 1];
        Leg { distance, turn, duration: self.times[slice] - self.times[slice - 1] }
    }

    /// The ranges of a slice (from 1).
    fn ranges_of(&self, slice: usize) -> impl Iterator<Item = BackedRange> + '_ {
        let rows = self.ranges.get(slice).cloned().unwrap_or_default();
        self.recording.ranges[rows].iter().map(move |row| {
            let leg = self.leg(slice);
            let fraction = ((self.times[slice] - row.time) / leg.duration).clamp(0.0, 1.0);
            let beacon = self.recording.beacons[row.beacon].position;
            BackedRange::new(row.range, beacon, leg.part(fraction), self.calibrated, self.noise.clone())
        })
    }

    /// The motion along a part of a leg.
    pub fn along(&self, leg: Leg) -> BiasedOdometry {
        BiasedOdometry::new(leg, self.drift, self.calibrated)
    }
}

fn prior(pose: [f64; 3], start: &Start, calibrated: bool) -> Moments {
    let d = dimension(calibrated);
    let variances = [
        start.position_variance,
        start.position_variance,
        start.heading_variance,
        start.gyro_bias_variance,
        start.range_scale_variance,
        start.range_offset_variance,
    ];
    let mut moments = Moments { mean: vec![0.0; d], covariance: vec![0.0; d * d] };
    moments.mean[..3].copy_from_slice(&pose);
    for (k, variance) in (0..d).zip(variances) {
        moments.covariance[k * d + k] = variance;
    }
    for (row, entries) in start.pose_covariance.iter().flatten().enumerate() {
        moments.covariance[row * d..][..3].copy_from_slice(entries);
    }
    moments
}

impl Chain for PlazaChain<'_> {
    type Motion = BiasedOdometry;

    fn space(&self) -> Space {
        Space::real(dimension(self.calibrated))
    }

    fn times(&self) -> &[f64] {
        &self.times
    }

    fn start(&self) -> &Moments {
        &self.start
    }

    fn motion(&self, slice: usize) -> BiasedOdometry {
        self.along(self.leg(slice))
    }

    fn evidence(&self, slice: usize) -> Result<Cluster, PositioningError> {
        let d = dimension(self.calibrated);
        let mut cluster = Cluster::new(d);
        for range in self.ranges_of(slice) {
            cluster
                .add(range, &[Block::new(0, d)])
                .map_err(|error| PositioningError::setting("sensor", format!("cannot be used: {error}")))?;
        }
        Ok(cluster)
    }

    fn evidence_kind(&self) -> &'static str {
        "range"
    }
}

impl Parts for PlazaChain<'_> {
    type PartMotion = BiasedOdometry;

    fn parts(&self) -> Vec<Block> {
        vec![Block::new(0, dimension(self.calibrated))]
    }

    fn part_motion(&self, _part: usize, slice: usize) -> BiasedOdometry {
        self.motion(slice)
    }

    fn absorb(&self, _part: usize, slice: usize, filter: &mut RaoBlackwellised) -> Result<(), FilterError> {
        self.ranges_of(slice).try_for_each(|range| filter.correct(&range).map(drop))
    }
}
