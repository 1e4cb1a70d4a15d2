use sumprod_fusion::{FusionError, InformationGraph};
use sumprod_graph::Space;
use sumprod_messages::{Categorical, Gaussian};

use crate::support::{World, below, random};

/// A random graph: observations and communications of several parents, of any past states.
fn drawn(seed: u64) -> InformationGraph {
    let mut random = random(seed);
    let mut graph = InformationGraph::new();
    let nodes = 3 + below(&mut random, 3);
    let mut states = Vec::new();
    for k in 0..nodes {
        let node = graph.add_node(format!("node {k}"));
        states.push(graph.latest(node).unwrap());
    }
    for step in 1..12 {
        let node = below(&mut random, nodes);
        let time = f64::from(step);
        if below(&mut random, 2) == 0 {
            states.push(graph.observe(node, time).unwrap());
        } else {
            let parents: Vec<_> =
                (0..1 + below(&mut random, 3)).map(|_| states[below(&mut random, states.len())]).collect();
            states.push(graph.communicate(&parents, node, time).unwrap());
        }
    }
    graph
}

/// Every belief by its plan is the posterior of its set; returns how many graphs had a plan for every event.
fn exact<M: World>(space: &Space, tolerance: f64) -> u32 {
    let mut planned = 0;
    for seed in 0..200 {
        let graph = drawn(seed);
        match graph.beliefs::<M>(space, &M::prior(), |item| Ok(M::likelihood(item))) {
            Ok(beliefs) => {
                planned += 1;
                for ((id, event), belief) in graph.events().zip(&beliefs) {
                    if event.information.contains(sumprod_fusion::Item::PRIOR) {
                        let error = belief.distance(&M::posterior(&event.information));
                        assert!(error < tolerance, "graph {seed}, event {}: {error:e}", id.index());
                    }
                }
            }
            Err(FusionError::Loop { .. }) => {}
            Err(error) => panic!("graph {seed}: {error}"),
        }
    }
    planned
}

#[test]
fn gaussian_beliefs_by_plan_are_the_posteriors() {
    assert!(exact::<Gaussian<2>>(&Space::real(2), 1e-12) > 100);
}

#[test]
fn categorical_beliefs_by_plan_are_the_posteriors() {
    assert!(exact::<Categorical>(&Space::Finite(3), 1e-12) > 100);
}

#[test]
fn a_shared_sensor_is_found_and_must_be_forwarded() {
    let mut graph = InformationGraph::new();
    let [s1, s3, s5, f1, f2, f3] = ["s1", "s3", "s5", "F1", "F2", "F3"].map(|name| graph.add_node(name));
    let [z1, z3, z5] = [s1, s3, s5].map(|node| graph.observe(node, 1.0).unwrap());
    let left = graph.communicate(&[z1, z3], f1, 1.0).unwrap();
    let right = graph.communicate(&[z3, z5], f2, 1.0).unwrap();
    let top = graph.communicate(&[left, right], f3, 1.0).unwrap();
    let common = graph.common(&[left, right]).unwrap();
    assert!(common.complete);
    assert_eq!(common.events, [z3]);
    let plan = graph.plan(top).unwrap();
    // The prior of F3 is part of both, and drops out.
    assert_eq!(plan.terms.iter().map(|(_, count)| count).sum::<i32>(), 1);
    assert!(
        plan.terms.contains(&(z3, -1)) && plan.terms.contains(&(left, 1)) && plan.terms.contains(&(right, 1))
    );
    assert_eq!(plan.forwarded, [z3]);
    let redundant = graph.redundancies();
    assert_eq!((redundant.len(), redundant[0].from, redundant[0].removable), (1, right, false));
    assert_eq!(graph.silent(), [f3]);
    let svg = graph.svg();
    assert!(svg.contains("stroke-dasharray") && svg.contains(">F3</text>") && svg.ends_with("</svg>\n"));
}

#[test]
fn memory_without_feedback_is_redundant_and_removable() {
    let mut graph = InformationGraph::new();
    let [low, high] = ["low", "high"].map(|name| graph.add_node(name));
    for step in 1..4 {
        let seen = graph.observe(low, f64::from(step)).unwrap();
        graph.communicate(&[seen], high, f64::from(step)).unwrap();
    }
    let redundant = graph.redundancies();
    assert_eq!(redundant.len(), 2);
    assert!(redundant.iter().all(|r| r.removable));
    assert_eq!(redundant[1].information.len(), 2);
}

#[test]
fn a_graph_survives_serialisation() {
    let graph = drawn(5);
    let text = serde_json::to_string(&graph).unwrap();
    let read: InformationGraph = serde_json::from_str(&text).unwrap();
    assert_eq!(read.svg(), graph.svg());
}
