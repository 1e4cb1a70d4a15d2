//! System `p-mpa`: one target among nodes of known position, tracked by Kalman and particle filters and by the
//! message-passing algorithms of Fan, Wang and Zhou.
//!
//! | method | state | hears | prediction | measurements |
//! |---|---|---|---|---|
//! | `kf` | position and velocity | itself | Gaussian | Gaussian |
//! | `pf` | position and velocity | itself | particles | particles |
//! | `pa-mpa-literal` | position, velocity frozen | itself, neighbours | Gaussian | Gaussian |
//! | `p-mpa` | position and velocity | itself, neighbours | particles, optimal proposal | Gaussian; ranges rings of kernels, in a product by Gibbs sampling |
//! | `p-mpa-literal` | position and velocity | itself, neighbours | particles with kernels | particles with kernels, in the printed product |
//! | `kf-all` | position and velocity | itself, neighbours | Gaussian | Gaussian |
//! | `pf-all` | position and velocity | itself, neighbours | particles | particles |
//!
//! These are combinations of the keys of [`method::MethodSettings`]; a scenario may have others. The world is
//! described in [`world`]. Source: Fan, Wang, Zhou, "P-MPA" (2018).

pub mod bound;
mod filter;
mod kernels;
pub mod method;
pub mod world;

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::error::PositioningError;
use crate::results::{Anchor, BoundStep, MethodRun, RunResult};
use crate::scenario::{FormUse, GraphSummary, Methods, RunRequest, Scenario};
use filter::Filter;
use kernels::KernelFilter;
use method::MethodSettings;
use world::{World, WorldSettings};

/// A scenario of system `p-mpa`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PMpa {
    /// The simulated world.
    pub world: WorldSettings,
    /// The methods to compare.
    pub method: Methods<MethodSettings>,
}

impl PMpa {
    fn method(&self, id: &str) -> Result<&MethodSettings, PositioningError> {
        let method = self.method.named(id)?;
        method.admit(id, &self.world)?;
        Ok(method)
    }

    fn bound(&self, world: &World) -> Vec<BoundStep> {
        let variances = bound::position_variances(&self.world, world, true);
        let steps = (1..).zip(variances);
        steps
            .map(|(step, position_variance)| BoundStep {
                step,
                time: f64::from(step) * self.world.interval,
                position_variance,
            })
            .collect()
    }
}

impl Scenario for PMpa {
    const SYSTEM: &'static str = "p-mpa";
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
        let RunRequest { seed, run, methods: wanted } = request;
        let chosen: Vec<&MethodSettings> =
            wanted.iter().map(|id| self.method(id)).collect::<Result<_, _>>()?;
        let world = World::simulate(&self.world, seed, run);
        let alone = bound::position_variances(&self.world, &world, false);
        let alone = (alone.iter().sum::<f64>() / alone.len() as f64).sqrt();
        let mut methods = Vec::with_capacity(wanted.len());
        for (id, method) in wanted.iter().zip(chosen) {
            let seed = request.method_seed(id);
            let mut done = MethodRun::timed(id, filter::layout(method), |out| {
                if let Some(rule) = method.kernel_rule(self.world.neighbour_measurement) {
                    return KernelFilter::new(&self.world, method, rule, &world, seed).run(out);
                }
                Filter::new(&self.world, method, &world, seed)
                    .map_err(|error| PositioningError::method(id, error))?
                    .run(out)
            })?;
            if !method.neighbours {
                done.diagnose("bound_without_neighbours_m", alone);
            }
            methods.push(done);
        }
        let anchors = (1..)
            .zip(&world.nodes)
            .map(|(number, place)| Anchor { name: format!("node {number}"), position: place.to_vec() });
        Ok(RunResult {
            run,
            nodes: vec!["target".to_owned()],
            anchors: anchors.collect(),
            bound: self.bound(&world),
            methods,
            ..RunResult::default()
        })
    }

    fn check(&self, (): &(), seed: u64, methods: &[String]) -> Result<Vec<GraphSummary>, PositioningError> {
        let world = World::simulate(&self.world, seed, 0);
        let most = world.hearings.iter().map(Vec::len).max();
        let step = world.hearings.iter().position(|heard| Some(heard.len()) == most).map_or(1, |k| k + 1);
        methods.iter().map(|id| self.summary(id, &world, step)).collect()
    }
}

impl PMpa {
    /// The graph of one scan, that of the scan before included.
    fn summary(&self, id: &str, world: &World, step: usize) -> Result<GraphSummary, PositioningError> {
        let method = self.method(id)?;
        let failed = |error| PositioningError::method(id, error);
        let mut filter = Filter::new(&self.world, method, world, 0).map_err(failed)?;
        filter.open(step).map_err(failed)?;
        let graph = filter.window.graph().map_err(|error| failed(error.into()))?;
        let forms = filter::form_uses(method, &self.world, world, step)
            .into_iter()
            .map(|(kind, form, edges)| FormUse { kind: kind.to_owned(), form, edges })
            .collect();
        let extent = format!("scan {step} of run 0, the one with the most neighbours, and its start");
        Ok(GraphSummary::new(id, extent, &graph, forms))
    }
}

#[cfg(test)]
mod tests;
