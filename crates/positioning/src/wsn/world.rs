//! The simulated world: one target at constant velocity, range sensors, and a sink that gathers what they measure.
//!
//! z_j = |p - s_j| + v_j, v ~ N(0, R), by every sensor that works, hears the target, and whose message arrives.
//!
//! The paper's model (section 4.1) has one sensor at the origin and prints its equation (11) with the noise under the
//! root, which would be an error of millimetres; it gives a product over M sensors and no places. Here M = 1 is the
//! origin, and a square number of sensors a square grid over [0, side]².
//!
//! With `start = "fixed"` the truth starts where the paper has it, at a point of the prior that is fixed; calibration
//! can be judged with `"bayes"` alone, where it is drawn from the prior.

use rand::RngExt;
use serde::{Deserialize, Serialize};
use sumprod_graph::{Purpose, Stream};

use crate::error::PositioningError;
use crate::tracking::{normal, trajectory};

/// Where the truth starts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Start {
    /// At `truth`, in every run.
    #[default]
    Fixed,
    /// At a draw from the prior.
    Bayes,
}

/// Where the sensors stand.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Layout {
    /// On a square grid over [0, side]², the corners included; a single one at the origin.
    #[default]
    Grid,
    /// Uniformly on [0, side]², anew in every run.
    Scattered,
}

/// The `[world]` table.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WorldSettings {
    /// Number K of scans, each of which is scored.
    pub steps: u32,
    /// Interval T between scans (s).
    pub interval: f64,
    /// Variance Q of the acceleration along each axis (m²/s⁴).
    pub process_variance: f64,
    /// Variance R of a measured range (m²).
    pub measurement_variance: f64,
    /// Number M of sensors.
    pub sensors: u32,
    /// Where they stand.
    pub layout: Layout,
    /// Side of the square on which they stand (m).
    pub side: f64,
    /// Where the truth starts.
    pub start: Start,
    /// True state at time zero where the start is fixed: x, vx, y, vy (m, m/s).
    pub truth: [f64; 4],
    /// Mean of the state at time zero that every method starts from.
    pub prior_mean: [f64; 4],
    /// Variances of its components (m², m²/s²).
    pub prior_variance: [f64; 4],
    /// Distance up to which a sensor hears the target (m); unlimited where absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reach: Option<f64>,
    /// Probability that a measurement is lost on its way to the sink.
    pub loss: f64,
    /// Probability that a working sensor fails for good, at each scan.
    pub failure: f64,
    /// First and last scan (from 1) at which nothing reaches the sink.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub outage: Option<[u32; 2]>,
    /// Where measurements are gathered (m).
    pub sink: [f64; 2],
    /// Distance that one radio transmission covers (m): a message takes as many as its way to the sink has hops.
    pub hop: f64,
    /// Deviation of each component of the velocity of a target that is found again after it was lost (m/s).
    pub acquisition_speed: f64,
}

/// Largest magnitude of a number of the world: squares of what comes of it stay numbers.
const LARGEST: f64 = 1e12;

/// Most readings that a run may hold.
const MOST_READINGS: u64 = 10_000_000;

impl Default for WorldSettings {
    /// The paper's, with four sensors at the corners.
    fn default() -> Self {
        Self {
            steps: 30,
            interval: 1.0,
            process_variance: 0.01,
            measurement_variance: 0.36,
            sensors: 4,
            layout: Layout::Grid,
            side: 500.0,
            start: Start::Fixed,
            truth: [80.0, 8.0, 20.0, 9.0],
            prior_mean: [81.0, 8.66, 19.8, 8.9],
            prior_variance: [1.5, 1.5, 0.9, 0.03],
            reach: None,
            loss: 0.0,
            failure: 0.0,
            outage: None,
            sink: [250.0, 250.0],
            hop: 150.0,
            acquisition_speed: 15.0,
        }
    }
}

impl WorldSettings {
    /// Whether nothing reaches the sink at a scan.
    fn is_out(&self, scan: u32) -> bool {
        self.outage.is_some_and(|[first, last]| (first..=last).contains(&scan))
    }

