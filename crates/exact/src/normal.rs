//! The normal equations at a point: the information A = Σ J'J of the whitened Jacobians, and the gradient g = Σ J'r.

use crate::structure::{Place, Structure};
use crate::{ExactError, Problem, Values};
use sumprod_models::Expansion;

/// Storage for the normal equations, in the order of elimination.
#[derive(Default)]
pub(crate) struct Normal {
    /// The lower triangle's values.
    pub(crate) lower: Vec<f64>,
    pub(crate) gradient: Vec<f64>,
    pub(crate) cost: f64,
    /// The sum of the factors' largest log densities.
    pub(crate) log_peak: f64,
    question: Expansion,
    chained: Vec<f64>,
}

impl Normal {
    /// Linearises all factors at these values, in order.
    pub(crate) fn fill(
        &mut self,
        problem: &Problem<'_>,
        structure: &Structure,
        values: &Values,
    ) -> Result<(), ExactError> {
        self.lower.clear();
        self.lower.resize(structure.row_index.len(), 0.0);
        self.gradient.clear();
        self.gradient.resize(structure.size(), 0.0);
        (self.cost, self.log_peak) = (0.0, 0.0);
        for factor in 0..problem.factor_count() {
            problem.expand(factor, &values.numbers, true, &mut self.question, &mut self.chained)?;
            self.cost += self.question.loss;
            self.log_peak += self.question.log_peak;
            let range =
                structure.place_pointer[factor] as usize..structure.place_pointer[factor + 1] as usize;
            self.add(problem, structure, problem.ports(factor), &structure.places[range]);
        }
        if self.gradient.iter().all(|g| g.is_finite()) {
            return Ok(());
        }
        Err(self.culprit(problem, values))
    }

    fn add(&mut self, problem: &Problem<'_>, structure: &Structure, ports: &[u32], places: &[Place]) {
        let Expansion { residual, jacobian, .. } = &self.question;
        let wide = jacobian.len() / residual.len().max(1);
        if wide == 0 {
            return;
        }
        let mut next = places.iter();
        let mut column = 0;
        for (p, &variable) in ports.iter().enumerate() {
            let d = problem.layout().freedoms(variable as usize).len();
            let first = structure.first[variable as usize] as usize;
            let gradient = &mut self.gradient[first..][..d];
            for (row, r) in jacobian.chunks_exact(wide).zip(residual) {
                gradient.iter_mut().zip(&row[column..]).for_each(|(g, j)| *g += j * r);
            }
            let mut other_column = 0;
            for (&other, place) in ports[..=p].iter().zip(&mut next) {
                let e = problem.layout().freedoms(other as usize).len();
                let block = Block { jacobian, wide, rows: (column, d), columns: (other_column, e) };
                if other == variable && other_column != column {
                    // One variable at two ports: the block and its transpose both lie on the diagonal.
                    block.add_diagonal(place, &mut self.lower);
                    block.transposed().add_diagonal(place, &mut self.lower);
                } else if other_column == column {
                    block.add_diagonal(place, &mut self.lower);
                } else if place.first_is_row {
                    block.add(place, &mut self.lower);
                } else {
                    block.transposed().add(place, &mut self.lower);
                }
                other_column += e;
            }
            column += d;
        }
    }

    /// The factor whose derivative is not finite.
    fn culprit(&mut self, problem: &Problem<'_>, values: &Values) -> ExactError {
        let remedy = "start its variables where the residual is smooth";
        for factor in 0..problem.factor_count() {
            if let Err(error) =
                problem.expand(factor, &values.numbers, true, &mut self.question, &mut self.chained)
            {
                return error;
            }
            let Expansion { residual, jacobian, .. } = &self.question;
            if let Some(&value) = residual.iter().chain(jacobian).find(|x| !x.is_finite()) {
                let what = format!("a derivative of factor {:?}", problem.factor_name(factor));
                return ExactError::NotFinite { what, value, remedy };
            }
        }
        ExactError::NotFinite { what: "the gradient of the cost".into(), value: f64::INFINITY, remedy }
    }
}

/// The product of two ports' columns of a Jacobian.
#[derive(Clone, Copy)]
struct Block<'a> {
    jacobian: &'a [f64],
    wide: usize,
    /// First column and number of columns.
    rows: (usize, usize),
    columns: (usize, usize),
}

impl Block<'_> {
    fn transposed(self) -> Self {
        Self { rows: self.columns, columns: self.rows, ..self }
    }

    #[inline]
    fn add(self, place: &Place, lower: &mut [f64]) {
        match self.rows.1 {
            1 => self.add_rows::<1>(place, lower),
            2 => self.add_rows::<2>(place, lower),
            3 => self.add_rows::<3>(place, lower),
            4 => self.add_rows::<4>(place, lower),
            6 => self.add_rows::<6>(place, lower),
            _ => self.add_any(place, lower, false),
        }
    }

    #[inline]
    fn add_rows<const D: usize>(self, place: &Place, lower: &mut [f64]) {
        let mut start = place.base as usize;
        for c in 0..self.columns.1 {
            let mut sum = [0.0; D];
            for row in self.jacobian.chunks_exact(self.wide) {
                let weight = row[self.columns.0 + c];
                for (sum, entry) in sum.iter_mut().zip(&row[self.rows.0..][..D]) {
                    *sum += weight * entry;
                }
            }
            for (out, sum) in lower[start..][..D].iter_mut().zip(sum) {
                *out += sum;
            }
            start += place.stride as usize - c;
        }
    }

    /// The lower triangle alone.
    #[inline]
    fn add_diagonal(self, place: &Place, lower: &mut [f64]) {
        match self.rows.1 {
            2 => self.add_triangle::<2>(place, lower),
            3 => self.add_triangle::<3>(place, lower),
            6 => self.add_triangle::<6>(place, lower),
            _ => self.add_any(place, lower, true),
        }
    }

    #[inline]
    fn add_triangle<const D: usize>(self, place: &Place, lower: &mut [f64]) {
        let mut start = place.base as usize;
        for c in 0..D {
            let mut sum = [0.0; D];
            for row in self.jacobian.chunks_exact(self.wide) {
                let weight = row[self.columns.0 + c];
                for (sum, entry) in sum.iter_mut().zip(&row[self.rows.0..][..D]) {
                    *sum += weight * entry;
                }
            }
            for (out, sum) in lower[start + c..][..D - c].iter_mut().zip(&sum[c..]) {
                *out += sum;
            }
            start += place.stride as usize - c;
        }
    }

    fn add_any(self, place: &Place, lower: &mut [f64], triangle: bool) {
        let mut start = place.base as usize;
        for c in 0..self.columns.1 {
            for r in if triangle { c } else { 0 }..self.rows.1 {
                let rows = self.jacobian.chunks_exact(self.wide);
                let sum: f64 = rows.map(|row| row[self.columns.0 + c] * row[self.rows.0 + r]).sum();
                lower[start + r] += sum;
            }
            start += place.stride as usize - c;
        }
    }
}
