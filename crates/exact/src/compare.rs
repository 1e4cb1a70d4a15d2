//! One graph by every method that can run it, side by side.

use crate::belief::BeliefOptions;
use crate::{Answer, Deviation, ExactError, Problem, SolveOptions, Values};
use std::fmt;
use std::time::Instant;

/// One method's line.
#[derive(Clone, Debug, PartialEq)]
pub struct ComparisonRow {
    /// The method.
    pub method: &'static str,
    /// Wall-clock time (s).
    pub seconds: f64,
    /// Steps, or rounds of messages.
    pub iterations: usize,
    /// The cost at its answer.
    pub cost: f64,
    /// Its evidence.
    pub log_evidence: Option<f64>,
    /// How far it is from the joint solve.
    pub deviation: Option<Deviation>,
    /// Why it has no answer.
    pub failure: Option<String>,
}

/// The methods, the exact one first.
#[derive(Clone, Debug, PartialEq)]
pub struct Comparison(pub Vec<ComparisonRow>);

impl fmt::Display for Comparison {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "{:<18} {:>10} {:>10} {:>14} {:>14} {:>12} {:>12}",
            "method", "time [s]", "iterations", "cost", "log evidence", "mean [sd]", "covariance"
        )?;
        for row in &self.0 {
            if let Some(failure) = &row.failure {
                writeln!(f, "{:<18} {failure}", row.method)?;
                continue;
            }
            let evidence = row.log_evidence.map_or(String::new(), |value| format!("{value:.6}"));
            let mean = row.deviation.map_or(String::new(), |d| format!("{:.2e}", d.mean_sd));
            let covariance = row.deviation.and_then(|d| d.covariance_relative);
            let covariance = covariance.map_or(String::new(), |value| format!("{value:.2e}"));
            writeln!(
                f,
                "{:<18} {:>10.4} {:>10} {:>14.6} {evidence:>14} {mean:>12} {covariance:>12}",
                row.method, row.seconds, row.iterations, row.cost
            )?;
        }
        Ok(())
    }
}

/// What a method yields.
type Outcome = Result<(Answer, usize, Option<f64>), ExactError>;

/// Runs a joint solve, loopy belief propagation, the same damped, and on a tree one sweep of messages each way.
///
/// # Errors
///
/// Where the joint solve fails; failures of the others stand in their rows.
pub fn compare(problem: &Problem<'_>, start: &Values, iterations: usize) -> Result<Comparison, ExactError> {
    let joint = || -> Outcome {
        let options = SolveOptions { max_iterations: iterations, ..SolveOptions::default() };
        let mut solution = problem.solve(start.clone(), &options)?;
        let evidence = solution.log_evidence()?;
        Ok((solution.answer()?, solution.report().iterations, Some(evidence)))
    };
    let beliefs = |damping: f64, tree: bool| -> Outcome {
        let options = BeliefOptions { rounds: 10, iterations, damping, tree };
        let beliefs = problem.beliefs(start.clone(), &options)?;
        Ok((beliefs.answer, beliefs.iterations, beliefs.log_evidence))
    };
    let (row, exact) = timed(problem, "joint", None, joint)?;
    let mut rows = vec![row];
    let edges = problem.port_count() + problem.components().len();
    if edges == problem.variable_count() + problem.factor_count() {
        rows.push(attempt(problem, "forward-backward", &exact, || beliefs(0.0, true)));
    }
    rows.push(attempt(problem, "gaussian-bp", &exact, || beliefs(0.0, false)));
    rows.push(attempt(problem, "gaussian-bp damped", &exact, || beliefs(0.4, false)));
    Ok(Comparison(rows))
}

fn timed(
    problem: &Problem<'_>,
    method: &'static str,
    exact: Option<&Answer>,
    work: impl Fn() -> Outcome,
) -> Result<(ComparisonRow, Answer), ExactError> {
    let begin = Instant::now();
    let (answer, iterations, log_evidence) = work()?;
    let seconds = begin.elapsed().as_secs_f64();
    let cost = problem.cost(&answer.values)?;
    let deviation = exact.and_then(|exact| answer.deviation_from(exact));
    Ok((ComparisonRow { method, seconds, iterations, cost, log_evidence, deviation, failure: None }, answer))
}

fn attempt(
    problem: &Problem<'_>,
    method: &'static str,
    exact: &Answer,
    work: impl Fn() -> Outcome,
) -> ComparisonRow {
    timed(problem, method, Some(exact), work).map_or_else(
        |error| ComparisonRow {
            method,
            seconds: 0.0,
            iterations: 0,
            cost: f64::NAN,
            log_evidence: None,
            deviation: None,
            failure: Some(error.to_string()),
        },
        |(row, _)| row,
    )
}
