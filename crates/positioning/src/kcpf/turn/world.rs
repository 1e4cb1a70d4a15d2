//! The trajectory, the radar, and what the methods take for them.

use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};
use sumprod_graph::{FastStream, Purpose, Stream};
use sumprod_models::library::{CoordinatedTurn, distance};
use sumprod_models::{Motion, Noise, NoiseError, Real, Residual};

use super::super::track::Step;
use super::Turn;
use crate::error::PositioningError;

/// The `[world]` table: the truth.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WorldSettings {
    /// Number of steps, each of which is scored.
    pub steps: u32,
    /// Interval between steps (s).
    #[serde(default = "one")]
    pub interval: f64,
    /// True position at time zero (m); the flight begins to the north.
    #[serde(default = "start")]
    pub start: [f64; 2],
    /// Least speed (m/s).
    pub speed: f64,
    /// The speed is the least one plus a uniform share of this (m/s).
    #[serde(default = "one")]
    pub speed_spread: f64,
    /// First step whose motion turns.
    pub turn_first: u32,
    /// Last step whose motion turns.
    pub turn_last: u32,
    /// Acceleration across the track in the turn (m/s²), to the right.
    pub turn_acceleration: f64,
}

/// The `[sensor]` table: the radar at the origin.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SensorSettings {
    /// Variance of a range (m²).
    pub range_variance: f64,
    /// Variance of a bearing (rad²).
    pub bearing_variance: f64,
}

/// The `[model]` table: what every method assumes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModelSettings {
    /// Variance of the acceleration along each axis (m²/s⁴).
    pub acceleration_variance: f64,
    /// Variance of the turn rate's step (rad²/s²).
    pub turn_rate_variance: f64,
    /// Variances of the prior: of each coordinate of the position (m²) and of the velocity (m²/s²), and of the turn
    /// rate (rad²/s²). Its mean is drawn around the true start.
    pub start_variances: [f64; 3],
}

fn one() -> f64 {
    1.0
}

fn start() -> [f64; 2] {
    [-2000.0, 0.0]
}

impl WorldSettings {
    pub(super) fn validate(&self) -> Result<(), PositioningError> {
        if self.steps == 0 {
            return Err(PositioningError::setting("world.steps", "is 0; at least 1 step is needed"));
        }
        positive("world.interval", self.interval, "s")?;
        positive("world.speed", self.speed, "m/s")?;
        if !(self.speed_spread >= 0.0 && self.speed_spread.is_finite()) {
            let problem = format!("is {} m/s; it must be finite and not negative", self.speed_spread);
            return Err(PositioningError::setting("world.speed_spread", problem));
        }
        let others = [("start", self.start[0]), ("start", self.start[1])];
        let turn = [("turn_acceleration", self.turn_acceleration)];
        if let Some((key, value)) = others.into_iter().chain(turn).find(|(_, value)| !value.is_finite()) {
            let problem = format!("is {value}; it must be finite");
            return Err(PositioningError::setting(format!("world.{key}"), problem));
        }
        if self.turn_last < self.turn_first || self.turn_last > self.steps {
            let problem = format!(
                "is {}; the turn must end after its first step {} and by the last step {}",
                self.turn_last, self.turn_first, self.steps
            );
            return Err(PositioningError::setting("world.turn_last", problem));
        }
        Ok(())
    }
}

impl SensorSettings {
    pub(super) fn validate(&self) -> Result<(), PositioningError> {
        positive("sensor.range_variance", self.range_variance, "m²")?;
        positive("sensor.bearing_variance", self.bearing_variance, "rad²")
    }
}

impl ModelSettings {
    pub(super) fn validate(&self) -> Result<(), PositioningError> {
        positive("model.acceleration_variance", self.acceleration_variance, "m²/s⁴")?;
        positive("model.turn_rate_variance", self.turn_rate_variance, "rad²/s²")?;
        (0..3).try_for_each(|k| positive(&format!("model.start_variances[{k}]"), self.start_variances[k], ""))
    }

    fn start_diagonal(&self) -> [f64; 5] {
        let [position, velocity, rate] = self.start_variances;
        [position, velocity, position, velocity, rate]
    }

