//! Coherent point drift: the displacements are a Gaussian process over the first tracks.
//!
//! v = G W with G_ij = exp(−|y_i − y_j|²/(2β²)) and the penalty λ/2 tr(WᵀGW): v ~ N(0, G/λ), in units of the sets' scale.
//! G ≈ L Lᵀ by pivoted Cholesky factors of rank r, exact to the share [`RESIDUAL`] of its trace or to the rank allowed;
//! then v = L a with a ~ N(0, I/λ), and (Lᵀ diag(p) L + λσ²/s² I) a = Lᵀ (P X − diag(p) Y) gives it. Smooth fields have
//! low rank whatever the number of tracks: O(M r²) an iteration, O(M r) memory.

use nalgebra::{Cholesky, DMatrix};

use super::em::Displacement;
use super::error::AssociationError;
use super::expectation::Pull;
use super::settings::positive;
use super::tracks::Tracks;

/// Share of the trace of G that its factors may lack.
const RESIDUAL: f64 = 1e-8;

/// Share of the trace of a system that its sums are rounded by.
const ROUNDING: f64 = 1e-15;

/// The smooth field of coherent point drift.
#[derive(Clone, Debug)]
pub struct CoherentDrift {
    length: f64,
    stiffness: f64,
    rank: usize,
    /// Columns of L, each of M entries.
    columns: Vec<Vec<f64>>,
    lacking: f64,
    /// λ/s².
    precision: f64,
    /// r·D, axis by axis.
    coefficients: Vec<f64>,
    /// The columns, each entry times the root of its track's weight.
    weighted: Vec<Vec<f64>>,
    /// Whole pull along one axis.
    axis: Vec<f64>,
}

impl CoherentDrift {
    /// A field with length β in units of the sets' root mean square coordinate, and stiffness λ.
    ///
    /// # Errors
    /// [`AssociationError::Parameter`] for values that are not positive and finite.
    pub fn new(length: f64, stiffness: f64) -> Result<Self, AssociationError> {
        positive("length", length)?;
        positive("stiffness", stiffness)?;
        Ok(Self {
            length,
            stiffness,
            rank: 200,
            columns: Vec::new(),
            lacking: 0.0,
            precision: 0.0,
            coefficients: Vec::new(),
            weighted: Vec::new(),
            axis: Vec::new(),
        })
    }

    /// Allows at most this rank, 200 at first. A field cut short is a stiffer one.
    ///
    /// # Errors
    /// [`AssociationError::Parameter`] for zero.
    pub fn with_rank(mut self, rank: usize) -> Result<Self, AssociationError> {
        if rank == 0 {
            return Err(AssociationError::parameter("rank", "is 0; at least 1 is needed"));
        }
        self.rank = rank;
        Ok(self)
    }

    /// Rank of the factors in use.
    pub fn rank(&self) -> usize {
        self.columns.len()
    }

    /// Share of the field's prior variance that the rank cuts off.
    pub fn lacking(&self) -> f64 {
        self.lacking
    }

    /// Pivoted Cholesky factors of G: each step takes the track that the factors explain least.
    fn factor(&mut self, tracks: &Tracks, scale: f64) {
        let rate = -0.5 / (self.length * scale).powi(2);
        let count = tracks.len();
        let mut left = vec![1.0; count];
        self.columns.clear();
        loop {
            let total: f64 = left.iter().sum();
            self.lacking = total / count.max(1) as f64;
            if self.columns.len() >= self.rank.min(count) || self.lacking <= RESIDUAL {
                return;
            }
            let worst = (0..count).fold(0, |best, m| if left[m] > left[best] { m } else { best });
            let pivot = left[worst].sqrt();
            let centre = &tracks.coordinates()[worst * tracks.width()..][..tracks.width()];
            let mut column: Vec<f64> = tracks
                .iter()
                .map(|track| (rate * super::candidates::squared_distance(track, centre)).exp())
                .collect();
            for known in &self.columns {
                let share = known[worst];
                column.iter_mut().zip(known).for_each(|(entry, known)| *entry -= share * known);
            }
            for (entry, left) in column.iter_mut().zip(&mut left) {
                *entry /= pivot;
                *left = (*left - *entry * *entry).max(0.0);
            }
            left[worst] = 0.0;
            self.columns.push(column);
        }
    }
}

impl Displacement for CoherentDrift {
    fn start(
        &mut self,
        first: &Tracks,
        scale: f64,
        _displacements: &mut [f64],
    ) -> Result<f64, AssociationError> {
        self.factor(first, scale);
        self.precision = self.stiffness / (scale * scale);
        self.coefficients = vec![0.0; self.columns.len() * first.width()];
        self.weighted = self.columns.clone();
        self.axis = vec![0.0; first.len()];
        Ok(1.0 / self.precision)
    }

    fn improve(
        &mut self,
        pull: &Pull,
        variance: f64,
        displacements: &mut [f64],
    ) -> Result<(), AssociationError> {
        let (count, rank) = (pull.weight.len(), self.columns.len());
        if rank == 0 {
            return Ok(());
        }
        let width = displacements.len() / count;
        for (weighted, column) in self.weighted.iter_mut().zip(&self.columns) {
            for ((weighted, entry), weight) in weighted.iter_mut().zip(column).zip(&pull.weight) {
                *weighted = entry * weight.sqrt();
            }
        }
        let mut normal = DMatrix::zeros(rank, rank);
        for (j, b) in self.weighted.iter().enumerate() {
            for (i, a) in self.weighted.iter().enumerate().take(j + 1) {
                let product = dot(a, b);
                normal[(i, j)] = product;
                normal[(j, i)] = product;
            }
        }
        // Rounding of the sums may take more than a weak prior gives.
        let prior = (self.precision * variance).max(ROUNDING * normal.trace());
        for k in 0..rank {
            normal[(k, k)] += prior;
        }
        // The force is about the old places; the coefficients are of the whole displacement.
        let mut right = DMatrix::zeros(rank, width);
        for i in 0..width {
            for (m, (whole, weight)) in self.axis.iter_mut().zip(&pull.weight).enumerate() {
                *whole = pull.force[m * width + i] + weight * displacements[m * width + i];
            }
            for (k, column) in self.columns.iter().enumerate() {
                right[(k, i)] = dot(column, &self.axis);
            }
        }
        let factors = Cholesky::new(normal).ok_or_else(|| AssociationError::Field {
            problem: format!(
                "its {rank} coefficients have a singular system at variance {variance}; raise the stiffness"
            ),
        })?;
        factors.solve_mut(&mut right);
        self.coefficients.copy_from_slice(right.as_slice());
        displacements.fill(0.0);
        for (k, column) in self.columns.iter().enumerate() {
            for i in 0..width {
                let coefficient = right[(k, i)];
                let moves = displacements.iter_mut().skip(i).step_by(width);
                moves.zip(column).for_each(|(displacement, entry)| *displacement += coefficient * entry);
            }
        }
        Ok(())
    }

    fn penalty(&self) -> f64 {
        0.5 * self.precision * self.coefficients.iter().map(|a| a * a).sum::<f64>()
    }
}

/// Σ a b, in four sums, so that the processor can add them at once.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut sums = [0.0; 4];
    let (heads, tails) = (a.chunks_exact(4), b.chunks_exact(4));
    let rest: f64 = heads.remainder().iter().zip(tails.remainder()).map(|(a, b)| a * b).sum();
    for (a, b) in heads.zip(tails) {
        for (sum, (a, b)) in sums.iter_mut().zip(a.iter().zip(b)) {
            *sum += a * b;
        }
    }
    sums.iter().sum::<f64>() + rest
}
