//! The answer of a joint solve: values, covariances of any variables, evidence.

use crate::cholesky::Numeric;
use crate::normal::Normal;
use crate::observability;
use crate::selected;
use crate::structure::Structure;
use crate::{Answer, ExactError, Problem, SolveReport, Values};
use std::f64::consts::TAU;
use std::sync::Arc;
use sumprod_graph::VariableId;
use sumprod_messages::Moments;

/// The smallest pivot, as a share of its diagonal, that is taken without asking whether a direction is free.
const SAFE_PIVOT: f64 = 1e-10;

/// The minimum of a problem's cost, and the Gaussian about it.
pub struct Solution<'p> {
    problem: &'p Problem<'p>,
    structure: Arc<Structure>,
    values: Values,
    normal: Normal,
    numeric: Numeric,
    /// Whether the factor is that of the information at the values, not at the point before the last step.
    current: bool,
    report: SolveReport,
}

impl<'p> Solution<'p> {
    /// Wraps what a descent ended with; `factored` where the factor is undamped.
    pub(crate) fn new(
        problem: &'p Problem<'p>,
        (structure, values, normal, numeric): (Arc<Structure>, Values, Normal, Numeric),
        factored: bool,
        report: SolveReport,
    ) -> Result<Self, ExactError> {
        let mut solution = Self { problem, structure, values, normal, numeric, current: false, report };
        if !factored {
            solution.factorise()?;
        }
        solution.refuse_free_directions()?;
        Ok(solution)
    }

    /// The values of all variables at the minimum.
    pub fn values(&self) -> &Values {
        &self.values
    }

    /// What the solve did.
    pub fn report(&self) -> SolveReport {
        self.report
    }

    fn factorise(&mut self) -> Result<(), ExactError> {
        let structure = &self.structure;
        self.numeric
            .factorise(
                &structure.symbolic,
                &structure.column_pointer,
                &structure.row_index,
                &self.normal.lower,
            )
            .map_err(|row| observability::explain(self.problem, &self.values, structure.variable_at(row)))?;
        self.current = true;
        Ok(())
    }

    /// The factor at the values themselves.
    fn refresh(&mut self) -> Result<(), ExactError> {
        if self.current { Ok(()) } else { self.factorise() }
    }

    /// A pivot that all but vanishes may be rounding where an exact zero should be.
    fn refuse_free_directions(&self) -> Result<(), ExactError> {
        let structure = &self.structure;
        let pivots = self.numeric.diagonal(&structure.symbolic);
        let diagonal = structure.column_pointer.iter().map(|&place| self.normal.lower.get(place).copied());
        let share = |(pivot, own): (&f64, Option<f64>)| pivot * pivot / own.unwrap_or(1.0);
        let least = pivots.iter().zip(diagonal).map(share).fold(f64::INFINITY, f64::min);
        if least >= SAFE_PIVOT {
            return Ok(());
        }
        let free = observability::free_directions(self.problem, &self.values)?;
        if free.is_empty() { Ok(()) } else { Err(ExactError::Unobservable(free)) }
    }

    /// Covariances of all variables, each in its own local coordinates, by the selected inverse.
    ///
    /// Twice the work of one factorisation.
    ///
    /// # Errors
    ///
    /// Where the information at the values is singular.
    pub fn marginals(&mut self) -> Result<Marginals, ExactError> {
        self.refresh()?;
        let layout = self.problem.shape.layout.clone();
        let mut pointer = Vec::with_capacity(layout.variables() + 1);
        let mut total = 0;
        for index in 0..layout.variables() {
            pointer.push(total);
            total += layout.freedoms(index).len().pow(2);
        }
        pointer.push(total);
        let mut entries = vec![0.0; total];
        let structure = &self.structure;
        selected::each_variable(structure, &self.numeric, |variable, block, stride| {
            let d = layout.freedoms(variable).len();
            let own = &mut entries[pointer[variable]..pointer[variable + 1]];
            for column in 0..d {
                for row in 0..d {
                    own[row * d + column] =
                        0.5 * (block[column * stride + row] + block[row * stride + column]);
                }
            }
        });
        Ok(Marginals { pointer, entries })
    }

