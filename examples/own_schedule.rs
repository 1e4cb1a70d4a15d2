//! A schedule of one's own: from the rim of a sensor network to its hub and back, against flooding.
//!
//! Arms of sensors reach out from a hub, and pairs of tips see each other, so that the graph has loops and no
//! order is exact. The hub knows where it is; offsets between neighbours are measured.

use std::cmp::Reverse;
use sumprod::graph::schedule::Refusal;
use sumprod::graph::{EdgeId, VariableId};
use sumprod::prelude::*;

/// All messages towards the hub, farthest first, then all others, nearest first.
struct HubFirst(VariableId, Vec<EdgeId>);

impl Schedule for HubFirst {
    fn begin(&mut self, topology: &Topology) -> Result<(), Refusal> {
        let mut hops = vec![usize::MAX; topology.variable_count()];
        hops[self.0.index()] = 0;
        let mut reached = vec![self.0];
        for next in 0.. {
            let Some(&variable) = reached.get(next) else { break };
            for own in topology.edges_of_variable(variable) {
                for edge in topology.edges_of_factor(topology.factor_of(own)) {
                    let other = topology.variable_of(edge);
                    if hops[other.index()] == usize::MAX {
                        hops[other.index()] = hops[variable.index()] + 1;
                        reached.push(other);
                    }
                }
            }
        }
        let of = |&edge: &EdgeId| hops[topology.variable_of(edge).index()];
        let farthest =
            |&edge: &EdgeId| topology.edges_of_factor(topology.factor_of(edge)).map(|e| of(&e)).max();
        let (mut inward, mut outward): (Vec<_>, Vec<_>) =
            topology.edges().partition(|e| Some(of(e)) < farthest(e));
        inward.sort_by_key(|edge| Reverse(of(edge)));
        outward.sort_by_key(of);
        self.1 = [inward, outward].concat();
        Ok(())
    }

    fn iteration(&mut self, _: &Topology, pass: &mut dyn Pass) -> Result<f64, GraphError> {
        pass.in_order(&self.1)
    }
}

/// Prints how many iterations each schedule takes to the same beliefs.
pub fn main() -> Result<(), Box<dyn std::error::Error>> {
    let (arms, length, space) = (6, 8, Space::real(2));
    let mut graph = FactorGraph::<DynamicGaussian>::new();
    let hub = graph.variable("hub", space.clone())?;
    graph.set_prior(hub, DynamicGaussian::from_moments(&[0.0, 0.0], &[0.01, 0.0, 0.0, 0.01])?)?;
    let mut pairs = Vec::new();
    let mut tips = Vec::new();
    for arm in 0..arms {
        tips.push(hub);
        for place in 0..length {
            let sensor = graph.variable(format!("arm {arm}, place {place}"), space.clone())?;
            pairs.push([std::mem::replace(&mut tips[arm], sensor), sensor]);
        }
    }
    pairs.extend(tips.chunks(2).map(|pair| [pair[0], pair[1]]));
    for (k, pair) in pairs.iter().enumerate() {
        let measured = [0.1 * (k % 7) as f64 - 0.3, 1.0 - 0.1 * (k % 5) as f64];
        let noise = Noise::isotropic(2, 0.04)?;
        graph.add("offset", RelativePosition::new(&measured, [2, 2], [&[0, 1], &[0, 1]], noise)?, pair)?;
    }

    let (mut flooding, mut hub_first) = (Flooding, HubFirst(hub, Vec::new()));
    let run = |name, schedule: &mut dyn Schedule| -> Result<f64, Box<dyn std::error::Error>> {
        let mut engine = Engine::new(&graph, Options::default())?;
        println!("{name}: {}", engine.run(schedule)?);
        Ok(engine.belief(tips[0]).moments()?.mean[0])
    };
    let apart = run("flooding", &mut flooding)? - run("hub first", &mut hub_first)?;
    (apart.abs() < 1e-6).then_some(()).ok_or("the schedules end at different beliefs".into())
}
