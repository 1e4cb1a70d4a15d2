//! System `cooperation`: agents that move, measure ranges to each other and to anchors, and locate themselves.
//!
//! | method | its keys | what it is |
//! |---|---|---|
//! | `joint` | `joint` | centralised iterated extended Kalman filter: the reference |
//! | `gaussian-bp` | | Gaussian belief propagation on time slices |
//! | `particle-bp` | `particles` | particle belief propagation, messages evaluated pointwise |
//! | `particle-bp-broadcast` | `particles`, `neighbours = "broadcast"` | the same with beliefs sent as they are (SPAWN) |
//! | `plug-in` | `neighbours = "plug-in"` | neighbours taken for anchors at their means |
//! | `anchors-only` | `neighbours = "ignored"` | every agent by itself |
//!
//! The methods are combinations of the keys of [`Method`], which a scenario may combine otherwise, edge by edge. The
//! model is that of [`World`]; positions are the state's components 0 and 2. Sources: Wymeersch, Lien and Win,
//! "Cooperative localization in wireless networks" (2009), for the graph; Ihler and McAllester, "Particle belief
//! propagation" (2009), for messages evaluated at the receiver's particles.

mod bound;
mod constraints;
mod geometry;
mod joint;
pub(crate) mod links;
mod method;
mod network;
mod plug_in;
mod world;

#[cfg(test)]
mod tests;

use std::path::Path;

use serde::{Deserialize, Serialize};
use sumprod_graph::{Factor, FactorGraph, GraphError, Options};
use sumprod_messages::{AnyForm, AnyMessage};

pub use bound::bound;
pub(crate) use constraints::names;
pub use joint::JointFilter;
pub use method::{Forms, Method};
pub use network::{Neighbours, NetworkFilter, Plan};
pub use world::{AnchorRanging, Draw, Ranging, Slice, State, World};

use crate::costs::Costs;
use crate::error::PositioningError;
use crate::form::FormSpec;
use crate::results::{Anchor, MethodRun, RunResult, StateLayout};
use crate::scenario::{FormUse, GraphSummary, Methods, RunRequest, Scenario};
use network::{DIMENSION, KINDS};

/// A scenario of system `cooperation`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Cooperation {
    /// The simulated network.
    pub world: World,
    /// The methods to compare.
    pub method: Methods<Method>,
}

impl Cooperation {
    fn run_method(&self, id: &str, draw: &Draw, seed: u64) -> Result<MethodRun, PositioningError> {
        let method = self.method.named(id)?;
        // The campaign spreads runs over threads; a run keeps to its own.
        let options = Options { seed, parallel: false, ..Options::default() };
        MethodRun::timed(id, StateLayout::planar_velocity(), |out| {
            if method.joint {
                run_joint(&self.world, draw, method.rounds, options, out)
            } else {
                run_network(&self.world, draw, method.plan(), options, out)
            }
        })
    }
}

fn run_network(
    world: &World,
    draw: &Draw,
    plan: Plan,
    options: Options,
    out: &mut MethodRun,
) -> Result<(), PositioningError> {
    let id = out.id.clone();
    let failed = |error: GraphError| PositioningError::method(&id, error);
    let mut filter = NetworkFilter::new(world, draw, plan, options).map_err(failed)?;
    out.notes.extend(plan.unused_products());
    let mut costs = Costs::default();
    for (k, slice) in (1..).zip(&draw.slices) {
        filter.step(slice).map_err(failed)?;
        filter.messages().for_each(|(kind, message)| costs.message(kind, message));
        for (agent, truth) in draw.truth[k].iter().enumerate() {
            let Some(belief) = filter.belief(agent) else { continue };
            costs.belief(belief);
            // As a Gaussian, because the moments of a collapsed cloud claim to know what its few particles do not.
            let gaussian = belief.to_gaussian().and_then(|(gaussian, _)| gaussian.moments());
            let moments = gaussian.map_err(|error| PositioningError::method(&id, error))?;
            out.push(k as u32, slice.time, agent as u32, truth, &moments.mean, &moments.covariance)?;
        }
    }
    costs.report(out);
    Ok(())
}

