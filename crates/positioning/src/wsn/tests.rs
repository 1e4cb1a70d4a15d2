use super::*;
use crate::campaign::Campaign;
use crate::metrics::{DiagnosticValue, MethodMetrics, Report};

/// The methods of the built-in scenarios.
const METHODS: &str = r#"
    "iekf": {"algorithm": "iekf"},
    "pf": {"algorithm": "bootstrap"},
    "rpf": {"algorithm": "regularised"},
    "literal": {"algorithm": "quantum-literal"},
    "is": {"algorithm": "quantum-importance"},
    "mh": {"algorithm": "quantum-metropolis"}"#;

fn scenario(world: &str, methods: &str) -> Wsn {
    let scenario: Wsn =
        serde_json::from_str(&format!(r#"{{"world": {{{world}}}, "method": {{{methods}}}}}"#)).unwrap();
    scenario.validate().unwrap();
    scenario
}

fn report(mut scenario: Wsn, runs: u32, methods: &[&str], particles: usize) -> Report {
    let each = scenario.method.iter().map(|(id, method)| {
        let particles = method.algorithm.has_particles().then_some(particles);
        (id.to_owned(), MethodSettings { particles, ..method.clone() })
    });
    scenario.method = Methods::new(each.collect());
    let methods: Vec<String> = methods.iter().map(|&id| id.to_owned()).collect();
    let campaign = Campaign::new(&scenario, &(), 1, runs, &methods).unwrap();
    Report::new("test", 1, &campaign.run(None, &|_, _| {}).unwrap()).unwrap()
}

fn rmse(report: &Report, id: &str) -> f64 {
    report.method(id).unwrap().summary.position_rmse_m.as_ref().unwrap().mean
}

fn told(metrics: &MethodMetrics, name: &str) -> f64 {
    match metrics.diagnostics.get(name) {
        Some(DiagnosticValue::Number(value)) => *value,
        other => panic!("{name}: {other:?}"),
    }
}

#[track_caller]
fn within(value: f64, low: f64, high: f64) {
    assert!((low..=high).contains(&value), "{value} is not within {low} to {high}");
}

#[test]
fn the_kalman_filter_is_calibrated_and_near_the_bound() {
    let report = report(scenario(r#""start": "bayes""#, METHODS), 200, &["iekf"], 1);
    let bound = report.bound.as_ref().unwrap().position_rmse_m.mean;
    within(rmse(&report, "iekf") / bound, 0.95, 1.05);
    let metrics = report.method("iekf").unwrap();
    within(metrics.summary.coverage95.unwrap(), 0.94, 0.965);
    within(metrics.summary.nees.as_ref().unwrap().state.as_ref().unwrap().mean, 3.7, 4.3);
}

#[test]
fn the_metropolis_form_beats_the_bootstrap_with_50_particles_and_keeps_them_distinct() {
    let report = report(scenario("", METHODS), 60, &["pf", "mh"], 50);
    assert!(rmse(&report, "mh") < 0.75 * rmse(&report, "pf"));
    within(rmse(&report, "mh"), 0.43, 0.53);
    let mh = report.method("mh").unwrap();
    assert!(told(mh, "distinct_fraction") > 0.88);
    within(told(mh, "acceptance"), 0.33, 0.46);
    assert_eq!(told(mh, "likelihood_evaluations"), 30.0 * 300.0);
    let pf = report.method("pf").unwrap();
    within(told(pf, "n_eff"), 21.5, 24.5);
    assert_eq!(told(pf, "likelihood_evaluations"), 30.0 * 50.0);
    within(told(pf, "unique_ancestors"), 20.0, 35.0);
}

#[test]
fn the_literal_form_is_not_calibrated_and_says_so() {
    // The likelihood counts several times: the position is over-confident, and the velocity hides it in the sum. The
    // start is the fixed one: of twelve drawn ones, one lies 3.9 deviations out in a velocity, where no particle is.
    let report = report(scenario("", METHODS), 12, &["literal", "mh"], 2000);
    let literal = report.method("literal").unwrap();
    assert!(literal.summary.coverage95.unwrap() < 0.9);
    let blocks = literal.summary.nees.as_ref().unwrap();
    assert!(blocks.position.as_ref().unwrap().mean > 2.8);
    assert!(blocks.velocity.as_ref().unwrap().mean < 0.8);
    assert!(literal.notes.iter().any(|note| note.starts_with("literal:")));
    // Twelve runs tell the coverage to 0.01.
    let sound = report.method("mh").unwrap();
    within(sound.summary.coverage95.unwrap(), 0.91, 0.98);
    assert!(sound.notes.is_empty());
}

#[test]
fn as_printed_without_reselection_the_literal_form_degenerates() {
    let never = r#""never": {"algorithm": "quantum-literal", "resample_below": 0.0}, "always": {"algorithm": "quantum-literal"}"#;
    let report = report(scenario("", never), 30, &["never", "always"], 50);
    assert!(told(report.method("never").unwrap(), "n_eff_final") < 5.0);
    assert!(told(report.method("always").unwrap(), "n_eff_final") > 15.0);
    assert!(rmse(&report, "never") > 1.5 * rmse(&report, "always"));
}

#[test]
fn evidence_agrees_with_the_kalman_filter() {
    // Ranges of 500 m are as good as linear. An estimate's log lies below the true one by half its variance, which a
    // start in the prior's tail makes large: the fixed start is 0.7 deviations away.
    let report = report(scenario("", METHODS), 10, &["iekf", "rpf", "is", "mh"], 2000);
    let exact = told(report.method("iekf").unwrap(), "log_evidence");
    for id in ["rpf", "is", "mh"] {
        within(told(report.method(id).unwrap(), "log_evidence") - exact, -1.0, 0.5);
    }
}

#[test]
fn sensors_chosen_by_information_tell_more_than_any() {
    let rules = r#""all": {"algorithm": "iekf"},
        "information": {"algorithm": "iekf", "active": 2},
        "economy": {"algorithm": "iekf", "active": 2, "schedule": "economy"},
        "random": {"algorithm": "iekf", "active": 2, "schedule": "random"}"#;
    let world = r#""sensors": 25, "layout": "scattered", "start": "bayes""#;
    let report = report(scenario(world, rules), 60, &["all", "information", "economy", "random"], 1);
    let [all, information, economy, random] =
        ["all", "information", "economy", "random"].map(|id| rmse(&report, id));
    assert!(all < information && information < 0.9 * random, "{all} {information} {economy} {random}");
    let spent = |id: &str| told(report.method(id).unwrap(), "transmissions");
    assert!(spent("economy") < spent("information") && spent("information") < spent("all"));
    assert_eq!(told(report.method("information").unwrap(), "measurements"), 2.0);
}

#[test]
fn a_lost_target_is_found_again() {
    let world = r#""steps": 40, "process_variance": 1.0, "sensors": 16, "reach": 130.0, "loss": 0.3, "start": "bayes""#;
    let methods =
        r#""keep": {"algorithm": "bootstrap"}, "seek": {"algorithm": "bootstrap", "reacquire": true}"#;
    let report = report(scenario(world, methods), 40, &["keep", "seek"], 100);
    assert!(rmse(&report, "seek") < 0.8 * rmse(&report, "keep"));
    assert!(told(report.method("seek").unwrap(), "reacquisitions") > 0.0);
}

#[test]
fn readings_that_no_particle_explains_are_told_and_the_remedy_is_the_user_s() {
    let world = r#""prior_mean": [500.0, 8.66, 19.8, 8.9], "steps": 5"#;
    let methods = r#""likeliest": {"algorithm": "bootstrap"},
        "keep": {"algorithm": "bootstrap", "gate": 30.0, "recovery": "keep-prediction"}"#;
    let report = report(scenario(world, methods), 1, &["likeliest", "keep"], 200);
    for id in ["likeliest", "keep"] {
        let metrics = report.method(id).unwrap();
        assert_eq!(told(metrics, "unexplained"), 1.0, "{id}");
        assert!(metrics.notes.iter().any(|note| note.starts_with("unexplained:")), "{id}");
    }
    assert_eq!(told(report.method("keep").unwrap(), "recovered"), 1.0);
    let failing = scenario(world, r#""fail": {"algorithm": "bootstrap", "gate": 30.0}"#);
    let ids = failing.methods();
    let error = failing.run(&(), RunRequest { seed: 1, run: 0, methods: &ids }).unwrap_err().to_string();
    assert!(error.starts_with("method `fail`: step 1: none of 2000 particles explains"), "{error}");
}

#[test]
fn a_scan_without_measurements_is_a_prediction() {
    let deaf = scenario(r#""loss": 1.0"#, METHODS);
    let ids = deaf.methods();
    let result = deaf.run(&(), RunRequest { seed: 1, run: 0, methods: &ids }).unwrap();
    for method in &result.methods {
        let last = method.estimates().last().unwrap();
        assert!((last.mean[0] - (81.0 + 30.0 * 8.66)).abs() < 25.0, "{}", method.id);
    }
}

#[test]
fn wrong_keys_are_named() {
    let refused = |method: &str| -> String {
        let text = format!(r#"{{"method": {{"a": {{{method}}}}}}}"#);
        serde_json::from_str::<Wsn>(&text).unwrap().validate().unwrap_err().to_string()
    };
    for (method, expected) in [
        (
            r#""algorithm": "iekf", "particles": 5"#,
            "`method.a.particles` is set, but this method holds no particles",
        ),
        (r#""algorithm": "bootstrap", "particles": 0"#, "`method.a.particles` is 0; at least 1 particle"),
        (r#""algorithm": "bootstrap", "bits": 9"#, "`method.a.bits` is set, but this method encodes nothing"),
        (
            r#""algorithm": "quantum-metropolis", "bits": 20"#,
            "`method.a.bits` cannot be used: the number of bits",
        ),
        (
            r#""algorithm": "quantum-metropolis", "rotation": 0.1"#,
            "`method.a.rotation` is set, but this method",
        ),
        (
            r#""algorithm": "quantum-importance", "rotation": -1.0"#,
            "`method.a.rotation` cannot be used: the angle",
        ),
        (r#""algorithm": "quantum-importance", "generations": 0"#, "`method.a.generations` is 0"),
        (r#""algorithm": "quantum-literal", "decoding": "global4", "reach": 1.0"#, "`method.a.reach` is set"),
        (r#""algorithm": "bootstrap", "resample_below": 2.0"#, "`method.a.resample_below` is 2; a share"),
        (r#""algorithm": "iekf", "gate": 5.0"#, "`method.a.gate` is set, but this method holds no particles"),
        (r#""algorithm": "bootstrap", "gate": 0.0"#, "`method.a.gate` is 0; a number of standard deviations"),
        (
            r#""algorithm": "bootstrap", "particles": 900000000"#,
            "`method.a.particles` is 900000000, which with 0",
        ),
        (r#""algorithm": "iekf", "active": 0"#, "`method.a.active` is 0; at least 1 sensor"),
    ] {
        let found = refused(method);
        assert!(found.starts_with(expected), "{found}");
    }
}
