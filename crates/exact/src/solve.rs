//! Gauss-Newton, Levenberg-Marquardt and dogleg on the normal equations.
//!
//! Every step solves (A + λ D) δ = -g, D the diagonal of A, and moves x to x retracted by δ. Whether to stop is asked of the
//! decrease that is left, g'A⁻¹g / 2 with the last factor: a linear graph is done after one factorisation.

use crate::cholesky::Numeric;
use crate::normal::Normal;
use crate::structure::Structure;
use crate::{ExactError, Ordering, Problem, Solution, Values};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// How a step is chosen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Optimizer {
    /// The full step, always taken.
    GaussNewton,
    /// The full step while it helps, else a damped one (Marquardt 1963).
    #[default]
    LevenbergMarquardt,
    /// The full step, cut by a trust region towards the steepest descent (Powell 1970).
    Dogleg,
}

/// How a problem is solved.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SolveOptions {
    /// How steps are chosen.
    pub optimizer: Optimizer,
    /// In which order variables are eliminated.
    pub ordering: Ordering,
    /// Iterations after which the solve is given up.
    pub max_iterations: usize,
    /// The share of the cost that is not worth another step.
    pub relative_tolerance: f64,
    /// The decrease of the cost that is not worth another step.
    pub absolute_tolerance: f64,
}

impl Default for SolveOptions {
    fn default() -> Self {
        Self {
            optimizer: Optimizer::default(),
            ordering: Ordering::default(),
            max_iterations: 200,
            relative_tolerance: 1e-12,
            absolute_tolerance: 1e-12,
        }
    }
}

/// What a solve did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SolveReport {
    /// Steps taken or tried.
    pub iterations: usize,
    /// The cost at the start.
    pub initial_cost: f64,
    /// The cost reached: half the squared whitened residual where noise is Gaussian and no kernel set.
    pub cost: f64,
}

/// The damping with which a full step that fails is repaired first.
const FIRST_DAMPING: f64 = 1e-8;
/// The smallest damping that is not zero.
const LEAST_DAMPING: f64 = 1e-11;
/// The damping beyond which no step helps.
const MOST_DAMPING: f64 = 1e12;

/// A problem's structure, kept for solves at other values: its analysis is done once.
#[derive(Clone, Debug)]
pub struct Solver {
    pub(crate) structure: Arc<Structure>,
    shape: (usize, usize, usize),
}

impl Solver {
    /// Analyses a problem.
    ///
    /// # Errors
    ///
    /// Where memory does not suffice.
    pub fn new(problem: &Problem<'_>, ordering: Ordering) -> Result<Self, ExactError> {
        let structure = Arc::new(Structure::new(problem, ordering)?);
        Ok(Self { structure, shape: shape(problem) })
    }

    /// Entries of the Cholesky factor, what the supernodes hold of zeros included.
    pub fn factor_entries(&self) -> usize {
        self.structure.symbolic.supernodes.len_val()
    }

    /// Minimises the cost from `start`.
    ///
    /// # Errors
    ///
    /// Where a factor cannot be linearised, a direction is free, or the iteration does not converge.
    pub fn solve<'p>(
        &self,
        problem: &'p Problem<'p>,
        start: Values,
        options: &SolveOptions,
    ) -> Result<Solution<'p>, ExactError> {
        if shape(problem) != self.shape || start.layout != problem.shape.layout {
            return Err(ExactError::Request("the solver or the values belong to another graph".into()));
        }
        Descent::new(problem, self.structure.clone(), start, options)?.run()
    }
}

fn shape(problem: &Problem<'_>) -> (usize, usize, usize) {
    (problem.variable_count(), problem.factor_count(), problem.port_count())
}

impl Problem<'_> {
    /// Minimises the cost from `start`: [`Solver::solve`] after an analysis.
    ///
    /// # Errors
    ///
    /// As [`Solver::solve`].
    pub fn solve(&self, start: Values, options: &SolveOptions) -> Result<Solution<'_>, ExactError> {
        Solver::new(self, options.ordering)?.solve(self, start, options)
    }
}

/// A step that has been computed, and the decrease that the quadratic model promises.
struct Step {
    change: Vec<f64>,
    predicted: f64,
}

