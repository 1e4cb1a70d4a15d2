//! Gaussian sums over the sub-swarms: the board's prior, and the proposal that a search shapes.

use std::ops::Range;

use rand::RngExt;
use sumprod_graph::{FastStream, Purpose, Space, Stream};
use sumprod_messages::Mixture;

use crate::error::OptimizerError;

/// Variance that every component has at least, in standard coordinates: it keeps a sub-swarm of one point apart
/// from a singular matrix.
const LEAST_VARIANCE: f64 = 1e-8;

/// Factor of the fitted Gaussians' covariances in the proposal: 1.5 times their width.
const WIDENING: f64 = 2.25;

/// Components below this share of the whole are left out.
const NEGLIGIBLE: f64 = 1e-12;

/// The components of a sum of Gaussians in standard coordinates.
#[derive(Clone)]
pub(super) struct Components {
    dimension: usize,
    log_weights: Vec<f64>,
    means: Vec<f64>,
    covariances: Vec<f64>,
}

impl Components {
    /// One Gaussian a range, with the weight, mean and covariance of its weighted points; none where all weights
    /// are zero.
    pub fn weighted(points: &[f64], log_weights: &[f64], ranges: &[Range<usize>], dimension: usize) -> Self {
        let weights = exponentials(log_weights);
        let total: f64 = weights.iter().sum();
        let mut sum = Self::none(dimension);
        for range in ranges {
            let share: f64 = weights[range.clone()].iter().sum();
            if share <= NEGLIGIBLE * total {
                continue;
            }
            let members = points[range.start * dimension..range.end * dimension].chunks_exact(dimension);
            sum.add(share / total, members.zip(&weights[range.clone()]), share);
        }
        sum
    }

    fn none(dimension: usize) -> Self {
        Self { dimension, log_weights: Vec::new(), means: Vec::new(), covariances: Vec::new() }
    }

    fn add<'a>(
        &mut self,
        weight: f64,
        members: impl Iterator<Item = (&'a [f64], &'a f64)> + Clone,
        share: f64,
    ) {
        let d = self.dimension;
        let mut mean = vec![0.0; d];
        for (row, weight) in members.clone() {
            mean.iter_mut().zip(row).for_each(|(mean, x)| *mean += weight / share * x);
        }
        let mut covariance = vec![0.0; d * d];
        for (row, weight) in members {
            for a in 0..d {
                for b in 0..d {
                    covariance[a * d + b] += weight / share * (row[a] - mean[a]) * (row[b] - mean[b]);
                }
            }
        }
        covariance.iter_mut().step_by(d + 1).for_each(|variance| *variance += LEAST_VARIANCE);
        self.log_weights.push(weight.ln());
        self.means.append(&mut mean);
        self.covariances.append(&mut covariance);
    }

    /// The same with covariances `factor` times as large.
    pub fn widened(mut self, factor: f64) -> Self {
        self.covariances.iter_mut().for_each(|entry| *entry *= factor);
        self
    }

    /// `share` of these and equal parts of those `fits` that hold something, widened; these alone where none does.
    pub fn defended(self, fits: [Self; 2], share: f64) -> Self {
        let whole: Vec<Self> = fits.into_iter().filter(|fit| !fit.log_weights.is_empty()).collect();
        if whole.is_empty() || share == 1.0 {
            return self;
        }
        let rest = (1.0 - share) / whole.len() as f64;
        let start = Self::none(self.dimension).and(self, share);
        whole.into_iter().fold(start, |sum, fit| sum.and(fit.widened(WIDENING), rest))
    }

    fn and(mut self, other: Self, share: f64) -> Self {
        self.log_weights.extend(other.log_weights.iter().map(|log| log + share.ln()));
        self.means.extend(other.means);
        self.covariances.extend(other.covariances);
        self
    }

    /// The sum as a density.
    pub fn mixture(&self) -> Result<Mixture, OptimizerError> {
        let parts = (self.log_weights.clone(), self.means.clone(), self.covariances.clone());
        Ok(Mixture::new(&Space::real(self.dimension), parts.0, parts.1, parts.2)?)
    }
}

/// `count` points of a sum, of which each component has its share to within one point.
pub(super) fn draw(sum: &Mixture, count: usize, random: &mut FastStream) -> Result<Vec<f64>, OptimizerError> {
    let mut stream = Stream::new(random.random(), 0, Purpose::Optimizer, 0);
    Ok(sum.sample_systematic(count, &mut stream)?.points().to_vec())
}

/// Exponentials of log values over the largest; all zero where none is finite.
pub(super) fn exponentials(logs: &[f64]) -> Vec<f64> {
    let largest = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    if !largest.is_finite() {
        return vec![0.0; logs.len()];
    }
    logs.iter().map(|log| (log - largest).exp()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One Gaussian of all points.
    fn one(points: &[f64], logs: &[f64], dimension: usize) -> Components {
        Components::weighted(points, logs, std::slice::from_ref(&(0..logs.len())), dimension)
    }

    #[test]
    fn a_sum_over_sub_swarms_keeps_mean_and_covariance() {
        let points: Vec<f64> = (0..24).map(|k| f64::from((7 * k) % 24).sqrt()).collect();
        let logs: Vec<f64> = (0..12).map(|k| -0.1 * f64::from(k)).collect();
        let whole = one(&points, &logs, 2).mixture().unwrap().moments();
        let cut = Components::weighted(&points, &logs, &[0..4, 4..8, 8..12], 2).mixture().unwrap().moments();
        for (a, b) in whole.mean.iter().chain(&whole.covariance).zip(cut.mean.iter().chain(&cut.covariance)) {
            assert!((a - b).abs() < 1e-9, "{a} {b}");
        }
    }

    #[test]
    fn shares_add_up_and_what_holds_nothing_is_left_out() {
        let sum = |x: f64| one(&[x, x + 1.0], &[0.0; 2], 1);
        let nothing = one(&[0.0, 1.0], &[f64::NEG_INFINITY; 2], 1);
        let mixture = sum(0.0).defended([sum(5.0), nothing.clone()], 0.25).mixture().unwrap();
        let weights = mixture.weights();
        assert!((weights[0] - 0.25).abs() < 1e-12 && (weights[1] - 0.75).abs() < 1e-12);
        assert!((mixture.covariance_of(1)[0] / mixture.covariance_of(0)[0] - WIDENING).abs() < 1e-9);
        assert_eq!(sum(0.0).defended([nothing.clone(), nothing], 0.25).mixture().unwrap().len(), 1);
    }
}
