//! What messages over finitely many states say of the whole graph: evidence, and beliefs of factors.

use crate::ExactError;
use sumprod_graph::{EdgeId, Engine, Factor, FactorId, VariableId};
use sumprod_messages::CategoricalFamily;
use sumprod_messages::vector::log_sum;
use sumprod_models::discrete::{LocalEvidence, Tabulation};

/// The log evidence that belief propagation holds at its messages,
///
/// log Z = Σ_f log Σ_x f Π m_{v→f} + Σ_v (1 - d_v) log Σ_x Π m_{f→v}
///
/// (Yedidia, Freeman and Weiss 2005) with d_v the number of factors at v: exact on trees, and stationary at fixed points of
/// sum-product messages. How messages are scaled cancels; a prior counts with its largest value at one.
///
/// # Errors
///
/// Where a factor is no function of finitely many states.
pub fn discrete_log_evidence<M: CategoricalFamily, F: Factor<M>>(
    engine: &Engine<'_, M, F>,
) -> Result<f64, ExactError> {
    let (graph, topology) = (engine.graph(), engine.topology());
    let mut total = 0.0;
    for variable in graph.variable_ids() {
        let degree = topology.edges_of_variable(variable).count() as f64;
        total += (1.0 - degree) * log_sum(&sent(engine, variable, None));
    }
    for factor in graph.factor_ids() {
        let mut question = LocalEvidence { logs: inputs(engine, factor), log_sum: 0.0 };
        if !graph.rules(factor).answer(&mut question) {
            return Err(ExactError::NoTable { factor: graph.factor_name(factor) });
        }
        total += question.log_sum;
    }
    Ok(total)
}

/// The belief of a factor, f Π m_{v→f}, as the probabilities of the joint states of its variables, the last port's state
/// running fastest.
///
/// # Errors
///
/// Where the factor is no function of finitely many states, or has more than 2²⁶ joint states.
pub fn factor_probabilities<M: CategoricalFamily, F: Factor<M>>(
    engine: &Engine<'_, M, F>,
    factor: FactorId,
) -> Result<Vec<f64>, ExactError> {
    let graph = engine.graph();
    let mut question = Tabulation::new(1 << 26);
    graph.rules(factor).answer(&mut question);
    let Some(table) = question.table else {
        return Err(ExactError::NoTable { factor: graph.factor_name(factor) });
    };
    let mut logs = table.logs().to_vec();
    let inputs = inputs(engine, factor);
    let (mut begin, mut block) = (0, logs.len());
    for &states in table.cardinalities() {
        block /= states;
        for (place, run) in logs.chunks_exact_mut(block.max(1)).enumerate() {
            let input = inputs[begin + place % states];
            run.iter_mut().for_each(|log| *log += input);
        }
        begin += states;
    }
    let total = log_sum(&logs);
    Ok(logs.iter().map(|log| (log - total).exp()).collect())
}

/// The logarithms of what all variables of a factor send it, port by port.
fn inputs<M: CategoricalFamily, F: Factor<M>>(engine: &Engine<'_, M, F>, factor: FactorId) -> Vec<f64> {
    let topology = engine.topology();
    let edges = topology.edges_of_factor(factor);
    edges.flat_map(|edge| sent(engine, topology.variable_of(edge), Some(edge))).collect()
}

/// The logarithms of the product of a variable's prior and messages, without the one along an edge.
fn sent<M: CategoricalFamily, F: Factor<M>>(
    engine: &Engine<'_, M, F>,
    variable: VariableId,
    without: Option<EdgeId>,
) -> Vec<f64> {
    let graph = engine.graph();
    let states = graph.space(variable).dimension();
    let (mut sum, mut own) = (vec![0.0; states], vec![0.0; states]);
    if let Some(prior) = graph.prior(variable) {
        prior.read_logs(&mut sum);
    }
    for edge in engine.topology().edges_of_variable(variable).filter(|&edge| Some(edge) != without) {
        engine.message(edge).read_logs(&mut own);
        sum.iter_mut().zip(&own).for_each(|(sum, log)| *sum += log);
    }
    sum
}