struct Descent<'p, 'o> {
    problem: &'p Problem<'p>,
    structure: Arc<Structure>,
    options: &'o SolveOptions,
    values: Values,
    here: Normal,
    there: Normal,
    numeric: Numeric,
    damped: Vec<f64>,
    damping: f64,
    /// By which the next failure multiplies the damping.
    growth: f64,
    radius: f64,
    /// Whether the factor is that of the undamped information at `here`, or at the point before.
    undamped: bool,
}

impl<'p, 'o> Descent<'p, 'o> {
    fn new(
        problem: &'p Problem<'p>,
        structure: Arc<Structure>,
        values: Values,
        options: &'o SolveOptions,
    ) -> Result<Self, ExactError> {
        let mut here = Normal::default();
        here.fill(problem, &structure, &values)?;
        let numeric = Numeric::new(&structure.symbolic)?;
        Ok(Self {
            problem,
            structure,
            options,
            values,
            here,
            there: Normal::default(),
            numeric,
            damped: Vec::new(),
            damping: 0.0,
            growth: 4.0,
            radius: f64::INFINITY,
            undamped: false,
        })
    }

    fn run(mut self) -> Result<Solution<'p>, ExactError> {
        let initial_cost = self.here.cost;
        let mut last = f64::INFINITY;
        for iteration in 0..self.options.max_iterations {
            let Some(step) = self.step()? else { continue };
            if step.predicted <= self.tolerance() && self.damping < LEAST_DAMPING {
                return self.finish(iteration, initial_cost);
            }
            let full = self.structure.unpermuted(self.problem, &step.change);
            let moved = self.values.retracted(&full);
            let filled = self.there.fill(self.problem, &self.structure, &moved);
            let decrease = self.here.cost - self.there.cost;
            let gain = decrease / step.predicted;
            let good = filled.is_ok() && (gain > 1e-4 || self.options.optimizer == Optimizer::GaussNewton);
            if !good {
                filled.or_else(|error| if self.may_shrink() { Ok(()) } else { Err(error) })?;
                if step.predicted <= self.tolerance() || self.damping >= MOST_DAMPING {
                    return self.finish(iteration + 1, initial_cost);
                }
                self.shrink(&step);
                continue;
            }
            last = decrease / self.here.cost.abs().max(f64::MIN_POSITIVE);
            self.values = moved;
            std::mem::swap(&mut self.here, &mut self.there);
            self.grow(gain, &step);
            if self.undamped && self.decrease_left()? <= self.tolerance() {
                return self.finish(iteration + 1, initial_cost);
            }
        }
        let (iterations, cost) = (self.options.max_iterations, self.here.cost);
        let remedy = "allow more iterations, start closer, or take another optimizer";
        Err(ExactError::NotConverged { iterations, cost, decrease: last, remedy })
    }

    fn tolerance(&self) -> f64 {
        self.options.relative_tolerance * self.here.cost.abs() + self.options.absolute_tolerance
    }

    fn may_shrink(&self) -> bool {
        self.options.optimizer != Optimizer::GaussNewton && self.damping < MOST_DAMPING && self.radius > 1e-12
    }

    /// The step at the present damping or radius; none where the matrix had to be damped first.
    fn step(&mut self) -> Result<Option<Step>, ExactError> {
        let structure = self.structure.clone();
        let lower = if self.damping > 0.0 {
            self.damped.clone_from(&self.here.lower);
            for &diagonal in &structure.column_pointer[..structure.size()] {
                self.damped[diagonal] *= 1.0 + self.damping;
                // A coordinate that nothing touches has no scale of its own.
                self.damped[diagonal] += self.damping * 1e-12;
            }
            &self.damped
        } else {
            &self.here.lower
        };
        self.undamped = self.damping == 0.0;
        let factored = self.numeric.factorise(
            &structure.symbolic,
            &structure.column_pointer,
            &structure.row_index,
            lower,
        );
        if let Err(row) = factored {
            if self.options.optimizer == Optimizer::LevenbergMarquardt && self.damping < 1e3 {
                self.damping = (10.0 * self.damping).max(FIRST_DAMPING);
                return Ok(None);
            }
            return Err(self.singular(row));
        }
        let mut change: Vec<f64> = self.here.gradient.iter().map(|g| -g).collect();
        self.numeric.solve(&structure.symbolic, &mut change, 1)?;
        if let Some(&value) = change.iter().find(|x| !x.is_finite()) {
            let remedy = "bring the factors' variances closer together";
            return Err(ExactError::NotFinite { what: "a step of the solve".into(), value, remedy });
        }
        if self.options.optimizer == Optimizer::Dogleg {
            return Ok(Some(self.cut(change)));
        }
        // -(g'δ + δ'Aδ / 2), with A δ = -g - λ D δ.
        let slope = dot(&self.here.gradient, &change);
        let drag: f64 = change
            .iter()
            .zip(&structure.column_pointer)
            .map(|(x, &diagonal)| x * x * (self.damping * self.here.lower[diagonal]))
            .sum();
        Ok(Some(Step { change, predicted: 0.5 * (drag - slope) }))
    }

    /// Powell's path from the steepest descent to the full step, as far as the trust region goes.
    fn cut(&self, full: Vec<f64>) -> Step {
        let gradient = &self.here.gradient;
        let length = norm(&full);
        if length <= self.radius {
            let predicted = -0.5 * dot(gradient, &full);
            return Step { change: full, predicted };
        }
        let image = self.multiply(gradient);
        let reach = dot(gradient, gradient) / dot(gradient, &image);
        let descent: Vec<f64> = gradient.iter().map(|g| -reach * g).collect();
        let short = norm(&descent);
        let change: Vec<f64> = if short >= self.radius {
            descent.iter().map(|x| x * self.radius / short).collect()
        } else {
            // The point of the line from one to the other that lies on the region's edge.
            let along: Vec<f64> = full.iter().zip(&descent).map(|(full, descent)| full - descent).collect();
            let (a, b) = (dot(&along, &along), dot(&along, &descent));
            let c = short * short - self.radius * self.radius;
            let share = (-b + (b * b - a * c).max(0.0).sqrt()) / a;
            descent.iter().zip(&along).map(|(descent, along)| descent + share * along).collect()
        };
        let predicted = -dot(gradient, &change) - 0.5 * dot(&change, &self.multiply(&change));
        Step { change, predicted }
    }

    /// A x from the lower triangle.
    fn multiply(&self, x: &[f64]) -> Vec<f64> {
        let mut out = vec![0.0; x.len()];
        for (column, &own) in x.iter().enumerate() {
            let range = self.structure.column_pointer[column]..self.structure.column_pointer[column + 1];
            for (&row, &entry) in self.structure.row_index[range.clone()].iter().zip(&self.here.lower[range])
            {
                out[row] += entry * own;
                if row != column {
                    out[column] += entry * x[row];
                }
            }
        }
        out
    }

    fn shrink(&mut self, step: &Step) {
        match self.options.optimizer {
            Optimizer::Dogleg => self.radius = 0.25 * self.radius.min(norm(&step.change)),
            _ => {
                self.damping = (self.growth * self.damping).max(FIRST_DAMPING);
                self.growth *= 2.0;
            }
        }
    }

    fn grow(&mut self, gain: f64, step: &Step) {
        match self.options.optimizer {
            Optimizer::Dogleg if gain > 0.75 => self.radius = self.radius.max(3.0 * norm(&step.change)),
            Optimizer::Dogleg if gain < 0.25 => self.radius = 0.5 * norm(&step.change),
            Optimizer::LevenbergMarquardt => {
                // Nielsen (1999): by how well the model foretold the decrease.
                self.damping *= (1.0 - (2.0 * gain - 1.0).powi(3)).max(0.1);
                self.growth = 4.0;
                if self.damping < LEAST_DAMPING {
                    self.damping = 0.0;
                }
            }
            _ => {}
        }
    }

    /// g'A⁻¹g / 2 with the last factor: what another step would gain.
    fn decrease_left(&self) -> Result<f64, ExactError> {
        let mut image = self.here.gradient.clone();
        self.numeric.solve(&self.structure.symbolic, &mut image, 1)?;
        Ok(0.5 * dot(&self.here.gradient, &image))
    }

    fn singular(&self, row: usize) -> ExactError {
        crate::observability::explain(self.problem, &self.values, self.structure.variable_at(row))
    }

    fn finish(self, iterations: usize, initial_cost: f64) -> Result<Solution<'p>, ExactError> {
        let report = SolveReport { iterations, initial_cost, cost: self.here.cost };
        let parts = (self.structure, self.values, self.here, self.numeric);
        Solution::new(self.problem, parts, self.undamped, report)
    }
}

pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn norm(a: &[f64]) -> f64 {
    dot(a, a).sqrt()
}
