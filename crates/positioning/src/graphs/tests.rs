//! The scenario end to end on small files.

use super::*;
use crate::metrics::DiagnosticValue;
use crate::metrics::Report;
use std::path::PathBuf;

const TRIANGLE: &str = "\
VERTEX_SE2 0 0 0 0
VERTEX_SE2 1 1 0 1.5
VERTEX_SE2 2 1 1 3
EDGE_SE2 0 1 1 0 1.5707963 100 0 0 100 0 400
EDGE_SE2 1 2 1 0 1.5707963 100 0 0 100 0 400
EDGE_SE2 2 0 1.02 0.97 1.6 100 0 0 100 0 400
";

/// A loop that hangs on the pose that is held: one through it would be cut there.
const HANGING: &str = "\
VERTEX_SE2 0 0 0 0
VERTEX_SE2 1 1 0 1.5
VERTEX_SE2 2 1 1 3
VERTEX_SE2 3 0 1 3
EDGE_SE2 0 1 1 0 1.5707963 100 0 0 100 0 400
EDGE_SE2 1 2 1 0 1.5707963 100 0 0 100 0 400
EDGE_SE2 2 3 1 0 0 100 0 0 100 0 400
EDGE_SE2 3 1 1.02 0.97 1.6 100 0 0 100 0 400
";

fn scenario(extra: &str) -> Graphs {
    let text = format!(
        r#"{{"world": {{{extra}}}, "method": {{"joint": {{"inference": "joint"}}, "map": {{"inference": "map"}},
            "gaussian-bp": {{"inference": "gaussian-bp"}}}}}}"#
    );
    serde_json::from_str(&text).unwrap()
}

fn file(name: &str, text: &str) -> PathBuf {
    let path = std::env::temp_dir().join(format!("sumprod-{}-{name}", std::process::id()));
    std::fs::write(&path, text).unwrap();
    path
}

fn run(scenario: &Graphs, path: &Path) -> RunResult {
    let prepared = scenario.prepare(1, Some(path)).unwrap();
    let methods = scenario.methods();
    scenario.run(&prepared, RunRequest { seed: 1, run: 0, methods: &methods }).unwrap()
}

fn figure(result: &RunResult, method: &str, name: &str) -> f64 {
    let report = Report::new("graph", 1, std::slice::from_ref(result)).unwrap();
    let metrics = report.method(method).unwrap();
    let (group, rest) = name.split_once('.').map_or((name, None), |(group, rest)| (group, Some(rest)));
    match (&metrics.diagnostics[group], rest) {
        (DiagnosticValue::Number(value), None) => *value,
        (DiagnosticValue::Group(values), Some(rest)) => values[rest],
        _ => panic!("{name}"),
    }
}

#[test]
fn a_loop_of_poses_by_every_method() {
    let path = file("hanging.g2o", HANGING);
    let result = run(&scenario(""), &path);
    std::fs::remove_file(&path).unwrap();
    let cost = figure(&result, "joint", "cost");
    assert!((figure(&result, "map", "cost") - cost).abs() < 1e-9 * cost);
    assert!((figure(&result, "gaussian-bp", "cost") - cost).abs() < 1e-6 * cost);
    assert!(figure(&result, "gaussian-bp", "error_to_exact.mean_sd") < 1e-3);
    assert!(figure(&result, "gaussian-bp", "error_to_exact.covariance_relative") > 1e-3, "loops");
    assert!(figure(&result, "joint", "log_evidence").is_finite());
    let names: Vec<&str> = result.files.iter().map(|file| file.name.as_str()).collect();
    assert_eq!(names, ["marginals.json", "marginals-map.json", "marginals-gaussian-bp.json"]);
    let marginals: serde_json::Value = serde_json::from_str(&result.files[0].contents).unwrap();
    assert_eq!(marginals["2"]["mean"].as_array().unwrap().len(), 3);
    assert_eq!(marginals["2"]["covariance"].as_array().unwrap().len(), 3);
    assert_eq!(marginals["2"]["order"], serde_json::json!(["x", "y", "theta"]));
    let map: serde_json::Value = serde_json::from_str(&result.files[1].contents).unwrap();
    assert!(map["2"].get("covariance").is_none());
}

#[test]
fn without_an_anchor_the_directions_are_told() {
    let path = file("free.g2o", TRIANGLE);
    let scenario = scenario(r#""anchor": "none""#);
    let prepared = scenario.prepare(1, Some(&path)).unwrap();
    std::fs::remove_file(&path).unwrap();
    let methods = vec!["joint".to_owned()];
    let error = scenario.run(&prepared, RunRequest { seed: 1, run: 0, methods: &methods }).unwrap_err();
    assert!(error.is_input());
    let said = error.to_string();
    assert!(said.contains("position along x") && said.contains("add a prior on one pose"), "{said}");
    let summaries = scenario.check(&prepared, 1, &methods).unwrap();
    assert_eq!((summaries[0].variables, summaries[0].unconstrained.len()), (3, 1));
    assert!(said.contains(&summaries[0].unconstrained[0]));
}

#[test]
fn wrong_files_and_keys_are_the_inputs_fault() {
    let path = file("wrong.g2o", "VERTEX_SE2 0 0 0 zero\n");
    let error = scenario("").prepare(1, Some(&path)).err().unwrap();
    std::fs::remove_file(&path).unwrap();
    assert!(error.is_input() && error.to_string().contains(":1: field 4 of VERTEX_SE2 (theta)"), "{error}");
    let error = scenario("").prepare(1, Some(&std::env::temp_dir())).err().unwrap();
    assert!(error.to_string().contains("is a folder"), "{error}");
    assert!(scenario(r#""anchor_sd_m": 0.0"#).validate().is_err());
    let path = file("named.g2o", TRIANGLE);
    let error = scenario(r#""anchor": "x9""#).prepare(1, Some(&path)).err().unwrap();
    std::fs::remove_file(&path).unwrap();
    assert!(error.to_string().contains("no variable of that name"), "{error}");
}
