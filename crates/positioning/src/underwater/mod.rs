//! System `underwater`: nodes that move in the sea, whose clocks are wrong, and anchors that speak.
//!
//! | method | hears | estimates |
//! |---|---|---|
//! | `one-way` | anchors | position, velocity and clock |
//! | `window` | anchors, and other nodes if told so | the same, over the latest frames together |
//! | `two-way` | anchors' round trips, the node moving meanwhile | position and velocity |
//! | `jsl` | the same, taken for ranges of one instant | position and velocity |
//! | `two-step` | anchors, by a clock that was set once | position and velocity |
//! | `direct` | anchors, as if its clock were right | position and velocity |
//!
//! All methods of a run have the same world and begin with the same solve of the beacons that nodes hear before they move
//! ([`start`]). Source: Gao, Wang, Chen, Shen, "A one-way prediction based joint self-localization and synchronization
//! algorithm for mobile underwater acoustic asynchronous networks", Journal of Electronics & Information Technology
//! 44(6), 2022. Its state is (a, b) of f(t) = a t + b; this one is the clock of the present, which is the same model and
//! stays well conditioned at any epoch.

pub mod method;
pub mod settings;
pub mod start;
mod track;
mod window;
pub mod world;

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::error::PositioningError;
use crate::results::{Anchor, MethodRun, RunResult};
use crate::scenario::{FormUse, GraphSummary, Methods, RunRequest, Scenario};
use method::{Algorithm, MethodSettings};
use settings::WorldSettings;
use start::Start;
use track::View;
use world::Draw;

/// A scenario of system `underwater`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Underwater {
    /// The simulated world.
    pub world: WorldSettings,
    /// The methods to compare.
    pub method: Methods<MethodSettings>,
}

impl Underwater {
    fn starts(&self, draw: &Draw) -> Result<Vec<Start>, PositioningError> {
        (0..draw.nodes.len()).map(|node| start::locate(&self.world, draw, node)).collect()
    }

    /// The graph of one frame of all nodes.
    fn summary(&self, id: &str, method: &MethodSettings) -> GraphSummary {
        let (nodes, anchors) = (self.world.nodes as usize, self.world.anchor_count as usize);
        let hearings = if method.cooperative { nodes * self.world.heard_nodes as usize } else { 0 };
        let (variables, factors) = (2 * nodes, nodes * (1 + anchors) + hearings);
        let edges = nodes * (2 + anchors) + 2 * hearings;
        let components = if hearings > 0 { 1 } else { nodes };
        let of = |kind: &str, edges| FormUse { kind: kind.to_owned(), form: "gaussian".to_owned(), edges };
        let heard = match method.algorithm {
            Algorithm::OneWay | Algorithm::Window => "pseudo-range",
            Algorithm::TwoWay => "round-trip",
            Algorithm::Jsl | Algorithm::TwoStep | Algorithm::Direct => "range",
        };
        let forms = [of("motion", 2 * nodes), of(heard, nodes * anchors), of("node", 2 * hearings)];
        GraphSummary {
            method: id.to_owned(),
            extent: "one frame of all nodes and the states before it".to_owned(),
            variables,
            factors,
            edges,
            components,
            loops: edges + components - variables - factors,
            forms: forms.into_iter().filter(|form| form.edges > 0).collect(),
            unconstrained: Vec::new(),
        }
    }
}

impl Scenario for Underwater {
    const SYSTEM: &'static str = "underwater";
    const READS_DATA: bool = false;
    type Prepared = ();

    fn validate(&self) -> Result<(), PositioningError> {
        self.world.validate()?;
        self.method.iter().try_for_each(|(id, method)| method.validate(id, &self.world))
    }

    fn methods(&self) -> Vec<String> {
        self.method.ids()
    }

    fn prepare(&self, _seed: u64, _data: Option<&Path>) -> Result<(), PositioningError> {
        Ok(())
    }

    fn run(&self, (): &(), request: RunRequest<'_>) -> Result<RunResult, PositioningError> {
        let draw = world::simulate(&self.world, request.seed, request.run)?;
        let starts = self.starts(&draw)?;
        let mut methods = Vec::with_capacity(request.methods.len());
        for id in request.methods {
            let method = self.method.named(id)?;
            let view = View { world: &self.world, method, draw: &draw, starts: &starts };
            let mut done = MethodRun::timed(id, track::layout(method), |out| match method.algorithm {
                Algorithm::Window => view.smooth(out),
                _ => view.filter(out),
            })?;
            view.tell(&mut done);
            methods.push(done);
        }
        let anchor = |(k, place): (usize, &[f64; 3])| Anchor {
            name: format!("anchor {}", k + 1),
            position: place.to_vec(),
        };
        Ok(RunResult {
            run: request.run,
            nodes: (1..=draw.nodes.len()).map(|node| format!("node {node}")).collect(),
            anchors: draw.anchors.iter().enumerate().map(anchor).collect(),
            methods,
            ..RunResult::default()
        })
    }

    fn check(&self, (): &(), seed: u64, methods: &[String]) -> Result<Vec<GraphSummary>, PositioningError> {
        let draw = world::simulate(&self.world, seed, 0)?;
        let free = match self.starts(&draw) {
            Ok(_) => Vec::new(),
            Err(error) => vec![error.to_string()],
        };
        let summary = |id: &String| -> Result<GraphSummary, PositioningError> {
            Ok(GraphSummary { unconstrained: free.clone(), ..self.summary(id, self.method.named(id)?) })
        };
        methods.iter().map(summary).collect()
    }
}

#[cfg(test)]
mod tests;
