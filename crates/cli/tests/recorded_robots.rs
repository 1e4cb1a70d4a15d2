//! Robots on recorded data: accuracy and honesty on the recordings where they are at hand, and what is said of
//! recordings that are broken.
//!
//! The recordings are sought in $SUMPROD_DATA, else in ../shared/data beside the workspace; where one is absent, its
//! test says so and passes.

#![allow(clippy::expect_used, reason = "helpers of tests fail the test")]

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;

fn sumprod(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_sumprod")).args(arguments).output().expect("the program starts")
}

/// A recording's folder, where it is at hand.
fn recording(name: &str) -> Option<String> {
    let workspace = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data");
    let root = std::env::var_os("SUMPROD_DATA").map_or(workspace, PathBuf::from);
    let path = root.join(name);
    if path.is_dir() {
        return path.to_str().map(str::to_owned);
    }
    println!("skipped: the recording {name} is not at {}", path.display());
    None
}

fn methods(scenario: &str, data: &str, more: &[&str]) -> Value {
    let output = sumprod(&[&["run", scenario, "--json", "--data", data], more].concat());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let mut report: Value = serde_json::from_slice(&output.stdout).expect("metrics as JSON");
    report["methods"].take()
}

fn rmse(methods: &Value, id: &str) -> f64 {
    methods[id]["position_rmse_m"]["mean"].as_f64().expect("an error")
}

/// Checks error (m), position NEES per degree of freedom, and coverage of the 95 % regions.
fn hold(methods: &Value, id: &str, error: f64, nees: [f64; 2], coverage: [f64; 2]) {
    let block = &methods[id]["nees"]["position"];
    let ratio = block["mean"].as_f64().zip(block["dof"].as_f64()).map(|(mean, dof)| mean / dof);
    let (ratio, covered) = (ratio.expect("a NEES"), methods[id]["coverage95"].as_f64().expect("a coverage"));
    let found = rmse(methods, id);
    assert!(found <= error, "{id}: {found} m");
    assert!((nees[0]..=nees[1]).contains(&ratio), "{id}: NEES {ratio}");
    assert!((coverage[0]..=coverage[1]).contains(&covered), "{id}: coverage {covered}");
}

#[test]
fn plaza_is_located_and_its_radio_calibrated() {
    let Some(data) = recording("plaza/plaza2") else { return };
    let methods = methods("plaza", &data, &["--method", "odometry,filter,smoother"]);
    hold(&methods, "filter", 0.32, [0.6, 1.6], [0.90, 0.99]);
    hold(&methods, "smoother", 0.23, [0.6, 1.6], [0.90, 0.99]);
    assert!(rmse(&methods, "odometry") > 10.0);
}

#[test]
fn a_walker_among_radio_links_is_tracked_by_every_method() {
    let Some(data) = recording("rti_basement") else { return };
    let fewer = |id: &str| format!("method.{id}.particles=300");
    let sets = ["pf", "qgpf-mh", "kcpf"].map(fewer);
    let more: Vec<&str> = sets.iter().flat_map(|set| ["--set", set]).collect();
    let methods = methods("wsn-walk", &data, &[&more[..], &["--set", "model.cell=0.3"]].concat());
    for id in ["grid", "pf", "qgpf-mh", "kcpf"] {
        hold(&methods, id, 1.0, [0.5, 1.6], [0.90, 0.995]);
    }
}

#[test]
fn five_robots_are_located_with_all_landmarks() {
    let Some(data) = recording("mrclam/dataset6") else { return };
    let methods = methods("mrclam", &data, &["--method", "odometry,filter,smoother"]);
    hold(&methods, "filter", 0.12, [0.6, 1.5], [0.90, 0.985]);
    hold(&methods, "smoother", 0.07, [0.6, 1.5], [0.90, 0.985]);
    assert!(rmse(&methods, "odometry") > 1.0);
}

/// Positions by particles, the rest of each state a Gaussian a particle: 200 particles already do.
#[test]
fn robots_are_located_by_particles() {
    let few = |id: &'static str| ["--method", "particle-filter", "--set", id];
    if let Some(data) = recording("plaza/plaza2") {
        let methods = methods("plaza", &data, &few("method.particle-filter.particles=200"));
        hold(&methods, "particle-filter", 0.41, [0.5, 1.8], [0.88, 0.99]);
    }
}

#[test]
fn robots_that_see_no_landmark_are_located_through_the_others() {
    let Some(data) = recording("mrclam/dataset6") else { return };
    let more =
        ["--set", "world.landmark_observers=[3,5]", "--method", "filter,filter-no-cooperation,smoother"];
    let methods = methods("mrclam", &data, &more);
    hold(&methods, "filter", 0.15, [0.6, 1.5], [0.90, 0.985]);
    hold(&methods, "smoother", 0.09, [0.6, 1.5], [0.90, 0.985]);
    assert!(rmse(&methods, "filter-no-cooperation") > 1.0);
}

/// A folder of its own for one test, removed when dropped.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("sumprod-{}-{name}", std::process::id()));
        fs::create_dir_all(&path).expect("a temporary folder");
        Self(path)
    }

    fn write(&self, file: &str, text: &str) {
        fs::write(self.0.join(file), text).expect("a temporary file");
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

/// What is said when a recording is refused; nothing may be written then.
fn refused(scenario: &str, folder: &Folder) -> String {
    let out = std::env::temp_dir().join(format!("sumprod-{}-{scenario}-never-made", std::process::id()));
    let (data, path) = (folder.0.to_str().expect("UTF-8"), out.to_str().expect("UTF-8"));
    let output = sumprod(&["run", scenario, "--data", data, "--out", path]);
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{message}");
    assert_eq!(message.lines().count(), 1, "{message}");
    assert!(output.stdout.is_empty() && !out.exists());
    message
}

#[test]
fn a_broken_plaza_recording_is_refused_with_file_and_line() {
    let folder = Folder::new("broken-plaza");
    assert!(refused("plaza", &folder).contains("holds no file Plaza*_TL.csv"));
    folder.write("Plaza9_TL.csv", "node_id,x_m,y_m\n1,10,0\n");
    folder.write("Plaza9_GT.csv", "t_s,x_m,y_m,heading_rad\n5.0,1,2,-2.5\n5.1,1,2,-2.5\n");
    folder.write("Plaza9_TD.txt", "5.05 2 1 NaN\n");
    folder.write("Plaza9_DR.txt", "5.1 0.4 -0.01\n5.2 0.3\n");
    assert!(refused("plaza", &folder).contains("Plaza9_DR.txt:2: the line is cut short"));
    folder.write("Plaza9_DR.txt", "5.1 0.4 -0.01\n");
    assert!(
        refused("plaza", &folder).contains("Plaza9_TD.txt:1: field 4 (range m) is NaN; it must be finite")
    );
}

#[test]
fn a_broken_team_recording_is_refused_with_file_and_line() {
    let folder = Folder::new("broken-team");
    assert!(refused("mrclam", &folder).contains("holds no file RobotN_Odometry.dat"));
    folder.write("Robot1_Odometry.dat", "1.0 0.1 0\n");
    folder.write("Landmark_Groundtruth.dat", "6 1.5 abc 0.001 0.001\n");
    assert!(refused("mrclam", &folder).contains("Landmark_Groundtruth.dat:1: field 3 (y m) is \"abc\""));
}
