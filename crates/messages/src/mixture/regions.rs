//! How many regions of high density a mixture has: modes that valleys separate.
//!
//! Modes proper are found by climbing ([`modes`](super::modes)), which along a ring of kernels finds as many as there
//! are kernels. What a person means by modes are regions with a valley between them. Components are the nodes of a
//! graph, joined where no third stands between; regions grow downhill from the peaks as the density falls, and where two meet they
//! are two if the saddle is at most half as high as the lower peak (persistence; Chazal, Guibas, Oudot, Skraba 2013,
//! "Persistence-based clustering in Riemannian manifolds").

use super::small::{Small, difference, multiply, whitener};
use super::{Evaluator, Mixture};
use std::f64::consts::LN_2;
use sumprod_graph::MessageError;

/// Share of the weight below which a region is none.
const NEGLIGIBLE: f64 = 0.01;

/// More components than this are not looked at: pairs of them are.
const MOST: usize = 400;

impl Mixture {
    /// The number of regions of high density that valleys separate; none for more than 400 components. O(N² log N).
    ///
    /// # Errors
    ///
    /// Where the covariance of the whole is not positive definite.
    pub fn regions(&self) -> Result<Option<usize>, MessageError> {
        if self.len() == 1 {
            return Ok(Some(1));
        }
        if self.len() > MOST {
            return Ok(None);
        }
        let pairs = self.neighbours()?;
        let d = self.dimension();
        let mut points = self.means.clone();
        let mut offset = Small::from_elem(0.0, d);
        for &(a, b) in &pairs {
            difference(&self.coordinates, self.mean_of(b), self.mean_of(a), &mut offset);
            points.extend(self.mean_of(a).iter().zip(&offset).map(|(x, step)| x + 0.5 * step));
        }
        let mut heights = vec![0.0; points.len() / d];
        Evaluator::new(self).log_densities(&points, &mut heights)?;
        let (at_means, between) = heights.split_at(self.len());
        let mut saddles: Vec<(f64, usize, usize)> = pairs
            .iter()
            .zip(between)
            .map(|(&(a, b), &middle)| (middle.min(at_means[a]).min(at_means[b]), a, b))
            .collect();
        saddles.sort_by(|x, y| y.0.total_cmp(&x.0).then((x.1, x.2).cmp(&(y.1, y.2))));
        Ok(Some(self.count(at_means, &saddles)))
    }

    /// Grows the regions: `saddles` are the joined pairs, the highest first.
    fn count(&self, heights: &[f64], saddles: &[(f64, usize, usize)]) -> usize {
        let mut region: Vec<usize> = (0..self.len()).collect();
        let mut masses = self.weights();
        let mut peaks = heights.to_vec();
        let mut count = 0;
        for &(saddle, a, b) in saddles {
            let (a, b) = (find(&mut region, a), find(&mut region, b));
            if a == b {
                continue;
            }
            let (high, low) = if peaks[a] >= peaks[b] { (a, b) } else { (b, a) };
            if saddle <= peaks[low] - LN_2 && masses[low] >= NEGLIGIBLE && masses[high] >= NEGLIGIBLE {
                count += 1;
            }
            region[low] = high;
            masses[high] += masses[low];
            peaks[high] = peaks[high].max(peaks[low]);
        }
        let roots = (0..self.len()).filter(|&i| region[i] == i && masses[i] >= NEGLIGIBLE).count();
        count + roots
    }

    /// Pairs of components with no third in the ball that has their means at its ends (Gabriel's graph, which is
    /// connected), in units of the whole's covariance; the smaller number first.
    fn neighbours(&self) -> Result<Vec<(usize, usize)>, MessageError> {
        let (d, count) = (self.dimension(), self.len());
        let covariance = self.moments().covariance;
        let Some((whitener, _)) = whitener(&covariance, d) else {
            crate::Cholesky::new(&covariance, d, "the covariance of the mixture")?;
            return Ok(Vec::new());
        };
        let (mut offset, mut white) = (Small::from_elem(0.0, d), Small::from_elem(0.0, d));
        let mut squares = vec![0.0; count * count];
        for a in 0..count {
            for b in 0..a {
                difference(&self.coordinates, self.mean_of(b), self.mean_of(a), &mut offset);
                multiply(&whitener, &offset, &mut white);
                let square = white.iter().map(|x| x * x).sum();
                (squares[a * count + b], squares[b * count + a]) = (square, square);
            }
        }
        let mut pairs = Vec::new();
        let mut nearest: Vec<usize> = Vec::with_capacity(count);
        for (a, own) in squares.chunks_exact(count).enumerate() {
            nearest.clear();
            nearest.extend((0..count).filter(|&b| b != a));
            nearest.sort_by(|&x, &y| own[x].total_cmp(&own[y]).then(x.cmp(&y)));
            for (place, &b) in nearest.iter().enumerate().filter(|(_, b)| **b > a) {
                // Whoever is in the ball is nearer than the other end, and mostly among the nearest.
                if nearest[..place].iter().all(|&c| own[c] + squares[b * count + c] >= own[b]) {
                    pairs.push((a, b));
                }
            }
        }
        Ok(pairs)
    }
}

fn find(region: &mut [usize], mut i: usize) -> usize {
    while region[i] != i {
        region[i] = region[region[i]];
        i = region[i];
    }
    i
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;
    use sumprod_graph::Space;

    fn kernels(space: &Space, means: Vec<f64>, variance: f64) -> Mixture {
        let d = space.dimension();
        let covariance = (0..d * d).map(|k| if k % (d + 1) == 0 { variance } else { 0.0 }).collect();
        Mixture::with_shared_covariance(space, vec![0.0; means.len() / d], means, covariance).unwrap()
    }

    #[test]
    fn valleys_separate_and_ripples_do_not() {
        let line = Space::real(1);
        assert_eq!(kernels(&line, vec![-3.0, 3.0], 1.0).regions().unwrap(), Some(2));
        assert_eq!(kernels(&line, vec![-0.9, 0.9], 1.0).regions().unwrap(), Some(1));
        // Ten kernels a width and a half apart ripple; a gap of five does not.
        let row = |gap: f64| (0..10).map(|i| 1.5 * f64::from(i) + if i < 5 { 0.0 } else { gap }).collect();
        assert_eq!(kernels(&line, row(0.0), 1.0).regions().unwrap(), Some(1));
        assert_eq!(kernels(&line, row(5.0), 1.0).regions().unwrap(), Some(2));
    }

    #[test]
    fn a_ring_is_one_and_two_arcs_are_two() {
        let arc = |keep: fn(f64) -> bool| -> Vec<f64> {
            let angles = (0..40).map(|k| TAU * f64::from(k) / 40.0).filter(|angle| keep(*angle));
            angles.flat_map(|angle| [10.0 * angle.cos(), 10.0 * angle.sin()]).collect()
        };
        let plane = Space::real(2);
        assert_eq!(kernels(&plane, arc(|_| true), 0.6).regions().unwrap(), Some(1));
        assert_eq!(kernels(&plane, arc(|angle| angle.cos().abs() > 0.7), 0.6).regions().unwrap(), Some(2));
    }

    #[test]
    fn what_weighs_nothing_is_no_region() {
        let log_weights = vec![0.0, 1e-3f64.ln()];
        let far = Mixture::with_shared_covariance(&Space::real(1), log_weights, vec![0.0, 20.0], vec![1.0])
            .unwrap();
        assert_eq!(far.regions().unwrap(), Some(1));
    }
}
