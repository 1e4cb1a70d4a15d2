//! The `[world]` table.

use serde::{Deserialize, Serialize};

use crate::PositioningError;
use crate::robots::numbers::{not_negative, positive};

/// Number of anchors of [`Layout::Cube`].
const CORNERS: u32 = 5;
/// Most estimates of one run.
const MOST_ESTIMATES: u64 = 10_000_000;
/// The least variance that a clock's offset may gain between two states of a window, in thirds of a range's.
const STIFFEST: f64 = 5e-11;
/// Times beyond this (s) leave less than a tenth of a millisecond of their digits.
const LATEST_S: f64 = 1e11;

/// Where the anchors are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Layout {
    /// At four corners of the cube that are no neighbours, and in the middle of the ground.
    Cube,
    /// Anywhere in the cube, other places in every run.
    Random,
}

/// The simulated network.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WorldSettings {
    /// Number of frames; in each every anchor speaks once.
    pub steps: u32,
    /// Number of nodes.
    pub nodes: u32,
    /// Time from one frame to the next (s), more where the slots of all anchors take longer.
    pub interval: f64,
    /// Time from one anchor's emission to the next one's (s); 0 if they speak together.
    pub slot_s: f64,
    /// Edge of the cube in which nodes start and anchors are (m).
    pub size: f64,
    /// Where the anchors are.
    pub anchors: Layout,
    /// Number of anchors; of the cube's the first so many.
    pub anchor_count: u32,
    /// Speed of sound (m/s).
    pub sound_speed: f64,
    /// Velocity of every node at the start (m/s).
    pub velocity: [f64; 3],
    /// What methods take for its variance along each axis, its mean being zero (m²/s²).
    pub velocity_variance: f64,
    /// Density of the nodes' white acceleration along each axis (m²/s³).
    pub acceleration_density: f64,
    /// Offset of every node's clock at time zero (s).
    pub clock_offset_s: f64,
    /// Skew of every node's clock (ppm).
    pub clock_skew_ppm: f64,
    /// Density of the white noise that drives the skew, in metres of sound (m²/s³).
    pub clock_density: f64,
    /// Variance of one time of flight (m²).
    pub range_variance: f64,
    /// Time at which nodes begin to move (s).
    pub epoch_s: f64,
    /// Whether nodes move while an anchor's sound is on its way to them. Before they reply to it they always do.
    pub motion_in_flight: bool,
    /// Number of beacons that each anchor sends to the standing nodes before.
    pub beacons: u32,
    /// Time from one beacon to the next (s).
    pub beacon_interval: f64,
    /// Time from the last beacon to the nodes' departure (s).
    pub rest_s: f64,
    /// From hearing an anchor to the reply, in round trips (s).
    pub reply_delay_s: f64,
    /// The same of the one exchange that sets the clocks of `two-step` (s).
    pub sync_reply_delay_s: f64,
    /// Number of other nodes that each node hears once a frame.
    pub heard_nodes: u32,
}

impl Default for WorldSettings {
    fn default() -> Self {
        Self {
            steps: 50,
            nodes: 10,
            interval: 1.0,
            slot_s: 0.0,
            size: 1000.0,
            anchors: Layout::Cube,
            anchor_count: CORNERS,
            sound_speed: 1500.0,
            velocity: [7.0, 6.0, 5.0],
            velocity_variance: 100.0,
            acceleration_density: 0.0025,
            clock_offset_s: 0.01,
            clock_skew_ppm: 400.0,
            clock_density: 1e-7,
            range_variance: 5.0,
            epoch_s: 0.0,
            motion_in_flight: false,
            beacons: 10,
            beacon_interval: 1.0,
            rest_s: 5.0,
            reply_delay_s: 0.5,
            sync_reply_delay_s: 1.0,
            heard_nodes: 0,
        }
    }
}

