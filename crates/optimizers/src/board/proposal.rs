//! Gaussian sums over the sub-swarms: the board's prior, and the proposal that a search shapes.

use std::ops::Range;

use rand::RngExt;
use sumprod_graph::{FastStream, Purpose, Space, Stream};
use sumprod_messages::{Evaluator, Mixture};

use super::chart::Chart;
use crate::error::OptimizerError;
use crate::target::PriorDensity;

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

    /// Equal parts of those `fits` that hold something, widened; nothing where none does.
    pub fn shaped(fits: [Self; 2]) -> Option<Self> {
        let whole: Vec<Self> = fits.into_iter().filter(|fit| !fit.log_weights.is_empty()).collect();
        let part = 1.0 / whole.len() as f64;
        let add = |sum: Option<Self>, fit: Self| {
            let sum = sum.unwrap_or_else(|| Self::none(fit.dimension));
            Some(sum.and(fit.widened(WIDENING), part))
        };
        whole.into_iter().fold(None, add)
    }

    /// `share` of these and the rest of what is `shaped`.
    pub fn defended(self, shaped: Self, share: f64) -> Self {
        Self::none(self.dimension).and(self, share).and(shaped, 1.0 - share)
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

/// What the particles are drawn from: the prior itself where its density is known, and a sum of Gaussians.
pub(super) struct Proposal<'a> {
    prior: Option<&'a dyn PriorDensity>,
    /// How many are drawn from the prior.
    defence: usize,
    gaussians: Option<Mixture>,
    count: usize,
}

impl<'a> Proposal<'a> {
    /// For `count` particles: `share` of the prior, or of the `sum` that stands for it, and the rest of what is
    /// `shaped`.
    pub fn new(
        prior: Option<&'a dyn PriorDensity>,
        sum: &Components,
        shaped: Option<Components>,
        share: f64,
        count: usize,
    ) -> Result<Self, OptimizerError> {
        let (defence, gaussians) = match (prior, shaped) {
            (Some(_), None) => (count, None),
            (Some(_), Some(shaped)) => {
                let defence = ((share * count as f64).round() as usize).clamp(1, count);
                (defence, (defence < count).then_some(shaped))
            }
            (None, None) => (0, Some(sum.clone())),
            (None, Some(shaped)) => (0, Some(sum.clone().defended(shaped, share))),
        };
        let gaussians = gaussians.map(|sum| sum.mixture()).transpose()?;
        Ok(Self { prior, defence, gaussians, count })
    }

    /// The particles. Each Gaussian has its share to within one point.
    pub fn draw(&self, chart: &Chart, random: &mut FastStream) -> Result<Vec<f64>, OptimizerError> {
        let mut points = match self.prior {
            Some(prior) => prior.draw(self.defence, random)?,
            None => Vec::new(),
        };
        if let Some(gaussians) = &self.gaussians {
            points.extend(chart.places(&draw(gaussians, self.count - self.defence, random)?));
        }
        Ok(points)
    }

    /// Writes the log density at standard coordinates, given that of the prior there.
    pub fn log_densities(
        &self,
        standard: &[f64],
        log_prior: &[f64],
        values: &mut [f64],
    ) -> Result<(), OptimizerError> {
        let Some(gaussians) = &self.gaussians else {
            values.copy_from_slice(log_prior);
            return Ok(());
        };
        Evaluator::new(gaussians).log_densities(standard, values)?;
        if self.defence > 0 {
            let share = self.defence as f64 / self.count as f64;
            for (value, prior) in values.iter_mut().zip(log_prior) {
                *value = log_sum(*value + (-share).ln_1p(), prior + share.ln());
            }
        }
        Ok(())
    }
}

/// `count` points of a sum, of which each component has its share to within one point.
pub(super) fn draw(sum: &Mixture, count: usize, random: &mut FastStream) -> Result<Vec<f64>, OptimizerError> {
    let mut stream = Stream::new(random.random(), 0, Purpose::Optimizer, 0);
    Ok(sum.sample_systematic(count, &mut stream)?.points().to_vec())
}

/// ln(eᵃ + eᵇ).
fn log_sum(a: f64, b: f64) -> f64 {
    let (small, large) = if a < b { (a, b) } else { (b, a) };
    if large == f64::NEG_INFINITY { large } else { large + (small - large).exp().ln_1p() }
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
        let shaped = Components::shaped([sum(5.0), nothing.clone()]).unwrap();
        let mixture = sum(0.0).defended(shaped, 0.25).mixture().unwrap();
        let weights = mixture.weights();
        assert!((weights[0] - 0.25).abs() < 1e-12 && (weights[1] - 0.75).abs() < 1e-12);
        assert!((mixture.covariance_of(1)[0] / mixture.covariance_of(0)[0] - WIDENING).abs() < 1e-9);
        assert!(Components::shaped([nothing.clone(), nothing]).is_none());
    }
}
