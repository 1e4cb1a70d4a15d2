//! Fewer components, at a known cost in divergence.

use super::Mixture;
use super::condense::{condense, log_determinants};
use super::small::{Small, difference, log_determinant, wrap_point};
use sumprod_graph::MessageError;

/// More components than this are condensed from the top before pairs are merged one by one.
const PAIRWISE: usize = 1_000;

/// Divergence (nats) up to which fewer components say the same.
pub(super) const SAME: f64 = 1e-3;

/// How many times more components are kept before pairs are merged than after.
const FINER: usize = 4;

impl Mixture {
    /// Leaves out the components whose weight is below `share` of the heaviest one's, and returns the weight that
    /// is lost. O(N).
    #[must_use]
    pub fn prune(&self, share: f64) -> (Self, f64) {
        let largest = self.log_weights.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let floor = largest + share.clamp(0.0, 1.0).ln();
        let kept: Vec<usize> = (0..self.len()).filter(|&i| self.log_weights[i] >= floor).collect();
        if kept.len() == self.len() {
            return (self.clone(), 0.0);
        }
        let mut pruned = self.select(&kept);
        let total = crate::vector::log_sum(&pruned.log_weights);
        pruned.log_weights.iter_mut().for_each(|log| *log -= total);
        (pruned, -total.exp_m1())
    }

    /// At most `count` components, merging pair after pair the two that cost least (Runnalls 2007, "Kullback-Leibler
    /// approach to Gaussian mixture reduction"), and an upper bound of the divergence that cost (nats). Mean and
    /// covariance are kept. O(N² d³), more than 1,000 components being condensed to that many first.
    ///
    /// # Errors
    ///
    /// Where `count` is zero.
    pub fn reduce(&self, count: usize) -> Result<(Self, f64), MessageError> {
        if count == 0 {
            let reason = "a mixture cannot be reduced to 0 components; keep at least 1";
            return Err(MessageError::Unsupported(reason.into()));
        }
        if self.len() <= count {
            return Ok((self.clone(), 0.0));
        }
        let first = condense(self, PAIRWISE.max(count), 0.0, None);
        let mut pairs = Pairs::new(&first.mixture);
        let mut divergence = first.divergence;
        while pairs.alive.len() > count {
            divergence += pairs.merge_cheapest();
        }
        Ok((pairs.finish(), divergence))
    }

    /// The mixture of this and the share `damping` of `other`.
    pub(super) fn blend(&self, other: &Self, damping: f64) -> Result<Self, MessageError> {
        self.check_like(other, "the message to blend with")?;
        let scaled = |mixture: &Self, share: f64| {
            mixture.log_weights.iter().map(|log| log + share.ln()).collect::<Vec<f64>>()
        };
        let mut log_weights = scaled(self, 1.0 - damping);
        log_weights.extend(scaled(other, damping));
        let mut means = self.means.clone();
        means.extend(&other.means);
        let each = [self, other].into_iter();
        let covariances = each
            .flat_map(|mixture| (0..mixture.len()).flat_map(|i| mixture.covariance_of(i)).copied())
            .collect();
        Self::assemble(&self.coordinates, log_weights, means, covariances, false).map(|(both, _)| both)
    }

    /// At most `count` components, fewer where the bound of the divergence stays at most [`SAME`]: what messages and
    /// beliefs are held with. `masses` say how much each component matters, where it is not its weight.
    pub(super) fn fewer(&self, count: usize, masses: Option<&[f64]>) -> Result<(Self, f64), MessageError> {
        if self.len() <= 1 {
            return Ok((self.clone(), 0.0));
        }
        if let Some(one) = self.as_one(SAME)? {
            return Ok(one);
        }
        let first = match masses {
            // Weights alone decide what pairs are merged, so masses must have had their say by then.
            Some(_) => condense(self, count.max(1), SAME, masses),
            None => condense(self, count.saturating_mul(FINER), SAME, None),
        };
        let (fewer, loss) = first.mixture.reduce(count)?;
        Ok((fewer, first.divergence + loss))
    }

