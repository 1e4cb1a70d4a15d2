use super::*;
use crate::results::{BoundStep, Diagnostic, DiagnosticSeries, Segment, StateLayout};

/// Deterministic normals for tests: splitmix64 and Box–Muller.
struct Normals(u64);

impl Normals {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    fn draw(&mut self) -> f64 {
        (-2.0 * (1.0 - self.uniform()).ln()).sqrt() * (std::f64::consts::TAU * self.uniform()).cos()
    }
}

fn run_of(run: u32, method: MethodRun) -> RunResult {
    RunResult { run, nodes: vec!["a".into()], methods: vec![method], ..RunResult::default() }
}

/// A position off by `errors` with unit covariance.
fn offsets(run: u32, errors: &[[f64; 2]]) -> RunResult {
    let mut method = MethodRun::new("m", StateLayout::planar_position());
    for (step, error) in errors.iter().enumerate() {
        method.push(step as u32, step as f64, 0, &[0.0; 2], error, &[1.0, 0.0, 0.0, 1.0]).unwrap();
    }
    run_of(run, method)
}

#[test]
fn rmse_pools_within_runs_and_averages_over_them() {
    let runs = [offsets(0, &[[3.0, 4.0], [0.0, 0.0]]), offsets(1, &[[1.0, 0.0]])];
    let report = Report::new("s", 1, &runs).unwrap();
    let rmse = report.methods[0].1.summary.position_rmse_m.clone().unwrap();
    assert!((rmse.mean - (0.5_f64 * (12.5 + 1.0)).sqrt()).abs() < 1e-15);
    let se_of_square = (11.5_f64.powi(2) / 2.0 / 2.0).sqrt();
    assert!((rmse.se.unwrap() - se_of_square / (2.0 * rmse.mean)).abs() < 1e-14);
}

#[test]
fn quantiles_interpolate_and_a_single_run_has_no_standard_error() {
    let errors: Vec<_> = (0..=10).map(|i| [f64::from(i), 0.0]).collect();
    let report = Report::new("s", 1, &[offsets(0, &errors)]).unwrap();
    let metrics = report.method("m").unwrap();
    let quantiles = metrics.summary.error_quantiles_m.clone().unwrap();
    assert_eq!((quantiles.p50, quantiles.p80, quantiles.p90, quantiles.p95), (5.0, 8.0, 9.0, 9.5));
    assert_eq!(metrics.per_run_p90_median_m, Some(9.0));
    assert_eq!(metrics.summary.position_rmse_m.as_ref().unwrap().se, None);
    assert_eq!(metrics.summary.nees.as_ref().unwrap().position.as_ref().unwrap().band95, None);
}

#[test]
fn growth_and_one_sidedness() {
    let report = Report::new("s", 1, &[offsets(0, &[[1.0, 1.0], [5.0, -1.0], [2.0, 2.0]])]).unwrap();
    let metrics = report.method("m").unwrap();
    assert!((metrics.last_third_over_first_third.unwrap() - 2.0).abs() < 1e-15);
    assert!((metrics.one_sidedness.unwrap() - (1.0 + 1.0 / 3.0) / 2.0).abs() < 1e-15);
}

/// A random walk seen in noise and its exact Kalman filter: 400 runs of 20 steps. The mean over runs of a step's NEES
/// keeps to its band with probability 95 % a step; 20 steps leave more than 5 times with probability below 0.0003.
/// Coverage has a standard error under 0.005 (successive errors are correlated), so ±0.02 fails below 1e-4.
#[test]
fn an_exact_kalman_filter_comes_out_calibrated() {
    let (process, noise) = (0.5_f64, 2.0_f64);
    let mut normals = Normals(7);
    let runs: Vec<_> = (0..400)
        .map(|run| {
            let mut method = MethodRun::new("kf", StateLayout::planar_position());
            let (mut truth, mut mean, mut variance) = ([0.0; 2], [0.0; 2], 0.0);
            let mut bound = Vec::new();
            for step in 0..20 {
                variance += process;
                let gain = variance / (variance + noise);
                for axis in 0..2 {
                    truth[axis] += process.sqrt() * normals.draw();
                    let measured = truth[axis] + noise.sqrt() * normals.draw();
                    mean[axis] += gain * (measured - mean[axis]);
                }
                variance *= 1.0 - gain;
                method
                    .push(step, f64::from(step), 0, &truth, &mean, &[variance, 0.0, 0.0, variance])
                    .unwrap();
                bound.push(BoundStep { step, time: f64::from(step), position_variance: 2.0 * variance });
            }
            RunResult { bound, ..run_of(run, method) }
        })
        .collect();
    let report = Report::new("walk", 7, &runs).unwrap();
    let metrics = report.method("kf").unwrap();
    assert_eq!(metrics.calibration().unwrap().verdict, Verdict::Calibrated);
    assert!((metrics.summary.coverage95.unwrap() - 0.95).abs() < 0.02);
    assert!(metrics.one_sidedness.unwrap() < 0.4);
    assert_eq!(metrics.summary.velocity_rmse_mps, None);

    let by_step = metrics.by_step.as_ref().unwrap();
    let nees = by_step.summary.nees.as_ref().unwrap().position.as_ref().unwrap();
    let [low, high] = nees.band95.unwrap();
    assert!(nees.mean.iter().filter(|&&mean| mean < low || mean > high).count() <= 5);

    // The filter is optimal, so its error is the bound's; the ratio's standard error is below 0.01.
    let rmse = metrics.summary.position_rmse_m.as_ref().unwrap().mean;
    let bound = report.bound.as_ref().unwrap();
    assert!((rmse / bound.position_rmse_m.mean - 1.0).abs() < 0.04);
    assert_eq!(bound.by_step.position_rmse_m.mean.len(), 20);
}

