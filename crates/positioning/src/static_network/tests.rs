//! Flips that a network resolves, forms that change on the way, and the same bits on any number of threads.

use nalgebra::{Matrix2, Vector2};

use super::posterior::Posterior;
use super::*;

fn scenario(agents: usize) -> StaticNetwork {
    let lattice = r#""cells": [4.0, 2.0], "rounds": [4, 3]"#;
    let text = format!(
        r#"{{"world": {{"agents": {agents}, "anchors_per_100": 13.0, "radius": 20.0, "range_variance": 0.25}},
            "method": {{"gaussian-bp": {{"gaussian_rounds": 60, "damping": 0.3, "start_variance": 225.0}},
                        "nbp": {{{lattice}}}, "nbp-refined": {{{lattice}, "gaussian_rounds": 30, "joint": true}}}}}}"#
    );
    serde_json::from_str(&text).unwrap()
}

fn run(scenario: &StaticNetwork, run: u32) -> RunResult {
    let methods = scenario.methods();
    let mut result = scenario.run(&(), RunRequest { seed: 1, run, methods: &methods }).unwrap();
    result.methods.iter_mut().for_each(|method| method.seconds = 0.0);
    result
}

fn mean_square(method: &MethodRun) -> f64 {
    let squares =
        method.estimates().map(|e| (e.mean[0] - e.truth[0]).powi(2) + (e.mean[1] - e.truth[1]).powi(2));
    squares.sum::<f64>() / method.len() as f64
}

fn diagnostic(method: &MethodRun, name: &str) -> Option<f64> {
    method.diagnostics.iter().find(|diagnostic| diagnostic.name == name).map(|diagnostic| diagnostic.value)
}

#[test]
fn a_network_resolves_the_flips_that_linearised_messages_keep() {
    let scenario = scenario(100);
    scenario.validate().unwrap();
    let results: Vec<RunResult> = (0..3).map(|number| run(&scenario, number)).collect();
    let error = |method: usize| {
        (results.iter().map(|result| mean_square(&result.methods[method])).sum::<f64>() / 3.0).sqrt()
    };
    let [gaussian, lattice, refined] = [error(0), error(1), error(2)];
    assert!(gaussian > 3.0 && lattice < 1.5 && refined < 1.0, "{gaussian} {lattice} {refined}");
    for result in &results {
        let [gaussian, lattice, refined] = &result.methods[..] else { panic!("three methods") };
        assert_eq!(diagnostic(gaussian, "form_changes"), Some(0.0));
        assert_eq!(diagnostic(lattice, "form_changes"), Some(0.0));
        assert!(diagnostic(refined, "form_changes").unwrap() > 1000.0);
        assert!(refined.notes.iter().any(|note| note.contains("changed from lattice to Gaussian")));
    }
}

/// The window's covariances are those of the whole network in one; beyond its margin a belief stands for the rest.
#[test]
fn windows_agree_with_the_whole_network() {
    let scenario = scenario(300);
    let draw = scenario.world.draw(2, 0).unwrap();
    let posterior = Posterior::new(&scenario.world, &draw, 1e4, draw.truth.clone());
    let on_an_arc = loose::loose(&posterior, 2.0);
    let part: Vec<usize> = (0..300).filter(|&agent| !on_an_arc[agent]).collect();
    let mut whole = posterior.clone();
    for agent in (0..300).filter(|&agent| on_an_arc[agent]) {
        whole.spreads[agent] = Matrix2::identity() * 1e8;
    }
    let from: Vec<[f64; 2]> = part.iter().map(|&agent| draw.truth[agent]).collect();
    let settled = whole.settle(&part, &from).unwrap();
    let beliefs: Vec<_> =
        draw.truth.iter().map(|&place| (Vector2::from(place), Matrix2::identity() * 0.2)).collect();
    let windows = joint::joint(posterior, beliefs, 2.0);
    assert_eq!(windows.moments.len(), 300);
    let mut largest: f64 = 0.0;
    for (own, covariance) in settled.covariances().into_iter().enumerate() {
        // Mirror images widen a covariance; few have one.
        let found = windows.moments[part[own]].1;
        largest = largest.max(1.0 - found.trace() / covariance.trace());
    }
    assert!(largest < 0.1, "{largest}");
}

#[test]
fn one_range_leaves_a_ring() {
    let scenario = scenario(1);
    let draw = Draw {
        truth: vec![[10.0, 0.0]],
        anchors: vec![[0.0, 0.0]],
        ranges: Vec::new(),
        anchor_ranges: vec![crate::cooperation::AnchorRanging { agent: 0, anchor: 0, measured: 10.0 }],
        start: vec![[0.0, 0.0]],
    };
    let posterior = Posterior::new(&scenario.world, &draw, 1e6, vec![[10.0, 0.0]]);
    assert_eq!(loose::loose(&posterior, 2.0), [true]);
    let near = posterior.reach(&posterior.places);
    let (mean, covariance) = loose::moments(&posterior, &near, 0).unwrap();
    assert!(mean.norm() < 1e-9, "{mean}");
    // E r² / 2 of a ring of this radius and width, the density of r being r times the Gaussian.
    let expected = 0.5 * (100.0 + 3.0 * 0.25);
    let off = (covariance - Matrix2::identity() * expected).norm();
    assert!(off < 0.01 * expected, "{covariance}");
}

