//! The scenario against integrals, against the published samples, and on wrong files.

mod reference;

use std::path::PathBuf;

use serde_json::{Value, json};

use super::{RangeGraph, RangeSlam};
use crate::results::{MethodRun, RunResult};
use crate::robots::scratch::Scratch;
use crate::scenario::{RunRequest, Scenario};
use reference::reference;

/// Four poses that bend to the left, two landmarks; measurements with noise. Rings at first, then mirror modes.
const GRAPH: &str = "\
# A graph of our own.
Variable Pose SE2 A 1.0 2.0 0.3
Variable Pose SE2 B 24.0 12.3 0.7
Variable Pose SE2 C 40.6 23.6 1.6
Variable Pose SE2 D 39.0 45.6 2.4
Variable Landmark R2 near 50.0 -15.0
Variable Landmark R2 far -10.0 45.0

Factor UnarySE2ApproximateGaussianPriorFactor A 1.0 2.0 0.3 covariance 0.01 0 0 0 0.01 0 0 0 0.0004
Factor SE2RelativeGaussianLikelihoodFactor A B 25 3 0.4 covariance 0.09 0.01 0 0.01 0.04 0 0 0 0.0009
Factor SE2RelativeGaussianLikelihoodFactor B C 20 -2 0.9 covariance 0.09 0.01 0 0.01 0.04 0 0 0 0.0009
Factor SE2RelativeGaussianLikelihoodFactor C D 22 1 0.8 covariance 0.09 0.01 0 0.01 0.04 0 0 0 0.0009
Factor SE2R2RangeGaussianLikelihoodFactor A near 52.6 1.5
Factor SE2R2RangeGaussianLikelihoodFactor A far 45.2 1.5
Factor SE2R2RangeGaussianLikelihoodFactor B near 36.9 1.5
Factor SE2R2RangeGaussianLikelihoodFactor C near 40.9 1.5
Factor SE2R2RangeGaussianLikelihoodFactor C far 54.0 1.5
Factor SE2R2RangeGaussianLikelihoodFactor D near 60.7 1.5
Factor SE2R2RangeGaussianLikelihoodFactor D far 50.6 1.5
";

fn scenario(methods: Value) -> RangeSlam {
    let scenario: RangeSlam =
        serde_json::from_value(json!({"world": {"file": "graph.fg"}, "method": methods})).unwrap();
    scenario.validate().unwrap();
    scenario
}

fn both() -> RangeSlam {
    scenario(json!({
        "mixture": {"samples": 4000, "form": {"range": {"mixture": 100}}},
        "gaussian": {"form": {"range": "gaussian"}},
    }))
}

fn run(scenario: &RangeSlam, file: &std::path::Path, seed: u64) -> RunResult {
    let growing = scenario.prepare(seed, Some(file)).unwrap();
    let methods = scenario.methods();
    scenario.run(&growing, RunRequest { seed, run: 0, methods: &methods }).unwrap()
}

fn method<'a>(result: &'a RunResult, id: &str) -> &'a MethodRun {
    result.methods.iter().find(|method| method.id == id).unwrap()
}

fn list<'a>(method: &'a MethodRun, name: &str) -> &'a [f64] {
    &method.lists.iter().find(|list| list.name == name).unwrap().values
}

/// The draws of one scalar marginal.
fn marginal(result: &RunResult, file: &str, line: &str) -> Vec<f64> {
    let text = &result.files.iter().find(|found| found.name == file).unwrap().contents;
    let found = text.lines().find_map(|text| text.strip_prefix(line)).unwrap();
    found.split(',').filter(|field| !field.is_empty()).map(|field| field.parse().unwrap()).collect()
}

fn draw_count(result: &RunResult, step: usize) -> usize {
    let name = format!("samples-mixture-step{step}.csv");
    let file = result.files.iter().find(|file| file.name == name).unwrap();
    file.contents.lines().next().unwrap().split(',').count() - 2
}

