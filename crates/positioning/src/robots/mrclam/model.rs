//! The chain of an MRCLAM recording: the joint state of the team in slices of equal length.

use std::collections::HashMap;
use std::ops::Range;

use serde::{Deserialize, Serialize};
use sumprod_filters::{Correct, FilterError, RaoBlackwellised};
use sumprod_graph::{MessageError, Space, wrap_angle};
use sumprod_messages::Moments;
use sumprod_models::{Block, Blocks, Cluster, Noise, NoiseError};

use super::commands::Commands;
use super::motion::{CommandedMotion, Drift, dimension};
use super::recording::{Recording, Robot, SightingRow, Subject};
use super::sighting::{Camera, Geometry, SightedBearing, SightedRange};
use crate::PositioningError;
use crate::robots::LONGEST_GAP_S;
use crate::robots::chain::Chain;
use crate::robots::particles::Parts;

/// Sightings this share of a slice after it still belong to it, against rounding.
const ROUNDING: f64 = 1e-9;
/// More slices than this are taken for a mistake.
const MOST_SLICES: f64 = 1e6;

/// Variances of each robot's state at the start.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Start {
    /// Of the position along each axis (m²).
    pub position_variance: f64,
    /// Of the heading (rad²).
    pub heading_variance: f64,
    /// Of the turn scale.
    pub turn_scale_variance: f64,
    /// Of the forward scale.
    pub forward_scale_variance: f64,
    /// Of the range scale.
    pub range_scale_variance: f64,
}

/// What the chain is made of besides the recording.
#[derive(Clone, Debug)]
pub struct Layout {
    /// Length of a slice (s).
    pub slice_s: f64,
    /// How late the robots follow their commands (s).
    pub odometry_delay_s: f64,
    /// Whether each robot's scale errors are estimated; otherwise they are zero.
    pub calibrated: bool,
    /// Whether bearings are left out.
    pub range_only: bool,
    /// Which robots' sightings of landmarks are used, by index.
    pub landmark_observers: Vec<bool>,
    /// Whether sightings of robots are used.
    pub cooperation: bool,
}

/// The chain of one recording.
#[derive(Debug)]
pub struct TeamChain<'a> {
    recording: &'a Recording,
    layout: Layout,
    camera: Camera,
    drift: Drift,
    commands: Vec<Commands>,
    times: Vec<f64>,
    start: Moments,
    /// The sightings in use, each with its variance factor.
    sightings: Vec<(SightingRow, f64)>,
    /// Those of each slice.
    of_slice: Vec<Range<usize>>,
}

impl<'a> TeamChain<'a> {
    /// The chain with slice 0 at the last robot's first command; a sighting goes to the first slice at or after it, so
    /// that no slice hears from its future.
    ///
    /// # Errors
    /// [`PositioningError::Unconstrained`] where a robot has no true pose to start from, and
    /// [`PositioningError::Setting`] where slices are so short that there are more than a million.
    pub fn new(
        recording: &'a Recording,
        start: &Start,
        drift: Drift,
        camera: Camera,
        layout: Layout,
    ) -> Result<Self, PositioningError> {
        let robots = &recording.robots;
        let commanded =
            |end: fn(&Robot) -> Option<f64>| robots.iter().filter_map(end).fold(f64::NEG_INFINITY, f64::max);
        let begin = commanded(|robot| robot.commands.first().map(|command| command.time));
        let end = commanded(|robot| robot.commands.last().map(|command| command.time));
        let steps = (end - begin) / layout.slice_s;
        if steps >= MOST_SLICES {
            let problem = format!(
                "is {}, which makes {steps:.0} slices; at most {MOST_SLICES} are allowed",
                layout.slice_s
            );
            return Err(PositioningError::setting("world.slice_s", problem));
        }
        let count = steps as usize + 1;
        let times: Vec<f64> = (0..count).map(|k| begin + layout.slice_s * k as f64).collect();
        let slice_of = |time: f64| ((time - begin) / layout.slice_s - ROUNDING).ceil() as usize;
        let sightings = in_use(recording, &layout, &camera, begin, times[count - 1]);
        let mut of_slice = vec![0..0; count];
        let mut first = 0;
        for same in sightings.chunk_by(|a, b| slice_of(a.0.time) == slice_of(b.0.time)) {
            of_slice[slice_of(same[0].0.time)] = first..first + same.len();
            first += same.len();
        }
        let commands =
            robots.iter().map(|robot| Commands::new(&robot.commands, layout.odometry_delay_s)).collect();
        let start = prior(robots, start, begin, layout.calibrated)?;
        Ok(Self { recording, layout, camera, drift, commands, times, start, sightings, of_slice })
    }

