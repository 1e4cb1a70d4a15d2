//! Means and covariances of weighted clouds, summed block by block in a fixed order.

use rayon::prelude::*;
use sumprod_graph::{Coordinate, wrap_angle};
use sumprod_messages::{Moments, vector};
use sumprod_models::cloud::{BLOCK, Cloud};

use super::weights::Weights;

/// Σ wᵢ xᵢ over the shorter of the two.
#[inline]
pub(crate) fn dot(weights: &[f64], values: &[f64]) -> f64 {
    vector::widest(Dot { weights, values })
}

struct Dot<'a> {
    weights: &'a [f64],
    values: &'a [f64],
}

impl pulp::NullaryFnOnce for Dot<'_> {
    type Output = f64;

    #[inline(always)]
    fn call(self) -> f64 {
        let count = self.weights.len().min(self.values.len());
        let (weights, rest) = self.weights[..count].as_chunks::<8>();
        let (values, others) = self.values[..count].as_chunks::<8>();
        let mut sums = [0.0; 8];
        for (w, x) in weights.iter().zip(values) {
            for ((sum, w), x) in sums.iter_mut().zip(w).zip(x) {
                *sum += w * x;
            }
        }
        for ((sum, w), x) in sums.iter_mut().zip(rest).zip(others) {
            *sum += w * x;
        }
        sums.iter().sum()
    }
}

/// Sums over all blocks what `of` writes of each, one after the other in the order of the blocks; scaled.
fn over_blocks(
    cloud: &Cloud,
    weights: &Weights,
    length: usize,
    parallel: bool,
    of: impl Fn(&[f64], &[f64], &mut [f64]) + Sync,
) -> Vec<f64> {
    let one = |(index, block): (usize, &[f64])| {
        let (relative, scale) = weights.block(index);
        let mut sums = vec![0.0; length];
        of(relative, block, &mut sums);
        sums.iter_mut().for_each(|sum| *sum *= scale);
        sums
    };
    let per_block: Vec<Vec<f64>> = if parallel {
        let size = (BLOCK * cloud.dimension()).max(1);
        cloud.values().par_chunks(size).enumerate().map(one).collect()
    } else {
        cloud.blocks().enumerate().map(one).collect()
    };
    let mut total = vec![0.0; length];
    for sums in &per_block {
        total.iter_mut().zip(sums).for_each(|(total, sum)| *total += sum);
    }
    total
}

pub(crate) fn mean(cloud: &Cloud, weights: &Weights, coordinates: &[Coordinate], parallel: bool) -> Vec<f64> {
    let d = coordinates.len();
    let total = weights.total();
    // A real coordinate's sum, or an angle's cosine and sine.
    let sums = over_blocks(cloud, weights, 2 * d, parallel, |relative, block, sums| {
        for (k, kind) in coordinates.iter().enumerate() {
            let values = &block[k * BLOCK..][..relative.len()];
            match kind {
                Coordinate::Real => sums[2 * k] = dot(relative, values),
                Coordinate::Angle => {
                    for (weight, angle) in relative.iter().zip(values) {
                        sums[2 * k] += weight * angle.cos();
                        sums[2 * k + 1] += weight * angle.sin();
                    }
                }
            }
        }
    });
    let each = coordinates.iter().enumerate();
    each.map(|(k, kind)| match kind {
        Coordinate::Real => sums[2 * k] / total,
        Coordinate::Angle => sums[2 * k + 1].atan2(sums[2 * k]),
    })
    .collect()
}

pub(crate) fn moments(
    cloud: &Cloud,
    weights: &Weights,
    coordinates: &[Coordinate],
    parallel: bool,
) -> Moments {
    let mean = mean(cloud, weights, coordinates, parallel);
    let d = mean.len();
    let total = weights.total();
    let mut covariance = over_blocks(cloud, weights, d * d, parallel, |relative, block, sums| {
        let mut offset = vec![0.0; d];
        for (i, weight) in relative.iter().enumerate() {
            for (k, kind) in coordinates.iter().enumerate() {
                let difference = block[k * BLOCK + i] - mean[k];
                offset[k] = if *kind == Coordinate::Angle { wrap_angle(difference) } else { difference };
            }
            for row in 0..d {
                for column in 0..=row {
                    sums[row * d + column] += weight * offset[row] * offset[column];
                }
            }
        }
    });
    for row in 0..d {
        for column in 0..=row {
            covariance[row * d + column] /= total;
            covariance[column * d + row] = covariance[row * d + column];
        }
    }
    Moments { mean, covariance }
}

/// The first coordinate that is not finite; NaN where all are.
pub(crate) fn not_finite(cloud: &Cloud) -> f64 {
    cloud.points().into_iter().find(|x| !x.is_finite()).unwrap_or(f64::NAN)
}
