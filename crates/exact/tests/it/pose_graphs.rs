//! Recorded pose graphs: optimum and marginal covariances.

use crate::support::{assert_close, json, numbers, recorded};
use std::path::Path;
use sumprod_exact::read::GraphFile;
use sumprod_exact::{Optimizer, Problem, SolveOptions, chordal_start};
use sumprod_models::library::PoseResidual;

fn held(path: &Path) -> GraphFile {
    let mut file = GraphFile::read(path).unwrap();
    file.hold(0, 1e-4, 1e-4).unwrap();
    file
}

fn optimum(name: &str, expected: [f64; 2]) {
    let Some(path) = recorded(&format!("pose_graphs/{name}")) else { return };
    let file = held(&path);
    for (form, expected) in [PoseResidual::Log, PoseResidual::Split].into_iter().zip(expected) {
        if expected.is_nan() {
            continue;
        }
        let graph = file.graph(form).unwrap();
        let problem = Problem::new(&graph).unwrap();
        let start = chordal_start(&file, &problem).unwrap();
        let solution = problem.solve(start, &SolveOptions::default()).unwrap();
        let report = solution.report();
        println!("{name} {form:?}: {report:?}");
        // The record has six decimals.
        assert!(
            (report.cost - expected).abs() < 6e-7 * expected.max(1.0),
            "{name}: {} expected {expected}",
            report.cost
        );
    }
}

#[test]
fn intel() {
    optimum("intel.g2o", [22.502117, 22.502348]);
}

#[test]
fn killian_court() {
    optimum("MIT.g2o", [20.603474, 20.581634]);
}

#[test]
fn manhattan_without_vertices() {
    optimum("manhattan.g2o", [1774.520535, 1774.518398]);
}

#[test]
fn toro() {
    optimum("w100.graph", [0.568927, 0.568913]);
}

#[test]
fn parking_garage() {
    optimum("parking-garage.g2o", [0.634192, f64::NAN]);
}

/// The recorded order puts rotation first in space.
fn golden(name: &str, order: &[usize]) {
    let Some(path) = recorded(&format!("pose_graphs_golden/{name}.g2o")) else { return };
    let Some(answer) = recorded(&format!("pose_graphs_golden/{name}.golden.json")) else { return };
    let answer = json(&answer);
    let file = held(&path);
    let graph = file.graph(PoseResidual::Log).unwrap();
    let problem = Problem::new(&graph).unwrap();
    for optimizer in [Optimizer::GaussNewton, Optimizer::LevenbergMarquardt, Optimizer::Dogleg] {
        let start = file.values(&problem).unwrap().unwrap();
        let options = SolveOptions { optimizer, ..SolveOptions::default() };
        let mut solution = problem.solve(start, &options).unwrap();
        println!("{name} {optimizer:?}: {:?}", solution.report());
        let chi2 = answer["chi2"].as_f64().unwrap();
        assert!((2.0 * solution.report().cost / chi2 - 1.0).abs() < 1e-6, "{}", solution.report().cost);
        if optimizer != Optimizer::LevenbergMarquardt {
            continue;
        }
        for (vertex, pose) in answer["optimum"].as_object().unwrap() {
            let found = solution.values().get(graph.find(vertex).unwrap());
            let expected = numbers(pose);
            let flip = if found.len() == 7 && found[6] * expected[6] < 0.0 { -1.0 } else { 1.0 };
            for (k, (a, b)) in found.iter().zip(&expected).enumerate() {
                let a = if k > 2 { a * flip } else { *a };
                assert!((a - b).abs() < 1e-4, "vertex {vertex}: {found:?} expected {expected:?}");
            }
        }
        let marginals = solution.marginals().unwrap();
        for (vertex, marginal) in answer["marginals"].as_object().unwrap() {
            let handle = graph.find(vertex).unwrap();
            let covariance = marginals.covariance(handle);
            let d = order.len();
            let ordered: Vec<f64> = order
                .iter()
                .flat_map(|&row| order.iter().map(move |&column| covariance[row * d + column]))
                .collect();
            assert_close(&ordered, &numbers(&marginal["covariance"]), 1e-4, vertex);
            assert_close(&solution.marginal(handle).unwrap().covariance, covariance, 1e-8, vertex);
        }
    }
}

#[test]
fn the_city_of_3500_poses() {
    golden("M3500", &[0, 1, 2]);
}

#[test]
fn the_sphere() {
    golden("sphere2500", &[3, 4, 5, 0, 1, 2]);
}