    /// Checks the values.
    ///
    /// # Errors
    /// [`PositioningError::Setting`] naming the key.
    pub fn validate(&self) -> Result<(), PositioningError> {
        let wrong =
            |key: String, problem: String| Err(PositioningError::setting(format!("world.{key}"), problem));
        if self.steps == 0 {
            return wrong("steps".into(), "is 0; at least 1 step is needed".into());
        }
        if self.sensors == 0 {
            return wrong("sensors".into(), "is 0; at least 1 sensor is needed".into());
        }
        let readings = u64::from(self.sensors) * u64::from(self.steps);
        if readings > MOST_READINGS {
            let problem = format!("times `world.steps` is {readings}; at most {MOST_READINGS} can be held");
            return wrong("sensors".into(), problem);
        }
        if let Some([first, last]) = self.outage.filter(|[first, last]| first > last) {
            let problem = format!("is [{first}, {last}]; the first scan must not come after the last");
            return wrong("outage".into(), problem);
        }
        let root = self.sensors.isqrt();
        if self.layout == Layout::Grid && root * root != self.sensors {
            let problem = format!(
                "is {}; a grid needs a square number, such as 1, 4 or 9, or set world.layout to \"scattered\"",
                self.sensors
            );
            return wrong("sensors".into(), problem);
        }
        let positive = [
            ("interval", Some(self.interval), "s; an interval"),
            ("process_variance", Some(self.process_variance), "m²/s⁴; a variance"),
            ("measurement_variance", Some(self.measurement_variance), "m²; a variance"),
            ("side", Some(self.side), "m; a length"),
            ("reach", self.reach, "m; a distance"),
            ("hop", Some(self.hop), "m; a distance"),
            ("acquisition_speed", Some(self.acquisition_speed), "m/s; a speed"),
        ];
        for (key, value, what) in positive {
            if let Some(value) = value.filter(|value| !(*value > 0.0 && *value <= LARGEST)) {
                return wrong(
                    key.into(),
                    format!("is {value} {what} must be positive and at most {LARGEST:e}"),
                );
            }
        }
        for (key, value) in [("loss", self.loss), ("failure", self.failure)] {
            if !(0.0..=1.0).contains(&value) {
                return wrong(key.into(), format!("is {value}; a probability lies between 0 and 1"));
            }
        }
        let vectors: [(&str, &[f64]); 3] =
            [("truth", &self.truth), ("prior_mean", &self.prior_mean), ("sink", &self.sink)];
        for (key, values) in vectors {
            if let Some(index) = values.iter().position(|value| value.is_nan() || value.abs() > LARGEST) {
                let problem =
                    format!("is {}; it must lie between -{LARGEST:e} and {LARGEST:e}", values[index]);
                return wrong(format!("{key}[{index}]"), problem);
            }
        }
        let variances = &self.prior_variance;
        if let Some(index) = variances.iter().position(|value| !(*value > 0.0 && *value <= LARGEST)) {
            let problem =
                format!("is {}; a variance must be positive and at most {LARGEST:e}", variances[index]);
            return wrong(format!("prior_variance[{index}]"), problem);
        }
        Ok(())
    }
}

/// One measured range as it reaches the sink.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// Index of the sensor.
    pub sensor: usize,
    /// The range (m); noise can make it negative.
    pub range: f64,
}

/// What happens to the sensors at one scan.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Scan {
    /// What would reach the sink from each sensor if it were asked, in the order of the sensors.
    pub readings: Vec<Reading>,
    /// Sensors that have failed, which the sink knows.
    pub failed: Vec<usize>,
}

/// One draw of the world.
#[derive(Clone, Debug, PartialEq)]
pub struct World {
    /// True states, from time zero on: K + 1 of them.
    pub truth: Vec<[f64; 4]>,
    /// Places of the sensors (m).
    pub sensors: Vec<[f64; 2]>,
    /// The scans, from the first on.
    pub scans: Vec<Scan>,
}

/// What the streams of a run are drawn for: the target's motion, its start, then each sensor.
const MOTION: u64 = 0;
const START: u64 = 1;
const FIRST_SENSOR: u64 = 2;

impl World {
    /// The world of one run; every draw is addressed by the seed, the run and what is drawn.
    pub fn simulate(settings: &WorldSettings, seed: u64, run: u32) -> Self {
        let stream = |entity| Stream::new(seed, u64::from(run), Purpose::World, entity).fast();
        let WorldSettings { interval, process_variance, steps, .. } = *settings;
        let start = match settings.start {
            Start::Fixed => settings.truth,
            Start::Bayes => {
                let mut random = stream(START);
                let spread = settings.prior_variance.map(f64::sqrt);
                std::array::from_fn(|k| settings.prior_mean[k] + spread[k] * normal(&mut random))
            }
        };
        let truth = trajectory(start, interval, process_variance, steps, &mut stream(MOTION));
        let spread = settings.measurement_variance.sqrt();
        let mut scans = vec![Scan::default(); steps as usize];
        let mut sensors = Vec::with_capacity(settings.sensors as usize);
        for sensor in 0..settings.sensors as usize {
            let mut random = stream(FIRST_SENSOR + sensor as u64);
            let drawn = [(); 2].map(|()| settings.side * random.random::<f64>());
            let place = match settings.layout {
                Layout::Scattered => drawn,
                Layout::Grid => grid(sensor, settings.sensors.isqrt() as usize, settings.side),
            };
            let mut works = true;
            for (number, (scan, state)) in (1..).zip(scans.iter_mut().zip(&truth[1..])) {
                let (noise, lost, fails) =
                    (normal(&mut random), random.random::<f64>(), random.random::<f64>());
                works &= fails >= settings.failure;
                let distance = (state[0] - place[0]).hypot(state[2] - place[1]);
                let heard = settings.reach.is_none_or(|reach| distance <= reach);
                if !works {
                    scan.failed.push(sensor);
                } else if heard && lost >= settings.loss && !settings.is_out(number) {
                    scan.readings.push(Reading { sensor, range: distance + spread * noise });
                }
            }
            sensors.push(place);
        }
        Self { truth, sensors, scans }
    }
}

