use nalgebra::{DMatrix, DVector};
use sumprod_messages::Proposal;

use super::*;
use crate::campaign::Campaign;
use crate::metrics::{DiagnosticValue, Report};

const C3: &str = r#"{
    "agents": 3, "steps": 15, "area": [[10.0, 90.0], [10.0, 90.0]], "speed_variance": 9.0,
    "process_variance": 0.5, "anchors": [[0.0, 0.0], [100.0, 0.0]], "range_variance": 1.0
}"#;

fn c3() -> World {
    serde_json::from_str(C3).unwrap()
}

fn c10(steps: u32) -> World {
    let anchors = vec![[0.0, 0.0], [100.0, 0.0], [0.0, 100.0], [100.0, 100.0], [50.0, 50.0]];
    World { agents: 10, steps, speed_variance: 1.0, anchors, radius: Some(45.0), ..c3() }
}

fn scenario(world: World, methods: &[(&str, Method)]) -> Cooperation {
    let methods = methods.iter().map(|(id, method)| ((*id).to_owned(), method.clone())).collect();
    let scenario = Cooperation { world, method: Methods::new(methods) };
    scenario.validate().unwrap();
    scenario
}

fn particles(neighbours: Neighbours, proposal: Proposal) -> Method {
    Method {
        neighbours,
        particles: Some(1000),
        senders: Some(50),
        proposal: Some(proposal),
        ..Method::default()
    }
}

fn joint(rounds: usize) -> Method {
    Method { joint: true, rounds, ..Method::default() }
}

fn campaign(scenario: &Cooperation, runs: u32) -> Vec<RunResult> {
    Campaign::new(scenario, &(), 1, runs, &[]).unwrap().run(None, &|_, _| {}).unwrap()
}

/// Ranges and their Jacobian at stacked states, agents' ranges first.
fn ranges(world: &World, slice: &Slice, x: &DVector<f64>) -> (DVector<f64>, DMatrix<f64>, DVector<f64>) {
    let m = slice.ranges.len() + slice.anchor_ranges.len();
    let (mut h, mut jacobian, mut z) = (DVector::zeros(m), DMatrix::zeros(m, x.len()), DVector::zeros(m));
    let position = |agent: usize| [x[4 * agent], x[4 * agent + 2]];
    let among =
        slice.ranges.iter().map(|r| (r.agents[0], Some(r.agents[1]), position(r.agents[1]), r.measured));
    let anchored = slice.anchor_ranges.iter().map(|r| (r.agent, None, world.anchors[r.anchor], r.measured));
    for (row, (own, other, end, measured)) in among.chain(anchored).enumerate() {
        let own_position = position(own);
        h[row] = (own_position[0] - end[0]).hypot(own_position[1] - end[1]);
        z[row] = measured;
        for axis in 0..2 {
            let slope = (own_position[axis] - end[axis]) / h[row];
            jacobian[(row, 4 * own + 2 * axis)] = slope;
            if let Some(other) = other {
                jacobian[(row, 4 * other + 2 * axis)] = -slope;
            }
        }
    }
    (h, jacobian, z)
}

/// The textbook's iterated extended Kalman filter, in covariance form (Bell and Cathey 1993).
fn textbook(world: &World, draw: &Draw, rounds: usize) -> Vec<(DVector<f64>, DMatrix<f64>)> {
    let n = 4 * world.agents;
    let mut f = DMatrix::identity(n, n);
    let mut q = DMatrix::zeros(n, n);
    for k in (0..n).step_by(2) {
        f[(k, k + 1)] = world.interval;
        let gain = [0.5 * world.interval.powi(2), world.interval];
        for (a, b) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
            q[(k + a, k + b)] = world.process_variance * gain[a] * gain[b];
        }
    }
    let mut mean = DVector::from_row_slice(draw.start.as_flattened());
    let mut p = DMatrix::from_fn(n, n, |r, c| if r == c { draw.start_variances[r % 4] } else { 0.0 });
    let mut out = Vec::new();
    for slice in &draw.slices {
        mean = &f * mean;
        p = &f * p * f.transpose() + &q;
        let mut x = mean.clone();
        let mut posterior = p.clone();
        for _ in 0..rounds {
            let (h, jacobian, z) = ranges(world, slice, &x);
            let noise = DMatrix::identity(z.len(), z.len()) * world.range_variance;
            let s = &jacobian * &p * jacobian.transpose() + noise;
            let gain = &p * jacobian.transpose() * s.try_inverse().unwrap();
            x = &mean + &gain * (z - h - &jacobian * (&mean - &x));
            posterior = &p - &gain * &jacobian * &p;
        }
        (mean, p) = (x, posterior);
        out.push((mean.clone(), p.clone()));
    }
    out
}

