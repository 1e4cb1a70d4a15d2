//! Components laid out for one question: how well does each agree with a given Gaussian?
//!
//! The answer, wᵢ N(m; mᵢ, C + Cᵢ) for a Gaussian (m, C), is the leave-one-out conditional of a Gibbs sampler over
//! labels, the weight of a pair in a product of mixtures and, for C = 0, a component's share of the density at m.
//! Components are held by coordinate, in blocks that are near each other; a block whose box lies too far away to
//! matter in double precision is never touched.

mod plan;

use super::Mixture;
use super::small::{Small, log_determinant};
use super::tree::Tree;
use crate::vector::{exp, greater, sum, widest};
use plan::Plan;
use std::f64::consts::TAU;
use sumprod_graph::Coordinate;

/// Components in a block.
const BLOCK: usize = 32;

/// Log weight of what fills the last block.
const NOTHING: f64 = -1e300;

/// Components whose share is smaller than e to minus this are as good as absent: 1e-19 of the largest.
const NEGLIGIBLE: f64 = 44.0;

/// A mixture's components in blocks.
pub(super) struct Kernels {
    dimension: usize,
    count: usize,
    stride: usize,
    /// A full turn and its inverse for an angle, zeros for a real coordinate.
    turns: Small,
    inverse_turns: Small,
    angles: bool,
    order: Vec<u32>,
    log_weights: Vec<f64>,
    /// One stretch of `stride` numbers per coordinate.
    means: Vec<f64>,
    /// One stretch per entry of the lower triangle; empty where one covariance is shared.
    covariances: Vec<f64>,
    shared: Small,
    blocks: Vec<Block>,
}

/// Bounds on what a block holds.
struct Block {
    centre: Small,
    half: Small,
    /// Largest variance by coordinate, and largest sum of a covariance's row in absolute value.
    variance: Small,
    row_sum: Small,
    /// Largest log weight, without and with the kernel's own normaliser.
    weight: f64,
    peak: f64,
}

/// What a question needs and leaves behind; kept by the caller so that no question allocates.
#[derive(Default)]
pub(super) struct Scratch {
    exponents: Vec<f64>,
    bounds: Vec<f64>,
    live: Vec<(u32, f64)>,
}

/// One question: the Gaussian's mean and covariance, all covariances (its own and the kernels') times `heat`.
#[derive(Clone, Copy)]
pub(super) struct Query<'a> {
    pub(super) mean: &'a [f64],
    /// Row-major.
    pub(super) covariance: &'a [f64],
    pub(super) heat: f64,
}

impl Kernels {
    /// Lays out `mixture` in the order of a KD tree. O(N log N).
    pub(super) fn new(mixture: &Mixture) -> Self {
        let order = if mixture.len() <= BLOCK {
            (0..mixture.len() as u32).collect()
        } else {
            Tree::of(mixture, BLOCK).order
        };
        Self::ordered(mixture, order)
    }

    /// Lays out `mixture` in this order, neighbours near each other.
    pub(super) fn ordered(mixture: &Mixture, order: Vec<u32>) -> Self {
        let d = mixture.dimension();
        let count = order.len();
        let stride = count.div_ceil(BLOCK) * BLOCK;
        let mut log_weights = vec![NOTHING; stride];
        let mut means = vec![0.0; stride * d];
        let entries = if mixture.shared { 0 } else { d * (d + 1) / 2 };
        let mut covariances = vec![0.0; stride * entries];
        for row in 0..d {
            if entries > 0 {
                let diagonal = row * (row + 1) / 2 + row;
                covariances[diagonal * stride..(diagonal + 1) * stride].fill(1.0);
            }
        }
        for (position, &i) in order.iter().enumerate() {
            let i = i as usize;
            log_weights[position] = mixture.log_weights[i];
            for (k, x) in mixture.mean_of(i).iter().enumerate() {
                means[k * stride + position] = *x;
            }
            if entries > 0 {
                let matrix = mixture.covariance_of(i);
                for row in 0..d {
                    for column in 0..=row {
                        let entry = row * (row + 1) / 2 + column;
                        covariances[entry * stride + position] = matrix[row * d + column];
                    }
                }
            }
        }
        let turn = |kind: &Coordinate| if *kind == Coordinate::Angle { TAU } else { 0.0 };
        let turns: Small = mixture.coordinates().iter().map(turn).collect();
        let inverse_turns: Small =
            turns.iter().map(|turn| if *turn > 0.0 { 1.0 / turn } else { 0.0 }).collect();
        let shared = mixture.shared_covariance().map_or_else(Small::new, Small::from_slice);
        let blocks = order.chunks(BLOCK).map(|part| Block::new(mixture, part)).collect();
        let angles = turns.iter().any(|&turn| turn > 0.0);
        Self {
            dimension: d,
            count,
            stride,
            turns,
            inverse_turns,
            angles,
            order,
            log_weights,
            means,
            covariances,
            shared,
            blocks,
        }
    }

