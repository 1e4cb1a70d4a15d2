//! Drawing points from a mixture.

use super::Mixture;
use super::small::{Small, root, wrap_point};
use crate::Particles;
use crate::vector::{each_stretch, sum_of_exponentials};
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use sumprod_graph::{FastStream, MessageError, Stream};

impl Mixture {
    /// `count` independent draws, of equal weights. O(N + M).
    ///
    /// # Errors
    ///
    /// Where `count` is zero.
    pub fn sample(&self, count: usize, stream: &mut Stream) -> Result<Particles, MessageError> {
        let mut random = stream.fast();
        let mut shares = self.cumulative();
        let total = shares.last().copied().unwrap_or(1.0);
        shares.iter_mut().for_each(|share| *share /= total);
        let mut labels: Vec<usize> = (0..count)
            .map(|_| {
                let uniform: f64 = random.random();
                shares.partition_point(|&share| share <= uniform).min(self.len() - 1)
            })
            .collect();
        labels.sort_unstable();
        Particles::equally_weighted(&self.space(), self.draw(&labels, &mut random))
    }

    /// `count` draws of equal weights whose components are chosen by a comb of equally spaced teeth, so that every
    /// component receives its share to within one draw: less noise than independent draws, never more. O(N + M).
    ///
    /// # Errors
    ///
    /// Where `count` is zero.
    pub fn sample_systematic(&self, count: usize, stream: &mut Stream) -> Result<Particles, MessageError> {
        let mut random = stream.fast();
        let labels = self.comb(count, &mut random);
        Particles::equally_weighted(&self.space(), self.draw(&labels, &mut random))
    }

    pub(super) fn cumulative(&self) -> Vec<f64> {
        let mut sums = self.weights();
        let mut sum = 0.0;
        sums.iter_mut().for_each(|value| {
            sum += *value;
            *value = sum;
        });
        sums
    }

    /// `count` component numbers in ascending order, by a comb with one random offset.
    pub(super) fn comb(&self, count: usize, random: &mut FastStream) -> Vec<usize> {
        let offset: f64 = random.random();
        let total = sum_of_exponentials(&self.log_weights, 0.0);
        let height = |tooth: usize| (tooth as f64 + offset) / count as f64 * total;
        let mut labels = Vec::with_capacity(count);
        let (mut sum, mut next) = (0.0, height(0));
        each_stretch(&self.log_weights, 0.0, |first, weights| {
            for (place, weight) in weights.iter().enumerate() {
                sum += weight;
                while sum > next && labels.len() < count {
                    labels.push(first + place);
                    next = height(labels.len());
                }
            }
            labels.len() < count
        });
        // Rounding may leave the last teeth beyond the sum.
        labels.resize(count, self.len().saturating_sub(1));
        labels
    }

    /// One point of each component numbered; components that repeat one after the other share their root.
    pub(super) fn draw(&self, labels: &[usize], random: &mut FastStream) -> Vec<f64> {
        let d = self.dimension();
        let mut points = Vec::with_capacity(labels.len() * d);
        let mut factor = Small::new();
        let mut current = usize::MAX;
        for &label in labels {
            let matrix = if self.shared { 0 } else { label };
            if matrix != current {
                factor = root(self.covariance_of(label), d).unwrap_or_else(|| Small::from_elem(0.0, d * d));
                current = matrix;
            }
            push_draw(self, self.mean_of(label), &factor, random, &mut points);
        }
        points
    }
}

/// Positions in a cumulative sum that `count` equally spaced teeth reach, the first `offset` of a space in.
pub(super) fn comb(cumulative: &[f64], count: usize, offset: f64) -> Vec<usize> {
    let total = cumulative.last().copied().unwrap_or(0.0);
    let last = cumulative.len().saturating_sub(1);
    let mut position = 0;
    (0..count)
        .map(|tooth| {
            let height = (tooth as f64 + offset) / count as f64 * total;
            while position < last && cumulative[position] <= height {
                position += 1;
            }
            position
        })
        .collect()
}

/// Appends mean + factor z, z standard normal, angles wrapped.
pub(super) fn push_draw(
    mixture: &Mixture,
    mean: &[f64],
    factor: &[f64],
    random: &mut FastStream,
    points: &mut Vec<f64>,
) {
    let d = mean.len();
    let start = points.len();
    points.extend_from_slice(mean);
    for column in 0..d {
        let z: f64 = StandardNormal.sample(random);
        for row in column..d {
            points[start + row] += factor[row * d + column] * z;
        }
    }
    wrap_point(&mixture.coordinates, &mut points[start..]);
}
