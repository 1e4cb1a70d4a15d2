//! Graphs that grow: the same answers as joint solves of all there is, and work that stays where something changed.

use crate::support::{assert_close, recorded};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use sumprod_exact::read::GraphFile;
use sumprod_exact::{ExactError, Incremental, IncrementalOptions, Problem, SolveOptions};
use sumprod_graph::{FactorGraph, Space, VariableId};
use sumprod_messages::DynamicGaussian;
use sumprod_models::library::{LinearGaussian, PosePrior, PoseResidual, RelativePose};
use sumprod_models::pose::Pose2;
use sumprod_models::{AddModel, Noise};

type Graph = FactorGraph<DynamicGaussian>;

/// What is added to a linear graph in a round, and what is forgotten after it.
#[derive(Clone, Debug)]
struct Round {
    dimensions: Vec<usize>,
    /// By shares of the variables that are there.
    factors: Vec<(Vec<f64>, Vec<f64>)>,
    forget: Option<f64>,
}

fn rounds() -> impl Strategy<Value = Vec<Round>> {
    let factor = (prop::collection::vec(0.0f64..1.0, 1..4), prop::collection::vec(-1.0f64..1.0, 40));
    let round = (
        prop::collection::vec(1usize..4, 0..4),
        prop::collection::vec(factor, 0..5),
        prop::option::of(0.0f64..1.0),
    )
        .prop_map(|(dimensions, factors, forget)| Round { dimensions, factors, forget });
    prop::collection::vec(round, 1..9)
}

fn linear(graph: &mut Graph, ports: &[VariableId], entries: &[f64], variance: f64) {
    let mut entries = entries.iter().copied().cycle();
    let mut matrices = Vec::new();
    for &port in ports {
        let d = graph.space(port).dimension();
        matrices.push(entries.by_ref().take(2 * d).collect::<Vec<f64>>());
    }
    let matrices: Vec<&[f64]> = matrices.iter().map(Vec::as_slice).collect();
    let target: Vec<f64> = entries.take(2).collect();
    let factor = LinearGaussian::new(&matrices, &target, Noise::isotropic(2, variance).unwrap()).unwrap();
    graph.add("linear", factor, ports).unwrap();
}

fn hold(graph: &mut Graph, variable: VariableId, at: f64) {
    let d = graph.space(variable).dimension();
    let unit: Vec<f64> = (0..d * d).map(|k| f64::from(u8::from(k % (d + 1) == 0))).collect();
    let noise = Noise::isotropic(d, 3.0).unwrap();
    graph.add("prior", LinearGaussian::new(&[&unit], &vec![at; d], noise).unwrap(), &[variable]).unwrap();
}

/// The live variables' means and covariances by a joint solve of everything.
fn assert_as_batch(graph: &Graph, smoother: &Incremental, live: &[VariableId], tolerance: f64) {
    let problem = Problem::new(graph).unwrap();
    let mut solution = problem.solve(smoother.values(), &SolveOptions::default()).unwrap();
    let marginals = solution.marginals().unwrap();
    for &variable in live {
        let found = smoother.marginal(variable).unwrap();
        for (a, b) in found.mean.iter().zip(solution.values().get(variable)) {
            assert!((a - b).abs() < tolerance * (1.0 + b.abs()), "{variable:?}: {a} expected {b}");
        }
        assert_close(&found.covariance, marginals.covariance(variable), tolerance, "covariance");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, rng_seed: RngSeed::Fixed(11), ..ProptestConfig::default() })]

    #[test]
    fn growth_and_forgetting_leave_the_joint_answer(rounds in rounds()) {
        let mut graph = Graph::new();
        let mut smoother = Incremental::default();
        let mut live: Vec<VariableId> = Vec::new();
        for round in rounds {
            for d in round.dimensions {
                let variable = graph.unnamed_variable(Space::real(d));
                hold(&mut graph, variable, 0.5 * d as f64);
                live.push(variable);
            }
            if live.is_empty() {
                continue;
            }
            for (shares, entries) in &round.factors {
                let pick = |share: &f64| live[(share * live.len() as f64) as usize];
                let ports: Vec<VariableId> = shares.iter().map(pick).collect();
                linear(&mut graph, &ports, entries, 0.7);
            }
            smoother.update(&graph, &[]).unwrap();
            assert_as_batch(&graph, &smoother, &live, 1e-8);
            if let Some(share) = round.forget {
                let gone = live.remove((share * live.len() as f64) as usize);
                smoother.forget(&graph, &[gone]).unwrap();
                assert_as_batch(&graph, &smoother, &live, 1e-8);
            }
        }
    }
}

/// A robot that drives squares and sees where it was a lap before.
fn step(graph: &mut Graph, poses: &mut Vec<VariableId>, slip: f64) -> Vec<f64> {
    let noise = |variance: f64| Noise::diagonal(&[variance, variance, 0.1 * variance]).unwrap();
    let k = poses.len();
    let pose = graph.variable(format!("x{k}"), Space::Se2).unwrap();
    let turn = if k.is_multiple_of(3) { std::f64::consts::FRAC_PI_2 } else { 0.0 };
    match poses.last() {
        None => graph.add("anchor", PosePrior::new([0.0; 3], noise(1e-4)).unwrap(), &[pose]),
        Some(&last) => graph.add(
            "odometry",
            RelativePose::new([1.0, 0.02, turn + slip], noise(0.02)).unwrap(),
            &[last, pose],
        ),
    }
    .unwrap();
    if k >= 12 && k.is_multiple_of(4) {
        let again = RelativePose::new([0.0, 0.0, 0.0], noise(0.01)).unwrap();
        graph.add("seen again", again, &[poses[k - 12], pose]).unwrap();
    }
    poses.push(pose);
    vec![1.0, 0.0, turn]
}

