//! Gaussians on a grid: the same bits on one thread, on two, and without threads.

use crate::linear::{Linear, noise};
use nalgebra::{Matrix2, Vector2};
use rayon::ThreadPoolBuilder;
use sumprod_graph::schedule::Flooding;
use sumprod_graph::{Engine, Factor, FactorGraph, Message, Options, Space};
use sumprod_messages::{DynamicGaussian, Gaussian};

pub fn grid<M: Message>(side: usize) -> FactorGraph<M, Linear<2>>
where
    Linear<2>: Factor<M>,
{
    let mut graph = FactorGraph::new();
    let x: Vec<_> = (0..side * side).map(|_| graph.unnamed_variable(Space::real(2))).collect();
    for k in 0..side * side {
        let value = Vector2::new(noise(3, k as u64), noise(4, k as u64));
        graph.factor("value", Linear::unary(Matrix2::identity(), value), &x[k..=k]).unwrap();
        let step = Linear::pair([-Matrix2::identity(), Matrix2::identity()], value, Matrix2::identity());
        if k % side + 1 < side {
            graph.factor("right", step.clone(), &x[k..=k + 1]).unwrap();
        }
        if k + side < side * side {
            graph.factor("down", step, &[x[k], x[k + side]]).unwrap();
        }
    }
    graph
}

fn solve<M: Message + PartialEq>(
    graph: &FactorGraph<M, Linear<2>>,
    parallel: bool,
    threads: usize,
) -> (Vec<f64>, Vec<M>)
where
    Linear<2>: Factor<M>,
{
    let pool = ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    pool.install(|| {
        let options = Options { parallel, max_iterations: 20, tolerance: 0.0, ..Options::default() };
        let mut engine = Engine::new(graph, options).unwrap();
        let report = engine.run(&mut Flooding).unwrap();
        let beliefs = graph.variable_ids().map(|variable| engine.belief(variable).clone());
        (report.changes, beliefs.collect())
    })
}

fn check<M: Message + PartialEq + std::fmt::Debug>()
where
    Linear<2>: Factor<M>,
{
    let graph = grid::<M>(60);
    let reference = solve(&graph, false, 1);
    for (parallel, threads) in [(true, 1), (true, 2), (false, 2)] {
        assert!(solve(&graph, parallel, threads) == reference, "parallel {parallel}, {threads} threads");
    }
}

#[test]
fn threads_do_not_show_in_the_answer() {
    check::<Gaussian<2>>();
    check::<DynamicGaussian>();
}
