//! Flooding on a square grid of two-dimensional Gaussians, boxed factors, one core.
//!
//! The graph of the peers' workload W2: every node observed, every grid edge a measured displacement with an
//! anisotropic information matrix. One message is one directed message of a pairwise factor.
//!
//! `cargo bench --bench grid [SIDE]`

#[path = "common.rs"]
mod common;

use common::{Timing, information};
use nalgebra::Vector2;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;
use sumprod::prelude::*;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    for side in common::sizes(&[30, 100, 300]) {
        let graph = grid(side)?;
        let messages = 2 * 2 * side * (side - 1);
        let options = Options { parallel: false, max_iterations: 20, tolerance: 0.0, ..Options::default() };
        let mut engine = Engine::new(&graph, options)?;
        engine.run(&mut Flooding)?;
        let timing = Timing::of(7, || engine.run(&mut Flooding).map(|_| ()))?;
        let nanoseconds = timing.median() / 20.0 / messages as f64 * 1e9;
        println!(
            "grid {side} x {side}: {messages} messages, {nanoseconds:.1} ns a message (median of {timing})"
        );
    }
    Ok(())
}

fn grid(side: usize) -> Result<FactorGraph<Gaussian<2>>, Box<dyn std::error::Error>> {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(7);
    let mut normal = move || -> f64 { StandardNormal.sample(&mut random) };
    let mut graph = FactorGraph::new();
    let mut truth = Vec::new();
    let mut nodes = Vec::new();
    let mut shapes = Xoshiro256PlusPlus::seed_from_u64(8);
    for _ in 0..side * side {
        let node = graph.unnamed_variable(Space::real(2));
        let place = Vector2::new(3.0 * normal(), 3.0 * normal());
        let observed = place + Vector2::new(3.0 * normal(), 3.0 * normal());
        let weight = information(&mut shapes, 0.05, 0.2);
        graph.set_prior(node, Gaussian::from_information(weight, weight * observed))?;
        truth.push(place);
        nodes.push(node);
    }
    for row in 0..side {
        for column in 0..side {
            let here = row * side + column;
            for there in [(column + 1 < side).then_some(here + 1), (row + 1 < side).then_some(here + side)] {
                let Some(there) = there else { continue };
                let measured = truth[there] - truth[here] + Vector2::new(normal(), normal());
                let factor = Displacement::from_information(measured, information(&mut shapes, 0.5, 2.0))?;
                graph.factor("", Box::new(factor) as Box<dyn Factor<_>>, &[nodes[here], nodes[there]])?;
            }
        }
    }
    Ok(graph)
}
