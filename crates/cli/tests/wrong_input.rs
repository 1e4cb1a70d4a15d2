//! Wrong input to the program: one sentence on standard error, exit status 2, nothing written.

#![allow(clippy::expect_used, reason = "helpers of tests fail the test")]

use std::fs;
use std::path::PathBuf;
use std::process::{Command, Output};

fn sumprod(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_sumprod")).args(arguments).output().expect("the program starts")
}

fn refused(arguments: &[&str]) -> String {
    let output = sumprod(arguments);
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{message}");
    assert!(output.stdout.is_empty(), "nothing on standard output");
    assert!(message.starts_with("error: "), "{message}");
    message
}

/// A scenario file of its own for one test, removed when dropped.
struct File(PathBuf);

impl File {
    fn new(name: &str, text: &str) -> Self {
        let path = std::env::temp_dir().join(format!("sumprod-{}-{name}.toml", std::process::id()));
        fs::write(&path, text).expect("a temporary file");
        Self(path)
    }

    fn name(&self) -> &str {
        self.0.to_str().expect("a path in UTF-8")
    }
}

impl Drop for File {
    fn drop(&mut self) {
        let _ = fs::remove_file(&self.0);
    }
}

#[test]
fn an_unknown_scenario_is_named() {
    let message = refused(&["run", "no-such-scenario"]);
    assert!(message.contains("no-such-scenario is neither a file nor a built-in scenario"), "{message}");
    assert_eq!(message.lines().count(), 1, "{message}");
}

#[test]
fn a_broken_file_is_refused_with_its_line() {
    let file = File::new("broken", "system = \"p-mpa\"\n[world\nsteps = 3\n");
    let message = refused(&["check", file.name()]);
    assert!(message.contains(&format!("{}:2: this is not TOML", file.name())), "{message}");
    assert_eq!(message.lines().count(), 1, "{message}");
}

#[test]
fn a_system_that_does_not_exist_is_refused_before_the_output_folder_is_made() {
    let file = File::new("system", "\nsystem = \"moon\"\n");
    let out = std::env::temp_dir().join(format!("sumprod-{}-never-made", std::process::id()));
    let message = refused(&["run", file.name(), "--out", out.to_str().expect("a path in UTF-8")]);
    assert!(message.contains(":2: `system` is \"moon\", which does not exist"), "{message}");
    assert!(!out.exists());
}

#[test]
fn a_base_that_does_not_exist_and_a_missing_system_are_refused() {
    let file = File::new("base", "base = \"moon\"\n");
    assert!(refused(&["run", file.name()]).contains(":1: `base` is \"moon\""));
    let file = File::new("empty", "runs = 3\n");
    assert!(refused(&["run", file.name()]).contains("`system` is missing"));
}

#[test]
fn an_override_without_a_value_is_refused() {
    let file = File::new("override", "system = \"p-mpa\"\n");
    let message = refused(&["run", file.name(), "--set", "world.steps"]);
    assert!(message.contains("--set world.steps: write KEY=VALUE"), "{message}");
}

#[test]
fn the_list_is_printed() {
    let output = sumprod(&["list"]);
    assert!(output.status.success());
    assert!(String::from_utf8_lossy(&output.stdout).starts_with("scenario"));
}

#[test]
fn numbers_that_cannot_be_are_refused_with_their_key() {
    let covariance = "start.pose_covariance=[[1.0,2.0,0.0],[2.0,1.0,0.0],[0.0,0.0,1.0]]";
    let crooked = "start.pose_covariance=[[1.0,0.5,0.0],[0.4,1.0,0.0],[0.0,0.0,1.0]]";
    for (scenario, set, words) in [
        ("pmpa-cdf", "world.stepz=3", "did you mean `world.steps`"),
        ("pmpa-cdf", "world.process_variance=-1", "a variance must be positive and finite"),
        ("pmpa-cdf", "method.pf.particles=0", "at least 1 particle"),
        ("coop-c3", "world.range_variance=nan", "is NaN"),
        ("coop-c3", "method.gaussian-bp.form.range=mixtur", "choose one of gaussian, mixture, particles"),
        (
            "plaza",
            covariance,
            "`start.pose_covariance` cannot be a covariance: the matrix is not positive definite",
        ),
        ("plaza", crooked, "a covariance must be symmetric"),
    ] {
        let message = refused(&["run", scenario, "--set", set]);
        assert!(message.contains(words), "{message}");
        let key = set.split('=').next().expect("a key");
        assert!(message.contains(key), "{message}");
        assert_eq!(message.lines().count(), 1, "{message}");
    }
}

#[test]
fn a_file_of_mixtures_that_is_none_is_refused_before_the_output_folder_is_made() {
    let file = File::new("mixtures", r#"{"dimension": 1, "mixtures": []}"#);
    let out = std::env::temp_dir().join(format!("sumprod-{}-no-product", std::process::id()));
    let out = out.to_str().expect("a path in UTF-8");
    let message = refused(&["run", "product", "--data", file.name(), "--out", out]);
    assert!(message.contains(&format!("{}: `mixtures` is empty", file.name())), "{message}");
    assert_eq!(message.lines().count(), 1, "{message}");
    assert!(!PathBuf::from(out).exists());
}

#[test]
fn a_network_that_nothing_fixes_says_what_would() {
    for verb in ["run", "check"] {
        let message = refused(&[verb, "coop-c3", "--set", "world.anchors=[]", "--set", "world.prior=false"]);
        assert!(message.contains("nothing constrains the translation"), "{message}");
        assert!(message.contains("add anchors"), "{message}");
    }
}

#[test]
fn a_range_only_graph_that_breaks_off_is_refused_with_its_line() {
    let file = File::new("graph", "Variable Pose SE2 A 0 0 0\nVariable Landmark R2 L 1");
    for verb in ["run", "check"] {
        let message = refused(&[verb, "range-slam-small", "--data", file.name()]);
        assert!(message.contains(":2: the line is cut short: y is missing after 5 fields"), "{message}");
        assert_eq!(message.lines().count(), 1, "{message}");
    }
    let message =
        refused(&["run", "range-slam-small", "--data", file.name(), "--set", "method.mixture.samples=0"]);
    assert!(message.contains("`method.mixture.samples` is 0"), "{message}");
}

#[test]
fn a_reader_that_has_seen_enough_is_no_failure() {
    use std::process::Stdio;
    for arguments in [&["list"][..], &["run", "coop-c3", "--runs", "1", "--method", "joint"]] {
        let mut command = Command::new(env!("CARGO_BIN_EXE_sumprod"));
        let mut child =
            command.args(arguments).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("it starts");
        drop(child.stdout.take());
        let output = child.wait_with_output().expect("it ends");
        assert!(output.status.success() && output.stderr.is_empty(), "{output:?}");
    }
}