/// Holds evidence, means, variances and shares of both sides of the first pose's course at every step against integrals
/// over `count` trajectories. Every difference stays within five standard errors, which a normal error exceeds once in
/// two million.
fn assert_integrals(graph: &RangeGraph, result: &RunResult, count: u32) {
    let mixture = method(result, "mixture");
    let [x0, y0, heading] = graph.priors[0].at;
    for step in 0..graph.poses.len() {
        let exact = reference(graph, step, count);
        let effective = list(mixture, "n_eff_by_step")[step];
        assert!(effective > 4_000.0, "step {step}: {effective} effective draws");
        assert!(exact.effective > 100.0, "step {step}: {} effective trajectories", exact.effective);
        let error = |variance: f64| 5.0 * (variance / exact.effective + variance / effective).sqrt();
        let log_evidence = list(mixture, "log_evidence")[step];
        // The relative variance of a mean of n weights is 1 / n_eff - 1 / n.
        let candidates = 2.0 * draw_count(result, step) as f64;
        let variance =
            (1.0 / exact.effective - 1.0 / f64::from(count)) + (1.0 / effective - 1.0 / candidates);
        let within = 5.0 * variance.max(0.0).sqrt() + 1e-4;
        assert!(
            (log_evidence - exact.log_evidence).abs() < within,
            "step {step}: {log_evidence} {} ± {within}",
            exact.log_evidence
        );
        for (number, landmark) in &exact.landmarks {
            let name = &graph.landmarks[*number].name;
            let draws = ["x", "y"].map(|axis| {
                marginal(result, &format!("samples-mixture-step{step}.csv"), &format!("{name},{axis}"))
            });
            for (k, draws) in draws.iter().enumerate() {
                let count = draws.len() as f64;
                let mean = draws.iter().sum::<f64>() / count;
                let variance = draws.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / count;
                let exact_mean = landmark.mean[k];
                let within = landmark.variance[k].sqrt() * error(1.0);
                assert!((mean - exact_mean).abs() < within, "step {step}, {name}: {mean} {exact_mean}");
                // A Gaussian's variance has the relative variance 2 a draw, a ring's less.
                let ratio = variance / landmark.variance[k];
                assert!((ratio - 1.0).abs() < error(2.0), "step {step}, {name}: variance off by {ratio}");
            }
            let (sine, cosine) = heading.sin_cos();
            let is_left = |(x, y): (&f64, &f64)| cosine * (y - y0) - sine * (x - x0) > 0.0;
            let left = draws[0].iter().zip(&draws[1]).filter(|point| is_left(*point)).count();
            let share = left as f64 / draws[0].len() as f64;
            assert!(
                (share - landmark.left).abs() < error(0.25),
                "step {step}, {name}: {share} {}",
                landmark.left
            );
        }
    }
}

#[test]
fn every_step_agrees_with_the_integrals() {
    let folder = Scratch::new();
    folder.write("graph.fg", GRAPH);
    let result = run(&both(), &folder.path(""), 1);
    assert_integrals(&RangeGraph::read(&folder.path("graph.fg")).unwrap(), &result, 2_000);
    // A ring, two modes, of which the third range leaves one 2 %, one mode.
    assert_eq!(list(method(&result, "mixture"), "modes.near"), [1.0, 2.0, 2.0, 1.0]);
    assert_eq!(list(method(&result, "mixture"), "modes.far"), [1.0, 1.0, 2.0, 1.0]);
    assert_eq!(list(method(&result, "gaussian"), "modes.near"), [1.0; 4]);
}

#[test]
fn draws_and_evidence_repeat_with_the_seed_and_differ_without() {
    let folder = Scratch::new();
    folder.write("graph.fg", GRAPH);
    let scenario = scenario(json!({"mixture": {"samples": 50, "form": {"range": {"mixture": 40}}}}));
    let files = |seed| run(&scenario, &folder.path(""), seed).files;
    assert_eq!(files(1), files(1));
    assert_ne!(files(1), files(2));
    assert_eq!(files(1).len(), 4);
    for (step, file) in files(1).iter().enumerate() {
        // Each pose has three marginals, each landmark two.
        assert_eq!(file.contents.lines().count(), 3 * (step + 1) + 4);
        assert!(file.contents.lines().all(|line| line.split(',').count() == 52), "{}", file.name);
    }
}