    /// The motion of one robot from a time to a later one (s).
    pub fn motion_between(&self, robot: usize, from: f64, to: f64) -> CommandedMotion {
        CommandedMotion {
            driven: self.commands[robot].between(from, to),
            duration: (to - from).max(0.0),
            drift: self.drift,
            calibrated: self.layout.calibrated,
        }
    }

    /// The coordinates of a robot's own state in the joint one.
    pub fn block(&self, robot: usize) -> Block {
        let d = dimension(self.layout.calibrated);
        Block::new(robot * d, d)
    }

    fn add(
        &self,
        cluster: &mut Cluster,
        slice: usize,
        (row, factor): &(SightingRow, f64),
    ) -> Result<(), Box<dyn std::error::Error + Send + Sync>> {
        let back = |robot: usize| self.commands[robot].between(self.times[slice], row.time);
        let calibrated = self.layout.calibrated;
        let observer = back(row.observer);
        let mut blocks = vec![self.block(row.observer)];
        let geometry = match row.subject {
            Subject::Landmark(index) => {
                Geometry::of_landmark(self.recording.landmarks[index].position, observer, calibrated)
            }
            Subject::Robot(other) => {
                blocks.push(self.block(other));
                Geometry::of_robot(observer, back(other), calibrated)
            }
        };
        if !self.layout.range_only {
            let noise = self.camera.bearing_noise(*factor)?;
            let geometry = geometry.clone();
            cluster.add(SightedBearing { measured: row.bearing, geometry, noise }, &blocks)?;
        }
        let noise = self.camera.range_noise(row.range, *factor)?;
        cluster.add(SightedRange { measured: row.range, geometry, noise }, &blocks)?;
        Ok(())
    }
}

/// The sightings that a layout uses, with their variance factors.
fn in_use(
    recording: &Recording,
    layout: &Layout,
    camera: &Camera,
    begin: f64,
    end: f64,
) -> Vec<(SightingRow, f64)> {
    let wanted = |row: &&SightingRow| {
        let known = match row.subject {
            Subject::Robot(_) => layout.cooperation,
            Subject::Landmark(_) => layout.landmark_observers[row.observer],
        };
        known && row.time > begin && row.time <= end
    };
    let mut last: HashMap<(usize, Subject), f64> = HashMap::new();
    let weigh = |row: &SightingRow| {
        let before = last.insert((row.observer, row.subject), row.time);
        (*row, camera.variance_factor(before.map(|before| row.time - before)))
    };
    recording.sightings.iter().filter(wanted).map(weigh).collect()
}

fn prior(robots: &[Robot], start: &Start, begin: f64, calibrated: bool) -> Result<Moments, PositioningError> {
    let own = dimension(calibrated);
    let d = robots.len() * own;
    let variances = [
        start.position_variance,
        start.position_variance,
        start.heading_variance,
        start.turn_scale_variance,
        start.forward_scale_variance,
        start.range_scale_variance,
    ];
    let mut moments = Moments { mean: vec![0.0; d], covariance: vec![0.0; d * d] };
    for (robot, first) in robots.iter().zip((0..d).step_by(own)) {
        moments.mean[first..first + 3].copy_from_slice(&true_pose(robot, begin)?);
        for (k, variance) in (first..first + own).zip(variances) {
            moments.covariance[k * d + k] = variance;
        }
    }
    Ok(moments)
}

