//! The world and its draws.

use std::f64::consts::PI;

use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};
use sumprod_fusion::association::{Sensors, Tracks};
use sumprod_graph::{FastStream, Purpose, Stream};

use crate::error::PositioningError;

/// Most tracks that a world may have: beyond lies a slip of the keyboard.
const MOST: u32 = 1_000_000;

/// The `[world]` table.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WorldSettings {
    /// Number of targets, uniform over a square.
    pub targets: u32,
    /// Side of the square (m); where absent as large as gives each target 120 km², 60 km for 30 targets.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub side_m: Option<f64>,
    /// Distance of the square from the line on which the sensors stand, at the square's left and right end (m).
    #[serde(default = "twenty_kilometres")]
    pub offset_m: f64,
    /// Probability that a sensor sees a target.
    pub detection_probability: f64,
    /// False tracks of each sensor, uniform over the square.
    pub false_tracks: u32,
    /// Variance of a track's coordinate (m²).
    pub noise_variance: f64,
    /// Level of the biases: what multiplies the two below.
    pub bias_level: f64,
    /// Size of a sensor's range bias at level 1 (m), of random sign.
    pub range_bias_m: f64,
    /// Size of a sensor's azimuth bias at level 1 (rad), of random sign.
    pub azimuth_bias_rad: f64,
}

fn twenty_kilometres() -> f64 {
    20_000.0
}

/// One draw of the world.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    /// Where the sensors stand.
    pub sensors: Sensors,
    /// True biases: range (m) and azimuth (rad) of the first sensor, then of the second.
    pub biases: [f64; 4],
    /// Tracks of the first sensor.
    pub first: Tracks,
    /// Tracks of the second sensor.
    pub second: Tracks,
    /// Whose the first tracks are; `None` of false ones.
    pub first_targets: Vec<Option<u32>>,
    /// Whose the second tracks are.
    pub second_targets: Vec<Option<u32>>,
}

impl Scene {
    /// Number of targets that both sensors see.
    pub fn common(&self) -> usize {
        let seen = |targets: &[Option<u32>]| -> Vec<u32> { targets.iter().flatten().copied().collect() };
        // Both lists ascend, as the targets were drawn.
        let second = seen(&self.second_targets);
        seen(&self.first_targets).iter().filter(|target| second.binary_search(target).is_ok()).count()
    }
}

impl WorldSettings {
    /// Side of the square (m).
    pub fn side(&self) -> f64 {
        self.side_m.unwrap_or_else(|| (f64::from(self.targets.max(1)) * 120e6).sqrt())
    }

    /// Checks the values.
    ///
    /// # Errors
    /// [`PositioningError::Setting`] naming the key.
    pub fn validate(&self) -> Result<(), PositioningError> {
        let wrong =
            |key: &str, problem: String| Err(PositioningError::setting(format!("world.{key}"), problem));
        for (key, count) in [("targets", self.targets), ("false_tracks", self.false_tracks)] {
            if count > MOST {
                return wrong(key, format!("is {count}; at most {MOST} are allowed"));
            }
        }
        if !(0.0..=1.0).contains(&self.detection_probability) {
            let problem = format!("is {}; a probability lies in [0, 1]", self.detection_probability);
            return wrong("detection_probability", problem);
        }
        if !(self.side() > 0.0 && self.side() < 1e9) {
            return wrong("side_m", format!("is {}; it must be positive and below 1e9", self.side()));
        }
        let bounded = [
            ("offset_m", self.offset_m, 1e9),
            ("noise_variance", self.noise_variance, 1e18),
            ("bias_level", self.bias_level, 1e6),
            ("range_bias_m", self.range_bias_m, 1e9),
            ("azimuth_bias_rad", self.azimuth_bias_rad, PI),
        ];
        for (key, value, most) in bounded {
            if !(0.0..=most).contains(&value) {
                return wrong(key, format!("is {value}; it must lie between 0 and {most}"));
            }
        }
        Ok(())
    }

    /// One draw of targets, biases and tracks.
    ///
    /// # Errors
    /// [`PositioningError::Setting`] where biases and noise leave the numbers that can be squared.
    pub fn simulate(&self, seed: u64, run: u32) -> Result<Scene, PositioningError> {
        let mut random = Stream::new(seed, u64::from(run), Purpose::World, 0).fast();
        let side = self.side();
        let sensors = Sensors { first: [0.0, 0.0], second: [side, 0.0] };
        let mut sign = || if random.random::<bool>() { self.bias_level } else { -self.bias_level };
        let sizes = [self.range_bias_m, self.azimuth_bias_rad, self.range_bias_m, self.azimuth_bias_rad];
        let biases = sizes.map(|size| size * sign());
        let mut place = || {
            let (x, y): (f64, f64) = (random.random(), random.random());
            [side * x, self.offset_m + side * y]
        };
        let targets: Vec<[f64; 2]> = (0..self.targets).map(|_| place()).collect();
        let [(first, first_targets), (second, second_targets)] =
            [(0, sensors.first, [biases[0], biases[1]]), (1, sensors.second, [biases[2], biases[3]])].map(
                |(index, sensor, offsets)| {
                    let mut random = Stream::new(seed, u64::from(run), Purpose::World, 1 + index).fast();
                    self.look(&targets, sensor, offsets, &mut random)
                },
            );
        let tracks = |places: Vec<[f64; 2]>| {
            Tracks::planar(&places)
                .map_err(|error| PositioningError::setting("world", format!("makes no tracks: {error}")))
        };
        let (first, second) = (tracks(first)?, tracks(second)?);
        Ok(Scene { sensors, biases, first, second, first_targets, second_targets })
    }
}

impl WorldSettings {
    /// A sensor's tracks and whose they are.
    fn look(
        &self,
        targets: &[[f64; 2]],
        sensor: [f64; 2],
        offsets: [f64; 2],
        random: &mut FastStream,
    ) -> (Vec<[f64; 2]>, Vec<Option<u32>>) {
        let side = self.side();
        let (mut tracks, mut owners) = (Vec::new(), Vec::new());
        let seen = targets.iter().zip(0..).map(|(place, target)| (Some(target), Some(*place)));
        let false_ones = (0..self.false_tracks).map(|_| (None, None));
        for (owner, place) in seen.chain(false_ones) {
            let chance: [f64; 3] = random.random();
            let noise: [f64; 2] = [StandardNormal.sample(random), StandardNormal.sample(random)];
            if owner.is_some() && chance[2] >= self.detection_probability {
                continue;
            }
            let place = place.unwrap_or([side * chance[0], self.offset_m + side * chance[1]]);
            let noisy = [0, 1].map(|i| place[i] + self.noise_variance.sqrt() * noise[i]);
            tracks.push(biased(noisy, sensor, offsets));
            owners.push(owner);
        }
        (tracks, owners)
    }
}

/// What a sensor with these offsets of range and azimuth sees of a place.
fn biased(place: [f64; 2], sensor: [f64; 2], [range, azimuth]: [f64; 2]) -> [f64; 2] {
    let (dx, dy) = (place[0] - sensor[0], place[1] - sensor[1]);
    let (distance, angle) = (dx.hypot(dy) + range, dy.atan2(dx) + azimuth);
    [sensor[0] + distance * angle.cos(), sensor[1] + distance * angle.sin()]
}
