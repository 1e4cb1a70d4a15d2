//! Gaussian belief propagation on a nonlinear graph: messages on its linear form until they stand still, then a step to
//! their means, and again.

use crate::{Answer, ExactError, Problem, Values, bethe_log_evidence};
use sumprod_graph::schedule::{Flooding, ForwardBackward};
use sumprod_graph::{Engine, Options, Schedule};

/// How messages are passed between linearisations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BeliefOptions {
    /// Linearisations; one suffices for a linear graph.
    pub rounds: usize,
    /// Rounds of messages between two of them.
    pub iterations: usize,
    /// Share of the old message that a new one keeps.
    pub damping: f64,
    /// Whether messages go once forwards and once backwards, which is exact on trees and refuses loops.
    pub tree: bool,
}

/// What belief propagation ended with.
#[derive(Clone, Debug)]
pub struct Beliefs {
    /// Means and covariances.
    pub answer: Answer,
    /// The Bethe approximation of the evidence, where every product is proper.
    pub log_evidence: Option<f64>,
    /// Rounds of messages in all.
    pub iterations: usize,
    /// Whether the last messages stood still.
    pub converged: bool,
    /// The largest change of a belief by round of messages since the last linearisation.
    pub changes: Vec<f64>,
}

/// The largest step, in standard deviations, that ends the linearisations.
const STILL: f64 = 1e-9;

impl Problem<'_> {
    /// Belief propagation from `start`.
    ///
    /// # Errors
    ///
    /// Where a factor cannot be linearised or a message computed, or a belief stays improper.
    pub fn beliefs(&self, start: Values, options: &BeliefOptions) -> Result<Beliefs, ExactError> {
        let (mut values, mut iterations) = (start, 0);
        let mut round = 0;
        loop {
            round += 1;
            let graph = self.linear_graph(&values)?;
            let settings = Options {
                tolerance: 1e-12,
                max_iterations: options.iterations,
                damping: options.damping,
                ..Options::default()
            };
            let mut engine = Engine::new(&graph, settings)?;
            let mut flooding = Flooding;
            let mut sweep = ForwardBackward::new();
            let schedule: &mut dyn Schedule = if options.tree { &mut sweep } else { &mut flooding };
            let run = engine.run(schedule)?;
            iterations += run.iterations;
            let (mut step, mut covariances, mut size): (Vec<f64>, _, f64) = (Vec::new(), Vec::new(), 0.0);
            for variable in graph.variable_ids() {
                let moments = engine.belief(variable).moments().map_err(|source| {
                    let variable = graph.variable_name(variable);
                    ExactError::Belief { variable, source }
                })?;
                for (k, x) in moments.mean.iter().enumerate() {
                    size = size.max(x.abs() / moments.covariance_at(k, k).sqrt());
                }
                step.extend_from_slice(&moments.mean);
                covariances.push(moments.covariance);
            }
            if !size.is_finite() {
                let remedy = "messages diverge; damp them, or solve jointly";
                return Err(ExactError::NotFinite {
                    what: "a step of belief propagation".into(),
                    value: size,
                    remedy,
                });
            }
            let log_evidence =
                bethe_log_evidence(self, &values, &engine).ok().filter(|value| value.is_finite());
            values = self.moved(&values, &step)?;
            if size < STILL || round >= options.rounds {
                let answer = Answer { values, covariances: Some(covariances) };
                let converged = run.converged();
                return Ok(Beliefs { answer, log_evidence, iterations, converged, changes: run.changes });
            }
        }
    }
}
