//! Functions on the cells of a lattice in the plane.

use nalgebra::{Matrix2, Vector2};
use serde::{Deserialize, Serialize};
use smallvec::SmallVec;
use std::sync::Arc;
use sumprod_graph::MessageError;

/// A cell by column (east) and row (north): [i, j] covers i·h to (i + 1)·h by j·h to (j + 1)·h, h the width.
pub type Cell = [i32; 2];

/// Logarithms of a positive function that is constant on each of some cells and has one value everywhere else.
///
/// Its cells are a support that a variable's messages share; sharing costs a count, not a copy.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
pub struct Lattice {
    width: f64,
    /// Ascending by column, then row.
    cells: Arc<[Cell]>,
    pub(super) log_values: Vec<f64>,
    pub(super) outside: f64,
}

impl Clone for Lattice {
    fn clone(&self) -> Self {
        Self {
            width: self.width,
            cells: self.cells.clone(),
            log_values: self.log_values.clone(),
            outside: self.outside,
        }
    }

    fn clone_from(&mut self, source: &Self) {
        self.width = source.width;
        self.cells.clone_from(&source.cells);
        self.log_values.clone_from(&source.log_values);
        self.outside = source.outside;
    }
}

impl Lattice {
    /// The function of these log values on `cells` of this width (m), and of the log value `outside` elsewhere.
    ///
    /// # Errors
    ///
    /// Where there is no cell, the cells are not ascending, a number is not finite, or the lengths differ.
    pub fn new(
        width: f64,
        cells: Arc<[Cell]>,
        log_values: Vec<f64>,
        outside: f64,
    ) -> Result<Self, MessageError> {
        if cells.len() != log_values.len() {
            let (found, expected) = (log_values.len(), cells.len());
            return Err(MessageError::Dimension { what: "the list of log values", found, expected });
        }
        if cells.is_empty() || !cells.windows(2).all(|pair| pair[0] < pair[1]) {
            let reason = "a lattice needs at least one cell, all in ascending order and none twice";
            return Err(MessageError::Unsupported(reason.into()));
        }
        if !(width.is_finite() && width > 0.0) {
            return Err(MessageError::NotFinite {
                what: "the reciprocal of the cells' width",
                value: 1.0 / width,
            });
        }
        if let Some(&value) = log_values.iter().chain([&outside]).find(|value| !value.is_finite()) {
            return Err(MessageError::NotFinite { what: "a log value of the lattice", value });
        }
        Ok(Self { width, cells, log_values, outside })
    }

    /// One on the given cells and in all other places; storage for [`Lattice::fill`].
    pub(super) fn empty() -> Self {
        Self { width: 1.0, cells: Arc::from([]), log_values: Vec::new(), outside: 0.0 }
    }

    /// Becomes the function that `log_value` gives for each of `cells` (ascending, at least one) and `outside`
    /// elsewhere, scaled such that its largest value is one. Storage is reused.
    ///
    /// # Errors
    ///
    /// Where a log value is not finite.
    pub fn fill(
        &mut self,
        width: f64,
        cells: &Arc<[Cell]>,
        outside: f64,
        mut log_value: impl FnMut(Cell) -> f64,
    ) -> Result<(), MessageError> {
        self.width = width;
        self.cells.clone_from(cells);
        self.log_values.clear();
        self.log_values.extend(cells.iter().map(|&cell| log_value(cell)));
        self.outside = outside;
        self.scale()
    }

    /// Subtracts the largest log value from all.
    pub(super) fn scale(&mut self) -> Result<(), MessageError> {
        let mut largest = f64::NEG_INFINITY;
        let mut sum = 0.0;
        for &value in &self.log_values {
            largest = if value > largest { value } else { largest };
            sum += value;
        }
        if !sum.is_finite() {
            return Err(MessageError::NotFinite { what: "the sum of the lattice's log values", value: sum });
        }
        self.log_values.iter_mut().for_each(|value| *value -= largest);
        self.outside -= largest;
        Ok(())
    }

    /// Width of a cell (m).
    pub fn width(&self) -> f64 {
        self.width
    }

    /// The cells, ascending.
    pub fn cells(&self) -> &Arc<[Cell]> {
        &self.cells
    }

    /// Log values, one a cell.
    pub fn log_values(&self) -> &[f64] {
        &self.log_values
    }

    /// Log value in all places without a cell.
    pub fn outside(&self) -> f64 {
        self.outside
    }

    /// The middle of a cell (m).
    pub fn centre(&self, cell: Cell) -> [f64; 2] {
        cell.map(|index| (f64::from(index) + 0.5) * self.width)
    }

    /// The middle of the first of the cells with the largest log value (m).
    pub fn heaviest(&self) -> [f64; 2] {
        let mut best = 0;
        for (place, &value) in self.log_values.iter().enumerate() {
            if value > self.log_values[best] {
                best = place;
            }
        }
        self.cells.get(best).map_or([0.0; 2], |&cell| self.centre(cell))
    }

    /// Log value at a point (m); by bisection.
    pub fn log_at(&self, point: [f64; 2]) -> f64 {
        let cell = point.map(|x| (x / self.width).floor() as i32);
        self.cells.binary_search(&cell).map_or(self.outside, |place| self.log_values[place])
    }

