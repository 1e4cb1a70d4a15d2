//! System `wsn`: one target tracked by a network of range sensors whose measurements a sink gathers.
//!
//! | algorithm | belief | source |
//! |---|---|---|
//! | `iekf` | Gaussian, iterated extended Kalman | Bell, Cathey 1993 |
//! | `bootstrap` | particles, weighed | Gordon, Salmond, Smith 1993 |
//! | `regularised` | particles, drawn from kernels and weighed | Musso, Oudjane, Le Gland 2001 |
//! | `random-walk`, `independence` | particles, moved by Markov chains | Gilks, Berzuini 2001 |
//! | `quantum-literal` | the likeliest points that strings of bits have found | Yang, Peng, Wang, Wang 2010, as printed |
//! | `quantum-importance`, `quantum-metropolis` | particles moved by strings of bits, as a sample of the posterior | the same, corrected |
//!
//! All particle filters are [`DrivenFilter`](sumprod_filters::DrivenFilter) with one
//! [`Move`](sumprod_optimizers::Move) or another. The world is described in [`world`]; sensors may be scattered, fail,
//! and be asked a few at a time ([`schedule`]). Source: Yang, Peng, Wang, Wang, "Tracking algorithms based on quantum
//! genetic particle filter for WSN" (2010).

mod acquisition;
pub mod method;
pub mod ranges;
pub mod schedule;
mod tracker;
pub mod world;

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::error::PositioningError;
use crate::results::{Anchor, BoundStep, MethodRun, RunResult, Segment, StateLayout};
use crate::scenario::{FormUse, GraphSummary, Methods, RunRequest, Scenario};
use crate::tracking::Recursion;
use method::MethodSettings;
use world::{World, WorldSettings};

/// A scenario of system `wsn`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Wsn {
    /// The simulated world.
    #[serde(default)]
    pub world: WorldSettings,
    /// The methods to compare.
    pub method: Methods<MethodSettings>,
}

impl Wsn {
    /// Before, during and after an outage.
    fn segments(&self) -> Vec<Segment> {
        let Some([first, last]) = self.world.outage else { return Vec::new() };
        let parts = [
            ("before", 1, first.saturating_sub(1)),
            ("outage", first.max(1), last),
            ("after", last.saturating_add(1), u32::MAX),
        ];
        let within = |(name, first, last): (&str, u32, u32)| Segment {
            name: name.to_owned(),
            first,
            last: last.min(self.world.steps),
        };
        parts.map(within).into_iter().filter(|segment| segment.first <= segment.last).collect()
    }

    /// The bound of whoever hears every reading that reaches the sink.
    fn bound(&self, world: &World) -> Vec<BoundStep> {
        let settings = &self.world;
        let mut bound = Recursion::new(settings.prior_variance, settings.interval, settings.process_variance);
        let scans = world.scans.iter().zip(&world.truth[1..]);
        (1..)
            .zip(scans)
            .map(|(step, (scan, state))| {
                bound.predict();
                for reading in &scan.readings {
                    bound.range(state, world.sensors[reading.sensor], settings.measurement_variance);
                }
                let time = f64::from(step) * settings.interval;
                BoundStep { step, time, position_variance: bound.position_variance() }
            })
            .collect()
    }
}

impl Scenario for Wsn {
    const SYSTEM: &'static str = "wsn";
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
        let chosen: Vec<&MethodSettings> =
            request.methods.iter().map(|id| self.method.named(id)).collect::<Result<_, _>>()?;
        let world = World::simulate(&self.world, request.seed, request.run);
        let mut methods = Vec::with_capacity(chosen.len());
        for (id, method) in request.methods.iter().zip(chosen) {
            let seed = request.method_seed(id);
            methods.push(MethodRun::timed(id, StateLayout::planar_velocity(), |out| {
                tracker::follow(&self.world, method, &world, seed, out)
            })?);
        }
        let anchors = (1..)
            .zip(&world.sensors)
            .map(|(number, place)| Anchor { name: format!("sensor {number}"), position: place.to_vec() });
        Ok(RunResult {
            run: request.run,
            nodes: vec!["target".to_owned()],
            anchors: anchors.collect(),
            bound: self.bound(&world),
            methods,
            segments: self.segments(),
            ..RunResult::default()
        })
    }

    fn check(&self, (): &(), _seed: u64, methods: &[String]) -> Result<Vec<GraphSummary>, PositioningError> {
        let mut summaries = Vec::with_capacity(methods.len());
        for id in methods {
            let method = self.method.named(id)?;
            let sensors = method.active.unwrap_or(usize::MAX).min(self.world.sensors as usize);
            let form = if method.algorithm.has_particles() {
                format!("particles {}", method.count())
            } else {
                "gaussian".to_owned()
            };
            let mut unconstrained = Vec::new();
            if sensors == 1 {
                let free = "nothing constrains the bearing of the target from the only sensor asked; a second sensor would";
                unconstrained.push(free.to_owned());
            }
            summaries.push(GraphSummary {
                method: id.clone(),
                extent: "one scan at which every sensor asked hears the target, and the state before"
                    .to_owned(),
                variables: 2,
                factors: 1 + sensors,
                edges: 2 + sensors,
                components: 1,
                loops: 0,
                forms: vec![
                    FormUse { kind: "prediction".to_owned(), form: form.clone(), edges: 2 },
                    FormUse { kind: "range".to_owned(), form, edges: sensors },
                ],
                unconstrained,
            });
        }
        Ok(summaries)
    }
}

#[cfg(test)]
mod tests;
