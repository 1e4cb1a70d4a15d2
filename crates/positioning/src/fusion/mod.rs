//! System `fusion`: one target seen by several sensors whose nodes tell each other what they believe.
//!
//! | method | rule | exchange | source |
//! |---|---|---|---|
//! | `centralised` | every measurement in one filter | none | |
//! | `removal` | what both hold is divided out | collected at the top | (9), (10) |
//! | `removal-feedback` | the same | and distributed | (11) to (16) |
//! | `naive`, `naive-feedback` | nothing is divided out | as above; on the ring among neighbours | |
//! | `ci` | covariance intersection | collected; on the ring among neighbours | Julier, Uhlmann 1997 |
//! | `no-shared` | what an edge carried before is divided out, the shared sensor is not | collected | |
//! | `one-hop` | neighbours' own observations | among neighbours | |
//! | `spanning-tree`, `loop` | what the edge carried before is divided out | among neighbours, without or with the loop's last link | Grime, Durrant-Whyte 1994 |
//! | `auto` | removal, until a loop is noticed; then an intersection | among neighbours | |
//!
//! These are combinations of the keys of [`method::MethodSettings`]; a scenario may have others. Every method sees the
//! same draws. The world is described in [`world`], who talks to whom in [`structure`].
//!
//! Source: Wang, Peng, Zhu, "Removing redundant information by Bayesian algorithm" (2018). Its equations and its model
//! are lost; both are reconstructed.

pub mod method;
mod network;
mod recording;
pub mod structure;
pub mod world;

#[cfg(test)]
mod tests;

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::error::PositioningError;
use crate::results::{MethodRun, OutputFile, RunResult, StateLayout};
use crate::scenario::{FormUse, GraphSummary, Methods, RunRequest, Scenario};
use method::{FusionRule, MethodSettings};
use structure::Structure;
use world::WorldSettings;

/// A scenario of system `fusion`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fusion {
    /// The simulated world.
    pub world: WorldSettings,
    /// The methods to compare.
    pub method: Methods<MethodSettings>,
}

impl Scenario for Fusion {
    const SYSTEM: &'static str = "fusion";
    const READS_DATA: bool = false;
    type Prepared = Structure;

    fn validate(&self) -> Result<(), PositioningError> {
        self.world.validate()?;
        self.method.iter().try_for_each(|(id, method)| method.validate(id, &self.world))
    }

    fn methods(&self) -> Vec<String> {
        self.method.ids()
    }

    fn prepare(&self, _seed: u64, _data: Option<&Path>) -> Result<Structure, PositioningError> {
        Ok(Structure::new(self.world.structure, self.world.sensors as usize))
    }

    fn run(&self, structure: &Structure, request: RunRequest<'_>) -> Result<RunResult, PositioningError> {
        let world = self.world.simulate(request.seed, request.run);
        let central = network::centralised(&self.world, &world)?;
        let mut methods = Vec::with_capacity(request.methods.len());
        let mut files = Vec::new();
        for id in request.methods {
            let method = self.method.named(id)?;
            methods.push(MethodRun::timed(id, StateLayout::planar_position(), |out| {
                network::run(&self.world, structure, method, &world, &central, out)
            })?);
            if request.run == 0 && method.rule != FusionRule::Centralised {
                let drawing = recording::record(&self.world, structure, method)
                    .map_err(|error| PositioningError::method(id, error))?;
                files.push(OutputFile {
                    name: format!("information-graph-{id}.svg"),
                    contents: drawing.svg(),
                });
            }
        }
        Ok(RunResult {
            run: request.run,
            nodes: structure.names.clone(),
            methods,
            files,
            ..RunResult::default()
        })
    }

    fn check(
        &self,
        structure: &Structure,
        _seed: u64,
        methods: &[String],
    ) -> Result<Vec<GraphSummary>, PositioningError> {
        methods.iter().map(|id| Ok(summary(id, self.method.named(id)?, structure))).collect()
    }
}

/// One copy of the state at every node, equality along every link, one likelihood a sensor.
fn summary(id: &str, method: &MethodSettings, structure: &Structure) -> GraphSummary {
    let (nodes, links) = match method.rule {
        FusionRule::Centralised => (1, 0),
        _ => (structure.names.len(), structure.links(method).len()),
    };
    let of = |kind: &str, edges| FormUse { kind: kind.to_owned(), form: "gaussian".to_owned(), edges };
    GraphSummary {
        method: id.to_owned(),
        extent: "one step".to_owned(),
        variables: nodes,
        factors: links + structure.sensors,
        edges: 2 * links + structure.sensors,
        components: 1,
        loops: (links + 1).saturating_sub(nodes),
        forms: vec![of("communication", 2 * links), of("measurement", structure.sensors)],
        unconstrained: Vec::new(),
    }
}
