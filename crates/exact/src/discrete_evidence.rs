//! The Bethe free energy of messages over finitely many states.

use crate::ExactError;
use crate::logs::log_sum;
use sumprod_graph::{Engine, Factor, FactorGraph};
use sumprod_messages::CategoricalFamily;
use sumprod_models::discrete::LocalEvidence;

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
    let graph: &FactorGraph<M, F> = engine.graph();
    let topology = engine.topology();
    let mut total = 0.0;
    // What each variable sends along each edge.
    let mut sent: Vec<Vec<f64>> = vec![Vec::new(); graph.edge_count()];
    for variable in graph.variable_ids() {
        let states = graph.space(variable).dimension();
        let mut own = vec![0.0; states];
        let mut belief = vec![0.0; states];
        if let Some(prior) = graph.prior(variable) {
            prior.read_logs(&mut belief);
        }
        let prior = belief.clone();
        for edge in topology.edges_of_variable(variable) {
            engine.message(edge).read_logs(&mut own);
            belief.iter_mut().zip(&own).for_each(|(belief, log)| *belief += log);
        }
        let mut degree = 0.0;
        for edge in topology.edges_of_variable(variable) {
            degree += 1.0;
            engine.message(edge).read_logs(&mut own);
            let others: Vec<f64> = if own.iter().all(|log| log.is_finite()) {
                belief.iter().zip(&own).map(|(belief, log)| belief - log).collect()
            } else {
                // What is ruled out cannot be taken away again.
                let mut others = prior.clone();
                for other in topology.edges_of_variable(variable).filter(|&other| other != edge) {
                    engine.message(other).read_logs(&mut own);
                    others.iter_mut().zip(&own).for_each(|(others, log)| *others += log);
                }
                others
            };
            sent[edge.index()] = others;
        }
        total += (1.0 - degree) * log_sum(&belief);
    }
    for factor in graph.factor_ids() {
        let mut question = LocalEvidence::default();
        for edge in topology.edges_of_factor(factor) {
            question.logs.extend_from_slice(&sent[edge.index()]);
        }
        if !graph.rules(factor).answer(&mut question) {
            return Err(ExactError::NoTable { factor: graph.factor_name(factor) });
        }
        total += question.log_sum;
    }
    Ok(total)
}
