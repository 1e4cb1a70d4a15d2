//! All schedules reach the answer, and the answer is right.

use crate::bell::{Behaviour, Bell, Graph, Linear, assert_close, beliefs, chain, grid, variables};
use proptest::prelude::*;
use std::sync::Arc;
use sumprod_graph::schedule::{Coloured, Flooding, ForwardBackward, Residual, Sequential, Sliced};
use sumprod_graph::{Engine, FactorGraph, GraphError, Options, Schedule, Space, Stop};

fn tight() -> Options {
    Options { tolerance: 1e-12, max_iterations: 2000, ..Options::default() }
}

/// Means and variances from the tridiagonal or full joint precision, by Gauss-Jordan elimination.
fn dense<const DIVIDES: bool>(graph: &Graph<DIVIDES>, factors: &[(&[f64], f64, f64, &[usize])]) -> Vec<Bell> {
    let n = graph.variable_count();
    let mut rows = vec![vec![0.0; 2 * n + 1]; n];
    for (k, row) in rows.iter_mut().enumerate() {
        row[n + k] = 1.0;
    }
    for (coefficients, offset, variance, ports) in factors {
        for (a, &row) in coefficients.iter().zip(*ports) {
            for (b, &column) in coefficients.iter().zip(*ports) {
                rows[row][column] += a * b / variance;
            }
            rows[row][2 * n] += a * offset / variance;
        }
    }
    for pivot in 0..n {
        let scale = 1.0 / rows[pivot][pivot];
        rows[pivot].iter_mut().for_each(|entry| *entry *= scale);
        let own = rows[pivot].clone();
        for (row, entries) in rows.iter_mut().enumerate().filter(|(row, _)| *row != pivot) {
            let share = entries[pivot];
            assert!(row != pivot);
            entries.iter_mut().zip(&own).for_each(|(entry, other)| *entry -= share * other);
        }
    }
    (0..n).map(|k| Bell::new(rows[k][2 * n], rows[k][n + k])).collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn trees_equal_the_joint(
        shape in prop::collection::vec((0usize..1000, 1usize..3, -2.0f64..2.0, 0.1f64..4.0), 1..12),
    ) {
        let total = 1 + shape.iter().map(|(_, new, _, _)| new).sum::<usize>();
        let (mut graph, x) = variables::<true>(total);
        let mut list: Vec<(Vec<f64>, f64, f64, Vec<usize>)> =
            (0..total).map(|k| (vec![1.0], k as f64, 3.0, vec![k])).collect();
        let mut used = 1;
        for (anchor, new, offset, variance) in shape {
            let ports: Vec<usize> = std::iter::once(anchor % used).chain(used..used + new).collect();
            let coefficients = (0..ports.len()).map(|k| if k == 0 { -1.0 } else { 0.5 + k as f64 }).collect();
            list.push((coefficients, offset, variance, ports));
            used += new;
        }
        for (coefficients, offset, variance, ports) in &list {
            let ids: Vec<_> = ports.iter().map(|&k| x[k]).collect();
            graph.factor("linear", Linear::new(coefficients, *offset, *variance), &ids).unwrap();
        }
        let borrowed: Vec<_> = list.iter().map(|(a, b, c, d)| (&a[..], *b, *c, &d[..])).collect();
        let exact = dense(&graph, &borrowed);
        assert_close(&beliefs(&graph, Options::default(), &mut ForwardBackward::new()), &exact, 1e-10);
        assert_close(&beliefs(&graph, tight(), &mut Flooding), &exact, 1e-10);
        assert_close(&beliefs(&graph, tight(), &mut Residual::default()), &exact, 1e-10);
    }
}

#[test]
fn all_schedules_reach_one_fixed_point() {
    let graph = grid::<true>(7, Behaviour::Exact);
    let reference = beliefs(&graph, tight(), &mut Flooding);
    assert_close(&beliefs(&graph, tight(), &mut Sequential::default()), &reference, 1e-10);
    assert_close(&beliefs(&graph, tight(), &mut Residual::default()), &reference, 1e-10);
    assert_close(&beliefs(&graph, tight(), &mut Coloured::new()), &reference, 1e-10);
}

