//! The structures end to end, in small.

use super::Fusion;
use crate::error::PositioningError;
use crate::metrics::{DiagnosticValue, Report};
use crate::results::RunResult;
use crate::scenario::{RunRequest, Scenario};

fn scenario(structure: &str, sensors: u32, keys: &str, methods: &str) -> Fusion {
    serde_json::from_str(&format!(
        r#"{{"world": {{"structure": "{structure}", "sensors": {sensors}, "steps": 60, "first_scored": 21, "interval": 0.015,
            "measurement_variance": 900, "start": [15, -10], "start_variance": 10,
            "process_noise": 0.140625, "exchange_interval": 1 {keys}}}, "method": {{{methods}}}}}"#
    ))
    .unwrap()
}

fn with_key(mut scenario: Fusion, change: impl FnOnce(&mut super::WorldSettings)) -> Fusion {
    change(&mut scenario.world);
    scenario
}

fn runs(scenario: &Fusion, count: u32) -> Report {
    scenario.validate().unwrap();
    let prepared = scenario.prepare(1, None).unwrap();
    let methods = scenario.methods();
    let runs: Vec<RunResult> = (0..count)
        .map(|run| scenario.run(&prepared, RunRequest { seed: 1, run, methods: &methods }).unwrap())
        .collect();
    Report::new("fusion", 1, &runs).unwrap()
}

fn told(report: &Report, method: &str, name: &str) -> f64 {
    match report.method(method).unwrap().diagnostics.get(name) {
        Some(DiagnosticValue::Number(value)) => *value,
        other => panic!("{method} reports {other:?} as {name}"),
    }
}

const REMOVAL: &str =
    r#""up": {"rule": "removal"}, "both": {"rule": "removal", "exchange": "collect-and-distribute"}"#;

#[test]
fn removal_is_the_centralised_filter() {
    for (structure, sensors) in [("star", 6), ("hierarchy", 5), ("ring", 6)] {
        let report = runs(&scenario(structure, sensors, "", REMOVAL), 5);
        for method in ["up", "both"] {
            assert!(told(&report, method, "centralised_difference") < 1e-9, "{structure} {method}");
            assert!(
                told(&report, method, "centralised_covariance_difference") < 1e-10,
                "{structure} {method}"
            );
        }
    }
}

#[test]
fn without_process_noise_seldom_exchanges_are_exact_too() {
    for interval in [2, 5, 10, 20] {
        for (structure, sensors) in [("star", 6), ("hierarchy", 5)] {
            let quiet = with_key(scenario(structure, sensors, "", REMOVAL), |world| {
                world.process_noise = 0.0;
                world.exchange_interval = interval;
            });
            let report = runs(&quiet, 3);
            for method in ["up", "both"] {
                let difference = told(&report, method, "centralised_difference");
                assert!(difference < 1e-9, "{structure} {method} every {interval}: {difference:e}");
            }
        }
    }
}

#[test]
fn a_ring_makes_the_automatic_rule_fall_back_and_a_path_does_not() {
    let methods = r#""ring": {"rule": "automatic", "exchange": "neighbours", "links": "all"},
        "path": {"rule": "automatic", "exchange": "neighbours"},
        "edge": {"rule": "edge", "exchange": "neighbours"}"#;
    let report = runs(&scenario("ring", 6, "", methods), 5);
    let notes = |method: &str| report.method(method).unwrap().notes.join(" ");
    assert!(notes("ring").contains("noticed a loop at step 3"), "{}", notes("ring"));
    assert!(notes("path").contains("no loop"));
    assert!(told(&report, "ring", "fallback_share") > 0.8);
    assert_eq!(told(&report, "path", "fallback_share"), 0.0);
    // On a path with a message a step, what is found by identity is the edge's separator.
    let (by_identity, by_edge) = (report.method("path").unwrap(), report.method("edge").unwrap());
    let rmse =
        |metrics: &crate::metrics::MethodMetrics| metrics.summary.position_rmse_m.as_ref().unwrap().mean;
    assert!((rmse(by_identity) - rmse(by_edge)).abs() < 1e-9);
}