    /// Values and covariances of all variables.
    ///
    /// # Errors
    ///
    /// As [`Solution::marginals`].
    pub fn answer(&mut self) -> Result<Answer, ExactError> {
        let marginals = self.marginals()?;
        let of = |&variable: &VariableId| marginals.covariance(variable).to_vec();
        let covariances = Some(self.problem.variables().iter().map(of).collect());
        Ok(Answer { values: self.values.clone(), covariances })
    }

    /// Mean (stored coordinates) and covariance (local coordinates, row-major) of one variable.
    ///
    /// # Errors
    ///
    /// As [`Solution::joint`].
    pub fn marginal(&mut self, variable: VariableId) -> Result<Moments, ExactError> {
        self.joint(&[variable])
    }

    /// Means, one after the other, and the joint covariance of some variables, in local coordinates, row-major. One sparse
    /// solve per degree of freedom.
    ///
    /// # Errors
    ///
    /// Where a handle is of another graph, or the information at the values is singular.
    pub fn joint(&mut self, variables: &[VariableId]) -> Result<Moments, ExactError> {
        self.refresh()?;
        let layout = self.problem.layout();
        if let Some(unknown) = variables.iter().find(|v| v.index() >= layout.variables()) {
            let (index, count) = (unknown.index(), layout.variables());
            return Err(ExactError::Request(format!("there is no variable {index}; the graph has {count}")));
        }
        let rows: Vec<usize> = variables
            .iter()
            .flat_map(|v| {
                let first = self.structure.first[v.index()] as usize;
                first..first + layout.freedoms(v.index()).len()
            })
            .collect();
        let size = layout.size();
        let mut covariance = vec![0.0; rows.len() * rows.len()];
        let mut column = vec![0.0; size];
        for (k, &row) in rows.iter().enumerate() {
            column.fill(0.0);
            column[row] = 1.0;
            self.numeric.solve(&self.structure.symbolic, &mut column, 1)?;
            for (j, &other) in rows.iter().enumerate() {
                covariance[j * rows.len() + k] = column[other];
            }
        }
        let d = rows.len();
        for row in 0..d {
            for column in 0..row {
                let mean = 0.5 * (covariance[row * d + column] + covariance[column * d + row]);
                (covariance[row * d + column], covariance[column * d + row]) = (mean, mean);
            }
        }
        let mean = variables.iter().flat_map(|&v| self.values.get(v).iter().copied()).collect();
        Ok(Moments { mean, covariance })
    }

    /// The log of the integral over all variables of the product of all factors, each a normalised density of its
    /// residual. Exact where the graph is linear and Gaussian; else Laplace's approximation at the minimum.
    ///
    /// log Z = Σ log p(r) + n/2 log 2π - log det A / 2.
    ///
    /// # Errors
    ///
    /// Where the information at the values is singular.
    pub fn log_evidence(&mut self) -> Result<f64, ExactError> {
        self.refresh()?;
        let diagonal = self.numeric.diagonal(&self.structure.symbolic);
        let half_log_determinant: f64 = diagonal.iter().map(|pivot| pivot.ln()).sum();
        let size = self.structure.size() as f64;
        Ok(self.normal.log_peak - self.normal.cost + 0.5 * size * TAU.ln() - half_log_determinant)
    }
}

/// Covariances of all variables.
#[derive(Clone, Debug, PartialEq)]
pub struct Marginals {
    pointer: Vec<usize>,
    entries: Vec<f64>,
}

impl Marginals {
    /// The covariance of a variable in its local coordinates, row-major; empty where the handle is of another graph.
    pub fn covariance(&self, variable: VariableId) -> &[f64] {
        match (self.pointer.get(variable.index()), self.pointer.get(variable.index() + 1)) {
            (Some(&start), Some(&end)) => &self.entries[start..end],
            _ => &[],
        }
    }
}