#[test]
fn the_joint_filter_is_the_textbooks() {
    for rounds in [1, 3] {
        let world = World { agents: 4, ..c10(6) };
        let draw = world.draw(3, 0).unwrap();
        let mut filter = JointFilter::new(&world, &draw, rounds, Options::default()).unwrap();
        for (slice, (mean, covariance)) in draw.slices.iter().zip(textbook(&world, &draw, rounds)) {
            filter.step(slice).unwrap();
            let found = filter.moments().unwrap().unwrap();
            let off = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(off(&found.mean, mean.as_slice()) < 1e-8);
            assert!(off(&found.covariance, covariance.as_slice()) < 1e-8);
        }
    }
}

#[test]
fn agents_that_ignore_each_other_are_joint_filters_of_one() {
    let world = c10(5);
    let draw = world.draw(4, 0).unwrap();
    let plan = Plan { neighbours: Neighbours::Ignored, rounds: 3, ..Plan::default() };
    let mut filter = NetworkFilter::new(&world, &draw, plan, Options::default()).unwrap();
    let mut alone = draw.clone();
    alone.slices.iter_mut().for_each(|slice| slice.ranges.clear());
    for (slice, (mean, covariance)) in draw.slices.iter().zip(textbook(&world, &alone, 3)) {
        filter.step(slice).unwrap();
        for agent in 0..world.agents {
            let found = filter.belief(agent).unwrap().moments().unwrap();
            for row in 0..4 {
                assert!((found.mean[row] - mean[4 * agent + row]).abs() < 1e-7);
                for column in 0..4 {
                    let exact = covariance[(4 * agent + row, 4 * agent + column)];
                    assert!((found.covariance_at(row, column) - exact).abs() < 1e-7);
                }
            }
        }
    }
}

/// Per agent and run: trace of the position covariance over the joint's, and squared Mahalanobis shift of the mean from
/// the joint's; each sorted.
fn against_joint(runs: &[RunResult], id: &str) -> [Vec<f64>; 2] {
    let of = |run: &RunResult, id: &str| run.methods.iter().find(|method| method.id == id).cloned().unwrap();
    let (mut traces, mut shifts) = (Vec::new(), Vec::new());
    for run in runs {
        for (own, exact) in of(run, id).estimates().zip(of(run, "joint").estimates()) {
            let position = |e: &crate::results::Estimate<'_>| {
                [e.covariance_at(0, 0), e.covariance_at(0, 2), e.covariance_at(2, 2)]
            };
            let ([a, _, c], [xx, xy, yy]) = (position(&own), position(&exact));
            let (dx, dy) = (own.mean[0] - exact.mean[0], own.mean[2] - exact.mean[2]);
            traces.push((a + c) / (xx + yy));
            shifts.push((yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / (xx * yy - xy * xy));
        }
    }
    traces.sort_by(f64::total_cmp);
    shifts.sort_by(f64::total_cmp);
    [traces, shifts]
}

