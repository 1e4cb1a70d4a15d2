//! Sub-swarms: slabs of equal count along the cloud's principal axis.

use std::ops::Range;

/// Fewest particles of a sub-swarm: with less it has no covariance to speak of.
const LEAST: usize = 4;

/// Iterations of the power method; an axis that has not settled by then is one of two equals.
const ITERATIONS: usize = 32;

pub(super) struct Partition {
    order: Vec<usize>,
    ranges: Vec<Range<usize>>,
}

impl Partition {
    /// Cuts `points` (row by row, of standard coordinates) into at most `sub_swarms` slabs. O(N log N + N d²).
    pub fn new(points: &[f64], dimension: usize, sub_swarms: usize) -> Self {
        let count = points.len() / dimension;
        let slabs = sub_swarms.min(count / LEAST).max(1);
        let axis = principal_axis(points, dimension);
        let along: Vec<f64> = points
            .chunks_exact(dimension)
            .map(|point| point.iter().zip(&axis).map(|(x, a)| x * a).sum())
            .collect();
        let mut order: Vec<usize> = (0..count).collect();
        order.sort_by(|&a, &b| along[a].total_cmp(&along[b]));
        let ranges = (0..slabs).map(|s| s * count / slabs..(s + 1) * count / slabs).collect();
        Self { order, ranges }
    }

    /// Number of particles.
    pub fn len(&self) -> usize {
        self.order.len()
    }

    /// The particles in the order of their slabs.
    pub fn order(&self) -> &[usize] {
        &self.order
    }

    /// Which places of that order each slab takes.
    pub fn ranges(&self) -> &[Range<usize>] {
        &self.ranges
    }
}

/// Leading eigenvector of Σ x x', by the power method from the coordinate of largest extent.
fn principal_axis(points: &[f64], dimension: usize) -> Vec<f64> {
    let mut scatter = vec![0.0; dimension * dimension];
    for point in points.chunks_exact(dimension) {
        for row in 0..dimension {
            for column in 0..dimension {
                scatter[row * dimension + column] += point[row] * point[column];
            }
        }
    }
    let widest = (0..dimension)
        .max_by(|&a, &b| scatter[a * (dimension + 1)].total_cmp(&scatter[b * (dimension + 1)]))
        .unwrap_or(0);
    let mut axis = scatter[widest * dimension..(widest + 1) * dimension].to_vec();
    for _ in 0..ITERATIONS {
        let length = axis.iter().map(|a| a * a).sum::<f64>().sqrt();
        if length == 0.0 || !length.is_finite() {
            return (0..dimension).map(|k| f64::from(u8::from(k == widest))).collect();
        }
        axis.iter_mut().for_each(|a| *a /= length);
        axis = scatter
            .chunks_exact(dimension)
            .map(|row| row.iter().zip(&axis).map(|(s, a)| s * a).sum())
            .collect();
    }
    axis
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slabs_have_equal_counts_and_follow_the_long_diagonal() {
        let points: Vec<f64> = (0..21)
            .map(|k| f64::from((8 * k) % 21) - 10.0)
            .flat_map(|t| [t + 0.1 * (t * 3.0).sin(), -t])
            .collect();
        let partition = Partition::new(&points, 2, 4);
        let sizes: Vec<usize> = partition.ranges().iter().map(|range| range.len()).collect();
        assert_eq!((partition.len(), sizes), (21, vec![5, 5, 5, 6]));
        let along: Vec<f64> = partition.order().iter().map(|&i| points[2 * i] - points[2 * i + 1]).collect();
        assert!(along.is_sorted() || along.iter().rev().is_sorted(), "{along:?}");
    }

    #[test]
    fn few_or_coinciding_points_are_one_slab_or_any() {
        let few = Partition::new(&[1.0, 2.0, 3.0], 1, 10);
        assert_eq!((few.ranges().len(), few.ranges()[0].clone()), (1, 0..3));
        let same = Partition::new(&[0.0; 16], 2, 2);
        assert_eq!(same.ranges(), [0..4, 4..8]);
    }
}