    /// Draws a component by its share, `uniform` in [0, 1) deciding; and the log of the sum of all shares. None
    /// where a sum of covariances is singular.
    pub(super) fn pick(&self, query: Query<'_>, uniform: f64, scratch: &mut Scratch) -> Option<(usize, f64)> {
        let plan = Plan::new(self, query)?;
        let (position, log) = widest(Pick { kernels: self, plan: &plan, uniform, scratch });
        Some((self.order[position.min(self.count - 1)] as usize, log + plan.constant))
    }

    /// Calls `visit` with the components whose log share reaches `threshold`, stretch by stretch: their numbers, their
    /// logs, and what to add to these for log shares. Returns the largest log share.
    pub(super) fn collect(
        &self,
        query: Query<'_>,
        threshold: f64,
        scratch: &mut Scratch,
        mut visit: impl FnMut(&[u32], &[f64], f64),
    ) -> Option<f64> {
        let plan = Plan::new(self, query)?;
        let floor = threshold - plan.constant;
        let largest = widest(Gather { kernels: self, plan: &plan, floor, depth: f64::INFINITY, scratch });
        for &(block, _) in scratch.live.iter().filter(|(_, top)| *top >= floor) {
            let start = block as usize * BLOCK;
            let end = (start + BLOCK).min(self.count);
            let (order, logs) = (&self.order[start..end], &scratch.exponents[start..end]);
            if floor == f64::NEG_INFINITY {
                visit(order, logs, plan.constant);
                continue;
            }
            let mut from = 0;
            while let Some(first) = logs[from..].iter().position(|&log| log >= floor) {
                let begin = from + first;
                let length = logs[begin..].iter().position(|&log| log < floor).unwrap_or(logs.len() - begin);
                visit(&order[begin..begin + length], &logs[begin..begin + length], plan.constant);
                from = begin + length;
            }
        }
        Some(largest + plan.constant)
    }
}

impl Block {
    fn new(mixture: &Mixture, part: &[u32]) -> Self {
        let d = mixture.dimension();
        let mut low = Small::from_elem(f64::INFINITY, d);
        let mut high = Small::from_elem(f64::NEG_INFINITY, d);
        let mut variance = Small::from_elem(0.0, d);
        let mut row_sum = Small::from_elem(0.0, d);
        let (mut weight, mut peak) = (f64::NEG_INFINITY, f64::NEG_INFINITY);
        for (position, &i) in part.iter().enumerate() {
            let i = i as usize;
            let matrix = mixture.covariance_of(i);
            for (k, &x) in mixture.mean_of(i).iter().enumerate() {
                low[k] = low[k].min(x);
                high[k] = high[k].max(x);
                variance[k] = variance[k].max(matrix[k * d + k]);
                row_sum[k] = row_sum[k].max(matrix[k * d..][..d].iter().map(|entry| entry.abs()).sum());
            }
            weight = weight.max(mixture.log_weights[i]);
            if !mixture.shared || position == 0 {
                let log = log_determinant(matrix, d).unwrap_or(f64::NEG_INFINITY);
                peak = peak.max(mixture.log_weights[i] - 0.5 * log);
            }
        }
        if mixture.shared {
            // The common normaliser is no part of the exponents then.
            peak = weight;
        }
        let centre = low.iter().zip(&high).map(|(a, b)| 0.5 * (a + b)).collect();
        let half = low.iter().zip(&high).map(|(a, b)| 0.5 * (b - a)).collect();
        Self { centre, half, variance, row_sum, weight, peak }
    }
}