#[test]
fn damping_changes_the_way_and_not_the_fixed_point() {
    let options = Options { damping: 0.4, ..tight() };
    let reference = beliefs(&grid::<true>(7, Behaviour::Exact), tight(), &mut Flooding);
    let graph = grid::<true>(7, Behaviour::Exact);
    assert_close(&beliefs(&graph, options, &mut Flooding), &reference, 1e-9);
    assert_close(&beliefs(&graph, options, &mut Sequential::default()), &reference, 1e-9);
    assert_close(&beliefs(&graph, options, &mut Residual::default()), &reference, 1e-9);
    assert_close(&beliefs(&graph, options, &mut Coloured::new()), &reference, 1e-9);
    // Priors that say they never change are sent once, and whole.
    let (mut graph, x) = variables::<true>(2);
    graph.factor("prior", Linear::prior(1.0, 2.0).behaving(Behaviour::Constant), &x[..1]).unwrap();
    graph.factor("step", Linear::step(1.0, 2.0), &x).unwrap();
    let damped = beliefs(&graph, options, &mut Flooding);
    assert_close(&damped, &[Bell::<true>::new(1.0, 2.0), Bell::new(2.0, 4.0)], 1e-10);
    // A single sweep is exact with or without damping.
    let graph = chain::<true>(30, Behaviour::Exact);
    let exact = beliefs(&graph, Options::default(), &mut ForwardBackward::new());
    assert_close(&beliefs(&graph, options, &mut ForwardBackward::new()), &exact, 1e-12);
}

#[test]
fn a_family_that_cannot_divide_gets_the_same_answers() {
    let (divides, multiplies) = (grid::<true>(6, Behaviour::Exact), grid::<false>(6, Behaviour::Exact));
    let reference = beliefs(&divides, tight(), &mut Flooding);
    assert_close(&beliefs(&multiplies, tight(), &mut Flooding), &reference, 1e-10);
    assert_close(&beliefs(&multiplies, tight(), &mut Sequential::default()), &reference, 1e-10);
    let sequential = Options { parallel: false, ..tight() };
    assert_eq!(beliefs(&multiplies, tight(), &mut Flooding), beliefs(&multiplies, sequential, &mut Flooding));
}

#[test]
fn a_start_leaves_no_trace() {
    let reference = beliefs(&grid::<true>(5, Behaviour::Exact), tight(), &mut Flooding);
    let mut graph = grid::<true>(5, Behaviour::Exact);
    for variable in graph.variable_ids() {
        graph.set_start(variable, Bell::new(100.0, 1e-3)).unwrap();
    }
    let schedules: [&mut dyn Schedule; 4] =
        [&mut Flooding, &mut Sequential::default(), &mut Residual::default(), &mut Coloured::new()];
    for schedule in schedules {
        assert_close(&beliefs(&graph, tight(), schedule), &reference, 1e-10);
    }
    // Alone, a prior speaks and a start does not.
    let (mut graph, x) = variables::<true>(1);
    graph.set_start(x[0], Bell::new(5.0, 1.0)).unwrap();
    graph.set_prior(x[0], Bell::new(-1.0, 4.0)).unwrap();
    assert_eq!(beliefs(&graph, tight(), &mut Flooding), [Bell::new(-1.0, 4.0)]);
}

#[test]
fn a_prior_is_evidence() {
    let mut graph = chain::<true>(5, Behaviour::Exact);
    graph.set_prior(graph.find("x4").unwrap(), Bell::new(7.0, 0.5)).unwrap();
    let mut with_factor = chain::<true>(5, Behaviour::Exact);
    let last = with_factor.find("x4").unwrap();
    with_factor.factor("prior", Linear::prior(7.0, 0.5), &[last]).unwrap();
    let reference = beliefs(&with_factor, tight(), &mut ForwardBackward::new());
    assert_close(&beliefs(&graph, tight(), &mut ForwardBackward::new()), &reference, 1e-12);
    assert_close(&beliefs(&graph, tight(), &mut Flooding), &reference, 1e-12);
}

#[test]
fn slices_filter_and_smooth() {
    let mut graph = chain::<true>(12, Behaviour::Exact);
    for (k, variable) in graph.variable_ids().enumerate() {
        graph.set_time(variable, 0.5 * k as f64).unwrap();
    }
    let smoothed = beliefs(&graph, tight(), &mut ForwardBackward::new());
    let filtered = beliefs(&graph, tight(), &mut Sliced::new(1));
    let last = smoothed.len() - 1;
    assert_close(&filtered[last..], &smoothed[last..], 1e-12);
    assert!(filtered[3].variance() > smoothed[3].variance(), "a filter has not heard the future");
    assert_close(&beliefs(&graph, tight(), &mut Sliced::new(1).smoothing()), &smoothed, 1e-12);
}

