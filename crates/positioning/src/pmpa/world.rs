//! The simulated world: one moving target, and nodes of known position that it hears when they are near.
//!
//! State X = [x, vx, y, vy] (m, m/s), interval T:
//!
//! X_k = F X_{k-1} + G u_k, u ~ N(0, Q I₂), per axis F = [1 T; 0 1] and G = [T²/2; T]: the covariance of G u has rank 2
//! of 4.
//!
//! | measurement | law |
//! |---|---|
//! | of itself | z_k = p_k + v |
//! | of node j, `relative` | z = p_k - p_j + v |
//! | of node j, `range` | z = \|p_k - p_j\| + v |
//!
//! with v ~ N(0, R) per component. Nodes lie uniformly on the bounding box of the true trajectory and are heard up to
//! a radius. Source: Fan, Wang, Zhou 2018, section 3.

use rand::RngExt;
use serde::{Deserialize, Serialize};
use sumprod_graph::{Purpose, Stream};

use crate::error::PositioningError;
use crate::tracking::{normal, trajectory};

/// What is measured of a node in reach.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum NeighbourMeasurement {
    /// The offset from the node, along both axes.
    #[default]
    Relative,
    /// The distance to the node.
    Range,
}

impl NeighbourMeasurement {
    /// The kind of its edges, as in `[method.ID.form]`.
    pub fn kind(self) -> &'static str {
        match self {
            Self::Relative => "relative",
            Self::Range => "range",
        }
    }
}

/// The `[world]` table.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WorldSettings {
    /// Number K of scans, each of which is scored.
    pub steps: u32,
    /// Variance Q of the acceleration along each axis (m²/s⁴).
    pub process_variance: f64,
    /// What is measured of a node in reach.
    #[serde(default)]
    pub neighbour_measurement: NeighbourMeasurement,
    /// Variance R of every measured component (m²).
    #[serde(default = "hundred")]
    pub measurement_variance: f64,
    /// Interval T between scans (s).
    #[serde(default = "one")]
    pub interval: f64,
    /// True state X₀ at time zero: x, vx, y, vy (m, m/s).
    #[serde(default = "start")]
    pub start: [f64; 4],
    /// Variance of each component with which every method starts at X₀ (m², m²/s²). Positive, since a message in
    /// information form cannot hold what is known exactly.
    #[serde(default = "start_variance")]
    pub start_variance: f64,
    /// Number of nodes.
    #[serde(default = "nodes")]
    pub nodes: u32,
    /// Distance up to which a node is heard (m).
    #[serde(default = "hundred")]
    pub radius: f64,
}

fn hundred() -> f64 {
    100.0
}

fn one() -> f64 {
    1.0
}

fn start() -> [f64; 4] {
    [-100.0, 2.0, 200.0, 20.0]
}

fn start_variance() -> f64 {
    1e-3
}

fn nodes() -> u32 {
    100
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
        let positive = [
            ("process_variance", self.process_variance, "m²/s⁴; a variance"),
            ("measurement_variance", self.measurement_variance, "m²; a variance"),
            ("start_variance", self.start_variance, "m²; a variance"),
            ("interval", self.interval, "s; an interval"),
            ("radius", self.radius, "m; a radius"),
        ];
        for (key, value, what) in positive {
            if !(value > 0.0 && value.is_finite()) {
                let problem = format!("is {value} {what} must be positive and finite");
                return Err(PositioningError::setting(format!("world.{key}"), problem));
            }
        }
        if let Some(index) = self.start.iter().position(|value| !value.is_finite()) {
            let problem = format!("is {}; it must be finite", self.start[index]);
            return Err(PositioningError::setting(format!("world.start[{index}]"), problem));
        }
        Ok(())
    }
}

/// What is measured of one node at one scan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Measured {
    /// Offset of the target from the node (m).
    Relative([f64; 2]),
    /// Distance to the node (m); the noise can make it negative.
    Range(f64),
}

/// One node heard at one scan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hearing {
    /// Index of the node.
    pub node: usize,
    /// What is measured of it.
    pub measured: Measured,
}

/// One draw of the world.
#[derive(Clone, Debug, PartialEq)]
pub struct World {
    /// True states, from time zero on: K + 1 of them.
    pub truth: Vec<[f64; 4]>,
    /// Positions of the nodes (m).
    pub nodes: Vec<[f64; 2]>,
    /// Measurements of itself (m), from the first scan on.
    pub fixes: Vec<[f64; 2]>,
    /// Nodes heard, from the first scan on.
    pub hearings: Vec<Vec<Hearing>>,
}

/// What the streams of a run are drawn for: the target's motion, its measurements, then each node.
const MOTION: u64 = 0;
const FIXES: u64 = 1;
const FIRST_NODE: u64 = 2;

