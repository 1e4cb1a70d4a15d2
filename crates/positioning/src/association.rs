//! System `association`: which tracks of two biased sensors are the same target's.
//!
//! Two sensors of the plane see targets with a probability, beside false tracks, and each measures with a range and an
//! azimuth bias that nobody tells the methods. Each run is one draw of targets, tracks and biases.
//!
//! | reported | is |
//! |---|---|
//! | `association.correct` | correctly declared share of the targets that both sensors see |
//! | `association.false` | wrong share of the declared pairs |
//! | `iterations` | of expectation-maximisation |
//! | `monotone` | 1 where the penalised log likelihood never fell by more than a millionth of its size, else 0 |
//! | `bias_error.range_m`, `bias_error.azimuth_rad` | root mean square error of the two sensors' biases |
//!
//! A method that estimates the biases has them as its state, so that NEES and coverage judge its covariance.
//!
//! Source: the track-association paper keeps no scenario; this is a reconstruction.

mod method;
mod score;
mod world;

use std::path::Path;

use serde::{Deserialize, Serialize};
use sumprod_fusion::association::{
    AssociationError, BiasField, CoherentDrift, Displacement, MixtureReport, Pair, associate, global_nearest,
    nearest,
};

use crate::error::PositioningError;
use crate::results::{MethodRun, RunResult, StateLayout};
use crate::scenario::{FormUse, GraphSummary, Methods, RunRequest, Scenario};

pub use method::{Algorithm, MethodSettings, StartSettings, TailsSettings};
pub use score::Judgement;
pub use world::{Scene, WorldSettings};

/// Fall of the penalised log likelihood, as a share of its size, that rounding explains.
const ROUNDING: f64 = 1e-6;

/// A scenario of system `association`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Association {
    /// The simulated world.
    pub world: WorldSettings,
    /// The methods to compare.
    pub method: Methods<MethodSettings>,
}

impl Association {
    fn declare(
        &self,
        method: &MethodSettings,
        scene: &Scene,
        out: &mut MethodRun,
    ) -> Result<Vec<Pair>, Failure> {
        let gate = method.gate_m + method.gate_per_level_m * self.world.bias_level;
        let (first, second) = (&scene.first, &scene.second);
        match method.algorithm {
            Algorithm::Nearest => Ok(nearest(first, second, gate)?),
            Algorithm::GlobalNearest => Ok(global_nearest(first, second, gate)?),
            Algorithm::KnownBias => {
                Ok(global_nearest(&scene.sensors.displaced(first, scene.biases)?, second, gate)?)
            }
            Algorithm::Drift => {
                let mut field = CoherentDrift::new(method.length(), method.stiffness())?;
                let pairs = mix(method, gate, scene, &mut field, out)?;
                out.diagnose("rank", field.rank() as f64);
                Ok(pairs)
            }
            Algorithm::Bias => {
                let mut field = BiasField::new(scene.sensors, method.prior())?;
                let pairs = mix(method, gate, scene, &mut field, out)?;
                if let Some((mean, covariance)) = field.posterior().and_then(|posterior| posterior.scan(0)) {
                    out.push(0, 0.0, 0, &scene.biases, mean.as_slice(), covariance.as_slice())?;
                    score::biases(&scene.biases, mean.as_slice(), out);
                }
                Ok(pairs)
            }
        }
    }
}

/// Why a method failed.
enum Failure {
    Association(AssociationError),
    Estimate(PositioningError),
}

impl From<AssociationError> for Failure {
    fn from(error: AssociationError) -> Self {
        Self::Association(error)
    }
}

impl From<PositioningError> for Failure {
    fn from(error: PositioningError) -> Self {
        Self::Estimate(error)
    }
}