#[test]
fn lost_messages_and_silent_nodes_break_nothing() {
    let methods = r#""up": {"rule": "removal"}, "both": {"rule": "removal", "exchange": "collect-and-distribute"},
        "auto": {"rule": "automatic", "exchange": "neighbours", "links": "all"},
        "private": {"rule": "private", "exchange": "neighbours", "links": "all"},
        "ci": {"rule": "intersection", "exchange": "neighbours"}"#;
    for structure in ["star", "hierarchy", "ring"] {
        // Past lost messages the shared sensor closes a loop.
        let methods = match structure {
            "hierarchy" => {
                methods.replace(r#""both": {"rule": "removal""#, r#""both": {"rule": "automatic""#)
            }
            _ => methods.to_owned(),
        };
        let lossy = scenario(structure, 6, r#", "message_loss": 0.3, "silent": [1]"#, &methods);
        let report = runs(&lossy, 3);
        for (id, method) in &report.methods {
            assert!(method.notes.iter().any(|note| note.contains("never sends")), "{id}");
            assert!(told(&report, id, "centralised_difference") > 0.0);
        }
        // Without noise lost messages cost time alone: what arrives is counted once.
        let quiet = with_key(lossy, |world| world.process_noise = 0.0);
        let nees = runs(&quiet, 20)
            .method("up")
            .unwrap()
            .summary
            .nees
            .as_ref()
            .unwrap()
            .position
            .as_ref()
            .unwrap()
            .mean;
        assert!((0.2..6.0).contains(&nees), "{structure}: {nees}");
    }
}

#[test]
fn the_drawing_marks_the_loop() {
    let methods = r#""auto": {"rule": "automatic", "exchange": "neighbours", "links": "all"},
        "path": {"rule": "edge", "exchange": "neighbours"}"#;
    let scenario = scenario("ring", 6, "", methods);
    let prepared = scenario.prepare(1, None).unwrap();
    let methods = scenario.methods();
    let run = scenario.run(&prepared, RunRequest { seed: 1, run: 0, methods: &methods }).unwrap();
    let looped = |k: usize| run.files[k].contents.matches("stroke-dasharray").count();
    assert_eq!(run.files[0].name, "information-graph-auto.svg");
    // The legend has one.
    assert!(looped(0) > 1);
    assert_eq!(looped(1), 1);
}

#[test]
fn wrong_settings_are_named() {
    let refused = |scenario: &Fusion| scenario.validate().unwrap_err().to_string();
    let world = |keys: &str| refused(&scenario("star", 6, keys, REMOVAL));
    assert!(world(r#", "silent": [6]"#).contains("names sensor 6; the sensors are 0 to 5"));
    assert!(world(r#", "message_loss": 1.0"#).contains("`world.message_loss` is 1"));
    let of =
        |change: fn(&mut super::WorldSettings)| refused(&with_key(scenario("ring", 6, "", REMOVAL), change));
    assert!(of(|world| world.sensors = 2).contains("`world.sensors` is 2; this structure takes 3 to 1000"));
    assert!(of(|world| world.exchange_interval = 0).contains("`world.exchange_interval` is 0"));
    assert!(of(|world| world.first_scored = 61).contains("`world.first_scored` is 61"));
    assert!(of(|world| world.process_noise = -1.0).contains("`world.process_noise` is -1"));
    assert!(of(|world| world.interval = f64::NAN).contains("`world.interval` is NaN"));
    let method = |text: &str| refused(&scenario("ring", 6, "", text));
    let looped = method(r#""x": {"rule": "removal", "exchange": "neighbours", "links": "all"}"#);
    assert!(looped.contains("`method.x.rule`") && looped.contains("automatic"), "{looped}");
    assert!(method(r#""x": {"rule": "naive", "intersection": "split"}"#).contains("intersects nothing"));
    assert!(method(r#""x": {"rule": "private"}"#).contains("neighbours"));
    assert!(method(r#""x": {"rule": "edge", "links": "all"}"#).contains("`method.x.links`"));
    let lossy = |structure: &str, methods: &str| {
        refused(&scenario(structure, 5, r#", "message_loss": 0.1"#, methods))
    };
    assert!(lossy("hierarchy", REMOVAL).contains("`method.both.exchange` distributes past lost messages"));
    let edge = r#""x": {"rule": "edge", "exchange": "neighbours"}"#;
    assert!(lossy("ring", edge).contains("choose \"removal\""));
    assert!(matches!(
        scenario("ring", 6, "", REMOVAL).method.named("y"),
        Err(PositioningError::UnknownMethod { .. })
    ));
}