#[test]
fn poses_that_settle_are_the_joint_minimum_and_odometry_costs_the_last_few() {
    let (mut graph, mut poses) = (Graph::new(), Vec::new());
    let mut smoother = Incremental::default();
    let mut at = Pose2 { x: 0.0, y: 0.0, heading: 0.0 };
    for k in 0..120 {
        let move_by = step(&mut graph, &mut poses, 0.004);
        if k > 0 {
            let last = smoother.value(poses[k - 1]).unwrap();
            at = Pose2 { x: last[0], y: last[1], heading: last[2] }.compose(&Pose2 {
                x: move_by[0],
                y: move_by[1],
                heading: move_by[2],
            });
        }
        let report = smoother.update(&graph, &[(poses[k], &[at.x, at.y, at.heading])]).unwrap();
        if k % 4 != 0 && report.relinearised == 0 {
            assert!(report.eliminated <= 16, "round {k}: {report:?}");
        }
        if k % 30 == 29 {
            smoother.settle(&graph, 1e-10, 30).unwrap();
            assert_as_batch(&graph, &smoother, &poses, 1e-6);
        }
    }
}

#[test]
fn a_fixed_lag_on_a_walk_is_exact_and_small() {
    let mut graph = Graph::new();
    let mut smoother = Incremental::new(IncrementalOptions::default());
    let mut live: Vec<VariableId> = Vec::new();
    for k in 0..60 {
        let variable = graph.unnamed_variable(Space::real(2));
        if k == 0 {
            hold(&mut graph, variable, 1.0);
        }
        for back in [1, 2] {
            if let Some(&earlier) = live.len().checked_sub(back).and_then(|place| live.get(place)) {
                let entries = [-1.0, 0.1, 0.0, -1.0, 1.0, 0.0, 0.2, 1.0, 0.3, f64::from(k) * 0.01];
                linear(&mut graph, &[earlier, variable], &entries, 0.5);
            }
        }
        live.push(variable);
        smoother.update(&graph, &[]).unwrap();
        if live.len() > 5 {
            let report = smoother.forget(&graph, &[live.remove(0)]).unwrap();
            assert!(report.eliminated <= 6, "{report:?}");
        }
        assert_as_batch(&graph, &smoother, &live, 1e-8);
    }
    let gone = graph.variable_ids().next().unwrap();
    assert!(
        matches!(smoother.marginal(gone), Err(ExactError::Request(reason)) if reason.contains("forgotten"))
    );
    linear(&mut graph, &[gone, live[0]], &[1.0], 1.0);
    let error = smoother.update(&graph, &[]).unwrap_err().to_string();
    assert!(error.contains("which was forgotten"), "{error}");
}

#[test]
fn what_a_failed_update_lacked_may_come_later() {
    let mut graph = Graph::new();
    let mut smoother = Incremental::default();
    let (a, b) = (graph.variable("a", Space::real(2)).unwrap(), graph.variable("b", Space::real(2)).unwrap());
    hold(&mut graph, a, 1.0);
    let error = smoother.update(&graph, &[]).unwrap_err();
    assert!(error.to_string().contains('b'), "{error}");
    assert!(smoother.marginal(b).is_err());
    linear(&mut graph, &[a, b], &[1.0, 0.2, 0.0, 1.0, -1.0, 0.3, 0.1, 1.0, 0.5, 0.5], 0.3);
    smoother.update(&graph, &[]).unwrap();
    assert_as_batch(&graph, &smoother, &[a, b], 1e-9);
    let error = smoother.update(&graph, &[(a, &[0.0, 0.0])]).unwrap_err().to_string();
    assert!(error.contains("was solved for before"), "{error}");
    smoother.update(&graph, &[]).unwrap();
    assert_as_batch(&graph, &smoother, &[a, b], 1e-9);
    let smaller = Graph::new();
    assert!(smoother.update(&smaller, &[]).unwrap_err().to_string().contains("another graph"));
}

#[test]
fn a_recorded_graph_pose_by_pose() {
    let Some(path) = recorded("pose_graphs/w100.graph") else { return };
    let mut file = GraphFile::read(&path).unwrap();
    file.hold(0, 1e-4, 1e-4).unwrap();
    let whole = file.graph(PoseResidual::Log).unwrap();
    let names: Vec<VariableId> = whole.variable_ids().collect();
    let start = file.values(&Problem::new(&whole).unwrap()).unwrap().unwrap();
    // Factors in the order in which their last pose appears.
    let mut order: Vec<usize> = (0..file.factors.len()).collect();
    order.sort_by_key(|&factor| file.factors[factor].variables.iter().max().copied());
    let mut smoother = Incremental::default();
    let mut graph = Graph::new();
    let mut next = order.into_iter().peekable();
    for (k, variable) in file.variables.iter().enumerate() {
        let pose = graph.variable(variable.name.clone(), variable.space.clone()).unwrap();
        while let Some(factor) =
            next.next_if(|&factor| file.factors[factor].variables.iter().all(|&v| v <= k))
        {
            file.add_factor(&mut graph, &file.factors[factor], &names, PoseResidual::Log).unwrap();
        }
        smoother.update(&graph, &[(pose, start.at(k))]).unwrap();
    }
    smoother.settle(&graph, 1e-10, 50).unwrap();
    let cost = Problem::new(&graph).unwrap().cost(&smoother.values()).unwrap();
    assert!((cost - 0.568927).abs() < 6e-7, "{cost}");
    assert_as_batch(&graph, &smoother, &names, 1e-6);
}
