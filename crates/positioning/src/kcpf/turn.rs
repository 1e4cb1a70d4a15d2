//! System `coordinated-turn`: an aircraft that flies straight, turns, and flies straight again, seen by a radar.
//!
//! The state is [x, vx, y, vy, ω]. The truth has speed v, turns clockwise at ω = -a/v between two times, and is
//! straight otherwise, without noise; every method takes the same model for it, a
//! [coordinated turn](sumprod_models::library::CoordinatedTurn) with noise. The radar at the origin measures range and
//! bearing. Segments are named `straight1`, `turn` and `straight2`.
//!
//! The paper gives the start, the speed, the times and "acceleration 50", which makes a U-turn of radius 1.8 km if it
//! is m/s²; the heading, the sensor, the sample time and all noises are lost, and are a reconstruction. A heading of +x
//! would fly through the radar.

mod world;

use std::path::Path;

use serde::{Deserialize, Serialize};
use sumprod_messages::Moments;

use super::method::{MethodSettings, Offer};
use super::{growth, track};
use crate::error::PositioningError;
use crate::results::{Anchor, MethodRun, RunResult, Segment, StateLayout};
use crate::scenario::{GraphSummary, Methods, RunRequest, Scenario};

pub use world::{ModelSettings, RadarMeasurement, SensorSettings, WorldSettings};

/// Steps after the start that are in no segment: what the prior leaves.
const SETTLING: u32 = 10;
/// Steps after the turn that still belong to it, and those after that in no segment.
const RECOVERY: u32 = 5;

/// A scenario of system `coordinated-turn`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Turn {
    /// The true trajectory.
    pub world: WorldSettings,
    /// The radar.
    pub sensor: SensorSettings,
    /// What every method takes for the motion and the start.
    pub model: ModelSettings,
    /// The methods to compare.
    pub method: Methods<MethodSettings>,
}

impl Turn {
    fn segments(&self) -> Vec<Segment> {
        let WorldSettings { steps, turn_first, turn_last, .. } = self.world;
        [
            ("straight1", SETTLING, turn_first.saturating_sub(1)),
            ("turn", turn_first.saturating_sub(1), turn_last + RECOVERY),
            ("straight2", turn_last + 2 * RECOVERY, steps),
        ]
        .into_iter()
        .filter(|(_, first, last)| first <= last)
        .map(|(name, first, last)| Segment { name: name.to_owned(), first, last })
        .collect()
    }
}

impl Scenario for Turn {
    const SYSTEM: &'static str = "coordinated-turn";
    const READS_DATA: bool = false;
    type Prepared = ();

    fn validate(&self) -> Result<(), PositioningError> {
        self.world.validate()?;
        self.sensor.validate()?;
        self.model.validate()?;
        let offer = Offer { grid: false, density: false };
        self.method.iter().try_for_each(|(id, method)| method.validate(id, offer))
    }

    fn methods(&self) -> Vec<String> {
        self.method.ids()
    }

    fn prepare(&self, _seed: u64, _data: Option<&Path>) -> Result<(), PositioningError> {
        Ok(())
    }

    fn run(&self, (): &(), request: RunRequest<'_>) -> Result<RunResult, PositioningError> {
        let (start, steps) = world::simulate(self, request.seed, request.run)?;
        let prior = Moments { mean: start.to_vec(), covariance: self.model.start_covariance() };
        let layout = StateLayout {
            names: ["x_m", "vx_mps", "y_m", "vy_mps", "turn_rate_rps"].map(str::to_owned).to_vec(),
            position: vec![0, 2],
            velocity: vec![1, 3],
            ..StateLayout::default()
        };
        let mut methods = Vec::with_capacity(request.methods.len());
        for id in request.methods {
            let (method, seed) = (self.method.named(id)?, request.method_seed(id));
            methods.push(MethodRun::timed(id, layout.clone(), |out| {
                track::run::<5, _, _>(method, &prior, &steps, seed, out)
            })?);
        }
        Ok(RunResult {
            run: request.run,
            nodes: vec!["aircraft".to_owned()],
            anchors: vec![Anchor { name: "radar".to_owned(), position: vec![0.0, 0.0] }],
            segments: self.segments(),
            methods,
            ..RunResult::default()
        })
    }

    fn check(&self, (): &(), _seed: u64, methods: &[String]) -> Result<Vec<GraphSummary>, PositioningError> {
        methods.iter().map(|id| Ok(growth::summary(id, self.method.named(id)?))).collect()
    }
}
