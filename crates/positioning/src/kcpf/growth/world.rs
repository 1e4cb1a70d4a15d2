//! The model and its draws.

use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};
use sumprod_graph::{MessageError, Purpose, Stream};
use sumprod_models::{Motion, Noise, NoiseError, ProcessNoise, Real, Residual};

use super::super::track::Step;
use crate::error::PositioningError;

/// The `[world]` table.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WorldSettings {
    /// Number K of steps, each of which is scored.
    pub steps: u32,
    /// Variance Q of the process noise.
    #[serde(default = "ten")]
    pub process_variance: f64,
    /// Variance R of the measurement.
    #[serde(default = "one")]
    pub measurement_variance: f64,
    /// Variance P of the state at step 0.
    #[serde(default = "five")]
    pub start_variance: f64,
}

fn ten() -> f64 {
    10.0
}

fn one() -> f64 {
    1.0
}

fn five() -> f64 {
    5.0
}

impl WorldSettings {
    /// Checks the values.
    ///
    /// # Errors
    /// [`PositioningError::Setting`] naming the key.
    pub fn validate(&self) -> Result<(), PositioningError> {
        if self.steps == 0 {
            return Err(PositioningError::setting("world.steps", "is 0; at least 1 step is needed"));
        }
        for (key, value) in [
            ("process_variance", self.process_variance),
            ("measurement_variance", self.measurement_variance),
            ("start_variance", self.start_variance),
        ] {
            if !(value > 0.0 && value.is_finite()) {
                let problem = format!("is {value}; a variance must be positive and finite");
                return Err(PositioningError::setting(format!("world.{key}"), problem));
            }
        }
        Ok(())
    }

    /// One draw of the world.
    ///
    /// # Errors
    /// [`PositioningError::Setting`] where a variance makes no noise.
    pub(in crate::kcpf) fn simulate(
        &self,
        seed: u64,
        run: u32,
    ) -> Result<Vec<Step<GrowthMotion, GrowthMeasurement>>, PositioningError> {
        let wrong = |key, error: String| PositioningError::setting(key, format!("makes no noise: {error}"));
        let mut random = Stream::new(seed, u64::from(run), Purpose::World, 0).fast();
        let mut normal = |variance: f64| -> f64 {
            let draw: f64 = StandardNormal.sample(&mut random);
            variance.sqrt() * draw
        };
        let mut state = [normal(self.start_variance)];
        (1..=self.steps)
            .map(|number| {
                let motion = GrowthMotion::new(number, self.process_variance)
                    .map_err(|error| wrong("world.process_variance", error.to_string()))?;
                let mut next = [0.0];
                motion.step(&state, &mut next);
                state = [next[0] + normal(self.process_variance)];
                let measured = square_law(state[0]) + normal(self.measurement_variance);
                let measurement = GrowthMeasurement::new(measured, self.measurement_variance)
                    .map_err(|error| wrong("world.measurement_variance", error.to_string()))?;
                Ok(Step { time: f64::from(number), motion, measurement, truth: state.to_vec() })
            })
            .collect()
    }
}

/// x' = x/2 + 25 x / (1 + x²) + 8 cos(1.2 (k - 1)) + v.
#[derive(Clone, Debug)]
pub struct GrowthMotion {
    drive: f64,
    noise: ProcessNoise,
}

impl GrowthMotion {
    /// The motion to step `number`, counted from 1.
    ///
    /// # Errors
    ///
    /// Where the variance is negative or not finite.
    pub fn new(number: u32, variance: f64) -> Result<Self, MessageError> {
        let drive = 8.0 * (1.2 * (f64::from(number) - 1.0)).cos();
        Ok(Self { drive, noise: ProcessNoise::diagonal(&[variance])? })
    }
}

impl Motion for GrowthMotion {
    fn dimension(&self) -> usize {
        1
    }

    fn step<T: Real>(&self, state: &[T], next: &mut [T]) {
        let x = state[0];
        next[0] = x * 0.5 + x * 25.0 / (x * x + 1.0) + self.drive;
    }

    fn noise(&self, _state: &[f64]) -> ProcessNoise {
        self.noise.clone()
    }
}

/// z = x² / 20 + w.
#[derive(Clone, Debug)]
pub struct GrowthMeasurement {
    measured: f64,
    noise: Noise,
}

impl GrowthMeasurement {
    /// A measurement and its variance.
    ///
    /// # Errors
    ///
    /// Where the variance is not positive and finite.
    pub fn new(measured: f64, variance: f64) -> Result<Self, NoiseError> {
        Ok(Self { measured, noise: Noise::isotropic(1, variance)? })
    }
}

fn square_law<T: Real>(x: T) -> T {
    x * x / 20.0
}

impl Residual for GrowthMeasurement {
    fn dimensions(&self) -> &[usize] {
        &[1]
    }

    fn noise(&self) -> &Noise {
        &self.noise
    }

    fn residual<T: Real>(&self, x: &[&[T]], out: &mut [T]) {
        out[0] = square_law(x[0][0]) - self.measured;
    }
}
