//! The scenario `plaza`: its keys, its methods, and how they are scored.

use std::path::Path;

use serde::{Deserialize, Serialize};
use sumprod_messages::Moments;
use sumprod_models::Transition;

use super::model::{Drift, PlazaChain, Sensor, Start};
use super::recording::Recording;
use crate::PositioningError;
use crate::results::{Anchor, MethodRun, RunResult, StateLayout};
use crate::robots::chain::{Chain, Inference};
use crate::robots::numbers::{not_negative, positive, positive_definite};
use crate::robots::particles::Way;
use crate::robots::{LONGEST_GAP_S, pose_of};
use crate::scenario::{GraphSummary, Methods, RunRequest, Scenario};

/// Truth this close to a slice is scored there (s): files round their times.
const ROUNDING_S: f64 = 1e-6;

/// One robot among ranging radios.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Plaza {
    world: World,
    start: Start,
    motion: Drift,
    sensor: Sensor,
    method: Methods<Method>,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct World {
    /// Whether gyro bias, range scale and range offset are estimated; otherwise they are zero.
    calibrate: bool,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Method {
    inference: Inference,
    /// Linearisations of a filter's evidence.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    rounds: Option<u32>,
    /// Slices that a fixed-lag smoother looks back; the whole recording if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    lag: Option<u32>,
    /// Passes of a smoother.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    sweeps: Option<u32>,
    /// Particles of a particle filter.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    particles: Option<u32>,
}

impl Method {
    fn way(&self, id: &str) -> Result<Way, PositioningError> {
        Way::new(id, self.inference, [self.rounds, self.lag, self.sweeps], self.particles)
    }
}

impl Plaza {
    fn chain<'a>(
        &self,
        recording: &'a Recording,
        method: &Method,
    ) -> Result<PlazaChain<'a>, PositioningError> {
        let with_ranges = method.inference != Inference::Odometry;
        let calibrated = self.world.calibrate;
        PlazaChain::new(recording, &self.start, self.motion, &self.sensor, calibrated, with_ranges)
    }

    fn method(
        &self,
        recording: &Recording,
        seed: u64,
        id: &str,
        method: &Method,
    ) -> Result<MethodRun, PositioningError> {
        let chain = self.chain(recording, method)?;
        let way = method.way(id)?;
        MethodRun::timed(id, StateLayout::planar_pose(), |run| {
            let mut last = Moments::default();
            way.run(id, &chain, seed, &mut |slice, moments| {
                score(run, &chain, recording, slice, moments)?;
                last.clone_from(moments);
                Ok(())
            })?;
            if let [_, _, _, bias, scale, offset] = last.mean[..]
                && method.inference != Inference::Odometry
            {
                run.diagnose("final_gyro_bias_radps", bias);
                run.diagnose("final_range_scale", scale);
                run.diagnose("final_range_offset_m", offset);
            }
            if recording.unknown > 0 {
                run.notes.push(format!("{} ranges to unknown beacons were left out", recording.unknown));
            }
            Ok(())
        })
    }
}

/// Scores the true poses from a slice to the next. Between slices the estimate goes forward by its share of the
/// row of odometry; rows longer than [`LONGEST_GAP_S`] are not scored inside.
fn score(
    run: &mut MethodRun,
    chain: &PlazaChain<'_>,
    recording: &Recording,
    slice: usize,
    moments: &Moments,
) -> Result<(), PositioningError> {
    let times = chain.times();
    let begin = times[slice];
    let first = recording.truth.partition_point(|row| row.time < begin - ROUNDING_S);
    let end = times.get(slice + 1).map_or(begin + ROUNDING_S, |next| next - ROUNDING_S);
    for row in recording.truth[first..].iter().take_while(|row| row.time < end) {
        let elapsed = row.time - begin;
        let here = if elapsed <= ROUNDING_S {
            pose_of(moments)
        } else {
            let leg = chain.leg(slice + 1);
            if leg.duration > LONGEST_GAP_S {
                continue;
            }
            let part = Transition::new(chain.along(leg.part(elapsed / leg.duration)));
            let ahead =
                part.predict_moments(moments).map_err(|error| PositioningError::method(&run.id, error))?;
            pose_of(&ahead)
        };
        let time = row.time - times[0];
        run.push(slice as u32, time, 0, &row.pose, &here.mean, &here.covariance)?;
    }
    Ok(())
}

impl Scenario for Plaza {
    const SYSTEM: &'static str = "plaza";
    const READS_DATA: bool = true;
    type Prepared = Recording;

    fn validate(&self) -> Result<(), PositioningError> {
        let Start {
            position_variance,
            heading_variance,
            pose_covariance,
            gyro_bias_variance,
            range_scale_variance,
            range_offset_variance,
        } = self.start;
        positive("start.position_variance", position_variance)?;
        positive("start.heading_variance", heading_variance)?;
        if let Some(covariance) = pose_covariance {
            positive_definite("start.pose_covariance", &covariance)?;
        }
        positive("start.gyro_bias_variance", gyro_bias_variance)?;
        positive("start.range_scale_variance", range_scale_variance)?;
        positive("start.range_offset_variance", range_offset_variance)?;
        not_negative("motion.across_variance", self.motion.across_variance)?;
        not_negative("motion.along_variance", self.motion.along_variance)?;
        not_negative("motion.position_variance", self.motion.position_variance)?;
        not_negative("motion.heading_variance", self.motion.heading_variance)?;
        not_negative("motion.gyro_bias_variance", self.motion.gyro_bias_variance)?;
        not_negative("motion.range_scale_variance", self.motion.range_scale_variance)?;
        not_negative("motion.range_offset_variance", self.motion.range_offset_variance)?;
        positive("sensor.range_variance", self.sensor.range_variance)?;
        if let Some(nu) = self.sensor.degrees_of_freedom {
            positive("sensor.degrees_of_freedom", nu)?;
        }
        self.method.iter().try_for_each(|(id, method)| method.way(id).map(|_| ()))
    }

    fn methods(&self) -> Vec<String> {
        self.method.ids()
    }

    fn prepare(&self, _seed: u64, data: Option<&Path>) -> Result<Recording, PositioningError> {
        Recording::read(data.unwrap_or(Path::new(".")))
    }

    fn run(&self, recording: &Recording, request: RunRequest<'_>) -> Result<RunResult, PositioningError> {
        let wanted = |id: &str| request.methods.iter().any(|wanted| wanted == id);
        let methods = self.method.iter().filter(|(id, _)| wanted(id));
        let methods: Result<Vec<MethodRun>, PositioningError> =
            methods.map(|(id, method)| self.method(recording, request.seed, id, method)).collect();
        let anchor = |beacon: &super::recording::Beacon| Anchor {
            name: format!("beacon {}", beacon.id),
            position: beacon.position.to_vec(),
        };
        Ok(RunResult {
            nodes: vec!["robot".into()],
            anchors: recording.beacons.iter().map(anchor).collect(),
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
