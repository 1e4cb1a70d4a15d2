//! The scenario `mrclam`: its keys, its methods, and how they are scored.

use std::path::Path;

use serde::{Deserialize, Serialize};
use sumprod_messages::Moments;
use sumprod_models::Transition;

use super::model::{Layout, Start, TeamChain};
use super::motion::Drift;
use super::recording::{Landmark, Recording};
use super::sighting::Camera;
use crate::PositioningError;
use crate::results::{Anchor, MethodRun, RunResult, StateLayout};
use crate::robots::chain::{Chain, Inference};
use crate::robots::numbers::{not_negative, positive};
use crate::robots::particles::Way;
use crate::robots::{marginal, pose_of};
use crate::scenario::{GraphSummary, Methods, RunRequest, Scenario};

/// A team of robots that see landmarks and each other.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Mrclam {
    world: World,
    start: Start,
    motion: Drift,
    camera: Camera,
    method: Methods<Method>,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct World {
    /// Numbers of the robots whose sightings of landmarks are used; all if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    landmark_observers: Option<Vec<u32>>,
    /// Whether the landmarks' places are given.
    known_landmarks: bool,
    /// Whether bearings are left out.
    range_only: bool,
    /// Whether the scales of odometry and ranges are estimated; otherwise they are taken as right.
    calibrate: bool,
    /// Length of a slice (s).
    slice_s: f64,
    /// How late the robots follow their odometry commands (s).
    odometry_delay_s: f64,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Method {
    inference: Inference,
    /// Whether sightings of robots by robots are used.
    #[serde(default = "yes")]
    cooperation: bool,
    /// Linearisations of a filter's evidence.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    rounds: Option<u32>,
    /// Slices that a fixed-lag smoother looks back; the whole recording if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    lag: Option<u32>,
    /// Passes of a smoother.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    sweeps: Option<u32>,
    /// Particles of each robot in a particle filter.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    particles: Option<u32>,
}

fn yes() -> bool {
    true
}

impl Method {
    fn way(&self, id: &str) -> Result<Way, PositioningError> {
        Way::new(id, self.inference, [self.rounds, self.lag, self.sweeps], self.particles)
    }
}

impl Mrclam {
    fn chain<'a>(
        &self,
        recording: &'a Recording,
        method: &Method,
    ) -> Result<TeamChain<'a>, PositioningError> {
        let evidence = method.inference != Inference::Odometry;
        let observes = |id: u32| match &self.world.landmark_observers {
            Some(observers) => observers.contains(&id),
            None => true,
        };
        let layout = Layout {
            slice_s: self.world.slice_s,
            odometry_delay_s: self.world.odometry_delay_s,
            calibrated: self.world.calibrate,
            range_only: self.world.range_only,
            landmark_observers: recording.robots.iter().map(|robot| evidence && observes(robot.id)).collect(),
            // Robots filtered one by one have no place for what two of them share.
            cooperation: evidence && method.cooperation && method.inference != Inference::ParticleFilter,
        };
        TeamChain::new(recording, &self.start, self.motion, self.camera, layout)
    }

    fn method(
        &self,
        recording: &Recording,
        seed: u64,
        id: &str,
        method: &Method,
    ) -> Result<MethodRun, PositioningError> {
        let way = method.way(id)?;
        MethodRun::timed(id, StateLayout::planar_pose(), |run| {
            let chain = self.chain(recording, method)?;
            way.run(id, &chain, seed, &mut |slice, moments| score(run, &chain, recording, slice, moments))?;
            if let Way::Particles(_) = way {
                run.notes.push("robots are filtered one by one; sightings of robots are not used".into());
            }
            if recording.unknown > 0 {
                let sentence = "sightings of unknown barcodes or of the robot's own were left out";
                run.notes.push(format!("{} {sentence}", recording.unknown));
            }
            Ok(())
        })
    }

    pub(super) fn check_observers(&self, recording: &Recording) -> Result<(), PositioningError> {
        let ids: Vec<u32> = recording.robots.iter().map(|robot| robot.id).collect();
        let mut observers = self.world.landmark_observers.iter().flatten();
        match observers.find(|id| !ids.contains(id)) {
            None => Ok(()),
            Some(stranger) => {
                let known = ids.iter().map(u32::to_string).collect::<Vec<_>>().join(", ");
                let problem = format!("names robot {stranger}; the recording has robots {known}");
                Err(PositioningError::setting("world.landmark_observers", problem))
            }
        }
    }
}

