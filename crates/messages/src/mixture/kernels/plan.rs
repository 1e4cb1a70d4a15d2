//! The inner loops: exponents of one block, one component per vector lane.

#![allow(
    clippy::needless_range_loop,
    reason = "rows and columns of small matrices are named by their indices"
)]

use super::super::small::{Small, whitener};
use super::{BLOCK, Block, Kernels, NOTHING, Query};
use crate::vector::{greater, ln, round};
use smallvec::SmallVec;
use std::f64::consts::{PI, TAU};

/// A question made ready: what is computed once for all components.
pub(super) struct Plan<'a> {
    mean: &'a [f64],
    covariance: &'a [f64],
    cold: f64,
    /// Whitens a shared covariance plus the Gaussian's; empty where each component has its own.
    whitener: Small,
    /// What all log shares have in common.
    pub(super) constant: f64,
    /// Half the log determinant of the Gaussian's own covariance, minus infinity where it is zero.
    half_log_determinant: f64,
    row_sum: Small,
}

impl<'a> Plan<'a> {
    pub(super) fn new(kernels: &Kernels, query: Query<'a>) -> Option<Self> {
        let d = kernels.dimension;
        let mut constant = -0.5 * d as f64 * (TAU * query.heat).ln();
        let mut whitening = Small::new();
        let mut half_log_determinant = f64::NEG_INFINITY;
        if kernels.shared.is_empty() {
            if query.covariance.iter().any(|&entry| entry != 0.0) {
                half_log_determinant = 0.5 * whitener(query.covariance, d)?.1;
            }
        } else {
            let total: Small = kernels.shared.iter().zip(query.covariance).map(|(a, b)| a + b).collect();
            let (matrix, log_determinant) = whitener(&total, d)?;
            whitening = matrix;
            constant -= 0.5 * log_determinant;
        }
        let row_sum = query.covariance.chunks_exact(d).map(|row| row.iter().map(|x| x.abs()).sum()).collect();
        Some(Self {
            mean: query.mean,
            covariance: query.covariance,
            cold: 1.0 / query.heat,
            whitener: whitening,
            constant,
            half_log_determinant,
            row_sum,
        })
    }

    /// No component of the block has a larger exponent than this.
    #[inline(always)]
    pub(super) fn bound(&self, kernels: &Kernels, block: &Block) -> f64 {
        let d = kernels.dimension;
        let (mut squared, mut farthest, mut widest) = (0.0, 0.0, 0.0);
        for k in 0..d {
            let mut offset = (self.mean[k] - block.centre[k]).abs();
            if kernels.turns[k] > 0.0 && offset > PI {
                offset = (offset - TAU * (offset / TAU).round()).abs();
            }
            let distance = (offset - block.half[k]).max(0.0);
            squared += distance * distance;
            farthest =
                greater(distance * distance / (self.covariance[k * d + k] + block.variance[k]), farthest);
            widest = greater(self.row_sum[k] + block.row_sum[k], widest);
        }
        let peak = if self.half_log_determinant > f64::NEG_INFINITY {
            block.peak.min(block.weight - self.half_log_determinant)
        } else {
            block.peak
        };
        peak - 0.5 * self.cold * greater(farthest, squared / widest)
    }

    /// Writes the exponents of one block and returns the largest.
    #[inline(always)]
    pub(super) fn block(&self, kernels: &Kernels, block: usize, exponents: &mut [f64]) -> f64 {
        let start = block * BLOCK;
        let Some(out) = exponents[start..].first_chunk_mut::<BLOCK>() else { return NOTHING };
        let shared = !kernels.shared.is_empty();
        match (kernels.dimension, shared, kernels.angles) {
            (1, true, false) => self.shared_block::<1, false>(kernels, start, out),
            (2, true, false) => self.shared_block::<2, false>(kernels, start, out),
            (3, true, false) => self.shared_block::<3, false>(kernels, start, out),
            (1, true, true) => self.shared_block::<1, true>(kernels, start, out),
            (2, true, true) => self.shared_block::<2, true>(kernels, start, out),
            (3, true, true) => self.shared_block::<3, true>(kernels, start, out),
            (_, true, _) => self.shared_block_of_any_dimension(kernels, start, out),
            (1, false, _) => self.own_block::<1>(kernels, start, out),
            (2, false, _) => self.own_block::<2>(kernels, start, out),
            (3, false, _) => self.own_block::<3>(kernels, start, out),
            (_, false, _) => self.own_block_of_any_dimension(kernels, start, out),
        }
        let mut largest = [NOTHING; 8];
        for lanes in out.chunks_exact(8) {
            for lane in 0..8 {
                largest[lane] = greater(lanes[lane], largest[lane]);
            }
        }
        largest.iter().fold(NOTHING, |a, &b| greater(a, b))
    }

    #[inline(always)]
    fn shared_block<const D: usize, const ANGLES: bool>(
        &self,
        kernels: &Kernels,
        start: usize,
        out: &mut [f64; BLOCK],
    ) {
        let Some((columns, log_weights)) = columns::<D>(kernels, &kernels.means, start) else { return };
        let (mut mean, mut turns, mut inverse) = ([0.0; D], [0.0; D], [0.0; D]);
        let mut matrix = [[0.0; D]; D];
        for row in 0..D {
            mean[row] = self.mean[row];
            turns[row] = kernels.turns[row];
            inverse[row] = kernels.inverse_turns[row];
            for column in 0..=row {
                matrix[row][column] = self.whitener[row * D + column];
            }
        }
        let half = 0.5 * self.cold;
        for i in 0..BLOCK {
            let mut offset = [0.0; D];
            for k in 0..D {
                offset[k] = mean[k] - columns[k][i];
                if ANGLES {
                    offset[k] = turned(offset[k], turns[k], inverse[k]);
                }
            }
            let mut squared = 0.0;
            for row in 0..D {
                let mut white = 0.0;
                for column in 0..=row {
                    white += matrix[row][column] * offset[column];
                }
                squared += white * white;
            }
            out[i] = log_weights[i] - half * squared;
        }
    }

