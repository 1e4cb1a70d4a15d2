//! The Bethe free energy of Gaussian messages.

use crate::{ExactError, Problem, Values};
use std::f64::consts::TAU;
use sumprod_graph::{Engine, FactorGraph, MessageError};
use sumprod_messages::{Cholesky, DynamicGaussian};
use sumprod_models::Expansion;

/// The log evidence that belief propagation holds at its messages,
///
/// log Z = Σ_f log ∫ f Π m_{v→f} + Σ_v log ∫ Π m_{f→v} - Σ_edges log ∫ m_{f→v} m_{v→f}
///
/// (Yedidia, Freeman and Weiss 2005): exact on trees, an approximation with loops. `engine` ran on
/// [`Problem::linear_graph`] of this problem at `values`; messages need no normalisation, which cancels.
///
/// # Errors
///
/// Where a product is improper, or a factor cannot be linearised.
pub fn bethe_log_evidence(
    problem: &Problem<'_>,
    values: &Values,
    engine: &Engine<'_, DynamicGaussian>,
) -> Result<f64, ExactError> {
    let graph: &FactorGraph<DynamicGaussian> = engine.graph();
    let topology = engine.topology();
    let mut total = 0.0;
    let named = |index: usize| {
        move |source: MessageError| ExactError::Prior { variable: problem.variable_name(index), source }
    };
    for (index, variable) in graph.variable_ids().enumerate() {
        total += log_integral_of(engine.belief(variable)).map_err(named(index))?;
    }
    let (mut question, mut chained) = (Expansion::default(), Vec::new());
    for (number, factor) in graph.factor_ids().enumerate() {
        problem.expand(number, &values.numbers, true, &mut question, &mut chained)?;
        let rows = question.residual.len();
        let n = question.jacobian.len() / rows.max(1);
        let mut information = vec![0.0; n * n];
        let mut vector = vec![0.0; n];
        for (row, r) in question.jacobian.chunks_exact(n.max(1)).zip(&question.residual) {
            for (i, a) in row.iter().enumerate() {
                vector[i] -= a * r;
                for (j, b) in row.iter().enumerate() {
                    information[i * n + j] += a * b;
                }
            }
        }
        let mut start = 0;
        for edge in topology.edges_of_factor(factor) {
            let variable = topology.variable_of(edge);
            let belief = engine.belief(variable);
            let incoming = belief.over(engine.message(edge));
            // The edge's own product is the belief again.
            total -= log_integral_of(belief).map_err(named(variable.index()))?;
            let d = incoming.dimension();
            for i in 0..d {
                vector[start + i] += incoming.information_vector()[i];
                for j in 0..d {
                    information[(start + i) * n + start + j] += incoming.information_at(i, j);
                }
            }
            start += d;
        }
        let failed = |source| ExactError::Factor { factor: problem.factor_name(number), source };
        total += log_integral(&information, &vector).map_err(failed)? + question.log_peak - question.loss;
    }
    Ok(total)
}

fn log_integral_of(message: &DynamicGaussian) -> Result<f64, MessageError> {
    let d = message.dimension();
    let mut information = vec![0.0; d * d];
    message.write_matrix(&mut information);
    log_integral(&information, message.information_vector())
}

/// log ∫ exp(-x'Λx / 2 + η'x) dx.
fn log_integral(information: &[f64], vector: &[f64]) -> Result<f64, MessageError> {
    let d = vector.len();
    let factor = Cholesky::new(information, d, "a product of messages")?;
    let mut half = vector.to_vec();
    let squared = factor.squared_length(&mut half);
    Ok(0.5 * (squared + d as f64 * TAU.ln() - factor.log_determinant()))
}
