//! Systematic selection of particles by weight, block by block.
//!
//! Particle i of weight wᵢ and cumulative weight Cᵢ is chosen for the places from ⌈N Cᵢ₋₁/C - u⌉ to ⌈N Cᵢ/C - u⌉, with
//! one uniform u for all (Carpenter, Clifford, Fearnhead 1999). Every particle writes itself at its first place,
//! later ones over earlier ones that have none, and a running maximum fills the rest: no branch on a weight.

use super::BLOCK;
use rayon::prelude::*;
use sumprod_messages::vector;

const TWO_TO_52: f64 = 4_503_599_627_370_496.0;

/// Weights by block: each block's own, relative, and the factor that makes them comparable.
#[derive(Clone, Copy, Debug)]
pub struct Selection<'a> {
    /// One weight a particle, [`BLOCK`] of them a block but in the last.
    pub weights: &'a [f64],
    /// What each block's weights are to be multiplied by.
    pub scales: &'a [f64],
    /// Each block's sum of weights, scaled.
    pub totals: &'a [f64],
}

/// Fills `chosen` with indices of particles in ascending order, in proportion to their weights; `offset` is uniform
/// in [0, 1). A particle of weight zero is never chosen; the weights' sum must be positive and finite.
///
/// O(n + N), in parallel over blocks if `parallel`; the result does not depend on that.
pub fn select(selection: Selection<'_>, offset: f64, parallel: bool, chosen: &mut [u32]) {
    let count = chosen.len();
    let total: f64 = selection.totals.iter().sum();
    let density = count as f64 / total;
    let place = |reached: f64| (reached * density - offset).ceil().clamp(0.0, count as f64) as usize;
    let mut jobs = Vec::with_capacity(selection.totals.len());
    let (mut reached, mut first, mut rest) = (0.0, 0, chosen);
    let last = selection.totals.iter().rposition(|&total| total > 0.0).unwrap_or(0);
    for (block, total) in selection.totals.iter().enumerate() {
        let before = reached;
        reached += total;
        let end = if block >= last { count } else { place(reached).max(first) };
        let (own, others) = rest.split_at_mut(end - first);
        rest = others;
        if !own.is_empty() {
            jobs.push(Job { block, before, first, own });
        }
        first = end;
    }
    let run = |job: &mut Job<'_>| vector::widest(Place { job, selection, density, offset });
    if parallel { jobs.par_iter_mut().for_each(run) } else { jobs.iter_mut().for_each(run) }
}

/// The places of one block's particles.
struct Job<'a> {
    block: usize,
    /// The cumulative weight before the block.
    before: f64,
    first: usize,
    own: &'a mut [u32],
}

/// Fills one block's places: compiled for the widest instructions, of which rounding up is one.
struct Place<'a, 'b> {
    job: &'a mut Job<'b>,
    selection: Selection<'a>,
    density: f64,
    offset: f64,
}

impl pulp::NullaryFnOnce for Place<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        self.job.run(self.selection, self.density, self.offset);
    }
}

impl Job<'_> {
    #[inline(always)]
    fn run(&mut self, selection: Selection<'_>, density: f64, offset: f64) {
        let start = self.block * BLOCK;
        let weights = &selection.weights[start..(start + BLOCK).min(selection.weights.len())];
        let scale = selection.scales[self.block];
        let shift = offset + self.first as f64;
        let room = self.own.len();
        self.own.fill(0);
        // Cumulative weights first, then all places at once, then the particles to their places.
        let mut reached = self.before;
        let mut places = [0.0; BLOCK];
        for (place, &weight) in places.iter_mut().zip(weights) {
            reached += weight * scale;
            *place = reached;
        }
        let most = room as f64;
        let mut ends = [0; BLOCK];
        for (end, place) in ends.iter_mut().zip(&places) {
            let up = (place * density - shift).ceil();
            let up = if up > 0.0 { up } else { 0.0 };
            let up = if up < most { up } else { most };
            // 2^52 and a small integer: the lowest bits are the integer, and the conversion is one of vectors.
            *end = (up + TWO_TO_52).to_bits() as u32;
        }
        // The first place of the next particle among the block's own.
        let mut next = 0;
        for (index, (&weight, &end)) in weights.iter().zip(&ends).enumerate() {
            if weight > 0.0 && next < room {
                self.own[next] = (start + index) as u32;
            }
            next = next.max(end as usize);
        }
        let mut own = 0;
        for chosen in &mut *self.own {
            own = own.max(*chosen);
            *chosen = own;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::RngExt;
    use sumprod_graph::{Purpose, Stream};

    fn chosen(weights: &[f64], scales: &[f64], count: usize, offset: f64, parallel: bool) -> Vec<u32> {
        let totals: Vec<f64> =
            weights.chunks(BLOCK).zip(scales).map(|(own, scale)| own.iter().sum::<f64>() * scale).collect();
        let mut chosen = vec![7; count];
        select(Selection { weights, scales, totals: &totals }, offset, parallel, &mut chosen);
        chosen
    }

    /// Each particle is chosen ⌊N w⌋ or ⌈N w⌉ times, in order, and none of weight zero.
    #[test]
    fn selection_is_systematic_over_blocks() {
        for entity in 0..40 {
            let mut random = Stream::new(3, 0, Purpose::User(4), entity).fast();
            let n = [1, 5, 512, 513, 2000][entity as usize % 5];
            let weights: Vec<f64> =
                (0..n)
                    .map(|k| {
                        if n > 1 && k % 3 == entity as usize % 3 {
                            0.0
                        } else {
                            random.random::<f64>().powi(4)
                        }
                    })
                    .collect();
            let scales: Vec<f64> = (0..n.div_ceil(BLOCK)).map(|_| random.random::<f64>()).collect();
            let total: f64 = weights.iter().enumerate().map(|(k, w)| w * scales[k / BLOCK]).sum();
            for count in [1, 7, 600, 3000] {
                let offset: f64 = random.random();
                let found = chosen(&weights, &scales, count, offset, false);
                assert_eq!(found, chosen(&weights, &scales, count, offset, true));
                assert!(found.is_sorted());
                let mut copies = vec![0.0; n];
                found.iter().for_each(|&index| copies[index as usize] += 1.0);
                for (k, copies) in copies.iter().enumerate() {
                    let expected = count as f64 * weights[k] * scales[k / BLOCK] / total;
                    assert!((copies - expected).abs() < 1.0 + 1e-9, "{copies} for {expected}");
                    assert!(weights[k] > 0.0 || *copies == 0.0);
                }
            }
        }
    }

    /// Over 4,000 offsets the mean number of copies is N w within 4.5 standard errors of at most ½ / √4000: wrong
    /// with probability below 4e-5.
    #[test]
    fn selection_is_unbiased() {
        let weights: [f64; 4] = [0.05, 0.4, 0.22, 0.33];
        let mut copies = [0.0; 4];
        let mut random = Stream::new(4, 0, Purpose::User(4), 0).fast();
        for _ in 0..4000 {
            for index in chosen(&weights, &[1.0], 3, random.random(), false) {
                copies[index as usize] += 1.0 / 4000.0;
            }
        }
        for (copies, weight) in copies.iter().zip(weights) {
            assert!((copies - 3.0 * weight).abs() < 4.5 * 0.5 / 4000.0_f64.sqrt(), "{copies} {weight}");
        }
    }
}