impl WorldSettings {
    /// Checks the values.
    ///
    /// # Errors
    /// [`PositioningError::Setting`] naming the key.
    pub fn validate(&self) -> Result<(), PositioningError> {
        let wrong =
            |key: &str, problem: String| Err(PositioningError::setting(format!("world.{key}"), problem));
        let counts = [("steps", self.steps), ("nodes", self.nodes), ("anchor_count", self.anchor_count)];
        if let Some((key, _)) = counts.into_iter().find(|&(_, count)| count == 0) {
            return wrong(key, "is 0; it must be at least 1".to_owned());
        }
        let estimates = u64::from(self.steps) * u64::from(self.nodes) * u64::from(self.anchor_count);
        if estimates > MOST_ESTIMATES {
            let problem = format!(
                "is {}: with {} nodes and {} anchors that makes {estimates} measurements a run, of which at most \
                 {MOST_ESTIMATES} are held",
                self.steps, self.nodes, self.anchor_count
            );
            return wrong("steps", problem);
        }
        if self.anchors == Layout::Cube && self.anchor_count > CORNERS {
            let problem = format!(
                "is {}, but \"cube\" has {CORNERS} places; set `world.anchors` to \"random\" for more",
                self.anchor_count
            );
            return wrong("anchor_count", problem);
        }
        if self.beacons < 2 {
            let problem = format!(
                "is {}; without at least 2 beacons nothing tells how fast a clock gains",
                self.beacons
            );
            return wrong("beacons", problem);
        }
        if self.heard_nodes >= self.nodes {
            let problem =
                format!("is {}; each of {} nodes has fewer others to hear", self.heard_nodes, self.nodes);
            return wrong("heard_nodes", problem);
        }
        for (key, value) in [
            ("interval", self.interval),
            ("size", self.size),
            ("sound_speed", self.sound_speed),
            ("velocity_variance", self.velocity_variance),
            ("acceleration_density", self.acceleration_density),
            ("clock_density", self.clock_density),
            ("range_variance", self.range_variance),
            ("beacon_interval", self.beacon_interval),
        ] {
            positive(&format!("world.{key}"), value)?;
        }
        for (key, value) in [
            ("slot_s", self.slot_s),
            ("rest_s", self.rest_s),
            ("reply_delay_s", self.reply_delay_s),
            ("sync_reply_delay_s", self.sync_reply_delay_s),
        ] {
            not_negative(&format!("world.{key}"), value)?;
        }
        let speed = self.velocity.iter().map(|v| v * v).sum::<f64>().sqrt();
        if speed.is_nan() || speed >= self.sound_speed {
            let problem = format!("is {speed} m/s fast; sound of {} m/s must be faster", self.sound_speed);
            return wrong("velocity", problem);
        }
        if !self.clock_offset_s.is_finite() {
            return wrong("clock_offset_s", format!("is {} s; it must be finite", self.clock_offset_s));
        }
        if !(-1e5..1e5).contains(&self.clock_skew_ppm) {
            let problem = format!("is {} ppm; a clock's skew must be below a tenth", self.clock_skew_ppm);
            return wrong("clock_skew_ppm", problem);
        }
        if !(-LATEST_S..=LATEST_S).contains(&self.epoch_s) {
            let problem = format!("is {} s; beyond {LATEST_S:.0e} s times lose their digits", self.epoch_s);
            return wrong("epoch_s", problem);
        }
        Ok(())
    }

    /// Places of the anchors that are the same in every run, as many as the cube has.
    pub fn corners(&self) -> [[f64; 3]; CORNERS as usize] {
        let (edge, half) = (self.size, 0.5 * self.size);
        [[0.0, 0.0, 0.0], [edge, edge, 0.0], [edge, 0.0, edge], [0.0, edge, edge], [half, half, 0.0]]
    }

    /// Time from one frame to the next (s).
    pub fn frame_interval(&self) -> f64 {
        self.interval.max(f64::from(self.anchor_count) * self.slot_s)
    }

    /// The shortest time between two states of a node (s).
    fn shortest(&self) -> f64 {
        let rest = self.frame_interval() - f64::from(self.anchor_count - 1) * self.slot_s;
        if self.slot_s > 0.0 { self.slot_s.min(rest) } else { rest }
    }

    /// The least density of the clocks' noise (m²/s³) with which states of a window are told apart: a clock whose offset
    /// moves by less than a hundred thousandth of a range's error from one state to the next makes of both one direction
    /// in double precision.
    pub fn least_clock_density(&self) -> f64 {
        STIFFEST * self.range_variance / self.shortest().powi(3)
    }

    /// Densities of the accelerations of position and clock (m²/s³).
    pub fn densities(&self) -> [f64; 4] {
        let q = self.acceleration_density;
        [q, q, q, self.clock_density]
    }
}
