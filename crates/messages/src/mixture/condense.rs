//! Fewer components by splitting from the top: fast, and with a bound on the divergence it costs.
//!
//! All components start as one group; the group whose merging costs most is split until the groups are few enough
//! and their cost low enough. The cost of merging a group of weight w into one Gaussian of the same moments is
//! ½ (w ln |P| - Σᵢ wᵢ ln |Cᵢ|), which bounds the Kullback-Leibler divergence of the merged from the original mixture
//! (Runnalls 2007, "Kullback-Leibler approach to Gaussian mixture reduction", theorem 3.2, summed over merges).

use super::Mixture;
use super::small::{Small, log_determinant};
use super::tree::{Merged, merge};
use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// A condensed mixture and what it cost.
pub(super) struct Condensed {
    pub(super) mixture: Mixture,
    /// Upper bound of the divergence from the original to the condensed mixture (nats).
    pub(super) divergence: f64,
}

struct Group {
    begin: usize,
    end: usize,
    merged: Merged,
    /// Share of the cost in the bound, and in the order of splitting.
    cost: f64,
    urgency: f64,
}

impl PartialEq for Group {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Group {}

impl PartialOrd for Group {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Group {
    fn cmp(&self, other: &Self) -> Ordering {
        self.urgency.total_cmp(&other.urgency).then(other.begin.cmp(&self.begin))
    }
}

/// Condenses `mixture` to at most `count` components, or fewer once the bound is at most `tolerance` nats.
/// `masses`, where given, say how much each component matters, instead of its weight, for what is split first.
/// O(N d² log K).
pub(super) fn condense(mixture: &Mixture, count: usize, tolerance: f64, masses: Option<&[f64]>) -> Condensed {
    if mixture.len() <= count && tolerance <= 0.0 {
        return Condensed { mixture: mixture.clone(), divergence: 0.0 };
    }
    let d = mixture.dimension();
    let log_determinants = log_determinants(mixture);
    let weights = mixture.weights();
    let mut order: Vec<u32> = (0..mixture.len() as u32).collect();
    let group = |begin: usize, end: usize, order: &[u32]| {
        let part = &order[begin..end];
        let merged = merge(mixture, &weights, part);
        let mut group = Group { begin, end, merged, cost: 0.0, urgency: 0.0 };
        if part.len() > 1 {
            let weight = group.merged.log_weight.exp();
            let own: f64 = match log_determinants.as_slice() {
                [shared] => weight * shared,
                all => part.iter().map(|&i| weights[i as usize] * all[i as usize]).sum(),
            };
            let together = log_determinant(&group.merged.covariance, d).unwrap_or(f64::INFINITY);
            group.cost = (0.5 * (weight * together - own)).max(0.0);
            group.urgency = group.cost;
            if let Some(masses) = masses {
                group.urgency *= part.iter().map(|&i| masses[i as usize]).sum::<f64>() / weight;
            }
        }
        group
    };
    let mut heap = BinaryHeap::with_capacity(count + 1);
    let mut leaves = Vec::new();
    let root = group(0, mixture.len(), &order);
    let mut divergence = root.cost;
    heap.push(root);
    while heap.len() + leaves.len() < count.max(1) && divergence > tolerance.max(0.0) {
        let Some(worst) = heap.pop() else { break };
        if worst.end - worst.begin == 1 {
            leaves.push(worst);
            continue;
        }
        let part = &mut order[worst.begin..worst.end];
        let middle = worst.begin + split(mixture, &weights, &worst.merged, part);
        let (low, high) = (group(worst.begin, middle, &order), group(middle, worst.end, &order));
        divergence += low.cost + high.cost - worst.cost;
        heap.push(low);
        heap.push(high);
    }
    leaves.extend(heap);
    leaves.sort_by_key(|group| group.begin);
    let mut condensed = Mixture {
        coordinates: mixture.coordinates.clone(),
        log_weights: Vec::with_capacity(leaves.len()),
        means: Vec::with_capacity(leaves.len() * d),
        covariances: Vec::with_capacity(leaves.len() * d * d),
        shared: false,
    };
    for leaf in &leaves {
        condensed.log_weights.push(leaf.merged.log_weight);
        condensed.means.extend_from_slice(&leaf.merged.mean);
        condensed.covariances.extend_from_slice(&leaf.merged.covariance);
    }
    Condensed { mixture: condensed, divergence: divergence.max(0.0) }
}

/// Log determinants of the covariances; one where they are shared.
pub(super) fn log_determinants(mixture: &Mixture) -> Vec<f64> {
    let d = mixture.dimension();
    let matrices = if mixture.shared { 1 } else { mixture.len() };
    (0..matrices).map(|i| log_determinant(mixture.covariance_of(i), d).unwrap_or(f64::NEG_INFINITY)).collect()
}

/// Parts a group at its mean across the coordinate that spreads most against the kernels' own variance, and returns
/// how many lie below.
fn split(mixture: &Mixture, weights: &[f64], merged: &Merged, part: &mut [u32]) -> usize {
    let d = mixture.dimension();
    let mut kernel = Small::from_elem(0.0, d);
    match mixture.shared_covariance() {
        Some(matrix) => kernel.iter_mut().enumerate().for_each(|(k, sum)| *sum = matrix[k * d + k]),
        None => {
            let total = merged.log_weight.exp();
            for &i in part.iter() {
                let own = mixture.covariance_of(i as usize);
                for (k, sum) in kernel.iter_mut().enumerate() {
                    *sum += weights[i as usize] / total * own[k * d + k];
                }
            }
        }
    }
    // A group of weight zero has no such mean; the smallest number keeps the ratio finite.
    let spread = |k: usize| merged.covariance[k * d + k] / kernel[k].max(f64::MIN_POSITIVE);
    let side = (0..d).fold(0, |best, k| if spread(k) > spread(best) { k } else { best });
    let key = |i: u32| {
        let x = mixture.means[i as usize * d + side] - merged.mean[side];
        match mixture.coordinates[side] {
            sumprod_graph::Coordinate::Real => x,
            sumprod_graph::Coordinate::Angle => sumprod_graph::wrap_angle(x),
        }
    };
    let mut below = 0;
    for position in 0..part.len() {
        if key(part[position]) < 0.0 {
            part.swap(position, below);
            below += 1;
        }
    }
    if below == 0 || below == part.len() {
        below = part.len() / 2;
        part.select_nth_unstable_by(below, |&a, &b| key(a).total_cmp(&key(b)));
    }
    below
}

#[cfg(test)]
mod tests {
    use super::*;
    use sumprod_graph::Space;