/// The same errors with a quarter of the claimed variance: NEES 8 for 2 degrees of freedom.
#[test]
fn wrong_claims_are_named() {
    let mut normals = Normals(3);
    let mut with = |variance: f64| -> Vec<RunResult> {
        (0..50)
            .map(|run| {
                let mut method = MethodRun::new("m", StateLayout::planar_position());
                for step in 0..20 {
                    let error = [normals.draw(), normals.draw()];
                    method.push(step, 0.0, 0, &[0.0; 2], &error, &[variance, 0.0, 0.0, variance]).unwrap();
                }
                run_of(run, method)
            })
            .collect()
    };
    for (variance, verdict) in [(0.25, Verdict::Overconfident), (4.0, Verdict::Cautious)] {
        let report = Report::new("s", 1, &with(variance)).unwrap();
        let calibration = report.method("m").unwrap().calibration().unwrap();
        assert_eq!(calibration.verdict, verdict);
        assert!((calibration.ratio * variance - 1.0).abs() < 0.15);
    }
}

#[test]
fn correlated_blocks_are_whitened_and_angles_wrapped() {
    let mut method = MethodRun::new("m", StateLayout::planar_pose());
    let covariance = [4.0, 1.0, 0.0, 1.0, 2.0, 0.0, 0.0, 0.0, 0.01];
    method.push(0, 0.0, 0, &[0.0, 0.0, 3.1], &[1.0, 1.0, -3.1], &covariance).unwrap();
    let report = Report::new("s", 1, &[run_of(0, method)]).unwrap();
    let blocks = report.method("m").unwrap().summary.nees.clone().unwrap();
    // [1 1] inv([4 1; 1 2]) [1 1]ᵀ = 4/7.
    assert!((blocks.position.unwrap().mean - 4.0 / 7.0).abs() < 1e-14);
    let turn = std::f64::consts::TAU - 6.2;
    assert!((blocks.state.unwrap().mean - (4.0 / 7.0 + turn * turn / 0.01)).abs() < 1e-10);
    assert_eq!(blocks.velocity, None);
}

#[test]
fn singular_claims_are_counted_and_do_not_cover() {
    let mut method = MethodRun::new("m", StateLayout::planar_velocity());
    // Rank 2 in 4 dimensions, as after one step of noise-driven motion from a known state.
    let rank_two = [
        0.25, 0.5, 0.0, 0.0, //
        0.5, 1.0, 0.0, 0.0, //
        0.0, 0.0, 0.25, 0.5, //
        0.0, 0.0, 0.5, 1.0,
    ];
    method.push(0, 0.0, 0, &[0.0; 4], &[0.1; 4], &rank_two).unwrap();
    method.push(1, 1.0, 0, &[0.0; 4], &[0.1; 4], &[0.0; 16]).unwrap();
    let report = Report::new("s", 1, &[run_of(0, method)]).unwrap();
    let summary = &report.method("m").unwrap().summary;
    let blocks = summary.nees.clone().unwrap();
    assert_eq!(blocks.position.unwrap().singular, Some(1));
    assert_eq!(blocks.velocity.unwrap().singular, Some(1));
    assert_eq!(blocks.state, None);
    assert_eq!(summary.coverage95, Some(0.5));
}

#[test]
fn the_json_has_the_documented_names_and_no_null() {
    let mut runs = [offsets(0, &[[1.0, 0.0], [0.0, 2.0], [1.0, 1.0]]), offsets(1, &[[0.5, 0.0]; 3])];
    for run in &mut runs {
        run.segments = vec![Segment { name: "turn".into(), first: 1, last: 1 }];
        let method = &mut run.methods[0];
        method.diagnose("n_eff", 100.0 * f64::from(run.run));
        method.diagnose("conversion_loss.range", 0.5);
        method.notes.push("a note".into());
        let steps = vec![0, 1, 2];
        method.series.push(DiagnosticSeries { name: "n_eff".into(), steps, values: vec![1.0, 2.0, 3.0] });
    }
    let report = Report::new("s", 9, &runs).unwrap();
    let text = serde_json::to_string(&report).unwrap();
    assert!(!text.contains("null"), "{text}");
    let value: serde_json::Value = serde_json::from_str(&text).unwrap();
    let method = &value["methods"]["m"];
    assert_eq!(method["n_eff"], 50.0);
    assert_eq!(method["standard_errors"]["n_eff"], 50.0);
    assert_eq!(method["standard_errors"]["conversion_loss"]["range"], 0.0);
    assert_eq!(method["conversion_loss"]["range"], 0.5);
    assert_eq!(method["by_step"]["n_eff"][2], 3.0);
    assert_eq!(method["by_step"]["position_rmse_m"]["mean"].as_array().unwrap().len(), 3);
    assert_eq!(method["nees"]["position"]["dof"], 2);
    assert_eq!(method["notes"][0], "a note");
    assert!(method["segments"]["turn"]["position_rmse_m"]["mean"].is_number());
    assert!(method["position_rmse_m"]["se"].is_number());
    for absent in ["velocity_rmse_mps", "bound"] {
        assert!(method.get(absent).is_none() && value.get(absent).is_none(), "{absent}");
    }
}