    #[inline(always)]
    fn shared_block_of_any_dimension(&self, kernels: &Kernels, start: usize, out: &mut [f64; BLOCK]) {
        let d = kernels.dimension;
        let mut squared = [0.0; BLOCK];
        for row in 0..d {
            let mut white = [0.0; BLOCK];
            for column in 0..=row {
                let means = &kernels.means[column * kernels.stride + start..][..BLOCK];
                let factor = self.whitener[row * d + column];
                let (turn, inverse) = (kernels.turns[column], kernels.inverse_turns[column]);
                for (white, mean) in white.iter_mut().zip(means) {
                    *white += factor * turned(self.mean[column] - mean, turn, inverse);
                }
            }
            for (squared, white) in squared.iter_mut().zip(&white) {
                *squared += white * white;
            }
        }
        for ((out, log_weight), squared) in out.iter_mut().zip(&kernels.log_weights[start..]).zip(&squared) {
            *out = log_weight - 0.5 * self.cold * squared;
        }
    }

    /// Each component with its own covariance, by its factors L D L'.
    #[inline(always)]
    fn own_block<const D: usize>(&self, kernels: &Kernels, start: usize, out: &mut [f64; BLOCK]) {
        let Some((columns, log_weights)) = columns::<D>(kernels, &kernels.means, start) else { return };
        let mut entries = [[log_weights; D]; D];
        for (row, entries) in entries.iter_mut().enumerate() {
            for (column, entry) in entries.iter_mut().enumerate().take(row + 1) {
                let stretch = (row * (row + 1) / 2 + column) * kernels.stride;
                let Some(values) = kernels.covariances[stretch + start..].first_chunk::<BLOCK>() else {
                    return;
                };
                *entry = values;
            }
        }
        let mut given = [[0.0; D]; D];
        let (mut mean, mut turns, mut inverse) = ([0.0; D], [0.0; D], [0.0; D]);
        for row in 0..D {
            mean[row] = self.mean[row];
            turns[row] = kernels.turns[row];
            inverse[row] = kernels.inverse_turns[row];
            for column in 0..=row {
                given[row][column] = self.covariance[row * D + column];
            }
        }
        let half = 0.5 * self.cold;
        for i in 0..BLOCK {
            let mut factor = [[0.0; D]; D];
            let mut pivots = [0.0; D];
            let mut offset = [0.0; D];
            let (mut squared, mut determinant) = (0.0, 1.0);
            for row in 0..D {
                let mut white = turned(mean[row] - columns[row][i], turns[row], inverse[row]);
                for column in 0..row {
                    // Holds L(row, column) × pivot(column) until it is divided.
                    let mut value = given[row][column] + entries[row][column][i];
                    for k in 0..column {
                        value -= factor[row][k] * factor[column][k] * pivots[k];
                    }
                    factor[row][column] = value / pivots[column];
                    white -= factor[row][column] * offset[column];
                }
                let mut pivot = given[row][row] + entries[row][row][i];
                for k in 0..row {
                    pivot -= factor[row][k] * factor[row][k] * pivots[k];
                }
                pivots[row] = pivot;
                offset[row] = white;
                squared += white * white / pivot;
                determinant *= pivot;
            }
            out[i] = log_weights[i] - half * squared - 0.5 * ln(determinant);
        }
    }

    #[inline(always)]
    fn own_block_of_any_dimension(&self, kernels: &Kernels, start: usize, out: &mut [f64; BLOCK]) {
        let d = kernels.dimension;
        let mut total: SmallVec<[f64; 36]> = SmallVec::from_elem(0.0, d * d);
        let mut offset: SmallVec<[f64; 6]> = SmallVec::from_elem(0.0, d);
        for (lane, out) in out.iter_mut().enumerate() {
            let i = start + lane;
            for row in 0..d {
                for column in 0..=row {
                    let entry = (row * (row + 1) / 2 + column) * kernels.stride + i;
                    total[row * d + column] = self.covariance[row * d + column] + kernels.covariances[entry];
                }
                let mean = kernels.means[row * kernels.stride + i];
                offset[row] = turned(self.mean[row] - mean, kernels.turns[row], kernels.inverse_turns[row]);
            }
            *out = match crate::Cholesky::new(&total, d, "a sum of covariances") {
                Ok(factor) => {
                    let squared = factor.squared_length(&mut offset);
                    kernels.log_weights[i] - 0.5 * (self.cold * squared + factor.log_determinant())
                }
                Err(_) => NOTHING,
            };
        }
    }
}

/// The block's means by coordinate, and its log weights.
type Columns<'a, const D: usize> = ([&'a [f64; BLOCK]; D], &'a [f64; BLOCK]);

#[inline(always)]
fn columns<'a, const D: usize>(
    kernels: &'a Kernels,
    values: &'a [f64],
    start: usize,
) -> Option<Columns<'a, D>> {
    let log_weights = kernels.log_weights[start..].first_chunk::<BLOCK>()?;
    let mut columns = [log_weights; D];
    for (k, column) in columns.iter_mut().enumerate() {
        *column = values[k * kernels.stride + start..].first_chunk::<BLOCK>()?;
    }
    Some((columns, log_weights))
}

#[inline(always)]
fn turned(offset: f64, turn: f64, inverse: f64) -> f64 {
    // A real coordinate has no turn to take off.
    offset - turn * round(offset * inverse)
}
