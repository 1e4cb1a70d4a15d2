//! The parts of a mixture that valleys set apart: a ring of kernels is one, two mirror modes are two.
//!
//! Components are visited from the densest mean down. One that overlaps no earlier one begins a part; one that overlaps
//! several parts is their saddle, and joins those whose summit it is not far below.
//!
//! Source: Chazal, Guibas, Oudot, Skraba, "Persistence-based clustering in Riemannian manifolds" (2013).

use super::Mixture;
use super::small::{Small, difference, whitener};
use sumprod_graph::MessageError;

/// Bhattacharyya distance (nats) from which two components lie apart: that of equal Gaussians three standard
/// deviations from each other, d² / 8.
const APART: f64 = 9.0 / 8.0;

impl Mixture {
    /// The number of the part that each component belongs to, from 0 at the highest summit down. Two parts are one
    /// unless the density between them falls below `valley` times that of the lower summit. O(N² d³).
    ///
    /// Components overlap within a Bhattacharyya distance, without its term for the difference in spread, of
    /// δ'C̄⁻¹δ / 8 = 9/8 with C̄ the mean of their covariances.
    ///
    /// # Errors
    ///
    /// Where a density cannot be computed.
    pub fn parts(&self, valley: f64) -> Result<Vec<usize>, MessageError> {
        let count = self.len();
        let heights: Vec<f64> =
            (0..count).map(|i| self.log_density(self.mean_of(i))).collect::<Result<_, _>>()?;
        let mut order: Vec<usize> = (0..count).collect();
        order.sort_by(|&a, &b| heights[b].total_cmp(&heights[a]));
        // The component that each hangs from, its part's summit hanging from itself.
        let mut above: Vec<usize> = (0..count).collect();
        for (place, &i) in order.iter().enumerate() {
            let near = order[..place].iter().filter(|&&j| self.distance(i, j) < APART);
            let mut summits: Vec<usize> = near.map(|&j| summit(&above, j)).collect();
            summits.sort_by(|&a, &b| heights[b].total_cmp(&heights[a]));
            summits.dedup();
            let Some((&highest, others)) = summits.split_first() else { continue };
            above[i] = highest;
            for &other in others.iter().filter(|&&other| heights[i] >= heights[other] + valley.ln()) {
                above[other] = highest;
            }
        }
        let mut numbers = vec![usize::MAX; count];
        let mut parts = 0;
        for &i in &order {
            let root = summit(&above, i);
            if numbers[root] == usize::MAX {
                numbers[root] = parts;
                parts += 1;
            }
            numbers[i] = numbers[root];
        }
        Ok(numbers)
    }

    fn distance(&self, i: usize, j: usize) -> f64 {
        let d = self.dimension();
        let both = self.covariance_of(i).iter().zip(self.covariance_of(j));
        let mean: Small = both.map(|(a, b)| 0.5 * (a + b)).collect();
        // The mean of two covariances has a factor wherever they have.
        let Some((whitener, _)) = whitener(&mean, d) else { return f64::INFINITY };
        let mut offset = Small::from_elem(0.0, d);
        difference(&self.coordinates, self.mean_of(i), self.mean_of(j), &mut offset);
        let squared: f64 = whitener
            .chunks_exact(d)
            .map(|row| row.iter().zip(&offset).map(|(a, b)| a * b).sum::<f64>().powi(2))
            .sum();
        squared / 8.0
    }
}

fn summit(above: &[usize], mut component: usize) -> usize {
    while above[component] != component {
        component = above[component];
    }
    component
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;
    use sumprod_graph::Space;

    #[test]
    fn a_ring_is_one_part_and_its_halves_are_two() {
        let ring = |log_weight: &dyn Fn(u32) -> f64| {
            let angles = (0..40).map(|k| f64::from(k) * TAU / 40.0);
            let means = angles.flat_map(|angle| [30.0 * angle.cos(), 30.0 * angle.sin()]).collect();
            let log_weights = (0..40).map(log_weight).collect();
            let covariance = vec![4.0, 0.0, 0.0, 4.0];
            Mixture::with_shared_covariance(&Space::real(2), log_weights, means, covariance).unwrap()
        };
        assert_eq!(ring(&|_| 0.0).parts(0.5).unwrap(), [0; 40]);
        // Two bridges between the halves, of which the first half is the heavier.
        let halves = |bridge: f64| {
            ring(&|k| if k % 20 < 3 { bridge } else { -0.01 * f64::from(k / 20) }).parts(0.5).unwrap()
        };
        let apart = halves(-3.0);
        assert_eq!((&apart[3..20], &apart[23..]), (&[0; 17][..], &[1; 17][..]));
        assert_eq!(halves(-0.3), [0; 40]);
    }
}
