//! What is known of a node of the tree without looking into it: bounds, and an expansion where it is tight.

use super::super::small::Small;
use super::Evaluator;
use crate::vector::log_sum;
use std::sync::OnceLock;

/// Components from which on a node may be expanded.
const EXPANDABLE: usize = 48;

/// Half-width in kernel widths up to which it may be.
const TIGHT: f64 = 0.5;

/// What is known of a node without looking into it.
pub(super) struct Bounds {
    pub(super) centre: Small,
    pub(super) half: Small,
    pub(super) variance: Small,
    pub(super) row_sum: f64,
    /// Largest log of a kernel's height, weight apart.
    pub(super) peak: f64,
    /// Largest log weight.
    pub(super) weight: f64,
    /// Made when first asked for; none where the node is too wide for it.
    pub(super) expansion: OnceLock<Option<Expansion>>,
}

impl Bounds {
    /// Bounds of two nodes together.
    pub(super) fn joined(&self, other: &Self) -> Self {
        let mut joined = Self {
            centre: self.centre.clone(),
            half: self.half.clone(),
            variance: self.variance.clone(),
            row_sum: self.row_sum.max(other.row_sum),
            peak: self.peak.max(other.peak),
            weight: self.weight.max(other.weight),
            expansion: OnceLock::new(),
        };
        for k in 0..self.centre.len() {
            let low = (self.centre[k] - self.half[k]).min(other.centre[k] - other.half[k]);
            let high = (self.centre[k] + self.half[k]).max(other.centre[k] + other.half[k]);
            joined.centre[k] = 0.5 * (low + high);
            joined.half[k] = 0.5 * (high - low);
            joined.variance[k] = self.variance[k].max(other.variance[k]);
        }
        joined
    }
}

/// Second-order expansion of a node about its mean, in whitened coordinates.
pub(super) struct Expansion {
    pub(super) log_factor: f64,
    pub(super) mean: Small,
    /// Lower triangle of the covariance of the means, off-diagonal entries doubled.
    pub(super) spread: Small,
    pub(super) radius: f64,
}

impl Expansion {
    /// 1 + ½ (y'Sy - tr S).
    pub(super) fn factor(&self, offset: &[f64]) -> f64 {
        let mut sum = 0.0;
        for row in 0..offset.len() {
            for column in 0..=row {
                let entry = self.spread[row * (row + 1) / 2 + column];
                sum += entry * (offset[row] * offset[column] - f64::from(u8::from(row == column)));
            }
        }
        1.0 + 0.5 * sum
    }
}

impl Evaluator<'_> {
    pub(super) fn leaf_bounds(&self, range: std::ops::Range<usize>, heights: &[f64]) -> Bounds {
        let mixture = self.mixture;
        let d = mixture.dimension();
        let mut low = Small::from_elem(f64::INFINITY, d);
        let mut high = Small::from_elem(f64::NEG_INFINITY, d);
        let mut variance = Small::from_elem(0.0, d);
        let mut row_sum: f64 = 0.0;
        let (mut peak, mut weight) = (f64::NEG_INFINITY, f64::NEG_INFINITY);
        for position in range.clone() {
            let i = self.tree.order[position] as usize;
            for (k, &x) in mixture.mean_of(i).iter().enumerate() {
                low[k] = low[k].min(x);
                high[k] = high[k].max(x);
            }
            peak = peak.max(heights[position]);
            weight = weight.max(mixture.log_weights()[i]);
            if !mixture.shared || position == range.start {
                let matrix = mixture.covariance_of(i);
                for k in 0..d {
                    variance[k] = variance[k].max(matrix[k * d + k]);
                    row_sum = row_sum.max(matrix[k * d..][..d].iter().map(|entry| entry.abs()).sum());
                }
            }
        }
        let centre: Small = low.iter().zip(&high).map(|(a, b)| 0.5 * (a + b)).collect();
        let half: Small = low.iter().zip(&high).map(|(a, b)| 0.5 * (b - a)).collect();
        Bounds { centre, half, variance, row_sum, peak, weight, expansion: OnceLock::new() }
    }

    /// The expansion of a node, where it may have one.
    pub(super) fn expansion(&self, number: usize) -> Option<&Expansion> {
        let (node, bounds) = (&self.tree.nodes[number], &self.nodes[number]);
        let make = || {
            let wide =
                bounds.half.iter().zip(&bounds.variance).any(|(half, v)| half * half > TIGHT * TIGHT * v);
            let expandable = node.range().len() >= EXPANDABLE && !self.common.is_empty() && !wide;
            expandable.then(|| self.expand(node.range(), bounds.peak))
        };
        bounds.expansion.get_or_init(make).as_ref()
    }

    fn expand(&self, range: std::ops::Range<usize>, height: f64) -> Expansion {
        let d = self.mixture.dimension();
        let rows =
            || self.components[range.start * self.width..range.end * self.width].chunks_exact(self.width);
        let logs: Vec<f64> = rows().map(|row| row[0] - height).collect();
        let log_weight = log_sum(&logs);
        let shares: Vec<f64> = logs.iter().map(|log| (log - log_weight).exp()).collect();
        let mut mean = Small::from_elem(0.0, d);
        for (row, share) in rows().zip(&shares) {
            mean.iter_mut().zip(&row[1..]).for_each(|(m, x)| *m += share * x);
        }
        let mut spread = Small::from_elem(0.0, d * (d + 1) / 2);
        let mut radius: f64 = 0.0;
        for (row, share) in rows().zip(&shares) {
            let offset: Small = row[1..].iter().zip(&mean).map(|(x, m)| x - m).collect();
            radius = radius.max(offset.iter().map(|x| x * x).sum());
            for r in 0..d {
                for c in 0..=r {
                    let factor = if r == c { *share } else { 2.0 * share };
                    spread[r * (r + 1) / 2 + c] += factor * offset[r] * offset[c];
                }
            }
        }
        Expansion { log_factor: log_weight + height, mean, spread, radius: radius.sqrt() }
    }
}