    /// At most `count` components by splitting from the top, or fewer once the bound of the divergence is at most
    /// `tolerance` (nats), and that bound. Less sharp than [`Mixture::reduce`] and much faster: O(N d² log K).
    ///
    /// # Errors
    ///
    /// Where `count` is zero.
    pub fn condense(&self, count: usize, tolerance: f64) -> Result<(Self, f64), MessageError> {
        if count == 0 {
            let reason = "a mixture cannot be condensed to 0 components; keep at least 1";
            return Err(MessageError::Unsupported(reason.into()));
        }
        let condensed = condense(self, count, tolerance, None);
        Ok((condensed.mixture, condensed.divergence))
    }
}

/// Components with the cheapest partner of each.
struct Pairs {
    mixture: Mixture,
    weights: Vec<f64>,
    log_determinants: Vec<f64>,
    alive: Vec<usize>,
    /// By component: the partner of larger number that costs least, and that cost.
    partner: Vec<(usize, f64)>,
}

struct Join {
    log_weight: f64,
    mean: Small,
    covariance: Small,
    log_determinant: f64,
    cost: f64,
}

impl Pairs {
    fn new(mixture: &Mixture) -> Self {
        let mut mixture = mixture.clone();
        let mut determinants = log_determinants(&mixture);
        if mixture.shared {
            let one = mixture.covariances.clone();
            mixture.covariances = one.iter().copied().cycle().take(one.len() * mixture.len()).collect();
            mixture.shared = false;
            determinants = vec![determinants[0]; mixture.len()];
        }
        let count = mixture.len();
        let mut pairs = Self {
            weights: mixture.weights(),
            mixture,
            log_determinants: determinants,
            alive: (0..count).collect(),
            partner: vec![(usize::MAX, f64::INFINITY); count],
        };
        for position in 0..count {
            pairs.find_partner(position);
        }
        pairs
    }

    fn find_partner(&mut self, position: usize) {
        let i = self.alive[position];
        self.partner[i] = self.alive[position + 1..]
            .iter()
            .map(|&j| (j, self.cost(i, j)))
            .fold((usize::MAX, f64::INFINITY), |best, other| if other.1 < best.1 { other } else { best });
    }

    /// What merging two components costs.
    fn cost(&self, i: usize, j: usize) -> f64 {
        match self.mixture.dimension() {
            1 => self.cost_of::<1>(i, j),
            2 => self.cost_of::<2>(i, j),
            3 => self.cost_of::<3>(i, j),
            4 => self.cost_of::<4>(i, j),
            _ => self.join(i, j).cost,
        }
    }

    /// [`Pairs::cost`] of D coordinates, without the heap.
    fn cost_of<const D: usize>(&self, i: usize, j: usize) -> f64 {
        let mixture = &self.mixture;
        let weight = self.weights[i] + self.weights[j];
        if weight <= 0.0 {
            return 0.0;
        }
        let (a, b) = (self.weights[i] / weight, self.weights[j] / weight);
        let mut offset = [0.0; D];
        difference(&mixture.coordinates, mixture.mean_of(j), mixture.mean_of(i), &mut offset);
        let (of_i, of_j) = (mixture.covariance_of(i), mixture.covariance_of(j));
        let mut covariance = [[0.0; D]; D];
        for (row, entries) in covariance.iter_mut().enumerate() {
            for (column, entry) in entries.iter_mut().enumerate() {
                let k = row * D + column;
                *entry = a * of_i[k] + b * of_j[k] + a * b * offset[row] * offset[column];
            }
        }
        let log_determinant = log_determinant(covariance.as_flattened(), D).unwrap_or(f64::INFINITY);
        let parts = a * self.log_determinants[i] + b * self.log_determinants[j];
        (0.5 * weight * (log_determinant - parts)).max(0.0)
    }

    fn join(&self, i: usize, j: usize) -> Join {
        let mixture = &self.mixture;
        let d = mixture.dimension();
        let (log_i, log_j) = (mixture.log_weights[i], mixture.log_weights[j]);
        let log_weight = crate::vector::log_sum(&[log_i, log_j]);
        let (a, b) = ((log_i - log_weight).exp(), (log_j - log_weight).exp());
        let mut offset = Small::from_elem(0.0, d);
        difference(&mixture.coordinates, mixture.mean_of(j), mixture.mean_of(i), &mut offset);
        let mut mean: Small = mixture.mean_of(i).iter().zip(&offset).map(|(m, o)| m + b * o).collect();
        wrap_point(&mixture.coordinates, &mut mean);
        let (of_i, of_j) = (mixture.covariance_of(i), mixture.covariance_of(j));
        let mut covariance = Small::from_elem(0.0, d * d);
        for row in 0..d {
            for column in 0..d {
                let entry = row * d + column;
                covariance[entry] = a * of_i[entry] + b * of_j[entry] + a * b * offset[row] * offset[column];
            }
        }
        let log_determinant = log_determinant(&covariance, d).unwrap_or(f64::INFINITY);
        let parts = a * self.log_determinants[i] + b * self.log_determinants[j];
        let cost = (0.5 * log_weight.exp() * (log_determinant - parts)).max(0.0);
        Join { log_weight, mean, covariance, log_determinant, cost }
    }