/// 900 agents of nine networks, whose shares inside differ by 3 % (one deviation): the bound on the share is three
/// standard errors of the nine.
#[test]
fn the_joint_posterior_is_calibrated() {
    let scenario = scenario(100);
    let methods = vec!["nbp-refined".to_owned()];
    let (mut inside, mut nees) = (0.0, 0.0);
    for run in 0..9 {
        let result = scenario.run(&(), RunRequest { seed: 3, run, methods: &methods }).unwrap();
        for estimate in result.methods[0].estimates() {
            let [mean, truth] = [estimate.mean, estimate.truth].map(Vector2::from_column_slice);
            let error = mean - truth;
            let [xx, xy, yy] = [0, 1, 2].map(|entry| estimate.covariance[entry]);
            let covariance = Matrix2::new(xx, xy, xy, yy);
            let square = error.dot(&(covariance.try_inverse().unwrap() * error));
            inside += f64::from(u8::from(square < 5.991)) / 900.0;
            nees += square / 1800.0;
        }
    }
    assert!((inside - 0.95).abs() < 0.03 && nees < 1.3, "{inside} {nees}");
}

#[test]
fn threads_do_not_show_in_the_answer() {
    let scenario = scenario(150);
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| run(&scenario, 4))
    };
    assert_eq!(on(1), on(2));
}

#[test]
fn a_network_that_no_anchor_holds_is_refused() {
    let mut scenario = scenario(20);
    scenario.world.anchors_per_100 = 0.0;
    let message = scenario.prepare(1, None).unwrap_err().to_string();
    assert!(
        message.contains("nothing constrains the translation (2 directions) and rotation (1)"),
        "{message}"
    );
    assert!(message.contains("`world.anchors_per_100`"), "{message}");
    scenario.world.agents = 1;
    let message = scenario.prepare(1, None).unwrap_err().to_string();
    assert!(message.contains("the position of agent 1 along both axes"), "{message}");
}

#[test]
fn agents_out_of_everyones_reach_keep_their_weak_start_and_are_counted() {
    let mut scenario = scenario(30);
    scenario.world.radius = 7.0;
    let draw = scenario.world.draw(1, 0).unwrap();
    let floating = anchorage::floating(&draw);
    assert!(!floating.is_empty());
    let result = run(&scenario, 0);
    for method in &result.methods {
        assert_eq!(method.len(), 30);
        assert_eq!(diagnostic(method, "agents_without_anchor"), Some(floating.len() as f64));
    }
    let summary = &scenario.check(&(), 1, &scenario.methods()).unwrap()[1];
    assert!(summary.unconstrained[0].contains("no chain of ranges"), "{summary:?}");
    assert_eq!(summary.forms[0].form, "lattice 4 m, at most 200 cells");
}

#[test]
fn silence_is_told_apart_from_loss_by_its_key() {
    let mut scenario = scenario(40);
    let edges = |scenario: &StaticNetwork| {
        let summary = scenario.check(&(), 1, &["nbp".to_owned()]).unwrap();
        summary[0].forms.iter().map(|form| form.kind.clone()).collect::<Vec<_>>()
    };
    assert_eq!(edges(&scenario), ["anchor", "range", "silence"]);
    scenario.world.silence = false;
    assert_eq!(edges(&scenario), ["anchor", "range"]);
}

#[test]
fn wrong_values_of_methods_are_refused_by_their_key() {
    let good = scenario(10);
    let method = good.method.get("nbp-refined").unwrap().clone();
    for (method, part) in [
        (Method { cells: vec![4.0, 3.0], ..method.clone() }, "holds 3 m after 4 m"),
        (Method { cells: vec![4.0], ..method.clone() }, "holds 2 numbers for 1 widths"),
        (Method { cells: vec![4.0, 0.0], ..method.clone() }, "holds 0 m; a width"),
        (Method { components: 0, ..method.clone() }, "`method.m.components` is 0"),
        (Method { damping: 1.0, ..method.clone() }, "`method.m.damping` is 1"),
        (Method { one_mode_deviation: 0.0, ..method.clone() }, "`method.m.one_mode_deviation` is 0 m"),
        (Method { start_variance: -1.0, ..method.clone() }, "`method.m.start_variance` is -1 m²"),
        (Method { cells: vec![], rounds: vec![], gaussian_rounds: 0, ..method.clone() }, "at least 1 round"),
    ] {
        let message = method.validate("m", 20.0).unwrap_err().to_string();
        assert!(message.contains(part), "{message}");
    }
}
