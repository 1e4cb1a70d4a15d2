//! Properties of the scenario. Campaigns have a fixed seed and few runs; figures over many are in the book.

mod recorded;

use super::Association;
use crate::campaign::Campaign;
use crate::metrics::{DiagnosticValue, MethodMetrics, Report, Verdict};
use crate::scenario::Scenario;

const METHODS: &str = r#"{
    "nn": {"algorithm": "nearest", "gate_per_level_m": 1800},
    "gnn": {"algorithm": "global-nearest", "gate_per_level_m": 1800},
    "gaussian-cpd": {"algorithm": "drift", "tails": "gaussian", "outlier_weight": 0.2, "start": "spread"},
    "t-cpd": {"algorithm": "drift", "tails": "student-estimated", "outlier_weight": 0.0, "start": "spread"},
    "t-bias": {"algorithm": "bias"},
    "known-bias": {"algorithm": "known-bias"}}"#;

fn scenario(changes: &[(&str, f64)], methods: &str) -> Association {
    let mut world = serde_json::json!({
        "targets": 30, "detection_probability": 0.9, "false_tracks": 3, "noise_variance": 1e4,
        "bias_level": 2.0, "range_bias_m": 300.0, "azimuth_bias_rad": 0.008726646,
    });
    for (key, value) in changes {
        let whole = ["targets", "false_tracks"].contains(key);
        world[*key] = if whole { (*value as u32).into() } else { (*value).into() };
    }
    let methods: serde_json::Value = serde_json::from_str(methods).unwrap();
    serde_json::from_value(serde_json::json!({"world": world, "method": methods})).unwrap()
}

fn report(changes: &[(&str, f64)], runs: u32) -> Report {
    let scenario = scenario(changes, METHODS);
    scenario.validate().unwrap();
    let runs = Campaign::new(&scenario, &(), 1, runs, &[]).unwrap().run(None, &|_, _| {}).unwrap();
    Report::new("test", 1, &runs).unwrap()
}

fn of(metrics: &MethodMetrics, group: &str, kind: &str) -> f64 {
    match metrics.diagnostics.get(group) {
        Some(DiagnosticValue::Group(kinds)) => kinds[kind],
        other => panic!("{group}: {other:?}"),
    }
}

fn number(metrics: &MethodMetrics, name: &str) -> f64 {
    match metrics.diagnostics.get(name) {
        Some(DiagnosticValue::Number(value)) => *value,
        other => panic!("{name}: {other:?}"),
    }
}

/// Shares of some 700 common targets of 30 runs. The bands are wider than those of 100 runs by what 30 leave open.
#[test]
fn the_field_of_the_biases_finds_the_pairs_where_neighbours_do_not() {
    let report = report(&[("bias_level", 4.0)], 30);
    let shares = |id| {
        let metrics = report.method(id).unwrap();
        [of(metrics, "association", "correct"), of(metrics, "association", "false")]
    };
    let [nn, gnn] = ["nn", "gnn"].map(shares);
    assert!(
        nn[0] < gnn[0] && (0.68..0.87).contains(&nn[0]) && (0.76..0.94).contains(&gnn[0]),
        "{nn:?} {gnn:?}"
    );
    for id in ["gaussian-cpd", "t-cpd", "t-bias"] {
        let [correct, wrong] = shares(id);
        assert!(correct > 0.96 && wrong < 0.025, "{id}: {correct} {wrong}");
        assert_eq!(number(report.method(id).unwrap(), "monotone"), 1.0, "{id}");
    }
    assert!(shares("t-bias")[0] >= shares("known-bias")[0] - 0.01);
}

#[test]
fn the_biases_come_with_their_uncertainty() {
    let report = report(&[], 60);
    let metrics = report.method("t-bias").unwrap();
    // Between 2.7 and 5.5 with a probability above 0.9999: 60 values of four degrees of freedom.
    let nees = metrics.summary.nees.as_ref().unwrap().state.as_ref().unwrap();
    assert!((2.7..5.5).contains(&nees.mean), "{}", nees.mean);
    assert!(metrics.calibration().is_some_and(|calibration| calibration.verdict != Verdict::Cautious));
    assert!(metrics.summary.rmse_m.is_none(), "metres and radians have no common size");
    assert!(of(metrics, "bias_error", "range_m") < 150.0);
}

#[test]
fn worlds_without_targets_or_tracks_are_no_failure() {
    for changes in [
        &[("targets", 0.0)][..],
        &[("targets", 0.0), ("false_tracks", 0.0)],
        &[("targets", 1.0), ("false_tracks", 0.0), ("detection_probability", 1.0)],
        &[("detection_probability", 0.0)],
        &[("noise_variance", 0.0), ("bias_level", 0.0)],
    ] {
        let report = report(changes, 3);
        for (id, metrics) in &report.methods {
            // A smooth field of one track moves less than the track does, and may leave it outside the gate.
            let seen = changes.contains(&("targets", 1.0)) && !id.ends_with("cpd");
            assert!(!seen || of(metrics, "association", "correct") > 0.5, "{id}: {changes:?}");
        }
    }
}

#[test]
fn the_world_does_not_depend_on_the_methods() {
    let scenario = scenario(&[], METHODS);
    let of = |wanted: &[String]| {
        let runs = Campaign::new(&scenario, &(), 7, 2, wanted).unwrap().run(None, &|_, _| {}).unwrap();
        runs[1].methods.iter().find(|method| method.id == "known-bias").unwrap().diagnostics.clone()
    };
    assert_eq!(of(&["known-bias".to_owned()]), of(&[]));
}

#[test]
fn wrong_values_are_named() {
    for (key, value) in [
        ("detection_probability", 1.1),
        ("noise_variance", -1.0),
        ("bias_level", f64::from(f32::MAX)),
        ("azimuth_bias_rad", 4.0),
        ("offset_m", -1.0),
        ("side_m", 0.0),
        ("targets", 2e6),
    ] {
        let error = scenario(&[(key, value)], METHODS).validate().unwrap_err().to_string();
        assert!(error.contains(&format!("`world.{key}`")), "{error}");
    }
    for (key, table) in [
        ("gate_m", r#"{"algorithm": "nearest", "gate_m": 0}"#),
        ("gate_per_level_m", r#"{"algorithm": "nearest", "gate_per_level_m": -1}"#),
        ("tails", r#"{"algorithm": "nearest", "tails": "gaussian"}"#),
        ("length", r#"{"algorithm": "bias", "length": 1}"#),
        ("range_deviation_m", r#"{"algorithm": "drift", "range_deviation_m": 1}"#),
        ("outlier_weight", r#"{"algorithm": "drift", "outlier_weight": 1}"#),
        ("degrees_of_freedom", r#"{"algorithm": "drift", "tails": "gaussian", "degrees_of_freedom": 3}"#),
        ("start", r#"{"algorithm": "drift", "start": {"metres": 0}}"#),
        ("refine", r#"{"algorithm": "bias", "refine": true, "outlier_weight": 0}"#),
        ("iterations", r#"{"algorithm": "bias", "iterations": 0}"#),
    ] {
        let error = scenario(&[], &format!(r#"{{"m": {table}}}"#)).validate().unwrap_err().to_string();
        assert!(error.contains(&format!("`method.m.{key}`")), "{error}");
    }
}