    /// Whether both are given on the same cells.
    pub(super) fn shares_support(&self, other: &Self) -> bool {
        self.width == other.width && (Arc::ptr_eq(&self.cells, &other.cells) || self.cells == other.cells)
    }

    /// Calls `visit` with each cell's place and the log value of `other` in its middle; linear where the widths agree.
    pub(super) fn each_of(cells: &[Cell], width: f64, other: &Self, mut visit: impl FnMut(usize, f64)) {
        if width != other.width {
            for (place, cell) in cells.iter().enumerate() {
                visit(place, other.log_at(cell.map(|index| (f64::from(index) + 0.5) * width)));
            }
            return;
        }
        let mut ahead = 0;
        for (place, cell) in cells.iter().enumerate() {
            while other.cells.get(ahead).is_some_and(|next| next < cell) {
                ahead += 1;
            }
            let found = other.cells.get(ahead) == Some(cell);
            visit(place, if found { other.log_values[ahead] } else { other.outside });
        }
    }

    /// This support in cells of another width: those whose middle a cell of this support holds, or that hold the
    /// middle of one.
    pub fn support_at(&self, width: f64) -> Arc<[Cell]> {
        if width == self.width {
            return self.cells.clone();
        }
        let mut cells: Vec<Cell> = Vec::with_capacity(self.cells.len());
        let parts = (self.width / width).round() as i32;
        for &cell in self.cells.iter() {
            if parts > 1 {
                let first = cell.map(|index| index.saturating_mul(parts));
                let pairs = (0..parts).flat_map(|i| (0..parts).map(move |j| [i, j]));
                cells.extend(pairs.map(|[i, j]| [first[0].saturating_add(i), first[1].saturating_add(j)]));
            } else {
                cells.push(self.centre(cell).map(|x| (x / width).floor() as i32));
            }
        }
        cells.sort_unstable();
        cells.dedup();
        cells.into()
    }

    /// Keeps the cells whose log value is at least `least`, and of these at most the `most` highest.
    pub(super) fn prune(&mut self, least: f64, most: usize) {
        let mut least = least;
        let kept = self.log_values.iter().filter(|&&value| value >= least).count();
        if kept > most.max(1) {
            let mut values: SmallVec<[f64; 1024]> = SmallVec::from_slice(&self.log_values);
            let (_, &mut limit, _) = values.select_nth_unstable_by(most.max(1) - 1, |a, b| b.total_cmp(a));
            least = limit;
        } else if kept == self.cells.len() {
            return;
        }
        let values = &self.log_values;
        self.cells = self
            .cells
            .iter()
            .zip(values)
            .filter(|&(_, &value)| value >= least)
            .map(|(&cell, _)| cell)
            .collect();
        self.log_values.retain(|&value| value >= least);
    }

    /// Writes the cells' normalised weights; returns the log of what they were divided by.
    pub fn weights_into(&self, weights: &mut impl Extend<f64>) -> f64 {
        let largest = self.log_values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let total: f64 = self.log_values.iter().map(|value| (value - largest).exp()).sum();
        let scale = 1.0 / total;
        weights.extend(self.log_values.iter().map(|value| (value - largest).exp() * scale));
        largest + total.ln()
    }

    /// Mean and covariance of the density proportional to this function on its cells; each cell is uniform.
    pub fn moments(&self) -> (Vector2<f64>, Matrix2<f64>) {
        let mut weights: SmallVec<[f64; 256]> = SmallVec::new();
        self.weights_into(&mut weights);
        let mut mean = Vector2::zeros();
        for (&cell, &weight) in self.cells.iter().zip(&weights) {
            mean += Vector2::from(self.centre(cell)) * weight;
        }
        let mut covariance = Matrix2::identity() * (self.width * self.width / 12.0);
        for (&cell, &weight) in self.cells.iter().zip(&weights) {
            let offset = Vector2::from(self.centre(cell)) - mean;
            covariance += offset * offset.transpose() * weight;
        }
        (mean, covariance)
    }

    /// The effective number of cells, 1 / Σ w².
    pub fn effective_cells(&self) -> f64 {
        let mut weights: SmallVec<[f64; 256]> = SmallVec::new();
        self.weights_into(&mut weights);
        1.0 / weights.iter().map(|weight| weight * weight).sum::<f64>()
    }

    /// Divergence (nats) of the density on the cells to the Gaussian of its moments: ½ ln |2πe P| - H.
    pub(super) fn divergence_to_gaussian(&self, covariance: &Matrix2<f64>) -> f64 {
        let mut weights: SmallVec<[f64; 256]> = SmallVec::new();
        self.weights_into(&mut weights);
        let area = self.width * self.width;
        let entropy: f64 =
            -weights.iter().filter(|&&w| w > 0.0).map(|weight| weight * (weight / area).ln()).sum::<f64>();
        let gaussian = (std::f64::consts::TAU * std::f64::consts::E) * covariance.determinant().sqrt();
        (gaussian.ln() - entropy).max(0.0)
    }
}
