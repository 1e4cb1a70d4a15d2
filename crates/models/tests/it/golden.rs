//! Recorded linear-Gaussian graphs: exact marginals of a chain, fixed points of loopy propagation.

use crate::support::assert_moments;
use nalgebra::{DMatrix, DVector};
use serde_json::Value;
use std::path::PathBuf;
use sumprod_graph::schedule::{Flooding, ForwardBackward};
use sumprod_graph::{Engine, FactorGraph, Options, Schedule, Space};
use sumprod_messages::DynamicGaussian;
use sumprod_models::library::LinearGaussian;
use sumprod_models::{AddModel, Noise};

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

fn numbers(value: &Value) -> Vec<f64> {
    match value.as_array() {
        Some(entries) => entries.iter().flat_map(numbers).collect(),
        None => vec![value.as_f64().unwrap()],
    }
}

fn agrees(name: &str, answer: &str, schedule: &mut dyn Schedule) {
    let Some(record) = recorded(name) else { return };
    let mut graph = FactorGraph::<DynamicGaussian>::new();
    for variable in record["variables"].as_array().unwrap() {
        let space = Space::real(variable["dim"].as_u64().unwrap() as usize);
        graph.variable(variable["name"].as_str().unwrap(), space).unwrap();
    }
    for factor in record["factors"].as_array().unwrap() {
        let names = factor["variables"].as_array().unwrap();
        let ports: Vec<_> = names.iter().map(|name| graph.find(name.as_str().unwrap()).unwrap()).collect();
        let matrices: Vec<Vec<f64>> = factor["A"].as_array().unwrap().iter().map(numbers).collect();
        let matrices: Vec<&[f64]> = matrices.iter().map(Vec::as_slice).collect();
        let noise = Noise::gaussian(&numbers(&factor["noise_covariance"])).unwrap();
        let factor = LinearGaussian::new(&matrices, &numbers(&factor["b"]), noise).unwrap();
        graph.add("recorded", factor, &ports).unwrap();
    }
    let options = Options { tolerance: 1e-13, max_iterations: 2000, ..Options::default() };
    let mut engine = Engine::new(&graph, options).unwrap();
    assert!(engine.run(schedule).unwrap().converged());
    let marginals = record[answer]["marginals"].as_object().unwrap();
    assert_eq!(marginals.len(), graph.variable_count());
    for (name, marginal) in marginals {
        let mean = DVector::from_vec(numbers(&marginal["mean"]));
        let covariance = DMatrix::from_row_slice(mean.len(), mean.len(), &numbers(&marginal["covariance"]));
        let found = engine.belief(graph.find(name).unwrap()).moments().unwrap();
        assert_moments(&found, &mean, &covariance, 1e-8);
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

#[test]
fn mixed_dimensions_in_pieces_equal_the_recorded_fixed_point() {
    agrees("disconnected.json", "gaussian_bp", &mut Flooding);
}