/// The place of a sensor on a grid of `root` by `root` over [0, side]².
fn grid(sensor: usize, root: usize, side: f64) -> [f64; 2] {
    let pitch = if root > 1 { side / (root - 1) as f64 } else { 0.0 };
    [(sensor % root) as f64 * pitch, (sensor / root) as f64 * pitch]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_grid_is_the_paper_s() {
        let places =
            |sensors| World::simulate(&WorldSettings { sensors, ..WorldSettings::default() }, 1, 0).sensors;
        assert_eq!(places(1), [[0.0, 0.0]]);
        assert_eq!(places(4), [[0.0, 0.0], [500.0, 0.0], [0.0, 500.0], [500.0, 500.0]]);
        assert_eq!(places(9)[4], [250.0, 250.0]);
    }

    #[test]
    fn what_one_sensor_draws_does_not_depend_on_the_others_or_on_what_is_lost() {
        let all = WorldSettings { sensors: 9, layout: Layout::Scattered, ..WorldSettings::default() };
        let first = World::simulate(&all, 1, 3);
        assert_eq!(first, World::simulate(&all, 1, 3));
        assert_ne!(first, World::simulate(&all, 1, 4));
        let fewer = WorldSettings {
            sensors: 5,
            loss: 0.3,
            failure: 0.02,
            reach: Some(300.0),
            outage: Some([4, 6]),
            ..all
        };
        let fewer = World::simulate(&fewer, 1, 3);
        assert!(fewer.scans[3..6].iter().all(|scan| scan.readings.is_empty()));
        assert_eq!(fewer.truth, first.truth);
        assert_eq!(fewer.sensors, first.sensors[..5]);
        for (scan, whole) in fewer.scans.iter().zip(&first.scans) {
            assert!(scan.readings.iter().all(|reading| whole.readings.contains(reading)));
        }
    }

    #[test]
    fn noise_loss_and_failure_are_as_frequent_as_the_settings_say() {
        // 400 runs of 30 scans and 4 sensors: 48,000 draws, bounds of 5 standard errors, error probability 6e-7 each.
        let settings = WorldSettings { loss: 0.2, start: Start::Bayes, ..WorldSettings::default() };
        let (mut squares, mut count) = (0.0, 0.0);
        for run in 0..400 {
            let world = World::simulate(&settings, 7, run);
            for (scan, state) in world.scans.iter().zip(&world.truth[1..]) {
                for reading in &scan.readings {
                    let place = world.sensors[reading.sensor];
                    squares += (reading.range - (state[0] - place[0]).hypot(state[2] - place[1])).powi(2);
                    count += 1.0;
                }
            }
        }
        let n = 48_000.0_f64;
        assert!((count / n - 0.8).abs() < 5.0 * (0.16 / n).sqrt());
        assert!((squares / count / 0.36 - 1.0).abs() < 5.0 * (2.0 / count).sqrt());
        let failing = WorldSettings { failure: 0.05, sensors: 100, ..WorldSettings::default() };
        let world = World::simulate(&failing, 7, 0);
        let last = world.scans.last().unwrap().failed.len() as f64 / 100.0;
        let expected = 1.0 - 0.95_f64.powi(30);
        assert!((last - expected).abs() < 5.0 * (expected * (1.0 - expected) / 100.0).sqrt());
        assert!(world.scans.windows(2).all(|pair| pair[0].failed.iter().all(|f| pair[1].failed.contains(f))));
    }

    #[test]
    fn wrong_values_are_refused_with_their_key() {
        let good = WorldSettings::default();
        assert!(good.validate().is_ok());
        for (wrong, expected) in [
            (
                WorldSettings { sensors: 5, ..good.clone() },
                "`world.sensors` is 5; a grid needs a square number",
            ),
            (WorldSettings { loss: 1.5, ..good.clone() }, "`world.loss` is 1.5; a probability"),
            (
                WorldSettings { outage: Some([5, 3]), ..good.clone() },
                "`world.outage` is [5, 3]; the first scan",
            ),
            (
                WorldSettings { sensors: 400_000_000, ..good.clone() },
                "`world.sensors` times `world.steps` is",
            ),
            (WorldSettings { process_variance: 1e13, ..good.clone() }, "`world.process_variance` is"),
            (WorldSettings { reach: Some(-1.0), ..good.clone() }, "`world.reach` is -1 m; a distance must"),
            (
                WorldSettings { prior_variance: [1.0, 0.0, 1.0, 1.0], ..good.clone() },
                "`world.prior_variance[1]` is 0; a variance",
            ),
        ] {
            let found = wrong.validate().unwrap_err().to_string();
            assert!(found.starts_with(expected), "{found}");
        }
    }
}
