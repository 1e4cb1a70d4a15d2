//! What a method does with a graph.

use super::Prepared;
use crate::error::PositioningError;
use crate::results::MethodRun;
use serde::{Deserialize, Serialize};
use sumprod_exact::{Answer, BeliefOptions, ExactError, Kernel, Optimizer, Problem, SolveOptions};

/// Keys of `[method.ID]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MethodSettings {
    /// What is done.
    pub inference: Inference,
    /// How steps of nonlinear solves are chosen.
    #[serde(default)]
    pub optimizer: Optimizer,
    /// Steps, or rounds of message passing between two linearisations, after which the method stops.
    #[serde(default = "iterations")]
    pub iterations: usize,
    /// Linearisations of message passing.
    #[serde(default = "rounds")]
    pub rounds: usize,
    /// Share of the old message that a new one keeps.
    #[serde(default)]
    pub damping: f64,
    /// The robust kernel of all factors of the file, for instance `{ huber = 1.345 }`.
    #[serde(default)]
    pub kernel: Kernel,
}

fn iterations() -> usize {
    200
}

fn rounds() -> usize {
    10
}

/// What a method does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Inference {
    /// Mean, covariances and evidence by joint solves.
    Joint,
    /// The minimum alone.
    Map,
    /// Loopy Gaussian belief propagation.
    GaussianBp,
}

impl MethodSettings {
    pub(super) fn validate(&self, id: &str) -> Result<(), PositioningError> {
        let key = |name: &str| format!("method.{id}.{name}");
        for (name, value) in [("iterations", self.iterations), ("rounds", self.rounds)] {
            if value == 0 {
                return Err(PositioningError::setting(key(name), "is 0; it must be at least 1"));
            }
        }
        if !(0.0..1.0).contains(&self.damping) {
            let problem = format!("is {}; it must be at least 0 and below 1", self.damping);
            return Err(PositioningError::setting(key("damping"), problem));
        }
        let width = match self.kernel {
            Kernel::None => 1.0,
            Kernel::Huber(width)
            | Kernel::Cauchy(width)
            | Kernel::GemanMcclure(width)
            | Kernel::Tukey(width) => width,
        };
        if !(width > 0.0 && width.is_finite()) {
            let problem = format!("has a width of {width}; it must be positive and finite");
            return Err(PositioningError::setting(key("kernel"), problem));
        }
        Ok(())
    }

    pub(super) fn run(&self, prepared: &Prepared, out: &mut MethodRun) -> Result<Answer, ExactError> {
        let mut problem = Problem::new(&prepared.graph)?;
        if self.kernel != Kernel::None {
            // Priors hold the gauge, and are no measurements that may be outliers.
            for kind in ["relative pose", "point in frame", "range", "linear"] {
                problem.set_kernel(kind, self.kernel);
            }
        }
        let options = SolveOptions {
            optimizer: self.optimizer,
            max_iterations: self.iterations,
            ..SolveOptions::default()
        };
        match self.inference {
            Inference::GaussianBp => self.beliefs(&problem, prepared, out),
            Inference::Map => {
                let solution = problem.solve(prepared.start.clone(), &options)?;
                report(out, solution.report().cost, solution.report().iterations);
                Ok(Answer { values: solution.values().clone(), covariances: None })
            }
            Inference::Joint => {
                let mut solution = problem.solve(prepared.start.clone(), &options)?;
                report(out, solution.report().cost, solution.report().iterations);
                out.diagnose("log_evidence", solution.log_evidence()?);
                solution.answer()
            }
        }
    }

    fn beliefs(
        &self,
        problem: &Problem<'_>,
        prepared: &Prepared,
        out: &mut MethodRun,
    ) -> Result<Answer, ExactError> {
        let options = BeliefOptions {
            rounds: if prepared.file.is_linear() { 1 } else { self.rounds },
            iterations: self.iterations,
            damping: self.damping,
            tree: false,
        };
        let beliefs = problem.beliefs(prepared.start.clone(), &options)?;
        report(out, problem.cost(&beliefs.answer.values)?, beliefs.iterations);
        if let Some(evidence) = beliefs.log_evidence {
            out.diagnose("log_evidence", evidence);
        }
        out.diagnose("converged", f64::from(u8::from(beliefs.converged)));
        if !beliefs.converged {
            out.notes.push(format!(
                "messages did not settle within {} rounds of the last linearisation; raise `iterations`, or damp them",
                self.iterations
            ));
        }
        Ok(beliefs.answer)
    }
}

fn report(out: &mut MethodRun, cost: f64, iterations: usize) {
    out.diagnose("cost", cost);
    out.diagnose("iterations", iterations as f64);
}
