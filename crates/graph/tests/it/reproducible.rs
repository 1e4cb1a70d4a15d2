//! The same bits on one thread, on two, and without threads.

use crate::bell::{Behaviour, Bell, Graph, Linear, grid, variables};
use rayon::ThreadPoolBuilder;
use sumprod_graph::schedule::{Coloured, Flooding, Residual, Sequential, Sliced};
use sumprod_graph::{Engine, GraphError, Options, Report, Schedule};

/// Beliefs and report of a fixed number of iterations in a pool of `threads`.
fn run(
    graph: &Graph,
    schedule: &mut (dyn Schedule + Send),
    parallel: bool,
    threads: usize,
) -> (Vec<Bell>, Report) {
    let options =
        Options { seed: 42, max_iterations: 6, tolerance: 0.0, damping: 0.2, parallel, ..Options::default() };
    let pool = ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    pool.install(|| {
        let mut engine = Engine::new(graph, options).unwrap();
        let report = engine.run(schedule).unwrap();
        (graph.variable_ids().map(|variable| *engine.belief(variable)).collect(), report)
    })
}

#[test]
fn threads_do_not_show_in_the_answer() {
    let mut graph = grid::<true>(40, Behaviour::Drawing);
    for variable in graph.variable_ids() {
        graph.set_time(variable, (variable.index() / 400) as f64).unwrap();
    }
    type Make = fn() -> Box<dyn Schedule + Send>;
    let schedules: [Make; 5] = [
        || Box::new(Flooding),
        || Box::new(Coloured::new()),
        || Box::new(Sliced::new(2).smoothing()),
        || Box::new(Sequential::default()),
        || Box::new(Residual::default()),
    ];
    for make in schedules {
        let reference = run(&graph, &mut *make(), false, 1);
        assert!(reference.1.changes.iter().all(|change| *change > 0.0), "the draws move every iteration");
        for threads in [1, 2] {
            let other = run(&graph, &mut *make(), true, threads);
            // Equality of floats is equality of bits here: no belief is zero or NaN.
            assert_eq!(other, reference, "{threads} threads");
        }
    }
}

#[test]
fn seeds_matter() {
    let graph = grid::<true>(5, Behaviour::Drawing);
    let run = |seed| {
        let options = Options { seed, max_iterations: 3, ..Options::default() };
        crate::bell::beliefs(&graph, options, &mut Flooding)
    };
    assert_eq!(run(1), run(1));
    assert_ne!(run(1), run(2));
}

#[test]
fn of_several_errors_the_first_in_order_is_reported() {
    let (mut graph, x) = variables::<true>(300);
    for (k, &id) in x.iter().enumerate() {
        let bad = if k >= 37 && k % 2 == 1 { Behaviour::NotANumber(0) } else { Behaviour::Exact };
        graph.factor("prior", Linear::prior(0.0, 1.0).behaving(bad), &[id]).unwrap();
        graph.set_time(id, 0.0).unwrap();
    }
    let pool = ThreadPoolBuilder::new().num_threads(2).build().unwrap();
    for _ in 0..20 {
        for schedule in [&mut Flooding as &mut (dyn Schedule + Send), &mut Sliced::new(1)] {
            let error =
                pool.install(|| Engine::new(&graph, Options::default()).unwrap().run(schedule)).unwrap_err();
            assert!(matches!(&error, GraphError::Rule { variable, .. } if variable == "x37"), "{error}");
        }
    }
}
