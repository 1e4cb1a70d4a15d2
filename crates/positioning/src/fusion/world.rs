//! The world: a target on a circle under white noise, measured by sensors of different quality.
//!
//! x_k = A x_{k-1} + w, A = I + εA₀ + ε²A₀²/2 + ε³A₀³/6 with A₀ = 2 [0 -1; 1 0], w ~ N(0, q I); x_0 ~ N(m, p I). Sensor i,
//! counted from 1, measures z = x + v with v ~ N(0, r √i I). The circle is that of Olfati-Saber, "Distributed Kalman
//! filtering for sensor networks" (2007), whose words the paper follows; the true start is drawn, so that consistency
//! can be judged.

use nalgebra::{Matrix2, Vector2};
use rand::RngExt;
use serde::{Deserialize, Serialize};
use sumprod_graph::{FastStream, MessageError, Purpose, Stream};
use sumprod_messages::Gaussian;

use super::structure::StructureKind;
use crate::error::PositioningError;
use crate::tracking::normal;

/// Streams of the world by entity; those of messages follow.
const TRUTH: u64 = 0;
const MESSAGES: u64 = 1;

/// The `[world]` table.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WorldSettings {
    /// Who talks to whom.
    pub structure: StructureKind,
    /// Number of sensors.
    pub sensors: u32,
    /// Number of steps.
    pub steps: u32,
    /// First step that is scored, counted from 1.
    pub first_scored: u32,
    /// Time of a step ε (s).
    pub interval: f64,
    /// Variance of the process noise along each axis, by step (m²).
    pub process_noise: f64,
    /// Variance of the first sensor along each axis (m²); the i-th has √i times as much.
    pub measurement_variance: f64,
    /// Mean of the start (m).
    pub start: [f64; 2],
    /// Variance of the start along each axis (m²).
    pub start_variance: f64,
    /// Steps from one exchange to the next.
    pub exchange_interval: u32,
    /// Sensors, counted from 0, whose nodes never send.
    #[serde(default)]
    pub silent: Vec<u32>,
    /// Probability that a message is lost.
    #[serde(default)]
    pub message_loss: f64,
}

/// One draw of the world.
#[derive(Clone, Debug)]
pub struct World {
    /// The true state by step, from step 1.
    pub truth: Vec<Vector2<f64>>,
    /// Measurements, sensor by sensor, by step.
    pub measured: Vec<Vec<Vector2<f64>>>,
    seed: u64,
    run: u32,
}

impl WorldSettings {
    /// Checks the values.
    ///
    /// # Errors
    /// [`PositioningError::Setting`] naming the key.
    pub fn validate(&self) -> Result<(), PositioningError> {
        let wrong =
            |key: &str, problem: String| Err(PositioningError::setting(format!("world.{key}"), problem));
        let least = self.structure.least_sensors();
        if self.sensors < least || self.sensors > 1000 {
            return wrong("sensors", format!("is {}; this structure takes {least} to 1000", self.sensors));
        }
        if self.steps == 0 || self.steps > 1_000_000 {
            return wrong("steps", format!("is {}; it must lie between 1 and 1000000", self.steps));
        }
        if self.exchange_interval == 0 || self.exchange_interval > self.steps {
            let (interval, steps) = (self.exchange_interval, self.steps);
            return wrong(
                "exchange_interval",
                format!("is {interval}; it must lie between 1 and the {steps} steps"),
            );
        }
        let last = self.steps - self.steps % self.exchange_interval;
        if self.first_scored == 0 || self.first_scored > last {
            let first = self.first_scored;
            return wrong(
                "first_scored",
                format!("is {first}; it must lie between 1 and the last exchange, {last}"),
            );
        }
        for (key, value) in [
            ("interval", self.interval),
            ("measurement_variance", self.measurement_variance),
            ("start_variance", self.start_variance),
        ] {
            if !(value > 0.0 && value.is_finite()) {
                return wrong(key, format!("is {value}; it must be positive and finite"));
            }
        }
        if !(self.process_noise >= 0.0 && self.process_noise.is_finite()) {
            return wrong(
                "process_noise",
                format!("is {}; a variance must be finite and not negative", self.process_noise),
            );
        }
        if let Some(value) = self.start.iter().find(|value| !value.is_finite()) {
            return wrong("start", format!("holds {value}; a place must be finite"));
        }
        if let Some(sensor) = self.silent.iter().find(|sensor| **sensor >= self.sensors) {
            let last = self.sensors - 1;
            return wrong("silent", format!("names sensor {sensor}; the sensors are 0 to {last}"));
        }
        if !(0.0..1.0).contains(&self.message_loss) {
            let loss = self.message_loss;
            return wrong("message_loss", format!("is {loss}; a probability must be at least 0 and below 1"));
        }
        Ok(())
    }