/// Over 100 draws of three agents. The values are 1.01 and 0.10 with standard errors 0.006 and 0.03 by run, more than
/// six of these inside the bands.
///
/// Predictions drawn from the motion alone leave some 40 effective particles of 1500, and hardly any where the prior
/// is in its tail: there the medians are held to the bands.
#[test]
fn one_slice_of_belief_propagation_is_near_the_joint_posterior() {
    let many = |proposal| Method { particles: Some(1500), ..particles(Neighbours::Extrinsic, proposal) };
    let scenario = scenario(
        World { steps: 1, ..c3() },
        &[
            ("joint", joint(10)),
            ("gaussian", Method::default()),
            ("informed", many(Proposal::Informed)),
            ("prediction", many(Proposal::Prediction)),
            ("plug-in", Method { neighbours: Neighbours::PlugIn, ..Method::default() }),
        ],
    );
    let runs = campaign(&scenario, 100);
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let median = |values: &[f64]| values[values.len() / 2];
    let within = |id: &str, of: &dyn Fn(&[f64]) -> f64| {
        let [trace, shift] = against_joint(&runs, id).map(|values| of(&values));
        assert!((0.85..1.05).contains(&trace), "{id}: trace ratio {trace}");
        assert!(shift < 0.35, "{id}: shift {shift}");
    };
    within("gaussian", &mean);
    within("informed", &mean);
    within("prediction", &median);
    assert!(mean(&against_joint(&runs, "plug-in")[1]) > 0.5);
}

/// 16 runs of seed 1. A run's own root mean square deviates by 0.2 m from run to run, 0.05 m or 4 % of the bound in the
/// mean of 16: the joint filter is held to four of these around the bound, the others to the bands of 100 runs plus one.
#[test]
fn three_agents_are_as_accurate_as_the_reference() {
    let scenario = scenario(
        c3(),
        &[
            ("joint", joint(10)),
            ("gaussian-bp", Method::default()),
            ("informed", particles(Neighbours::Extrinsic, Proposal::Informed)),
            ("prediction", particles(Neighbours::Extrinsic, Proposal::Prediction)),
            ("broadcast", particles(Neighbours::Broadcast, Proposal::Informed)),
            ("plug-in", Method { neighbours: Neighbours::PlugIn, ..Method::default() }),
            ("anchors-only", Method { neighbours: Neighbours::Ignored, ..Method::default() }),
        ],
    );
    let report = Report::new("c3", 1, &campaign(&scenario, 16)).unwrap();
    let rmse = |id: &str| report.method(id).unwrap().summary.position_rmse_m.as_ref().unwrap().mean;
    let bound = report.bound.as_ref().unwrap().position_rmse_m.mean;
    assert!((1.0..1.4).contains(&bound), "bound {bound}");
    assert!((0.85..1.17).contains(&(rmse("joint") / bound)), "joint {}", rmse("joint"));
    assert!(rmse("gaussian-bp") < 1.45 && rmse("informed") < 1.45 && rmse("prediction") < 1.6);
    for id in ["joint", "gaussian-bp", "informed", "prediction", "broadcast"] {
        assert!(rmse("plug-in") > rmse(id), "{id} {} against plug-in {}", rmse(id), rmse("plug-in"));
        assert!(rmse("anchors-only") > rmse(id));
    }
    let coverage = |id: &str| report.method(id).unwrap().summary.coverage95.unwrap();
    assert!(coverage("joint") > 0.9 && coverage("plug-in") < 0.85);
}

#[test]
fn another_form_on_one_kind_of_edge_says_what_it_costs() {
    let form = Forms { range: Some(FormSpec::particles(300, None, Proposal::Informed)), ..Forms::default() };
    let scenario = scenario(World { steps: 4, ..c3() }, &[("mixed", Method { form, ..Method::default() })]);
    let report = Report::new("c3", 1, &campaign(&scenario, 4)).unwrap();
    let diagnostics = &report.method("mixed").unwrap().diagnostics;
    let Some(DiagnosticValue::Group(losses)) = diagnostics.get("conversion_loss") else {
        panic!("no conversion loss in {diagnostics:?}")
    };
    assert!(losses["prediction"] > 0.0);
    let Some(DiagnosticValue::Number(n_eff)) = diagnostics.get("n_eff") else { panic!("no n_eff") };
    assert!((2.0..300.0).contains(n_eff));
}

