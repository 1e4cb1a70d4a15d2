//! What a run carries from one iteration to the next.

use crate::{Factor, FactorGraph, Message, Topology};

/// Messages, beliefs and the count of iterations, which together with the seed fix everything that follows.
#[derive(Clone)]
pub(crate) struct State<M> {
    pub(crate) iteration: u64,
    /// Factor-to-variable messages, by edge.
    pub(crate) messages: Vec<M>,
    /// Whether a message has been sent along each edge yet: the first has nothing to be damped with.
    pub(crate) sent: Vec<bool>,
    pub(crate) beliefs: Vec<M>,
    pub(crate) priors: Vec<Option<M>>,
    /// Beliefs that stand for a start rather than a product: nothing may be divided out of them.
    pub(crate) guessed: Vec<bool>,
    /// Beliefs to be computed before the first iteration.
    pub(crate) stale: Vec<bool>,
    /// Vacuous messages, one per space in use, and which one each variable's is.
    pub(crate) vacuous: Vec<M>,
    pub(crate) vacuous_of: Vec<u32>,
}

impl<M: Message> State<M> {
    pub(crate) fn new<F: Factor<M>>(graph: &FactorGraph<M, F>, topology: &Topology) -> Self {
        let mut vacuous = Vec::new();
        let mut spaces: Vec<&crate::Space> = Vec::new();
        let mut vacuous_of = Vec::with_capacity(graph.variable_count());
        for variable in graph.variable_ids() {
            let space = graph.space(variable);
            let known = spaces.iter().rposition(|other| *other == space);
            vacuous_of.push(known.unwrap_or_else(|| {
                spaces.push(space);
                vacuous.push(M::vacuous(space));
                spaces.len() - 1
            }) as u32);
        }
        let vacuous_at = |variable: usize| vacuous[vacuous_of[variable] as usize].clone();
        let messages = graph.edge_variable.iter().map(|&variable| vacuous_at(variable as usize)).collect();
        let mut state = Self {
            iteration: 0,
            messages,
            sent: vec![false; topology.edge_count()],
            beliefs: (0..topology.variable_count()).map(vacuous_at).collect(),
            priors: Vec::with_capacity(topology.variable_count()),
            guessed: vec![false; topology.variable_count()],
            stale: vec![false; topology.variable_count()],
            vacuous,
            vacuous_of,
        };
        for (index, variable) in graph.variables.iter().enumerate() {
            // Without an edge no message would ever replace the start.
            let isolated = topology.raw_edges_of_variable(index).is_empty();
            if let Some(start) = &variable.start {
                state.beliefs[index] = start.clone();
                state.guessed[index] = true;
            }
            state.stale[index] = variable.prior.is_some() && (variable.start.is_none() || isolated);
            state.priors.push(variable.prior.clone());
        }
        state
    }
}