fn refusal(text: &str) -> String {
    let folder = Scratch::new();
    folder.write("graph.fg", text);
    let error = both().prepare(1, Some(&folder.path(""))).unwrap_err();
    assert!(error.is_input());
    error.to_string().replace(&folder.path("").display().to_string(), "").trim_start_matches('/').to_owned()
}

#[test]
fn wrong_files_are_refused_with_their_line() {
    let line = |number: usize, text: &str| {
        let mut lines: Vec<&str> = GRAPH.lines().collect();
        lines[number - 1] = text;
        lines.join("\n")
    };
    for (text, sentence) in [
        (line(2, "Variable Pose SE3 A 0 0 0"), "graph.fg:2: a variable \"Pose SE3\" is unknown"),
        (line(3, "Variable Pose SE2 A 0 0 0"), "graph.fg:3: the name A is taken"),
        (line(4, "Variable Pose SE2 C 0 NaN 0"), "graph.fg:4: y is NaN; it must be finite"),
        (line(5, "Value Pose SE2 D 0 0 0"), "graph.fg:5: begins with \"Value\""),
        (
            line(6, "Variable Landmark R2 near 1"),
            "graph.fg:6: the line is cut short: y is missing after 5 fields",
        ),
        (line(13, "Factor AmbiguousDataAssociationFactor A near"), "graph.fg:13: a factor AmbiguousData"),
        (
            line(13, "Factor SE2R2RangeGaussianLikelihoodFactor A near 52.6 0"),
            "the standard deviation is 0 m",
        ),
        (line(13, "Factor SE2R2RangeGaussianLikelihoodFactor A near -1 1"), "the distance is -1 m"),
        (line(13, "Factor SE2R2RangeGaussianLikelihoodFactor near A 1 1"), "near is a landmark; a pose"),
        (
            line(13, "Factor SE2R2RangeGaussianLikelihoodFactor A other 1 1"),
            "other is declared by no line above",
        ),
        (
            line(13, "Factor SE2R2RangeGaussianLikelihoodFactor A near 1 1 1"),
            "\"1\" stands after the end of the 6",
        ),
        (
            GRAPH.replace("covariance 0.01 0 0 0 0.01", "covariance 0.01 0 0 0 -0.01"),
            "graph.fg:9: the noise cov",
        ),
        (GRAPH.replace("A B 25", "A B x25"), "graph.fg:10: x is \"x25\", which is no number"),
        (GRAPH.replace("A B 25", "A A 25"), "graph.fg:10: A is measured from itself"),
        (GRAPH.replace("Factor SE2Rel", "# Factor SE2Rel"), "nothing constrains B; give it a prior"),
        (
            GRAPH
                .lines()
                .filter(|line| !line.contains(" far 4") && !line.contains(" far 5"))
                .collect::<Vec<_>>()
                .join("\n"),
            "nothing constrains far; give it a range",
        ),
        (String::new(), "graph.fg: holds 0 poses and 0 ranges"),
    ] {
        let found = refusal(&text);
        assert!(found.contains(sentence), "{found} does not say {sentence}");
    }
    // A file that stops anywhere is refused or is a smaller graph, but never a panic.
    let folder = Scratch::new();
    for end in (0..GRAPH.len()).step_by(7) {
        folder.write("graph.fg", &GRAPH[..end]);
        let _ = both().prepare(1, Some(&folder.path("")));
    }
    assert!(both().prepare(1, Some(&folder.path("none.fg"))).is_err());
}