    fn merge_cheapest(&mut self) -> f64 {
        let cheapest =
            self.alive.iter().copied().fold(self.alive[0], |best, i| {
                if self.partner[i].1 < self.partner[best].1 { i } else { best }
            });
        let other = match self.partner[cheapest].0 {
            usize::MAX => self.alive[usize::from(self.alive[0] == cheapest)],
            found => found,
        };
        let (i, j) = (cheapest.min(other), cheapest.max(other));
        let join = self.join(i, j);
        let d = self.mixture.dimension();
        self.mixture.log_weights[i] = join.log_weight;
        self.weights[i] = join.log_weight.exp();
        self.mixture.means[i * d..(i + 1) * d].copy_from_slice(&join.mean);
        self.mixture.covariances[i * d * d..(i + 1) * d * d].copy_from_slice(&join.covariance);
        self.log_determinants[i] = join.log_determinant;
        self.alive.retain(|&k| k != j);
        for position in 0..self.alive.len() {
            let k = self.alive[position];
            if k == i || self.partner[k].0 == i || self.partner[k].0 == j {
                self.find_partner(position);
            } else if k < i {
                let cost = self.cost(k, i);
                if cost < self.partner[k].1 {
                    self.partner[k] = (i, cost);
                }
            }
        }
        join.cost
    }

    fn finish(self) -> Mixture {
        self.mixture.select(&self.alive)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sumprod_graph::Space;

    #[test]
    fn close_pairs_merge_first_and_moments_are_kept() {
        let space = Space::real(1);
        let log_weights = vec![0.2f64.ln(), 0.3f64.ln(), 0.1f64.ln(), 0.4f64.ln()];
        let means = vec![0.0, 10.0, 0.1, 10.2];
        let mixture = Mixture::new(&space, log_weights, means, vec![1.0, 1.0, 1.1, 0.9]).unwrap();
        let (reduced, divergence) = mixture.reduce(2).unwrap();
        assert_eq!(reduced.len(), 2);
        assert!(divergence < 0.01, "{divergence}");
        let mut weights = reduced.weights();
        weights.sort_by(f64::total_cmp);
        assert!((weights[0] - 0.3).abs() < 1e-12);
        let (before, after) = (mixture.moments(), reduced.moments());
        assert!((before.mean[0] - after.mean[0]).abs() < 1e-12);
        assert!((before.covariance[0] - after.covariance[0]).abs() < 1e-12);
        assert!(mixture.reduce(0).is_err());
        assert_eq!(mixture.reduce(1).unwrap().0.len(), 1);
    }

    #[test]
    fn merging_beats_splitting_at_equal_size() {
        let means: Vec<f64> = (0..60).map(|i| (f64::from(i) * 0.618_034).fract().powi(2) * 20.0).collect();
        let mixture =
            Mixture::with_shared_covariance(&Space::real(1), vec![0.0; 60], means, vec![0.3]).unwrap();
        let (_, merged) = mixture.reduce(10).unwrap();
        let (_, split) = mixture.condense(10, 0.0).unwrap();
        assert!(merged <= split, "{merged} {split}");
    }

    #[test]
    fn pruning_says_what_it_lost() {
        let log_weights = vec![0.7f64.ln(), 0.2999f64.ln(), 1e-4f64.ln()];
        let mixture =
            Mixture::with_shared_covariance(&Space::real(1), log_weights, vec![0.0, 1.0, 2.0], vec![1.0])
                .unwrap();
        let (pruned, lost) = mixture.prune(1e-3);
        assert_eq!(pruned.len(), 2);
        assert!((lost - 1e-4).abs() < 1e-12);
    }
}
