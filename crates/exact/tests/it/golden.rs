//! Recorded linear-Gaussian graphs: means, covariances, evidence.

use crate::support::{assert_close, json, numbers, recorded};
use sumprod_exact::read::GraphFile;
use sumprod_exact::{Optimizer, Ordering, Problem, SolveOptions};
use sumprod_models::library::PoseResidual;

fn agrees(name: &str) {
    let Some(path) = recorded(&format!("linear_gaussian_golden/{name}")) else { return };
    let golden = &json(&path)["golden"];
    let file = GraphFile::read(&path).unwrap();
    let graph = file.graph(PoseResidual::Log).unwrap();
    let problem = Problem::new(&graph).unwrap();
    for optimizer in [Optimizer::GaussNewton, Optimizer::LevenbergMarquardt, Optimizer::Dogleg] {
        for ordering in [Ordering::MinimumDegree, Ordering::Natural] {
            let options = SolveOptions { optimizer, ordering, ..SolveOptions::default() };
            let mut solution = problem.solve(problem.start(), &options).unwrap();
            assert_eq!(solution.report().iterations, 1, "{name} {optimizer:?}");
            let marginals = solution.marginals().unwrap();
            for (variable, marginal) in golden["marginals"].as_object().unwrap() {
                let handle = graph.find(variable).unwrap();
                let (mean, covariance) = (numbers(&marginal["mean"]), numbers(&marginal["covariance"]));
                let scale = mean.iter().fold(1.0f64, |most, x| most.max(x.abs()));
                for (a, b) in solution.values().get(handle).iter().zip(&mean) {
                    assert!((a - b).abs() < 1e-10 * scale, "{name} {variable}: {a} {b}");
                }
                assert_close(marginals.covariance(handle), &covariance, 1e-10, variable);
                assert_close(&solution.marginal(handle).unwrap().covariance, &covariance, 1e-10, variable);
            }
            let evidence = golden["log_evidence"].as_f64().unwrap();
            assert!((solution.log_evidence().unwrap() - evidence).abs() < 1e-8, "{name}");
        }
    }
}

#[test]
fn a_chain() {
    agrees("chain30.json");
}

#[test]
fn a_grid() {
    agrees("grid5x5.json");
}

#[test]
fn pieces_of_mixed_dimensions() {
    agrees("disconnected.json");
}

#[test]
fn pairs_of_variables() {
    for name in ["chain30.json", "grid5x5.json", "disconnected.json"] {
        let Some(path) = recorded(&format!("linear_gaussian_golden/{name}")) else { return };
        let record = json(&path);
        let file = GraphFile::read(&path).unwrap();
        let graph = file.graph(PoseResidual::Log).unwrap();
        let problem = Problem::new(&graph).unwrap();
        let mut solution = problem.solve(problem.start(), &SolveOptions::default()).unwrap();
        let Some(joints) = record["golden"]["joint_marginals"].as_array() else { continue };
        for joint in joints {
            let names = joint["variables"].as_array().unwrap();
            let pair: Vec<_> = names.iter().map(|n| graph.find(n.as_str().unwrap()).unwrap()).collect();
            let d: Vec<usize> = pair.iter().map(|&v| graph.space(v).dimension()).collect();
            let found = solution.joint(&pair).unwrap();
            let cross: Vec<f64> = (0..d[0])
                .flat_map(|row| (0..d[1]).map(move |column| (row, column)))
                .map(|(row, column)| found.covariance_at(row, d[0] + column))
                .collect();
            assert_close(&cross, &numbers(&joint["cross_covariance"]), 1e-9, name);
        }
    }
}
