//! The fixed point of loopy Gaussian belief propagation against recorded high-precision answers.

use crate::linear::Linear;
use nalgebra::{DMatrix, DVector, Matrix2, SMatrix, SVector};
use serde_json::Value;
use std::path::PathBuf;
use sumprod_graph::schedule::{Flooding, ForwardBackward};
use sumprod_graph::{Engine, FactorGraph, Options, Schedule, Space};
use sumprod_messages::Gaussian;

/// The recorded graph, or none (said on stdout) where the data are absent.
fn recorded(name: &str) -> Option<Value> {
    let root = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../..");
    let data = std::env::var_os("SUMPROD_DATA").map_or_else(|| root.join("../shared/data"), PathBuf::from);
    let file = data.join("linear_gaussian_golden").join(name);
    let Ok(text) = std::fs::read_to_string(&file) else {
        println!("skipped: {} is absent; set SUMPROD_DATA to the folder of the data", file.display());
        return None;
    };
    Some(serde_json::from_str(&text).unwrap())
}

fn vector(value: &Value) -> DVector<f64> {
    let numbers: Vec<f64> = value.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect();
    DVector::from_vec(numbers)
}

fn matrix(value: &Value) -> DMatrix<f64> {
    let rows: Vec<_> = value.as_array().unwrap().iter().map(|row| vector(row).transpose()).collect();
    DMatrix::from_rows(&rows)
}

/// A recorded factor of one or two variables of two coordinates, residual of any dimension.
fn factor(value: &Value) -> Linear<2> {
    let weight = matrix(&value["noise_covariance"]).try_inverse().unwrap();
    let b = vector(&value["b"]);
    let a: Vec<DMatrix<f64>> = value["A"].as_array().unwrap().iter().map(matrix).collect();
    let block = |i: usize, j: usize| -> Matrix2<f64> {
        let product = a[i].transpose() * &weight * &a[j];
        SMatrix::from_column_slice(product.as_slice())
    };
    let shift = |i: usize| -> SVector<f64, 2> {
        SVector::from_column_slice((a[i].transpose() * &weight * &b).as_slice())
    };
    let mut linear = Linear::unary(block(0, 0), shift(0));
    if a.len() == 2 {
        let zero = SMatrix::<f64, 2, 2>::zeros();
        linear = Linear::pair([zero, zero], SVector::zeros(), zero);
        linear.blocks = [[block(0, 0), block(0, 1)], [block(1, 0), block(1, 1)]];
        linear.vectors = [shift(0), shift(1)];
    }
    linear
}

fn agrees(name: &str, answer: &str, schedule: &mut dyn Schedule) {
    let Some(record) = recorded(name) else { return };
    let mut graph: FactorGraph<Gaussian<2>, Linear<2>> = FactorGraph::new();
    for variable in record["variables"].as_array().unwrap() {
        assert_eq!(variable["dim"], 2);
        graph.variable(variable["name"].as_str().unwrap(), Space::real(2)).unwrap();
    }
    for recorded in record["factors"].as_array().unwrap() {
        let names = recorded["variables"].as_array().unwrap();
        let ports: Vec<_> = names.iter().map(|name| graph.find(name.as_str().unwrap()).unwrap()).collect();
        graph.factor("recorded", factor(recorded), &ports).unwrap();
    }
    let options = Options { tolerance: 1e-13, max_iterations: 2000, ..Options::default() };
    let mut engine = Engine::new(&graph, options).unwrap();
    assert!(engine.run(schedule).unwrap().converged());
    let marginals = record[answer]["marginals"].as_object().unwrap();
    assert_eq!(marginals.len(), graph.variable_count());
    for (name, marginal) in marginals {
        let (mean, covariance) = engine.belief(graph.find(name).unwrap()).moments().unwrap();
        let far = (mean - vector(&marginal["mean"])).amax();
        let wide = (covariance - matrix(&marginal["covariance"])).amax();
        assert!(far < 1e-8 && wide < 1e-8, "{name}: mean off by {far:e}, covariance by {wide:e}");
    }
}

#[test]
fn the_chain_equals_the_exact_marginals() {
    agrees("chain30.json", "golden", &mut ForwardBackward::new());
    agrees("chain30.json", "gaussian_bp", &mut Flooding);
}

#[test]
fn the_grid_equals_the_recorded_fixed_point() {
    agrees("grid5x5.json", "gaussian_bp", &mut Flooding);
}
