//! System `growth`: the univariate growth model, whose posterior often has two modes.
//!
//! x_k = x/2 + 25 x / (1 + x²) + 8 cos(1.2 (k - 1)) + v, v ~ N(0, Q), z_k = x_k² / 20 + w, w ~ N(0, R), x_0 ~ N(0, P).
//!
//! Each run has K scored steps. Source: Kitagawa, "Non-Gaussian state-space modeling of nonstationary time series"
//! (1987), as in Gordon, Salmond, Smith (1993); the paper keeps no more of its model than the picture of it.

mod grid;
mod world;

use std::path::Path;

use serde::{Deserialize, Serialize};
use sumprod_messages::Moments;

use super::method::{Algorithm, MethodSettings, Offer};
use super::track::{self, Step};
use crate::error::PositioningError;
use crate::results::{MethodRun, RunResult, StateLayout};
use crate::scenario::{FormUse, GraphSummary, Methods, RunRequest, Scenario};

pub use world::{GrowthMeasurement, GrowthMotion, WorldSettings};

/// Cells of a grid where its table does not say.
const CELLS: usize = 1001;

/// A scenario of system `growth`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Growth {
    /// The simulated world.
    pub world: WorldSettings,
    /// The methods to compare.
    pub method: Methods<MethodSettings>,
}

impl Growth {
    fn track(
        &self,
        method: &MethodSettings,
        steps: &[Step<GrowthMotion, GrowthMeasurement>],
        seed: u64,
        out: &mut MethodRun,
    ) -> Result<(), PositioningError> {
        if method.algorithm == Algorithm::Grid {
            return grid::run(&self.world, method.cells.unwrap_or(CELLS), steps, out);
        }
        let prior = Moments { mean: vec![0.0], covariance: vec![self.world.start_variance] };
        track::run::<1, _, _>(method, &prior, steps, seed, out)
    }
}

impl Scenario for Growth {
    const SYSTEM: &'static str = "growth";
    const READS_DATA: bool = false;
    type Prepared = ();

    fn validate(&self) -> Result<(), PositioningError> {
        self.world.validate()?;
        let offer = Offer { grid: true, density: true };
        self.method.iter().try_for_each(|(id, method)| method.validate(id, offer))
    }

    fn methods(&self) -> Vec<String> {
        self.method.ids()
    }

    fn prepare(&self, _seed: u64, _data: Option<&Path>) -> Result<(), PositioningError> {
        Ok(())
    }

    fn run(&self, (): &(), request: RunRequest<'_>) -> Result<RunResult, PositioningError> {
        let steps = self.world.simulate(request.seed, request.run)?;
        let layout = StateLayout { names: vec!["x".into()], ..StateLayout::default() };
        let mut methods = Vec::with_capacity(request.methods.len());
        for id in request.methods {
            let (method, seed) = (self.method.named(id)?, request.method_seed(id));
            methods.push(MethodRun::timed(id, layout.clone(), |out| self.track(method, &steps, seed, out))?);
        }
        Ok(RunResult { run: request.run, nodes: vec!["state".to_owned()], methods, ..RunResult::default() })
    }

    fn check(&self, (): &(), _seed: u64, methods: &[String]) -> Result<Vec<GraphSummary>, PositioningError> {
        methods.iter().map(|id| Ok(summary(id, self.method.named(id)?))).collect()
    }
}

/// The chain of one step: the state before and after, their motion, and the measurement.
pub(super) fn summary(id: &str, method: &MethodSettings) -> GraphSummary {
    let form = match method.algorithm {
        Algorithm::Grid => format!("grid of {} cells", method.cells.unwrap_or(CELLS)),
        Algorithm::ExtendedKalman => "gaussian".to_owned(),
        Algorithm::Bootstrap | Algorithm::KnowledgeBoard => format!("particles {}", method.particles()),
    };
    let of = |kind: &str, edges| FormUse { kind: kind.to_owned(), form: form.clone(), edges };
    GraphSummary {
        method: id.to_owned(),
        extent: "one step and the state before it".to_owned(),
        variables: 2,
        factors: 2,
        edges: 3,
        components: 1,
        loops: 0,
        forms: vec![of("prediction", 2), of("measurement", 1)],
        unconstrained: Vec::new(),
    }
}