/// Associates by a mixture and reports its iterations.
fn mix(
    method: &MethodSettings,
    gate: f64,
    scene: &Scene,
    field: &mut impl Displacement,
    out: &mut MethodRun,
) -> Result<Vec<Pair>, AssociationError> {
    let found = associate(&scene.first, &scene.second, field, &method.mixture(gate))?;
    let MixtureReport { converged, degrees_of_freedom, variance, .. } = &found.report;
    out.diagnose("iterations", found.report.iterations() as f64);
    out.diagnose("converged", f64::from(u8::from(*converged)));
    out.diagnose("monotone", f64::from(u8::from(found.report.largest_fall() <= ROUNDING)));
    out.diagnose("deviation_m", variance.sqrt());
    if let Some(degrees) = degrees_of_freedom {
        out.diagnose("degrees_of_freedom", *degrees);
    }
    Ok(found.pairs)
}

impl Scenario for Association {
    const SYSTEM: &'static str = "association";
    const READS_DATA: bool = false;
    type Prepared = ();

    fn validate(&self) -> Result<(), PositioningError> {
        self.world.validate()?;
        self.method.iter().try_for_each(|(id, method)| method.validate(id))
    }

    fn methods(&self) -> Vec<String> {
        self.method.ids()
    }

    fn prepare(&self, _seed: u64, _data: Option<&Path>) -> Result<(), PositioningError> {
        Ok(())
    }

    fn run(&self, (): &(), request: RunRequest<'_>) -> Result<RunResult, PositioningError> {
        let scene = self.world.simulate(request.seed, request.run)?;
        let mut methods = Vec::with_capacity(request.methods.len());
        for id in request.methods {
            let method = self.method.named(id)?;
            let layout = match method.algorithm {
                Algorithm::Bias => biases(),
                _ => StateLayout {
                    names: vec![],
                    position: vec![],
                    velocity: vec![],
                    angular: vec![],
                    clock: vec![],
                },
            };
            let mut pairs = Vec::new();
            let mut done = MethodRun::timed(id, layout, |out| {
                pairs = self.declare(method, &scene, out).map_err(|failure| match failure {
                    Failure::Association(error @ AssociationError::Crowded { .. }) => {
                        PositioningError::setting(
                            format!("method.{id}.gate_m"),
                            format!("is too wide: {error}"),
                        )
                    }
                    Failure::Association(error) => PositioningError::method(id, error),
                    Failure::Estimate(error) => error,
                })?;
                Ok::<(), PositioningError>(())
            })?;
            score::pairs(&scene, &pairs, &mut done);
            methods.push(done);
        }
        Ok(RunResult { run: request.run, nodes: vec!["sensors".to_owned()], methods, ..RunResult::default() })
    }

    fn check(&self, (): &(), seed: u64, methods: &[String]) -> Result<Vec<GraphSummary>, PositioningError> {
        let scene = self.world.simulate(seed, 0)?;
        let (first, second) = (scene.first.len(), scene.second.len());
        let summary = |id: &String| {
            let algorithm = self.method.named(id)?.algorithm;
            // The field, and of each second track its association; scales are summed out within the factors.
            let (variables, factors, form) = match algorithm {
                Algorithm::Drift | Algorithm::Bias => (1 + second, 1 + second, "maximum of a gaussian"),
                _ => (second, second, "none"),
            };
            let own = variables - second;
            Ok(GraphSummary {
                method: id.clone(),
                extent: format!("{first} and {second} tracks of run 0"),
                variables,
                factors,
                edges: second + own * (1 + second),
                components: if own == 1 { 1 } else { second },
                loops: 0,
                forms: vec![
                    FormUse { kind: "field".into(), form: form.into(), edges: own * (1 + second) },
                    FormUse { kind: "association".into(), form: "categorical".into(), edges: second },
                ],
                unconstrained: Vec::new(),
            })
        };
        methods.iter().map(summary).collect()
    }
}

/// The state of a method that estimates biases.
fn biases() -> StateLayout {
    let names = ["range_1_m", "azimuth_1_rad", "range_2_m", "azimuth_2_rad"].map(str::to_owned).to_vec();
    StateLayout { names, position: vec![], velocity: vec![], angular: vec![1, 3], clock: vec![] }
}

#[cfg(test)]
mod tests;
