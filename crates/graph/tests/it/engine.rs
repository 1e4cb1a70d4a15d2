//! What the engine sends, how it damps, and whom it blames.

use crate::bell::{Behaviour, Bell, Graph, Linear, variables};
use std::sync::atomic::Ordering;
use sumprod_graph::schedule::{Flooding, ForwardBackward, Sequential};
use sumprod_graph::{Engine, GraphError, MessageError, Options, Outgoing, Schedule};

fn two_with(behaviour: Behaviour) -> Graph {
    let (mut graph, x) = variables::<true>(2);
    graph.factor("prior", Linear::prior(1.0, 2.0), &x[..1]).unwrap();
    graph.factor("link", Linear::step(0.0, 1.0).behaving(behaviour), &x).unwrap();
    graph
}

#[test]
fn a_factor_that_sends_nan_is_named() {
    let mut started = two_with(Behaviour::NotANumber(1));
    // A start must not hide what it stands in for.
    started.set_start(started.find("x1").unwrap(), Bell::new(0.0, 1.0)).unwrap();
    for graph in [two_with(Behaviour::NotANumber(1)), started] {
        let schedules: [&mut dyn Schedule; 3] =
            [&mut Flooding, &mut ForwardBackward::new(), &mut Sequential::default()];
        for schedule in schedules {
            let error = Engine::new(&graph, Options::default()).unwrap().run(schedule).unwrap_err();
            let GraphError::Rule { factor, port, variable, iteration, source } = &error else {
                panic!("{error}")
            };
            assert_eq!((factor.as_str(), *port, variable.as_str(), *iteration), ("link #1", 1, "x1", 1));
            assert!(matches!(source, MessageError::NotFinite { value, .. } if value.is_nan()));
            for word in ["\"link #1\"", "port 1", "\"x1\"", "NaN", "iteration 1"] {
                assert!(error.to_string().contains(word), "{error}");
            }
        }
    }
}

#[test]
fn a_product_that_fails_names_the_variable() {
    let graph = two_with(Behaviour::Negative);
    let error = Engine::new(&graph, Options::default()).unwrap().run(&mut Flooding).unwrap_err();
    assert!(
        matches!(&error, GraphError::Product { variable, iteration: 1, .. } if variable == "x0"),
        "{error}"
    );
    assert!(error.to_string().contains("the product is not positive definite"), "{error}");
}

#[test]
fn after_an_error_the_engine_goes_on() {
    let graph = two_with(Behaviour::NotANumber(1));
    let mut engine = Engine::new(&graph, Options::default()).unwrap();
    let first = engine.run(&mut Flooding).unwrap_err();
    let again = engine.run(&mut Flooding).unwrap_err();
    let at = |error: &GraphError| match error {
        GraphError::Rule { factor, iteration, .. } => (factor.clone(), *iteration),
        other => panic!("{other}"),
    };
    assert_eq!((at(&first), at(&again)), (("link #1".into(), 1), ("link #1".into(), 2)));
    assert_eq!(engine.topology().edge_count(), 3);
}

#[test]
fn broadcast_sends_the_belief_and_extrinsic_leaves_the_receiver_out() {
    let (mut graph, x) = variables::<true>(2);
    graph.set_prior(x[0], Bell::new(1.0, 0.5)).unwrap();
    graph.set_prior(x[1], Bell::new(2.0, 0.25)).unwrap();
    let echo = graph.factor("echo", Linear::step(0.0, 1.0).behaving(Behaviour::Echo), &x).unwrap();
    let to_second = graph.edge(echo, 1).unwrap();
    let schedules: [&mut dyn Schedule; 2] = [&mut Flooding, &mut Sequential::default()];
    for schedule in schedules {
        let run = |outgoing, schedule: &mut dyn Schedule| {
            let options = Options { outgoing, max_iterations: 2, tolerance: 0.0, ..Options::default() };
            let mut engine = Engine::new(&graph, options).unwrap();
            engine.run(schedule).unwrap();
            (*engine.message(to_second), *engine.belief(x[0]))
        };
        let (sent, _) = run(Outgoing::Extrinsic, schedule);
        assert_eq!(sent, Bell::new(1.0, 0.5), "the first variable's prior alone");
        let (sent, _) = run(Outgoing::Broadcast, schedule);
        assert!(
            sent.precision > 2.0 + 4.0 - 1e-12,
            "the belief holds what came over the same edge: {sent:?}"
        );
    }
}

#[test]
fn damping_keeps_its_share_of_the_old_message() {
    let schedules: [&mut dyn Schedule; 2] = [&mut Flooding, &mut ForwardBackward::iterated(9)];
    for schedule in schedules {
        let (mut graph, x) = variables::<true>(1);
        let factor = graph.factor("grow", Linear::prior(0.0, 1.0).behaving(Behaviour::Growing), &x).unwrap();
        let edge = graph.edge(factor, 0).unwrap();
        let options = Options { damping: 0.5, max_iterations: 1, ..Options::default() };
        let mut engine = Engine::new(&graph, options).unwrap();
        let mut seen = Vec::new();
        for _ in 0..3 {
            engine.run(schedule).unwrap();
            seen.push(engine.message(edge).precision);
        }
        // The factor sends 1, 4, 9; the first has nothing to be damped with.
        assert_eq!(seen, [1.0, 2.5, 5.75]);
    }
}

#[test]
fn constant_factors_are_asked_once() {
    let shared = std::sync::Arc::new(Linear::prior(0.0, 1.0).behaving(Behaviour::Constant));
    let mut counted: sumprod_graph::FactorGraph<Bell, std::sync::Arc<Linear>> = Default::default();
    let variable = counted.unnamed_variable(sumprod_graph::Space::real(1));
    counted.factor("prior", shared.clone(), &[variable]).unwrap();
    let options = Options { tolerance: 0.0, damping: 0.25, ..Options::default() };
    let mut engine = Engine::new(&counted, options).unwrap();
    for _ in 0..4 {
        engine.run(&mut Flooding).unwrap();
    }
    assert_eq!(shared.calls.load(Ordering::Relaxed), 1);
    assert_eq!(engine.belief(variable).precision, 1.0);
    let mut resumed = Engine::resume(&counted, options, engine.checkpoint()).unwrap();
    resumed.run(&mut Flooding).unwrap();
    assert_eq!(shared.calls.load(Ordering::Relaxed), 1, "a resumed run knows what has been sent");
}

/// A star: one hub, many leaves, each with a prior. Beliefs of the hub are updated message by message within a
/// pass and must equal the closed form at its end.
#[test]
fn a_hub_of_many_edges_costs_one_pass_and_is_exact() {
    let leaves = 100_000;
    let (mut graph, x) = variables::<true>(leaves + 1);
    for leaf in 1..=leaves {
        graph.factor("prior", Linear::prior(leaf as f64 / leaves as f64, 1.0), &x[leaf..=leaf]).unwrap();
        graph.factor("link", Linear::step(0.0, 1.0), &[x[0], x[leaf]]).unwrap();
    }
    let mut engine = Engine::new(&graph, Options::default()).unwrap();
    engine.run(&mut ForwardBackward::new()).unwrap();
    let belief = engine.belief(x[0]);
    assert!((belief.variance() * leaves as f64 / 2.0 - 1.0).abs() < 1e-9, "{}", belief.variance());
    let mean = (leaves as f64 + 1.0) / 2.0 / leaves as f64;
    assert!((belief.mean() - mean).abs() < 1e-9, "{}", belief.mean());
}
