//! What a method does with a graph.

use super::Coordinates;
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
    /// Which messages over states are sent first: all at once, or those whose inputs have changed most.
    #[serde(default)]
    pub schedule: Order,
    /// The change of messages over states below which they have settled.
    #[serde(default = "tolerance")]
    pub tolerance: f64,
    /// The most entries of all tables of a junction tree.
    #[serde(default = "most_entries")]
    pub most_entries: usize,
}

/// The order of messages over states.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Order {
    /// All at once.
    #[default]
    Flooding,
    /// The largest change first.
    Residual,
}

fn tolerance() -> f64 {
    1e-9
}

fn most_entries() -> usize {
    sumprod_exact::JunctionOptions::default().most_entries
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
    /// Marginals and evidence of states, exact.
    JunctionTree,
    /// Loopy sum-product messages over states.
    Bp,
    /// Loopy max-product messages over states.
    MaxProduct,
}

impl Inference {
    /// Whether this is for graphs of finitely many states.
    pub(super) fn takes_states(self) -> bool {
        matches!(self, Self::Map | Self::JunctionTree | Self::Bp | Self::MaxProduct)
    }

    /// Whether this is for graphs of continuous variables.
    pub(super) fn takes_coordinates(self) -> bool {
        matches!(self, Self::Map | Self::Joint | Self::GaussianBp)
    }
}

impl MethodSettings {
    pub(super) fn validate(&self, id: &str) -> Result<(), PositioningError> {
        let key = |name: &str| format!("method.{id}.{name}");
        let counts =
            [("iterations", self.iterations), ("rounds", self.rounds), ("most_entries", self.most_entries)];
        for (name, value) in counts {
            if value == 0 {
                return Err(PositioningError::setting(key(name), "is 0; it must be at least 1"));
            }
        }
        if !(0.0..1.0).contains(&self.damping) {
            let problem = format!("is {}; it must be at least 0 and below 1", self.damping);
            return Err(PositioningError::setting(key("damping"), problem));
        }
        if !(self.tolerance >= 0.0 && self.tolerance.is_finite()) {
            let problem = format!("is {}; it must be finite and not negative", self.tolerance);
            return Err(PositioningError::setting(key("tolerance"), problem));
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

    pub(super) fn run(&self, prepared: &Coordinates, out: &mut MethodRun) -> Result<Answer, ExactError> {
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
            _ => {
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
        prepared: &Coordinates,
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
            out.notes.push(unsettled(&beliefs.changes, "`joint`"));
        }
        Ok(beliefs.answer)
    }
}

/// What to do about messages that did not settle: more of them where their changes shrink, something else where not.
pub(super) fn unsettled(changes: &[f64], exact: &str) -> String {
    let (halfway, last) = (changes.get(changes.len() / 2), changes.last());
    let (halfway, last) = (halfway.copied().unwrap_or(0.0), last.copied().unwrap_or(0.0));
    let found = format!(
        "messages did not settle in {} iterations: their largest change went from {halfway:.1e} halfway to {last:.1e}",
        changes.len()
    );
    if last < 0.5 * halfway {
        format!("{found}; raise `iterations`")
    } else {
        format!(
            "{found}, and more of them would not help: set `damping`, or take {exact}, since messages in loops need not settle"
        )
    }
}

pub(super) fn report(out: &mut MethodRun, cost: f64, iterations: usize) {
    out.diagnose("cost", cost);
    out.diagnose("iterations", iterations as f64);
}
