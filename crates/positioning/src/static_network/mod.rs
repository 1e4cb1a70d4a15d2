//! System `static-network`: agents that stand still and locate themselves by ranges alone.
//!
//! Flipped agents are the whole difficulty: whoever hears two anchors has two mirror images, and messages must carry
//! both until the network decides. The methods are combinations of the keys of [`Method`]:
//!
//! | method | its keys | what it is |
//! |---|---|---|
//! | `gaussian-bp` | no `cells` | linearised Gaussian messages from the weak start |
//! | `nbp` | `cells`, `rounds` | messages on a lattice of the plane, coarse and then fine |
//! | `nbp-refined` | and `gaussian_rounds`, `joint` | the same; edges into agents whose belief has become one mode turn Gaussian; the joint posterior around these beliefs has the last word |
//!
//! The model is that of [`World`]. Sources: Ihler, Fisher, Moses and Willsky, "Nonparametric belief propagation for
//! self-localization of sensor networks" (2005), which also takes silence for evidence.

mod anchorage;
mod folds;
mod joint;
mod loose;
mod method;
mod network;
mod posterior;
mod silence;
mod world;

#[cfg(test)]
mod tests;

use std::path::Path;

use serde::{Deserialize, Serialize};
use sumprod_graph::{FactorGraph, GraphError, Options};
use sumprod_messages::{LatticeForm, LatticeMessage};

use joint::Joint;
pub use method::Method;
pub use world::{Draw, World};

use crate::costs::Costs;
use crate::error::PositioningError;
use crate::results::{Anchor, MethodRun, RunResult, StateLayout};
use crate::scenario::{FormUse, GraphSummary, Methods, RunRequest, Scenario};
use network::{ANCHOR, RANGE, Run, SILENCE};

/// A scenario of system `static-network`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StaticNetwork {
    /// The simulated network.
    pub world: World,
    /// The methods to compare.
    pub method: Methods<Method>,
}

impl StaticNetwork {
    fn run_method(&self, id: &str, draw: &Draw, seed: u64) -> Result<MethodRun, PositioningError> {
        let method = self.method.named(id)?;
        let failed = |error: GraphError| PositioningError::method(id, error);
        let options = Options { seed, max_iterations: usize::MAX, ..Options::default() };
        let mut out = MethodRun::timed(id, StateLayout::planar_position(), |out| {
            let graph = network::graph(&self.world, draw, method).map_err(failed)?;
            let mut run = Run::new(&graph, &self.world, draw, options).map_err(failed)?;
            run.complete(method).map_err(failed)?;
            let joint = method.joint.then(|| run.joint(&self.world, draw, method)).transpose();
            let joint = joint.map_err(|error| PositioningError::method(id, error))?;
            report(&run, draw, joint.as_ref(), out)
        })?;
        let floating = anchorage::floating(draw).len();
        if floating > 0 {
            out.diagnose("agents_without_anchor", floating as f64);
        }
        Ok(out)
    }
}

fn report(
    run: &Run<'_>,
    draw: &Draw,
    joint: Option<&Joint>,
    out: &mut MethodRun,
) -> Result<(), PositioningError> {
    let mut costs = Costs::default();
    run.messages().for_each(|(kind, message)| costs.message(kind, message));
    let mut undecided = 0;
    for (agent, truth) in draw.truth.iter().enumerate() {
        let belief = run.belief(agent);
        costs.belief(belief);
        undecided += usize::from(belief.lattice().is_some());
        let (mean, covariance) = match joint {
            Some(joint) => joint.moments[agent],
            None => belief.moments().map_err(|error| PositioningError::method(&out.id, error))?,
        };
        out.push(0, 0.0, agent as u32, truth, mean.as_slice(), covariance.as_slice())?;
    }
    costs.report(out);
    out.diagnose("iterations", run.iterations as f64);
    out.diagnose("form_changes", run.changes.edges as f64);
    if run.changes.edges > 0 {
        out.diagnose("agents_left_on_lattice", undecided as f64);
        let note = "edges into an agent whose belief had become one mode changed from lattice to Gaussian during the \
                    run; `form_changes` counts them";
        out.notes.push(note.into());
    }
    if let Some(joint) = joint {
        out.diagnose("folds_undone", joint.folds_undone as f64);
        out.diagnose("mirror_images", joint.images as f64);
        out.diagnose("agents_on_an_arc", joint.on_an_arc as f64);
    }
    Ok(())
}

impl Scenario for StaticNetwork {
    const SYSTEM: &'static str = "static-network";
    const READS_DATA: bool = false;
    type Prepared = ();

    fn validate(&self) -> Result<(), PositioningError> {
        self.world.validate()?;
        self.method.iter().try_for_each(|(id, method)| method.validate(id, self.world.radius))
    }

    fn methods(&self) -> Vec<String> {
        self.method.ids()
    }

    /// Refuses a network that floats, by its first draw.
    fn prepare(&self, seed: u64, _data: Option<&Path>) -> Result<(), PositioningError> {
        anchorage::refuse_floating(&self.world.draw(seed, 0)?)
    }

    fn run(&self, (): &(), request: RunRequest<'_>) -> Result<RunResult, PositioningError> {
        let draw = self.world.draw(request.seed, request.run)?;
        anchorage::refuse_floating(&draw)?;
        let methods = request
            .methods
            .iter()
            .map(|id| self.run_method(id, &draw, request.method_seed(id)))
            .collect::<Result<_, _>>()?;
        let anchors = (1..).zip(&draw.anchors);
        Ok(RunResult {
            run: request.run,
            nodes: (1..=self.world.agents).map(|number| format!("agent {number}")).collect(),
            anchors: anchors
                .map(|(number, place)| Anchor { name: format!("anchor {number}"), position: place.to_vec() })
                .collect(),
            methods,
            ..RunResult::default()
        })
    }

    fn check(&self, (): &(), seed: u64, methods: &[String]) -> Result<Vec<GraphSummary>, PositioningError> {
        let draw = self.world.draw(seed, 0)?;
        let summary = |id: &String| {
            let graph = network::graph(&self.world, &draw, self.method.named(id)?)
                .map_err(|error| PositioningError::method(id, error))?;
            Ok(summarise(id, &graph, &draw))
        };
        methods.iter().map(summary).collect()
    }
}

fn summarise(id: &str, graph: &FactorGraph<LatticeMessage>, draw: &Draw) -> GraphSummary {
    let forms = [ANCHOR, RANGE, SILENCE].into_iter().filter_map(|kind| {
        let mut edges = graph
            .factor_ids()
            .filter(|&factor| graph.factor_kind(factor) == kind)
            .flat_map(|factor| {
                (0..graph.ports(factor).count()).filter_map(move |port| graph.edge(factor, port).ok())
            })
            .peekable();
        let form = match graph.edge_form(*edges.peek()?) {
            LatticeForm::Gaussian(_) => "gaussian".to_owned(),
            LatticeForm::Lattice { width, most } => format!("lattice {width} m, at most {most} cells"),
        };
        Some(FormUse { kind: kind.to_owned(), form, edges: edges.count() })
    });
    let floating = anchorage::floating(draw);
    let unconstrained = (!floating.is_empty()).then(|| {
        let who = crate::cooperation::names(&floating);
        format!("no chain of ranges leads from {who} to an anchor: their weak start alone holds them")
    });
    GraphSummary {
        unconstrained: unconstrained.into_iter().collect(),
        ..GraphSummary::new(id, "the network of the first run", graph, forms.collect())
    }
}