#[test]
fn long_recordings_are_gathered_into_bins() {
    let errors = vec![[1.0, 0.0]; 2500];
    let report = Report::new("s", 1, &[offsets(0, &errors)]).unwrap();
    let by_step = report.method("m").unwrap().by_step.as_ref().unwrap();
    assert_eq!(by_step.time_s.len(), 834);
    assert_eq!(by_step.time_s[1], 4.0);
    assert_eq!(by_step.summary.position_rmse_m.as_ref().unwrap().mean, vec![1.0; 834]);
}

#[test]
fn results_that_do_not_fit_together_are_refused() {
    assert!(Report::new("s", 1, &[]).is_err());
    let mut other = offsets(1, &[[0.0; 2]]);
    other.methods[0].id = "n".into();
    let error = Report::new("s", 1, &[offsets(0, &[[0.0; 2]]), other]).unwrap_err();
    assert!(error.to_string().contains("run 1 has no method `m`"));
    let mut bad = offsets(0, &[[0.0; 2]]);
    bad.methods[0].diagnostics.push(Diagnostic { name: "n_eff".into(), value: f64::NAN });
    assert!(Report::new("s", 1, &[bad]).unwrap_err().to_string().contains("n_eff = NaN"));
}

#[test]
fn a_state_without_a_position_is_judged_by_its_intervals() {
    let layout = StateLayout { names: vec!["x".into()], ..StateLayout::default() };
    let run = |run: u32, truths: &[f64]| {
        let mut method = MethodRun::new("m", layout.clone());
        for (step, &truth) in truths.iter().enumerate() {
            method
                .push_with_intervals(step as u32, 0.0, 0, &[truth], &[0.0], &[1.0], &[[-1.0, 3.0]])
                .unwrap();
        }
        run_of(run, method)
    };
    let truths = [[2.0, 0.0, -2.0, 1.0]; 3].concat();
    let report = Report::new("s", 1, &[run(0, &truths), run(1, &truths)]).unwrap();
    let metrics = report.method("m").unwrap();
    let summary = &metrics.summary;
    assert_eq!(summary.position_rmse_m, None);
    assert!((summary.rmse_m.as_ref().unwrap().mean - 1.5).abs() < 1e-12);
    assert_eq!((summary.coverage95, summary.width95), (Some(0.75), Some(4.0)));
    let last_ten = (truths[2..].iter().map(|x| x * x).sum::<f64>() / 10.0).sqrt();
    assert!((metrics.final_rmse_m.as_ref().unwrap().mean - last_ten).abs() < 1e-12);
    assert_eq!(metrics.calibration().unwrap().verdict, Verdict::Overconfident);
}

#[test]
fn a_clock_is_judged_by_itself() {
    let layout = StateLayout::spatial_velocity().with_clock();
    assert_eq!((layout.dimension(), &layout.clock[..]), (8, &[6, 7][..]));
    let mut method = MethodRun::new("m", layout);
    let mut covariance = vec![0.0; 64];
    covariance.iter_mut().step_by(9).for_each(|entry| *entry = 1.0);
    (covariance[6 * 9], covariance[7 * 9]) = (4e-6, 25.0);
    let mut mean = [0.0; 8];
    (mean[6], mean[7]) = (4e-3, 5.0);
    method.push(1, 0.0, 0, &[0.0; 8], &mean, &covariance).unwrap();
    let report = Report::new("s", 1, &[run_of(0, method)]).unwrap();
    let summary = &report.method("m").unwrap().summary;
    assert!((summary.clock_offset_rmse_s.as_ref().unwrap().mean - 4e-3).abs() < 1e-18);
    assert!((summary.clock_skew_rmse_ppm.as_ref().unwrap().mean - 5.0).abs() < 1e-12);
    let nees = summary.nees.as_ref().unwrap();
    let (clock, state) = (nees.clock.as_ref().unwrap(), nees.state.as_ref().unwrap());
    assert!((clock.mean - 5.0).abs() < 1e-12 && clock.dof == 2);
    assert!((state.mean - 5.0).abs() < 1e-12 && state.dof == 8);
}
