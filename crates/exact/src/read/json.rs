//! Linear-Gaussian factors as JSON: `{"variables": [{"name", "dim"}], "factors": [{"variables", "A", "b",
//! "noise_covariance"}]}`, each factor Σ Aₖ xₖ ~ N(b, R). Other keys are passed over.

use super::{FileFactor, FileVariable, GraphFile, Measurement};
use crate::ExactError;
use serde::Deserialize;
use sumprod_graph::Space;

#[derive(Deserialize)]
struct Record {
    variables: Vec<Variable>,
    factors: Vec<Factor>,
}

#[derive(Deserialize)]
struct Variable {
    name: String,
    dim: usize,
}

#[derive(Deserialize)]
struct Factor {
    variables: Vec<String>,
    #[serde(rename = "A")]
    matrices: Vec<Vec<Vec<f64>>>,
    #[serde(rename = "b")]
    target: Vec<f64>,
    noise_covariance: Vec<Vec<f64>>,
}

/// The largest dimension of a variable: beyond it a file is more likely wrong than meant.
const LARGEST: usize = 10_000;

pub(super) fn read(file: &mut GraphFile, text: &str) -> Result<(), ExactError> {
    let record: Record = serde_json::from_str(text).map_err(|error| {
        let line = (error.line() > 0).then(|| error.line());
        ExactError::file(&file.path, line, format!("is no linear-Gaussian graph: {error}"))
    })?;
    for (k, variable) in record.variables.into_iter().enumerate() {
        if !(1..=LARGEST).contains(&variable.dim) {
            let problem = format!("variables[{k}].dim is {}; it must be 1 to {LARGEST}", variable.dim);
            return Err(ExactError::file(&file.path, None, problem));
        }
        let space = Space::real(variable.dim);
        file.add_variable(None, FileVariable { name: variable.name, space, value: None })?;
    }
    for (k, factor) in record.factors.into_iter().enumerate() {
        let wrong = |problem: String| ExactError::file(&file.path, None, format!("factors[{k}]: {problem}"));
        let rows = factor.target.len();
        if factor.matrices.len() != factor.variables.len() {
            let (found, expected) = (factor.matrices.len(), factor.variables.len());
            return Err(wrong(format!("A has {found} matrices for {expected} variables")));
        }
        let mut variables = Vec::with_capacity(factor.variables.len());
        for (name, matrix) in factor.variables.iter().zip(&factor.matrices) {
            let number = file.find(name).ok_or_else(|| wrong(format!("there is no variable {name:?}")))?;
            let d = file.variables[number].space.dimension();
            if matrix.len() != rows || matrix.iter().any(|row| row.len() != d) {
                return Err(wrong(format!("the matrix of {name} is not {rows} by {d}")));
            }
            variables.push(number);
        }
        if factor.noise_covariance.len() != rows
            || factor.noise_covariance.iter().any(|row| row.len() != rows)
        {
            return Err(wrong(format!("noise_covariance is not {rows} by {rows}")));
        }
        let matrices = factor.matrices.iter().map(|matrix| matrix.concat()).collect();
        let measurement = Measurement::Linear(matrices, factor.target);
        let covariance = factor.noise_covariance.concat();
        file.factors.push(FileFactor { line: None, variables, measurement, covariance });
    }
    Ok(())
}