    fn cloud(count: usize) -> Mixture {
        let mut means = Vec::new();
        for i in 0..count {
            let t = i as f64 * 0.754_877_666;
            let s = i as f64 * 0.569_840_291;
            means.extend([6.0 * t.fract() - 3.0, 2.0 * s.fract() - 1.0]);
        }
        let weights = (0..count).map(|i| (i % 7) as f64 * 0.2).collect();
        Mixture::with_shared_covariance(&Space::real(2), weights, means, vec![0.2, 0.05, 0.05, 0.1]).unwrap()
    }

    #[test]
    fn moments_are_kept_whatever_the_size() {
        let mixture = cloud(300);
        let exact = mixture.moments();
        for count in [1, 7, 40] {
            let condensed = condense(&mixture, count, 0.0, None).mixture;
            assert_eq!(condensed.len(), count);
            let found = condensed.moments();
            for (a, b) in
                exact.mean.iter().zip(&found.mean).chain(exact.covariance.iter().zip(&found.covariance))
            {
                assert!((a - b).abs() < 1e-12);
            }
        }
    }

    /// The divergence is integrated on a grid.
    #[test]
    fn the_bound_holds_and_falls() {
        let mixture = cloud(300);
        let mut last = f64::INFINITY;
        for count in [4, 16, 64] {
            let Condensed { mixture: condensed, divergence } = condense(&mixture, count, 0.0, None);
            let mut exact = 0.0;
            for i in 0..120 {
                for j in 0..60 {
                    let x = [-6.0 + f64::from(i) * 0.1, -3.0 + f64::from(j) * 0.1];
                    let (p, q) = (mixture.log_density(&x).unwrap(), condensed.log_density(&x).unwrap());
                    exact += 0.01 * p.exp() * (p - q);
                }
            }
            assert!(exact < divergence && divergence < last, "{exact} {divergence} {last}");
            last = divergence;
        }
    }
}