impl World {
    /// The world of one run; every draw is addressed by the seed, the run and what is drawn, so that what one node
    /// draws does not depend on the others.
    pub fn simulate(settings: &WorldSettings, seed: u64, run: u32) -> Self {
        let stream = |entity| Stream::new(seed, u64::from(run), Purpose::World, entity).fast();
        let WorldSettings { start, interval, process_variance, steps, .. } = *settings;
        let truth = trajectory(start, interval, process_variance, steps, &mut stream(MOTION));
        let spread = settings.measurement_variance.sqrt();
        let positions = || truth[1..].iter().map(|state| [state[0], state[2]]);
        let mut random = stream(FIXES);
        let fixes = positions().map(|p| p.map(|x| x + spread * normal(&mut random))).collect();
        let corners = [0, 2].map(|axis| {
            let along = truth.iter().map(move |state| state[axis]);
            (along.clone().fold(f64::INFINITY, f64::min), along.fold(f64::NEG_INFINITY, f64::max))
        });
        let mut nodes = Vec::with_capacity(settings.nodes as usize);
        let mut hearings = vec![Vec::new(); settings.steps as usize];
        for node in 0..settings.nodes as usize {
            let mut random = stream(FIRST_NODE + node as u64);
            let place = corners.map(|(low, high)| low + (high - low) * random.random::<f64>());
            for (heard, target) in hearings.iter_mut().zip(positions()) {
                let noise = [(); 2].map(|()| spread * normal(&mut random));
                let offset = [target[0] - place[0], target[1] - place[1]];
                let distance = offset[0].hypot(offset[1]);
                if distance <= settings.radius {
                    let measured = match settings.neighbour_measurement {
                        NeighbourMeasurement::Relative => {
                            Measured::Relative([offset[0] + noise[0], offset[1] + noise[1]])
                        }
                        NeighbourMeasurement::Range => Measured::Range(distance + noise[0]),
                    };
                    heard.push(Hearing { node, measured });
                }
            }
            nodes.push(place);
        }
        Self { truth, nodes, fixes, hearings }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings(steps: u32, process_variance: f64) -> WorldSettings {
        WorldSettings {
            steps,
            process_variance,
            neighbour_measurement: NeighbourMeasurement::Relative,
            measurement_variance: hundred(),
            interval: one(),
            start: start(),
            start_variance: start_variance(),
            nodes: nodes(),
            radius: hundred(),
        }
    }

    #[test]
    fn a_run_depends_on_its_number_and_the_seed_alone() {
        let settings = settings(60, 10.0);
        let first = World::simulate(&settings, 1, 3);
        assert_eq!(first, World::simulate(&settings, 1, 3));
        assert_ne!(first, World::simulate(&settings, 1, 4));
        assert_ne!(first, World::simulate(&settings, 2, 3));
        let fewer = World::simulate(&WorldSettings { nodes: 40, ..settings }, 1, 3);
        assert_eq!(fewer.fixes, first.fixes);
        assert_eq!(fewer.nodes, first.nodes[..40]);
    }

    #[test]
    fn nodes_in_reach_and_no_others_are_heard() {
        let world = World::simulate(&settings(60, 10.0), 1, 0);
        for (heard, state) in world.hearings.iter().zip(&world.truth[1..]) {
            let near: Vec<usize> = (0..world.nodes.len())
                .filter(|&j| (state[0] - world.nodes[j][0]).hypot(state[2] - world.nodes[j][1]) <= 100.0)
                .collect();
            assert_eq!(heard.iter().map(|hearing| hearing.node).collect::<Vec<_>>(), near);
        }
    }

    #[test]
    fn noises_have_their_variances() {
        // 200 runs of 60 scans and two axes are 24,000 draws: a variance to 0.9 %; bound 5 standard errors, error
        // probability 6e-7 each.
        let settings = settings(60, 10.0);
        let (mut fix, mut offset, mut acceleration) = (Vec::new(), Vec::new(), Vec::new());
        for run in 0..200 {
            let world = World::simulate(&settings, 7, run);
            for (k, pair) in world.truth.windows(2).enumerate() {
                for axis in 0..2 {
                    let position = pair[1][2 * axis];
                    acceleration.push(pair[1][2 * axis + 1] - pair[0][2 * axis + 1]);
                    fix.push(world.fixes[k][axis] - position);
                    for hearing in &world.hearings[k] {
                        let Measured::Relative(z) = hearing.measured else { panic!("a range") };
                        offset.push(z[axis] - (position - world.nodes[hearing.node][axis]));
                    }
                }
            }
        }
        for (sample, variance) in [(fix, 100.0), (offset, 100.0), (acceleration, 10.0)] {
            let n = sample.len() as f64;
            let ratio = sample.iter().map(|x| x * x).sum::<f64>() / n / variance;
            assert!((ratio - 1.0).abs() < 5.0 * (2.0 / n).sqrt(), "{ratio}");
        }
    }

    #[test]
    fn neighbours_are_as_sparse_as_the_geometry_says() {
        // Mean number of neighbours a scan at Q = 10: 37.8 at 20 scans, 5.4 at 60; 300 runs know them to 1.4 and 0.2.
        for (steps, low, high) in [(20, 33.0, 43.0), (60, 4.4, 6.4)] {
            let settings = settings(steps, 10.0);
            let total: usize = (0..300)
                .map(|run| World::simulate(&settings, 1, run).hearings.iter().map(Vec::len).sum::<usize>())
                .sum();
            let mean = total as f64 / f64::from(300 * steps);
            assert!((low..high).contains(&mean), "{steps} scans: {mean}");
        }
    }

    #[test]
    fn wrong_values_are_refused_with_their_key() {
        let good = settings(60, 10.0);
        assert!(good.validate().is_ok());
        for (wrong, expected) in [
            (WorldSettings { steps: 0, ..good.clone() }, "`world.steps` is 0; at least 1 step is needed"),
            (
                WorldSettings { process_variance: -4.0, ..good.clone() },
                "`world.process_variance` is -4 m²/s⁴; a variance must be positive and finite",
            ),
            (
                WorldSettings { measurement_variance: f64::NAN, ..good.clone() },
                "`world.measurement_variance` is NaN m²; a variance must be positive and finite",
            ),
            (
                WorldSettings { radius: f64::INFINITY, ..good.clone() },
                "`world.radius` is inf m; a radius must be positive and finite",
            ),
            (
                WorldSettings { start: [0.0, f64::NAN, 0.0, 0.0], ..good.clone() },
                "`world.start[1]` is NaN; it must be finite",
            ),
        ] {
            assert_eq!(wrong.validate().unwrap_err().to_string(), expected);
        }
    }
}