#[test]
fn slices_need_rounds_and_finite_times() {
    let mut graph = chain::<true>(3, Behaviour::Exact);
    let reason = |graph: &Graph, schedule: &mut dyn Schedule| {
        let error = Engine::new(graph, Options::default()).unwrap().run(schedule).unwrap_err();
        assert!(matches!(error, GraphError::Schedule(_)), "{error}");
        error.to_string()
    };
    assert!(reason(&graph, &mut Sliced::new(1)).contains("none has one"));
    assert!(reason(&graph, &mut Sliced::new(0)).contains("at least one round"));
    graph.set_time(graph.find("x1").unwrap(), f64::NAN).unwrap();
    assert!(reason(&graph, &mut Sliced::new(1)).contains("NaN"));
}

#[test]
fn reports_say_why_a_run_stopped() {
    let graph = grid::<true>(4, Behaviour::Exact);
    let mut engine = Engine::new(&graph, Options { max_iterations: 3, ..tight() }).unwrap();
    let report = engine.run(&mut Flooding).unwrap();
    assert_eq!((report.iterations, report.stop, report.converged()), (3, Stop::IterationLimit, false));
    assert_eq!(report.changes.len(), 3);
    let mut engine = Engine::new(&graph, Options { tolerance: 0.0, ..tight() }).unwrap();
    let report = engine.run(&mut Flooding).unwrap();
    assert_eq!(report.stop, Stop::Converged, "a tolerance of zero waits for no change at all");
    assert_eq!(report.changes.last(), Some(&0.0));
    let chain = chain::<true>(4, Behaviour::Exact);
    let report = Engine::new(&chain, tight()).unwrap().run(&mut ForwardBackward::new()).unwrap();
    assert_eq!((report.iterations, report.stop), (1, Stop::Finished));
    assert!(report.to_string().starts_with("finished after 1 iteration"));
    let report = Engine::new(&chain, tight()).unwrap().run(&mut ForwardBackward::iterated(9)).unwrap();
    assert_eq!((report.iterations, report.stop), (2, Stop::Converged));
}

#[test]
fn a_chain_of_a_million_variables_runs() {
    let count = 1_000_000;
    let mut graph: FactorGraph<Bell, Arc<Linear>> = FactorGraph::new();
    let x: Vec<_> = (0..count).map(|_| graph.unnamed_variable(Space::real(1))).collect();
    let (step, tie) = (Arc::new(Linear::step(0.0, 1.0)), Arc::new(Linear::prior(3.0, 50.0)));
    graph.factor("prior", Arc::new(Linear::prior(-2.0, 0.5)), &x[..1]).unwrap();
    for pair in x.windows(2) {
        graph.factor("step", step.clone(), pair).unwrap();
        graph.factor("tie", tie.clone(), &pair[1..]).unwrap();
    }
    let mut engine = Engine::new(&graph, Options::default()).unwrap();
    engine.run(&mut ForwardBackward::new()).unwrap();

    // The joint precision is tridiagonal: the means by the Thomas algorithm.
    let (mut diagonal, mut right) = (vec![2.0 + 0.02; count], vec![3.0 * 0.02; count]);
    (diagonal[0], right[0]) = (2.0 + 1.0, -2.0 * 2.0);
    diagonal[count - 1] = 1.0 + 0.02;
    for k in 1..count {
        let share = -1.0 / diagonal[k - 1];
        diagonal[k] += share;
        right[k] -= share * right[k - 1];
    }
    let mut mean = right[count - 1] / diagonal[count - 1];
    for k in (0..count).rev() {
        if k + 1 < count {
            mean = (right[k] + mean) / diagonal[k];
        }
        let found = engine.belief(x[k]).mean();
        assert!((found - mean).abs() < 1e-10, "variable {k}: {found} instead of {mean}");
    }
    assert_eq!(graph.components().len(), 1);
    assert_eq!(graph.loop_count(), 0);
}

#[test]
fn a_start_that_nothing_replaces_does_not_keep_a_run_going() {
    let (mut graph, x) = variables::<true>(2);
    graph.factor("step", Linear::step(0.0, 1.0), &x).unwrap();
    for &variable in &x {
        graph.set_start(variable, Bell::new(5.0, 1.0)).unwrap();
    }
    let schedules: [&mut dyn Schedule; 4] =
        [&mut Flooding, &mut Sequential::default(), &mut Residual::default(), &mut Coloured::new()];
    for schedule in schedules {
        let report = Engine::new(&graph, tight()).unwrap().run(schedule).unwrap();
        assert_eq!(report.stop, Stop::Converged, "{report}");
    }
}