#[test]
fn wrong_methods_are_refused_with_their_key() {
    for (method, sentence) in [
        (json!({"samples": 0, "form": {"range": "gaussian"}}), "`method.m.samples` is 0"),
        (json!({"samples": 2_000_000, "form": {"range": "gaussian"}}), "at most 1000000 samples"),
        (json!({"form": {"range": {"particles": 10}}}), "`method.m.form.range` is particles"),
        (json!({"form": {"range": {"mixture": 0}}}), "`method.m.form.range.mixture` is 0"),
    ] {
        let scenario: RangeSlam =
            serde_json::from_value(json!({"world": {"file": "f"}, "method": {"m": method}})).unwrap();
        let found = scenario.validate().unwrap_err().to_string();
        assert!(found.contains(sentence), "{found}");
    }
}

/// Mean of |F⁻¹ - G⁻¹| for two samples.
fn wasserstein(mut a: Vec<f64>, mut b: Vec<f64>) -> f64 {
    a.sort_by(f64::total_cmp);
    b.sort_by(f64::total_cmp);
    let (n, m) = (a.len() as f64, b.len() as f64);
    let (mut i, mut j, mut from, mut sum) = (0, 0, 0.0, 0.0);
    while i < a.len() && j < b.len() {
        let (of_a, of_b) = ((i + 1) as f64 / n, (j + 1) as f64 / m);
        let to = of_a.min(of_b);
        sum += (a[i] - b[j]).abs() * (to - from);
        from = to;
        i += usize::from(of_a <= to);
        j += usize::from(of_b <= to);
    }
    sum
}

/// The published graph: evidence by numerical integration, samples by nested sampling. The seed is fixed, so that the
/// bounds are either met or not.
#[test]
fn the_published_posterior_is_met() {
    let Some(folder) = data() else {
        eprintln!("skipped: range_slam_small is not below SUMPROD_DATA");
        return;
    };
    let scenario = scenario(json!({"mixture": {"samples": 4000, "form": {"range": {"mixture": 100}}}}));
    let file = folder.join("factor_graph.fg");
    let result = run(&scenario, &file, 1);
    assert_integrals(&RangeGraph::read(&file).unwrap(), &result, 2_000);
    let mixture = method(&result, "mixture");
    for (step, exact) in [(0, 11.629), (1, 8.001)] {
        let found = list(mixture, "log_evidence")[step];
        assert!((found - exact).abs() < 0.03, "step {step}: {found}");
    }
    assert_eq!(list(mixture, "modes.L1"), [1.0, 2.0, 1.0, 1.0, 1.0, 1.0]);
    assert_eq!(list(mixture, "modes.L2"), [1.0, 1.0, 1.0, 2.0, 1.0, 1.0]);
    assert!((list(mixture, "heaviest_mode.L1")[1] - 0.5).abs() < 0.05);
    for (step, bound) in [(0, 2.4), (1, 1.6)] {
        let read = |name: &str| std::fs::read_to_string(folder.join(format!("step{step}{name}"))).unwrap();
        let order = read("_ordering");
        let columns: Vec<String> = order
            .split_whitespace()
            .flat_map(|name| {
                let axes: &[&str] = if name.starts_with('X') { &["x", "y", "theta"] } else { &["x", "y"] };
                axes.iter().map(move |axis| format!("{name},{axis}"))
            })
            .collect();
        let text = read(".sample");
        let rows: Vec<Vec<f64>> =
            text.lines().map(|line| line.split_whitespace().map(|x| x.parse().unwrap()).collect()).collect();
        let distances: Vec<f64> = columns
            .iter()
            .enumerate()
            .filter(|(_, column)| column.starts_with('L'))
            .map(|(k, column)| {
                let ours = marginal(&result, &format!("samples-mixture-step{step}.csv"), column);
                wasserstein(ours, rows.iter().map(|row| row[k]).collect())
            })
            .collect();
        let mean = distances.iter().sum::<f64>() / distances.len() as f64;
        assert!(mean < bound, "step {step}: {mean} m");
    }
}

fn data() -> Option<PathBuf> {
    let root = std::env::var_os("SUMPROD_DATA").map_or_else(
        || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data"),
        PathBuf::from,
    );
    let folder = root.join("range_slam_small");
    folder.is_dir().then_some(folder)
}