/// Scores every robot at its true poses from a slice to the next, its estimate led forward by the commands. Truth is
/// never interpolated, so that no gap in it is scored across.
fn score(
    run: &mut MethodRun,
    chain: &TeamChain<'_>,
    recording: &Recording,
    slice: usize,
    moments: &Moments,
) -> Result<(), PositioningError> {
    let times = chain.times();
    let begin = times[slice];
    let end = times.get(slice + 1).copied();
    for (node, robot) in recording.robots.iter().enumerate() {
        let first = robot.truth.partition_point(|row| row.time < begin);
        let within = |row: &&super::recording::TruthRow| end.map_or(row.time <= begin, |end| row.time < end);
        let mut own = None;
        for row in robot.truth[first..].iter().take_while(within) {
            let block = chain.block(node);
            let own = own.get_or_insert_with(|| marginal(moments, block.start, block.length));
            let ahead = Transition::new(chain.motion_between(node, begin, row.time))
                .predict_moments(own)
                .map_err(|error| PositioningError::method(&run.id, error))?;
            let pose = pose_of(&ahead);
            let time = row.time - times[0];
            run.push(slice as u32, time, node as u32, &row.pose, &pose.mean, &pose.covariance)?;
        }
    }
    Ok(())
}

impl Scenario for Mrclam {
    const SYSTEM: &'static str = "mrclam";
    const READS_DATA: bool = true;
    type Prepared = Recording;

    fn validate(&self) -> Result<(), PositioningError> {
        if !self.world.known_landmarks {
            let problem = "is false, but this system has no variables for landmarks; set it to true, or leave the \
                           landmarks out with world.landmark_observers = []";
            return Err(PositioningError::setting("world.known_landmarks", problem));
        }
        positive("world.slice_s", self.world.slice_s)?;
        not_negative("world.odometry_delay_s", self.world.odometry_delay_s)?;
        positive("start.position_variance", self.start.position_variance)?;
        positive("start.heading_variance", self.start.heading_variance)?;
        positive("start.turn_scale_variance", self.start.turn_scale_variance)?;
        positive("start.forward_scale_variance", self.start.forward_scale_variance)?;
        positive("start.range_scale_variance", self.start.range_scale_variance)?;
        not_negative("motion.position_variance", self.motion.position_variance)?;
        not_negative("motion.heading_variance", self.motion.heading_variance)?;
        not_negative("motion.turn_scale_variance", self.motion.turn_scale_variance)?;
        not_negative("motion.forward_scale_variance", self.motion.forward_scale_variance)?;
        not_negative("motion.range_scale_variance", self.motion.range_scale_variance)?;
        positive("camera.range_variance", self.camera.range_variance)?;
        not_negative("camera.range_variance_growth", self.camera.range_variance_growth)?;
        positive("camera.bearing_variance", self.camera.bearing_variance)?;
        not_negative("camera.correlation_s", self.camera.correlation_s)?;
        if let Some(nu) = self.camera.degrees_of_freedom {
            positive("camera.degrees_of_freedom", nu)?;
        }
        self.method.iter().try_for_each(|(id, method)| method.way(id).map(|_| ()))
    }

    fn methods(&self) -> Vec<String> {
        self.method.ids()
    }

    fn prepare(&self, _seed: u64, data: Option<&Path>) -> Result<Recording, PositioningError> {
        let recording = Recording::read(data.unwrap_or(Path::new(".")))?;
        self.check_observers(&recording)?;
        Ok(recording)
    }

    fn run(&self, recording: &Recording, request: RunRequest<'_>) -> Result<RunResult, PositioningError> {
        let wanted = self.method.iter().filter(|(id, _)| request.methods.iter().any(|wanted| wanted == id));
        let methods: Result<Vec<MethodRun>, PositioningError> =
            wanted.map(|(id, method)| self.method(recording, request.seed, id, method)).collect();
        let anchor = |landmark: &Landmark| Anchor {
            name: format!("landmark {}", landmark.id),
            position: landmark.position.to_vec(),
        };
        Ok(RunResult {
            nodes: recording.robots.iter().map(|robot| format!("robot {}", robot.id)).collect(),
            anchors: recording.landmarks.iter().map(anchor).collect(),
            methods: methods?,
            ..RunResult::default()
        })
    }

    fn check(
        &self,
        recording: &Recording,
        _seed: u64,
        methods: &[String],
    ) -> Result<Vec<GraphSummary>, PositioningError> {
        let wanted = self.method.iter().filter(|(id, _)| methods.iter().any(|wanted| wanted == id));
        wanted.map(|(id, method)| method.way(id)?.summary(id, &self.chain(recording, method)?)).collect()
    }
}
