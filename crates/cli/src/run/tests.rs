use std::fs;
use std::path::PathBuf;

use super::*;
use crate::args::ScenarioArguments;

/// A folder name of its own for one test, removed when dropped.
struct Scratch(PathBuf);

impl Scratch {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("sumprod-run-{}-{name}", std::process::id()));
        let _ = fs::remove_dir_all(&path);
        Self(path)
    }

    fn files(&self) -> Vec<String> {
        let mut names: Vec<String> = fs::read_dir(&self.0)
            .map(|entries| {
                entries.flatten().map(|entry| entry.file_name().to_string_lossy().into_owned()).collect()
            })
            .unwrap_or_default();
        names.sort();
        names
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

fn arguments(sets: &[&str], out: Option<&Scratch>) -> RunArguments {
    RunArguments {
        scenario: ScenarioArguments {
            scenario: "walk".into(),
            set: sets.iter().map(|&set| set.to_owned()).collect(),
            ..ScenarioArguments::default()
        },
        out: out.map(|scratch| scratch.0.clone()),
        ..RunArguments::default()
    }
}

fn run(arguments: &RunArguments) -> Result<Report, Failure> {
    let document = setup::document(&arguments.scenario, &[])?;
    dispatch(&document, Run { arguments, out: arguments.out.as_deref() })
}

#[test]
fn a_run_writes_all_its_files_and_the_table_judges_the_methods() {
    let scratch = Scratch::new("files");
    let report = run(&arguments(&[], Some(&scratch))).unwrap();
    let expected = [
        "error_cdf.svg",
        "estimates.csv",
        "metrics.json",
        "nees.svg",
        "rmse.svg",
        "runs.jsonl",
        "trajectories.svg",
        "walk.txt",
    ];
    assert_eq!(scratch.files(), expected);
    assert_eq!(fs::read_to_string(scratch.0.join("walk.txt")).unwrap(), "run 0\n");
    let json: serde_json::Value =
        serde_json::from_str(&fs::read_to_string(scratch.0.join("metrics.json")).unwrap()).unwrap();
    assert_eq!(json["methods"]["kf"]["conversion_loss"]["range"], 0.25);
    assert_eq!(json["runs"], 30);
    let lines = fs::read_to_string(scratch.0.join("estimates.csv")).unwrap().lines().count();
    assert_eq!(lines, 1 + 30 * 3 * 40 * 2);

    let text = report::text(&report);
    let line = |id: &str| text.lines().find(|line| line.starts_with(id)).unwrap().to_owned();
    assert!(line("kf ").ends_with("  yes"), "{text}");
    assert!(line("boastful ").ends_with("  no, over-confident"), "{text}");
    assert!(line("raw ").ends_with("  yes"), "{text}");
    assert!(text.contains("bound") && text.contains("kf: conversion_loss.range 0.250"), "{text}");
    assert!(text.contains("kf: an exact answer"));

    let again = run(&arguments(&[], Some(&scratch))).unwrap();
    assert_eq!(again, report, "a finished campaign is read back, times included");
}

#[test]
fn a_failure_writes_nothing_and_takes_its_empty_folder_away() {
    let scratch = Scratch::new("failure");
    let failure = run(&arguments(&["world.fails_at=0", "runs=1"], Some(&scratch))).unwrap_err();
    assert_eq!(failure.sentence(), "run 0: method `kf`: the innovation covariance is singular");
    assert_eq!(failure.status(), 1);
    assert!(!scratch.0.exists());
    let failure = run(&arguments(&["world.process_variance=-1"], Some(&scratch))).unwrap_err();
    assert_eq!(failure.status(), 2);
    assert!(!scratch.0.exists());
}

#[test]
fn a_folder_that_cannot_be_written_is_a_wrong_input() {
    let scratch = Scratch::new("file-in-the-way");
    fs::write(&scratch.0, "a file").unwrap();
    let failure = run(&arguments(&[], Some(&scratch))).unwrap_err();
    assert_eq!(failure.status(), 2);
    assert!(failure.sentence().contains("--out") && failure.sentence().ends_with("choose another folder"));
    fs::remove_file(&scratch.0).unwrap();
}

#[test]
fn data_for_a_scenario_that_reads_none_and_unknown_methods_are_refused() {
    let mut wrong = arguments(&[], None);
    wrong.scenario.data = Some("somewhere".into());
    assert!(run(&wrong).unwrap_err().sentence().contains("reads no data"));
    let mut wrong = arguments(&[], None);
    wrong.scenario.method = vec!["kff".into()];
    let failure = run(&wrong).unwrap_err();
    assert_eq!(failure.sentence(), "there is no method `kff` in this scenario; it has kf, boastful, raw");
    assert_eq!(failure.status(), 2);
}

#[test]
fn outputs_can_be_turned_off() {
    let scratch = Scratch::new("off");
    run(&arguments(&["runs=2", "output.plots=false", "output.estimates=false"], Some(&scratch))).unwrap();
    assert_eq!(scratch.files(), ["metrics.json", "runs.jsonl", "walk.txt"]);
}

#[test]
fn a_sweep_runs_every_value_into_a_folder_of_its_own_and_prints_one_table() {
    let scratch = Scratch::new("sweep");
    let mut wanted = arguments(&["runs=3"], Some(&scratch));
    wanted.sweep = vec!["world.process_variance=1,4".into()];
    let swept = sweep::run(&wanted, &[]).unwrap();
    let expected = ["metrics.json", "sweep.svg", "world.process_variance=1", "world.process_variance=4"];
    assert_eq!(scratch.files(), expected);
    assert!(scratch.0.join(expected[2]).join("estimates.csv").exists());
    let text = sweep::text(&swept);
    assert_eq!(text.lines().filter(|line| line.contains(" kf ")).count(), 2, "{text}");
    let json: serde_json::Value =
        serde_json::from_str(&fs::read_to_string(scratch.0.join("metrics.json")).unwrap()).unwrap();
    assert_eq!(json["sweep"][1]["values"]["world.process_variance"], 4);
    let alone = run(&arguments(&["runs=3", "world.process_variance=4"], None)).unwrap();
    let figure = &json["sweep"][1]["methods"]["kf"]["position_rmse_m"]["mean"];
    assert_eq!(figure.as_f64().unwrap(), alone.methods[0].1.summary.position_rmse_m.as_ref().unwrap().mean);
}

#[test]
fn a_wrong_value_of_a_sweep_is_told_before_anything_runs() {
    let scratch = Scratch::new("sweep-wrong");
    let mut wanted = arguments(&["runs=3"], Some(&scratch));
    wanted.sweep = vec!["world.process_variance=1,-4".into()];
    let failure = sweep::run(&wanted, &[]).map(drop).unwrap_err();
    assert_eq!(failure.status(), 2);
    assert!(failure.sentence().contains("world.process_variance=-4"), "{}", failure.sentence());
    assert!(!scratch.0.exists());
}