    /// The motion's matrix A.
    pub fn transition(&self) -> Matrix2<f64> {
        let turn = Matrix2::new(0.0, -2.0, 2.0, 0.0) * self.interval;
        Matrix2::identity() + turn + turn * turn / 2.0 + turn * turn * turn / 6.0
    }

    /// The belief of all nodes at time zero.
    ///
    /// # Errors
    /// Where the variance makes no belief.
    pub(super) fn prior(&self) -> Result<Gaussian<2>, MessageError> {
        Gaussian::from_moments(Vector2::from(self.start), Matrix2::identity() * self.start_variance)
    }

    /// A belief one step later.
    pub(super) fn predicted(&self, belief: &Gaussian<2>) -> Result<Gaussian<2>, MessageError> {
        let (mean, covariance) = belief.moments()?;
        let a = self.transition();
        let spread = a * covariance * a.transpose() + Matrix2::identity() * self.process_noise;
        Gaussian::from_moments(a * mean, spread)
    }

    /// What sensor `sensor` says of the state by measuring `measured`.
    pub(super) fn likelihood(&self, sensor: usize, measured: &Vector2<f64>) -> Gaussian<2> {
        let weight = 1.0 / self.variance(sensor);
        Gaussian::from_information(Matrix2::identity() * weight, measured * weight)
    }

    fn variance(&self, sensor: usize) -> f64 {
        self.measurement_variance * (sensor as f64 + 1.0).sqrt()
    }

    /// One draw of the world.
    pub(super) fn simulate(&self, seed: u64, run: u32) -> World {
        let mut random = Stream::new(seed, u64::from(run), Purpose::World, TRUTH).fast();
        let draw = |variance: f64, random: &mut FastStream| {
            Vector2::new(normal(random), normal(random)) * variance.sqrt()
        };
        let mut state = Vector2::from(self.start) + draw(self.start_variance, &mut random);
        let mut world = World {
            truth: Vec::with_capacity(self.steps as usize),
            measured: vec![Vec::with_capacity(self.steps as usize); self.sensors as usize],
            seed,
            run,
        };
        let a = self.transition();
        for _ in 0..self.steps {
            state = a * state + draw(self.process_noise, &mut random);
            world.truth.push(state);
            for (sensor, measured) in world.measured.iter_mut().enumerate() {
                measured.push(state + draw(self.variance(sensor), &mut random));
            }
        }
        world
    }

    /// Whether what node `from` sends at a step never arrives at `to`: the same for every method.
    pub(super) fn loses(&self, world: &World, step: u32, from: usize, to: usize) -> bool {
        if self.message_loss == 0.0 {
            return false;
        }
        let mut stream = Stream::new(world.seed, u64::from(world.run), Purpose::World, MESSAGES)
            .derive((u64::from(step) << 32) | ((from as u64) << 16) | to as u64);
        stream.random::<f64>() < self.message_loss
    }

    /// Whether nodes talk at a step, counted from 1.
    pub(super) fn exchanges(&self, step: u32) -> bool {
        step.is_multiple_of(self.exchange_interval)
    }

    /// Whether the node of this number never sends; nodes of sensors come first.
    pub(super) fn is_silent(&self, node: usize) -> bool {
        self.silent.iter().any(|&sensor| sensor as usize == node)
    }
}
