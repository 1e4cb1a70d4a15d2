//! After warm-up no message of fixed size allocates: counted by a global allocator.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests fail the test")]

#[path = "it/linear.rs"]
#[allow(dead_code, reason = "shared with the tests beside, which use the rest")]
mod linear;

use linear::Linear;
use nalgebra::{SMatrix, SVector};
use sumprod_graph::schedule::{Flooding, ForwardBackward, Sequential};
use sumprod_graph::{
    Engine, Factor, FactorGraph, GraphError, Message, Options, Pass, Schedule, Space, Topology,
};
use sumprod_messages::{DynamicGaussian, Gaussian};

/// Runs a schedule and notes the allocations of each iteration.
struct Counted<S> {
    schedule: S,
    allocations: Vec<u64>,
}

impl<S: Schedule> Schedule for Counted<S> {
    fn begin(&mut self, topology: &Topology) -> Result<(), sumprod_graph::schedule::Refusal> {
        self.allocations.reserve(64);
        self.schedule.begin(topology)
    }

    fn iteration(&mut self, topology: &Topology, pass: &mut dyn Pass) -> Result<f64, GraphError> {
        let mut change = Ok(0.0);
        let counted = allocation_counter::measure(|| change = self.schedule.iteration(topology, pass));
        self.allocations.push(counted.count_total);
        change
    }

    fn iterations(&self) -> Option<usize> {
        self.schedule.iterations()
    }
}

fn unary<const D: usize>(k: usize) -> Linear<D> {
    Linear::unary(SMatrix::identity(), SVector::repeat(k as f64))
}

fn pair<const D: usize>() -> Linear<D> {
    let one = SMatrix::<f64, D, D>::identity();
    Linear::pair([-one, one], SVector::repeat(1.0), one * 0.5)
}

/// A chain (`side` 1) or grid with a factor on every variable and between neighbours.
fn graph<M: Message, const D: usize>(side: usize, count: usize) -> FactorGraph<M, Box<dyn Factor<M>>>
where
    Linear<D>: Factor<M>,
{
    let mut graph: FactorGraph<M> = FactorGraph::new();
    let x: Vec<_> = (0..count).map(|_| graph.unnamed_variable(Space::real(D))).collect();
    for k in 0..count {
        graph.factor("unary", Box::new(unary::<D>(k)), &x[k..=k]).unwrap();
        if k + 1 < count && (side == 1 || (k + 1) % side != 0) {
            graph.factor("pair", Box::new(pair::<D>()), &x[k..=k + 1]).unwrap();
        }
        if side > 1 && k + side < count {
            graph.factor("pair", Box::new(pair::<D>()), &[x[k], x[k + side]]).unwrap();
        }
    }
    graph
}

fn check<M: Message, const D: usize>(what: &str)
where
    Linear<D>: Factor<M>,
{
    let (chain, grid) = (graph::<M, D>(1, 100), graph::<M, D>(10, 100));
    let options = Options { parallel: false, tolerance: 0.0, max_iterations: 6, ..Options::default() };
    none(&chain, options, ForwardBackward::iterated(6), &format!("forward-backward, {what}"));
    for damping in [0.0, 0.2] {
        let options = Options { damping, ..options };
        none(&grid, options, Flooding, &format!("flooding, {what}, damping {damping}"));
        none(&grid, options, Sequential::default(), &format!("sequential, {what}, damping {damping}"));
    }
}

fn none<M: Message>(graph: &FactorGraph<M>, options: Options, schedule: impl Schedule, what: &str) {
    let mut counted = Counted { schedule, allocations: Vec::new() };
    let mut engine = Engine::new(graph, options).unwrap();
    engine.run(&mut counted).unwrap();
    assert!(counted.allocations.len() > 1, "{what}: nothing was measured");
    assert!(counted.allocations[1..].iter().all(|&count| count == 0), "{what}: {:?}", counted.allocations);
}

#[test]
fn the_counter_counts() {
    let counted = allocation_counter::measure(|| drop(std::hint::black_box(vec![1.0; 10])));
    assert_eq!(counted.count_total, 1);
}

#[test]
fn no_message_allocates_after_warm_up() {
    check::<Gaussian<2>, 2>("two coordinates");
    check::<Gaussian<4>, 4>("four coordinates");
    check::<DynamicGaussian, 1>("dynamic, one coordinate");
    check::<DynamicGaussian, 3>("dynamic, three coordinates");
    check::<DynamicGaussian, 5>("dynamic, five coordinates");
}