#[test]
fn one_thread_and_two_give_the_same_bits() {
    let scenario = scenario(
        World { steps: 3, ..c3() },
        &[
            ("particles", particles(Neighbours::Extrinsic, Proposal::Informed)),
            ("gaussian", Method::default()),
        ],
    );
    let world = World::at_density(40, 3);
    let draw = world.draw(2, 0).unwrap();
    let plan = particles(Neighbours::Extrinsic, Proposal::Informed).plan();
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut runs = campaign(&scenario, 4);
            runs.iter_mut().flat_map(|run| &mut run.methods).for_each(|method| method.seconds = 0.0);
            let mut filter = NetworkFilter::new(&world, &draw, plan, Options::default()).unwrap();
            draw.slices.iter().for_each(|slice| filter.step(slice).unwrap());
            let beliefs: Vec<AnyMessage> =
                (0..filter.agents()).map(|agent| filter.belief(agent).unwrap().clone()).collect();
            (runs, beliefs)
        })
    };
    assert!(on(1) == on(2));
}

#[test]
fn the_anchors_can_be_heard_first() {
    let first = Method { anchors_first: true, ..Method::default() };
    let scenario = scenario(c3(), &[("usual", Method::default()), ("first", first)]);
    let report = Report::new("c3", 1, &campaign(&scenario, 10)).unwrap();
    let median = |id: &str| report.method(id).unwrap().summary.error_quantiles_m.as_ref().unwrap().p50;
    assert!((median("first") / median("usual") - 1.0).abs() < 0.1);
    assert_ne!(median("first"), median("usual"));
}

#[test]
fn graphs_are_described_before_they_run() {
    let scenario =
        scenario(c3(), &[("joint", joint(2)), ("bp", Method { particles: Some(20), ..Method::default() })]);
    let ids = scenario.methods();
    let [joint, bp] = &scenario.check(&(), 1, &ids).unwrap()[..] else { panic!("two summaries") };
    assert_eq!((joint.variables, joint.factors, joint.edges, joint.loops), (2, 2, 3, 0));
    // 3 predictions and 3 ranges of two edges, 6 ranges to anchors of one; a triangle of agents has one loop.
    assert_eq!((bp.variables, bp.factors, bp.edges, bp.components, bp.loops), (6, 12, 18, 1, 1));
    let forms: Vec<_> = bp.forms.iter().map(|form| (form.kind.as_str(), form.edges)).collect();
    assert_eq!(forms, [("prediction", 6), ("range", 6), ("anchor", 6)]);
    assert!(bp.forms.iter().all(|form| form.form == "particles 20"));
}

#[test]
fn a_floating_network_is_refused_before_it_runs_and_an_anchored_one_finds_itself() {
    let floating = World { anchors: Vec::new(), prior: false, ..c3() };
    let refused = scenario(floating, &[("bp", Method::default())]).prepare(1, None).unwrap_err();
    assert!(refused.is_input());
    assert!(refused.to_string().contains("translation (2 directions) and rotation (1) of agents 1, 2 and 3"));

    let four = vec![[0.0, 0.0], [100.0, 0.0], [0.0, 100.0], [100.0, 100.0]];
    let world = World { anchors: four, prior: false, ..c3() };
    let method = Method { rounds: 6, anchors_first: true, ..Method::default() };
    let scenario = scenario(world, &[("bp", method)]);
    scenario.prepare(1, None).unwrap();
    let report = Report::new("c3", 1, &campaign(&scenario, 10)).unwrap();
    let errors = report.method("bp").unwrap().summary.error_quantiles_m.as_ref().unwrap();
    assert!(errors.p50 < 1.5, "{}", errors.p50);
}