/// Finds the blocks that matter and writes their exponents; returns the largest.
struct Gather<'a> {
    kernels: &'a Kernels,
    plan: &'a Plan<'a>,
    /// Exponents below this are not wanted, nor those further than `depth` below the largest.
    floor: f64,
    depth: f64,
    scratch: &'a mut Scratch,
}

impl Gather<'_> {
    #[inline(always)]
    fn run(self) -> f64 {
        let Self { kernels, plan, floor, depth, scratch } = self;
        let blocks = kernels.blocks.len();
        if scratch.exponents.len() < kernels.stride {
            scratch.exponents.resize(kernels.stride, 0.0);
        }
        scratch.live.clear();
        scratch.bounds.clear();
        let mut first = (0, f64::NEG_INFINITY);
        let bounded = blocks > 1 && (floor > f64::NEG_INFINITY || depth < f64::INFINITY);
        if bounded {
            for (number, block) in kernels.blocks.iter().enumerate() {
                let bound = plan.bound(kernels, block);
                if bound > first.1 {
                    first = (number, bound);
                }
                scratch.bounds.push(bound);
            }
        }
        let mut largest = plan.block(kernels, first.0, &mut scratch.exponents);
        scratch.live.push((first.0 as u32, largest));
        for number in (0..blocks).filter(|&number| number != first.0) {
            if bounded && scratch.bounds[number] < greater(largest - depth, floor) {
                continue;
            }
            let top = plan.block(kernels, number, &mut scratch.exponents);
            largest = greater(top, largest);
            scratch.live.push((number as u32, top));
        }
        largest
    }
}

impl pulp::NullaryFnOnce for Gather<'_> {
    type Output = f64;

    #[inline(always)]
    fn call(self) -> f64 {
        self.run()
    }
}

struct Pick<'a> {
    kernels: &'a Kernels,
    plan: &'a Plan<'a>,
    uniform: f64,
    scratch: &'a mut Scratch,
}

impl pulp::NullaryFnOnce for Pick<'_> {
    type Output = (usize, f64);

    #[inline(always)]
    fn call(self) -> (usize, f64) {
        let Self { kernels, plan, uniform, scratch } = self;
        let floor = f64::NEG_INFINITY;
        let largest = Gather { kernels, plan, floor, depth: NEGLIGIBLE, scratch: &mut *scratch }.run();
        let mut total = 0.0;
        // From here on `live` holds the blocks that matter with their sums.
        scratch.live.retain(|&(_, top)| top >= largest - NEGLIGIBLE);
        for (block, share) in &mut scratch.live {
            let start = *block as usize * BLOCK;
            let Some(values) = scratch.exponents[start..].first_chunk_mut::<BLOCK>() else { continue };
            for value in values.iter_mut() {
                *value = exp(*value - largest);
            }
            *share = sum(values);
            total += *share;
        }
        let log = largest + total.ln();
        let mut rest = uniform * total;
        let last = scratch.live.len().saturating_sub(1);
        for (number, &(block, share)) in scratch.live.iter().enumerate() {
            if rest < share || number == last {
                let start = block as usize * BLOCK;
                for (lane, share) in scratch.exponents[start..start + BLOCK].iter().enumerate() {
                    rest -= share;
                    if rest < 0.0 {
                        return (start + lane, log);
                    }
                }
                // Rounding left a remainder: the last component that has a share.
                let values = &scratch.exponents[start..start + BLOCK];
                let lane = values.iter().rposition(|&share| share > 1e-300).unwrap_or(0);
                return (start + lane, log);
            }
            rest -= share;
        }
        (0, log)
    }
}