/// A robot's true pose at a time, between the rows around it, or that of the row next to it.
fn true_pose(robot: &Robot, time: f64) -> Result<[f64; 3], PositioningError> {
    let after = robot.truth.partition_point(|row| row.time < time);
    let near = |index: usize| robot.truth.get(index).filter(|row| (row.time - time).abs() <= LONGEST_GAP_S);
    match (after.checked_sub(1).and_then(near), near(after)) {
        (Some(before), Some(after)) => {
            let share = (time - before.time) / (after.time - before.time);
            let turn = wrap_angle(after.pose[2] - before.pose[2]);
            let blend = |axis: usize| before.pose[axis] + share * (after.pose[axis] - before.pose[axis]);
            Ok([blend(0), blend(1), before.pose[2] + share * turn])
        }
        (Some(row), None) | (None, Some(row)) => Ok(row.pose),
        (None, None) => Err(PositioningError::Unconstrained {
            what: format!("the pose that robot {} starts from", robot.id),
            remedy: format!(
                "its ground truth needs a row within {LONGEST_GAP_S} s of {time} s, when the last robot's odometry begins"
            ),
        }),
    }
}

impl Chain for TeamChain<'_> {
    type Motion = Blocks<CommandedMotion>;

    fn space(&self) -> Space {
        // A heading counts its turns: it never jumps along a chain, so that its coordinate is a real one.
        Space::real(self.start.dimension())
    }

    fn times(&self) -> &[f64] {
        &self.times
    }

    fn start(&self) -> &Moments {
        &self.start
    }

    fn motion(&self, slice: usize) -> Self::Motion {
        let (from, to) = (self.times[slice - 1], self.times[slice]);
        Blocks((0..self.commands.len()).map(|robot| self.motion_between(robot, from, to)).collect())
    }

    fn evidence(&self, slice: usize) -> Result<Cluster, PositioningError> {
        let mut cluster = Cluster::new(self.start.dimension());
        for sighting in &self.sightings[self.of_slice[slice].clone()] {
            self.add(&mut cluster, slice, sighting)
                .map_err(|error| PositioningError::setting("camera", format!("cannot be used: {error}")))?;
        }
        Ok(cluster)
    }

    fn evidence_kind(&self) -> &'static str {
        "sighting"
    }
}

impl Parts for TeamChain<'_> {
    type PartMotion = CommandedMotion;

    fn parts(&self) -> Vec<Block> {
        (0..self.commands.len()).map(|robot| self.block(robot)).collect()
    }

    fn part_motion(&self, part: usize, slice: usize) -> CommandedMotion {
        self.motion_between(part, self.times[slice - 1], self.times[slice])
    }

    fn absorb(&self, part: usize, slice: usize, filter: &mut RaoBlackwellised) -> Result<(), FilterError> {
        for (row, factor) in &self.sightings[self.of_slice[slice].clone()] {
            let Subject::Landmark(index) = row.subject else { continue };
            if row.observer != part {
                continue;
            }
            let driven = self.commands[part].between(self.times[slice], row.time);
            let landmark = self.recording.landmarks[index].position;
            let geometry = Geometry::of_landmark(landmark, driven, self.layout.calibrated);
            let noise = |noise: Result<Noise, NoiseError>| {
                let reason = |error: NoiseError| MessageError::Unsupported(error.to_string());
                noise.map_err(|error| FilterError::Step { step: slice as u64, source: reason(error) })
            };
            if !self.layout.range_only {
                let noise = noise(self.camera.bearing_noise(*factor))?;
                filter.correct(&SightedBearing {
                    measured: row.bearing,
                    geometry: geometry.clone(),
                    noise,
                })?;
            }
            let noise = noise(self.camera.range_noise(row.range, *factor))?;
            filter.correct(&SightedRange { measured: row.range, geometry, noise })?;
        }
        Ok(())
    }
}