fn run_joint(
    world: &World,
    draw: &Draw,
    rounds: usize,
    options: Options,
    out: &mut MethodRun,
) -> Result<(), PositioningError> {
    let id = out.id.clone();
    let failed = |error: GraphError| PositioningError::method(&id, error);
    let mut filter = JointFilter::new(world, draw, rounds, options).map_err(failed)?;
    for (k, slice) in (1..).zip(&draw.slices) {
        filter.step(slice).map_err(failed)?;
        let Some(moments) = filter.moments().map_err(failed)? else { continue };
        for (agent, truth) in draw.truth[k].iter().enumerate() {
            let first = DIMENSION * agent;
            let covariance: Vec<f64> = (0..DIMENSION * DIMENSION)
                .map(|entry| moments.covariance_at(first + entry / DIMENSION, first + entry % DIMENSION))
                .collect();
            let mean = &moments.mean[first..first + DIMENSION];
            out.push(k as u32, slice.time, agent as u32, truth, mean, &covariance)?;
        }
    }
    Ok(())
}

impl Scenario for Cooperation {
    const SYSTEM: &'static str = "cooperation";
    const READS_DATA: bool = false;
    type Prepared = ();

    fn validate(&self) -> Result<(), PositioningError> {
        self.world.validate()?;
        self.method.iter().try_for_each(|(id, method)| method.validate(id))
    }

    fn methods(&self) -> Vec<String> {
        self.method.ids()
    }

    /// Refuses a network that floats, by its first draw.
    fn prepare(&self, seed: u64, _data: Option<&Path>) -> Result<(), PositioningError> {
        if self.world.prior {
            return Ok(());
        }
        constraints::refuse_free(&self.world, &self.world.draw(seed, 0)?)
    }

    fn run(&self, (): &(), request: RunRequest<'_>) -> Result<RunResult, PositioningError> {
        let draw = self.world.draw(request.seed, request.run)?;
        constraints::refuse_free(&self.world, &draw)?;
        let methods = request
            .methods
            .iter()
            .map(|id| self.run_method(id, &draw, request.method_seed(id)))
            .collect::<Result<_, _>>()?;
        let anchors = (1..).zip(&self.world.anchors);
        Ok(RunResult {
            run: request.run,
            nodes: (1..=self.world.agents).map(|number| format!("agent {number}")).collect(),
            anchors: anchors
                .map(|(number, place)| Anchor { name: format!("anchor {number}"), position: place.to_vec() })
                .collect(),
            bound: bound(&self.world, &draw)?,
            methods,
            ..RunResult::default()
        })
    }

    fn check(&self, (): &(), seed: u64, methods: &[String]) -> Result<Vec<GraphSummary>, PositioningError> {
        let draw = self.world.draw(seed, 0)?;
        let Some(slice) = draw.slices.first() else { return Ok(Vec::new()) };
        let summary = |id: &String| {
            let method = self.method.named(id)?;
            let failed = |error: GraphError| PositioningError::method(id, error);
            let (world, options) = (&self.world, Options::default());
            if method.joint {
                let filter = JointFilter::new(world, &draw, method.rounds, options).map_err(failed)?;
                return filter.describe(slice, |graph| summarise(id, graph)).map_err(failed);
            }
            let filter = NetworkFilter::new(world, &draw, method.plan(), options).map_err(failed)?;
            filter.describe(slice, |graph| summarise(id, graph)).map_err(failed)
        };
        methods.iter().map(summary).collect()
    }
}

fn summarise<F: Factor<AnyMessage>>(id: &str, graph: &FactorGraph<AnyMessage, F>) -> GraphSummary {
    let mut forms: Vec<FormUse> = Vec::new();
    for factor in graph.factor_ids() {
        let kind = graph.factor_kind(factor);
        let edges = graph.ports(factor).count();
        // A prediction goes one way: the form of what it leaves is the belief's.
        let Ok(edge) = graph.edge(factor, edges - 1) else { continue };
        let form: AnyForm = *graph.edge_form(edge);
        match forms.iter_mut().find(|form| form.kind == kind) {
            Some(form) => form.edges += edges,
            None => forms.push(FormUse { kind: kind.into(), form: FormSpec(form).to_string(), edges }),
        }
    }
    forms.sort_by_key(|form| KINDS.iter().position(|kind| *kind == form.kind));
    GraphSummary::new(id, "the start and the first slice", graph, forms)
}
