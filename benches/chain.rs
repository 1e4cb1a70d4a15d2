//! Forward-backward smoothing of a four-dimensional constant-velocity chain: all means and covariances, one core.
//!
//! The model of the peers' workload W1: dt = 0.1, two-dimensional position observations, process noise of full
//! rank. The transition is one factor shared by all steps; the time includes building messages and reading every
//! mean and covariance, not building the graph.
//!
//! `cargo bench --bench chain [STEPS]`

#[path = "common.rs"]
mod common;

use common::Timing;
use nalgebra::{Matrix2, Matrix2x4, Matrix4, Matrix4x2, Vector2, Vector4};
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;
use std::hint::black_box;
use std::sync::Arc;
use sumprod::prelude::*;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    for steps in common::sizes(&[1_000, 10_000, 100_000, 1_000_000]) {
        let graph = chain(steps)?;
        let options = Options { parallel: false, ..Options::default() };
        let repeats = (2_000_000 / steps).clamp(5, 200);
        let mut engine = Engine::new(&graph, options)?;
        let mut schedule = ForwardBackward::new();
        engine.run(&mut schedule)?;
        let timing = Timing::of(repeats, || -> Result<(), Box<dyn std::error::Error>> {
            engine.run(&mut schedule)?;
            for variable in graph.variable_ids() {
                black_box(engine.belief(variable).moments()?);
            }
            Ok(())
        })?;
        let microseconds = timing.median() / steps as f64 * 1e6;
        println!("chain of {steps}: {microseconds:.3} us a step (median of {timing})");
    }
    Ok(())
}

type Shared = Arc<dyn Factor<Gaussian<4>>>;

fn chain(steps: usize) -> Result<FactorGraph<Gaussian<4>, Shared>, Box<dyn std::error::Error>> {
    let (dt, q, r) = (0.1, 1.0, 0.5);
    let mut transition = Matrix4::<f64>::identity();
    (transition[(0, 2)], transition[(1, 3)]) = (dt, dt);
    let gain = Matrix4x2::new(dt * dt / 2.0, 0.0, 0.0, dt * dt / 2.0, dt, 0.0, 0.0, dt);
    let process = gain * gain.transpose() * q * q + Matrix4::identity() * 1e-4;
    let observe = Matrix2x4::new(1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0);
    let weight = observe.transpose() * Matrix2::identity() / (r * r);

    let mut random = Xoshiro256PlusPlus::seed_from_u64(1);
    let mut normal = move || -> f64 { StandardNormal.sample(&mut random) };
    let step: Shared =
        Arc::new(LinearPair::new(&-transition, &Matrix4::identity(), &Vector4::zeros(), &process)?);
    let root = process.cholesky().ok_or("the process noise is singular")?.l();
    let mut graph = FactorGraph::new();
    let mut state = Vector4::new(normal(), normal(), 1.0 + 2.0 * normal(), 1.0 + 2.0 * normal());
    let mut previous = None;
    for _ in 0..steps {
        let variable = graph.unnamed_variable(Space::real(4));
        if let Some(previous) = previous {
            state = transition * state + root * Vector4::from_fn(|_, _| normal());
            graph.factor("", step.clone(), &[previous, variable])?;
        }
        let observed = observe * state + Vector2::new(normal(), normal()) * r;
        let mut evidence = Gaussian::from_information(weight * observe, weight * observed);
        if previous.is_none() {
            let prior = Matrix4::from_diagonal(&Vector4::new(1.0, 1.0, 4.0, 4.0));
            evidence = evidence.times(&Gaussian::from_moments(Vector4::new(0.0, 0.0, 1.0, 1.0), prior)?);
        }
        graph.set_prior(variable, evidence)?;
        previous = Some(variable);
    }
    Ok(graph)
}