    pub(super) fn start_covariance(&self) -> Vec<f64> {
        let mut covariance = vec![0.0; 25];
        covariance.iter_mut().step_by(6).zip(self.start_diagonal()).for_each(|(entry, value)| *entry = value);
        covariance
    }
}

fn positive(key: &str, value: f64, unit: &str) -> Result<(), PositioningError> {
    if value > 0.0 && value.is_finite() {
        return Ok(());
    }
    let space = if unit.is_empty() { "" } else { " " };
    Err(PositioningError::setting(key, format!("is {value}{space}{unit}; it must be positive and finite")))
}

/// Range (m) and bearing (rad, anticlockwise from +x) of [x, vx, y, vy, ω] seen from the origin.
#[derive(Clone, Debug)]
pub struct RadarMeasurement {
    measured: [f64; 2],
    noise: Noise,
}

impl RadarMeasurement {
    /// Range and bearing with their variances.
    ///
    /// # Errors
    ///
    /// Where a variance is not positive and finite.
    pub fn new(measured: [f64; 2], variances: [f64; 2]) -> Result<Self, NoiseError> {
        Ok(Self { measured, noise: Noise::diagonal(&variances)? })
    }
}

impl Residual for RadarMeasurement {
    fn dimensions(&self) -> &[usize] {
        &[5]
    }

    fn noise(&self) -> &Noise {
        &self.noise
    }

    fn residual<T: Real>(&self, x: &[&[T]], out: &mut [T]) {
        let (east, north) = (x[0][0], x[0][2]);
        out[0] = distance(east, north) - self.measured[0];
        out[1] = north.atan2(east) - self.measured[1];
    }

    fn angles(&self) -> &[usize] {
        &[1]
    }
}

/// What the streams of a run are drawn for.
const SPEED: u64 = 0;
const RADAR: u64 = 1;
const START: u64 = 2;

type Steps = Vec<Step<CoordinatedTurn, RadarMeasurement>>;

/// The prior's mean, and the steps of one run.
pub(super) fn simulate(scenario: &Turn, seed: u64, run: u32) -> Result<([f64; 5], Steps), PositioningError> {
    let Turn { world, sensor, model, .. } = scenario;
    let wrong = |key: &str, error: String| PositioningError::setting(key, format!("makes no noise: {error}"));
    let stream = |entity| Stream::new(seed, u64::from(run), Purpose::World, entity).fast();
    let motion = CoordinatedTurn::new(world.interval, model.acceleration_variance, model.turn_rate_variance)
        .map_err(|error| wrong("model.acceleration_variance", error.to_string()))?;
    let share: f64 = stream(SPEED).random();
    let speed = world.speed + world.speed_spread * share;
    let mut state = [world.start[0], 0.0, world.start[1], speed, 0.0];
    let mut random = stream(START);
    let mut mean = state;
    for (mean, variance) in mean.iter_mut().zip(model.start_diagonal()) {
        *mean += variance.sqrt() * normal(&mut random);
    }
    let variances = [sensor.range_variance, sensor.bearing_variance];
    let mut random = stream(RADAR);
    let steps = (1..=world.steps).map(|number| {
        let turning = (world.turn_first..=world.turn_last).contains(&number);
        state[4] = if turning { -world.turn_acceleration / speed } else { 0.0 };
        let before = state;
        motion.step(&before, &mut state);
        let measured = [
            state[0].hypot(state[2]) + variances[0].sqrt() * normal(&mut random),
            state[2].atan2(state[0]) + variances[1].sqrt() * normal(&mut random),
        ];
        let measurement = RadarMeasurement::new(measured, variances)
            .map_err(|error| wrong("sensor.range_variance", error.to_string()))?;
        let time = f64::from(number) * world.interval;
        Ok(Step { time, motion: motion.clone(), measurement, truth: state.to_vec() })
    });
    Ok((mean, steps.collect::<Result<_, PositioningError>>()?))
}

fn normal(random: &mut FastStream) -> f64 {
    StandardNormal.sample(random)
}
