//! Wrong networks given to the program: one sentence that names the culprit, exit status 2; and one that changes form.

#![allow(clippy::expect_used, reason = "helpers of tests fail the test")]

use std::process::{Command, Output};

fn sumprod(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_sumprod")).args(arguments).output().expect("the program starts")
}

fn refused(arguments: &[&str]) -> String {
    let output = sumprod(arguments);
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{message}");
    assert!(output.stdout.is_empty(), "nothing on standard output");
    assert_eq!(message.lines().count(), 1, "{message}");
    message
}

#[test]
fn a_network_without_anchors_and_priors_says_what_floats() {
    for verb in ["run", "check"] {
        let sets = ["--set", "world.anchors=[]", "--set", "world.prior=false"];
        let message = refused(&[&[verb, "coop-c3"], &sets[..]].concat());
        let sentence =
            "nothing constrains the translation (2 directions) and rotation (1) of agents 1, 2 and 3";
        assert!(message.contains(sentence), "{message}");
        assert!(message.contains("add anchors"), "{message}");
    }
}

#[test]
fn values_that_mean_nothing_are_refused_by_their_key() {
    for (set, part) in [
        ("world.range_variance=-1", "`world.range_variance` is -1 m²"),
        ("world.radius=0", "`world.radius` is 0 m"),
        ("world.agents=0", "`world.agents` is 0"),
        ("world.speed=3", "`world.speed` is an unknown key; did you mean `world.speed_variance`?"),
        ("method.particle-bp.particles=0", "`method.particle-bp.particles` is 0"),
        ("method.joint.particles=5", "`method.joint.particles` does not apply to the joint filter"),
        ("method.gaussian-bp.form.range={particles=0}", "`method.gaussian-bp.form.range.particles` is 0"),
        ("method.gaussian-bp.form.range=mixtur", "choose one of gaussian, mixture, particles"),
        ("method.gaussian-bp.form.ranges=gaussian", "did you mean `method.gaussian-bp.form.range`?"),
        ("method.gaussian-bp.neighbours=silent", "choose one of extrinsic, broadcast, plug-in, ignored"),
    ] {
        let message = refused(&["run", "coop-c3", "--set", set]);
        assert!(message.contains(part), "{set}: {message}");
    }
}

#[test]
fn another_form_runs_and_reports_its_cost() {
    let set = "method.gaussian-bp.form.range={particles=300}";
    let steps = "world.steps=3";
    let arguments = ["run", "coop-c3", "--runs", "2", "--method", "gaussian-bp", "--json"];
    let output = sumprod(&[&arguments[..], &["--set", set, "--set", steps]].concat());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON on standard output");
    let method = &json["methods"]["gaussian-bp"];
    assert!(method["conversion_loss"]["prediction"].as_f64().is_some_and(|loss| loss > 0.0), "{method}");
    assert!(method["n_eff"].as_f64().is_some_and(|n_eff| n_eff > 1.0), "{method}");
}

#[test]
fn every_network_is_described() {
    for scenario in ["coop-c3", "coop-c10", "coop-c100"] {
        let output = sumprod(&["check", scenario]);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(text.contains("form.prediction = particles 1000"), "{text}");
        assert!(text.starts_with("joint (the start and the first slice): 2 variables, 2 factors"), "{text}");
    }
}

#[test]
fn a_static_network_says_what_is_wrong_with_it() {
    for (set, part) in [
        (
            "world.anchors_per_100=0",
            "nothing constrains the translation (2 directions) and rotation (1) of agents 1, 2",
        ),
        ("world.agents=0", "`world.agents` is 0"),
        ("world.radius=-1", "`world.radius` is -1 m"),
        ("world.link_loss=2", "`world.link_loss` is 2"),
        ("method.nbp.cells=[4.0, 3.0]", "`method.nbp.cells` holds 3 m after 4 m"),
        ("method.nbp.cells=[4.0]", "`method.nbp.rounds` holds 2 numbers for 1 widths"),
        ("method.nbp.components=0", "`method.nbp.components` is 0"),
        ("method.nbp.cell=[4.0]", "did you mean `method.nbp.cells`?"),
    ] {
        let message = refused(&["run", "coop-static", "--set", set]);
        assert!(message.contains(part), "{set}: {message}");
    }
}
