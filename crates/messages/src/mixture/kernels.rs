//! Components laid out for one question: how well does each agree with a given Gaussian?
//!
//! The answer, wᵢ N(m; mᵢ, C + Cᵢ) for a Gaussian (m, C), is the leave-one-out conditional of a Gibbs sampler over
//! labels, the weight of a pair in a product of mixtures and, for C = 0, a component's share of the density at m.
//! Components are held by coordinate, in blocks that are near each other; a block whose box lies too far away to
//! matter in double precision is never touched.

use super::Mixture;
use super::small::{Small, whitener};
use super::tree::Tree;
use super::vector::{exp, greater, ln, round, widest};
use smallvec::SmallVec;
use std::f64::consts::{PI, TAU};
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
        let inverse_turns: Small = turns.iter().map(|turn| if *turn > 0.0 { 1.0 / turn } else { 0.0 }).collect();
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

    /// Number of components.
    pub(super) fn len(&self) -> usize {
        self.count
    }

    /// Draws a component by its share, `uniform` in [0, 1) deciding; and the log of the sum of all shares. None
    /// where a sum of covariances is singular.
    pub(super) fn pick(&self, query: Query<'_>, uniform: f64, scratch: &mut Scratch) -> Option<(usize, f64)> {
        let plan = Plan::new(self, query)?;
        let (position, log) = widest(Pick { kernels: self, plan: &plan, uniform, scratch });
        Some((self.order[position.min(self.count - 1)] as usize, log + plan.constant))
    }

    /// Calls `visit` with each component whose log share reaches `threshold`, and returns the largest log share.
    pub(super) fn collect(
        &self,
        query: Query<'_>,
        threshold: f64,
        scratch: &mut Scratch,
        mut visit: impl FnMut(usize, f64),
    ) -> Option<f64> {
        let plan = Plan::new(self, query)?;
        let floor = threshold - plan.constant;
        let largest = widest(Gather { kernels: self, plan: &plan, floor, scratch });
        for &(block, top) in &scratch.live {
            if top < floor {
                continue;
            }
            let start = block as usize * BLOCK;
            let end = (start + BLOCK).min(self.count);
            for position in start..end {
                let log = scratch.exponents[position];
                if log >= floor {
                    visit(self.order[position] as usize, log + plan.constant);
                }
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
                let log_determinant = whitener(matrix, d).map_or(f64::NEG_INFINITY, |(_, log)| log);
                peak = peak.max(mixture.log_weights[i] - 0.5 * log_determinant);
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

/// A question made ready: what is computed once for all components.
struct Plan<'a> {
    mean: &'a [f64],
    covariance: &'a [f64],
    cold: f64,
    /// Whitens a shared covariance plus the Gaussian's; empty where each component has its own.
    whitener: Small,
    /// What all log shares have in common.
    constant: f64,
    /// Half the log determinant of the Gaussian's own covariance, minus infinity where it is zero.
    half_log_determinant: f64,
    row_sum: Small,
}

impl<'a> Plan<'a> {
    fn new(kernels: &Kernels, query: Query<'a>) -> Option<Self> {
        let d = kernels.dimension;
        let mut constant = -0.5 * d as f64 * (TAU * query.heat).ln();
        let mut whitening = Small::new();
        let mut half_log_determinant = f64::NEG_INFINITY;
        if kernels.shared.is_empty() {
            if query.covariance.iter().any(|&entry| entry != 0.0) {
                half_log_determinant = 0.5 * whitener(query.covariance, d)?.1;
            }
        } else {
            let total: Small = kernels.shared.iter().zip(query.covariance).map(|(a, b)| a + b).collect();
            let (matrix, log_determinant) = whitener(&total, d)?;
            whitening = matrix;
            constant -= 0.5 * log_determinant;
        }
        let row_sum = query.covariance.chunks_exact(d).map(|row| row.iter().map(|x| x.abs()).sum()).collect();
        Some(Self {
            mean: query.mean,
            covariance: query.covariance,
            cold: 1.0 / query.heat,
            whitener: whitening,
            constant,
            half_log_determinant,
            row_sum,
        })
    }

    /// No component of the block has a larger exponent than this.
    #[inline(always)]
    fn bound(&self, kernels: &Kernels, block: &Block) -> f64 {
        let d = kernels.dimension;
        let (mut squared, mut farthest, mut widest) = (0.0, 0.0, 0.0);
        for k in 0..d {
            let mut offset = (self.mean[k] - block.centre[k]).abs();
            if kernels.turns[k] > 0.0 && offset > PI {
                offset = (offset - TAU * (offset / TAU).round()).abs();
            }
            let distance = (offset - block.half[k]).max(0.0);
            squared += distance * distance;
            farthest = greater(distance * distance / (self.covariance[k * d + k] + block.variance[k]), farthest);
            widest = greater(self.row_sum[k] + block.row_sum[k], widest);
        }
        let peak = if self.half_log_determinant > f64::NEG_INFINITY {
            block.peak.min(block.weight - self.half_log_determinant)
        } else {
            block.peak
        };
        peak - 0.5 * self.cold * greater(farthest, squared / widest)
    }

    /// Writes the exponents of one block and returns the largest.
    #[inline(always)]
    fn block(&self, kernels: &Kernels, block: usize, exponents: &mut [f64]) -> f64 {
        let start = block * BLOCK;
        let Some(out) = exponents[start..].first_chunk_mut::<BLOCK>() else { return NOTHING };
        let shared = !kernels.shared.is_empty();
        match (kernels.dimension, shared, kernels.angles) {
            (1, true, false) => self.shared_block::<1, false>(kernels, start, out),
            (2, true, false) => self.shared_block::<2, false>(kernels, start, out),
            (3, true, false) => self.shared_block::<3, false>(kernels, start, out),
            (1, true, true) => self.shared_block::<1, true>(kernels, start, out),
            (2, true, true) => self.shared_block::<2, true>(kernels, start, out),
            (3, true, true) => self.shared_block::<3, true>(kernels, start, out),
            (_, true, _) => self.shared_block_of_any_dimension(kernels, start, out),
            (1, false, _) => self.own_block::<1>(kernels, start, out),
            (2, false, _) => self.own_block::<2>(kernels, start, out),
            (3, false, _) => self.own_block::<3>(kernels, start, out),
            (_, false, _) => self.own_block_of_any_dimension(kernels, start, out),
        }
        let mut largest = [NOTHING; 8];
        for lanes in out.chunks_exact(8) {
            for lane in 0..8 {
                largest[lane] = greater(lanes[lane], largest[lane]);
            }
        }
        largest.iter().fold(NOTHING, |a, &b| greater(a, b))
    }

    #[inline(always)]
    fn shared_block<const D: usize, const ANGLES: bool>(
        &self,
        kernels: &Kernels,
        start: usize,
        out: &mut [f64; BLOCK],
    ) {
        let Some((columns, log_weights)) = columns::<D>(kernels, &kernels.means, start) else { return };
        let (mut mean, mut turns, mut inverse) = ([0.0; D], [0.0; D], [0.0; D]);
        let mut matrix = [[0.0; D]; D];
        for row in 0..D {
            mean[row] = self.mean[row];
            turns[row] = kernels.turns[row];
            inverse[row] = kernels.inverse_turns[row];
            for column in 0..=row {
                matrix[row][column] = self.whitener[row * D + column];
            }
        }
        let half = 0.5 * self.cold;
        for i in 0..BLOCK {
            let mut offset = [0.0; D];
            for k in 0..D {
                offset[k] = mean[k] - columns[k][i];
                if ANGLES {
                    offset[k] = turned(offset[k], turns[k], inverse[k]);
                }
            }
            let mut squared = 0.0;
            for row in 0..D {
                let mut white = 0.0;
                for column in 0..=row {
                    white += matrix[row][column] * offset[column];
                }
                squared += white * white;
            }
            out[i] = log_weights[i] - half * squared;
        }
    }

    #[inline(always)]
    fn shared_block_of_any_dimension(&self, kernels: &Kernels, start: usize, out: &mut [f64; BLOCK]) {
        let d = kernels.dimension;
        let mut squared = [0.0; BLOCK];
        for row in 0..d {
            let mut white = [0.0; BLOCK];
            for column in 0..=row {
                let means = &kernels.means[column * kernels.stride + start..][..BLOCK];
                let factor = self.whitener[row * d + column];
                let (turn, inverse) = (kernels.turns[column], kernels.inverse_turns[column]);
                for (white, mean) in white.iter_mut().zip(means) {
                    *white += factor * turned(self.mean[column] - mean, turn, inverse);
                }
            }
            for (squared, white) in squared.iter_mut().zip(&white) {
                *squared += white * white;
            }
        }
        for ((out, log_weight), squared) in out.iter_mut().zip(&kernels.log_weights[start..]).zip(&squared) {
            *out = log_weight - 0.5 * self.cold * squared;
        }
    }

    /// Each component with its own covariance, by its factors L D L'.
    #[inline(always)]
    fn own_block<const D: usize>(&self, kernels: &Kernels, start: usize, out: &mut [f64; BLOCK]) {
        let Some((columns, log_weights)) = columns::<D>(kernels, &kernels.means, start) else { return };
        let mut entries = [[log_weights; D]; D];
        for (row, entries) in entries.iter_mut().enumerate() {
            for (column, entry) in entries.iter_mut().enumerate().take(row + 1) {
                let stretch = (row * (row + 1) / 2 + column) * kernels.stride;
                let Some(values) = kernels.covariances[stretch + start..].first_chunk::<BLOCK>() else { return };
                *entry = values;
            }
        }
        let mut given = [[0.0; D]; D];
        let (mut mean, mut turns, mut inverse) = ([0.0; D], [0.0; D], [0.0; D]);
        for row in 0..D {
            mean[row] = self.mean[row];
            turns[row] = kernels.turns[row];
            inverse[row] = kernels.inverse_turns[row];
            for column in 0..=row {
                given[row][column] = self.covariance[row * D + column];
            }
        }
        let half = 0.5 * self.cold;
        for i in 0..BLOCK {
            let mut factor = [[0.0; D]; D];
            let mut pivots = [0.0; D];
            let mut offset = [0.0; D];
            let (mut squared, mut determinant) = (0.0, 1.0);
            for row in 0..D {
                let mut white = turned(mean[row] - columns[row][i], turns[row], inverse[row]);
                for column in 0..row {
                    // Holds L(row, column) × pivot(column) until it is divided.
                    let mut value = given[row][column] + entries[row][column][i];
                    for k in 0..column {
                        value -= factor[row][k] * factor[column][k] * pivots[k];
                    }
                    factor[row][column] = value / pivots[column];
                    white -= factor[row][column] * offset[column];
                }
                let mut pivot = given[row][row] + entries[row][row][i];
                for k in 0..row {
                    pivot -= factor[row][k] * factor[row][k] * pivots[k];
                }
                pivots[row] = pivot;
                offset[row] = white;
                squared += white * white / pivot;
                determinant *= pivot;
            }
            out[i] = log_weights[i] - half * squared - 0.5 * ln(determinant);
        }
    }

    #[inline(always)]
    fn own_block_of_any_dimension(&self, kernels: &Kernels, start: usize, out: &mut [f64; BLOCK]) {
        let d = kernels.dimension;
        let mut total: SmallVec<[f64; 36]> = SmallVec::from_elem(0.0, d * d);
        let mut offset: SmallVec<[f64; 6]> = SmallVec::from_elem(0.0, d);
        for (lane, out) in out.iter_mut().enumerate() {
            let i = start + lane;
            for row in 0..d {
                for column in 0..=row {
                    let entry = (row * (row + 1) / 2 + column) * kernels.stride + i;
                    total[row * d + column] = self.covariance[row * d + column] + kernels.covariances[entry];
                }
                let mean = kernels.means[row * kernels.stride + i];
                offset[row] = turned(self.mean[row] - mean, kernels.turns[row], kernels.inverse_turns[row]);
            }
            *out = match crate::Cholesky::new(&total, d, "a sum of covariances") {
                Ok(factor) => {
                    let squared = factor.squared_length(&mut offset);
                    kernels.log_weights[i] - 0.5 * (self.cold * squared + factor.log_determinant())
                }
                Err(_) => NOTHING,
            };
        }
    }
}

/// The block's means by coordinate, and its log weights.
type Columns<'a, const D: usize> = ([&'a [f64; BLOCK]; D], &'a [f64; BLOCK]);

#[inline(always)]
fn columns<'a, const D: usize>(kernels: &'a Kernels, values: &'a [f64], start: usize) -> Option<Columns<'a, D>> {
    let log_weights = kernels.log_weights[start..].first_chunk::<BLOCK>()?;
    let mut columns = [log_weights; D];
    for (k, column) in columns.iter_mut().enumerate() {
        *column = values[k * kernels.stride + start..].first_chunk::<BLOCK>()?;
    }
    Some((columns, log_weights))
}

#[inline(always)]
fn turned(offset: f64, turn: f64, inverse: f64) -> f64 {
    // A real coordinate has no turn to take off.
    offset - turn * round(offset * inverse)
}

/// Finds the blocks that matter and writes their exponents; returns the largest.
struct Gather<'a> {
    kernels: &'a Kernels,
    plan: &'a Plan<'a>,
    /// Exponents below this are not wanted, whatever the largest is.
    floor: f64,
    scratch: &'a mut Scratch,
}

impl Gather<'_> {
    #[inline(always)]
    fn run(self) -> f64 {
        let Self { kernels, plan, floor, scratch } = self;
        let blocks = kernels.blocks.len();
        if scratch.exponents.len() < kernels.stride {
            scratch.exponents.resize(kernels.stride, 0.0);
        }
        scratch.live.clear();
        scratch.bounds.clear();
        let mut first = (0, f64::NEG_INFINITY);
        if blocks > 1 {
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
            if scratch.bounds[number] < greater(largest - NEGLIGIBLE, floor) {
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
        let largest =
            Gather { kernels, plan, floor: f64::NEG_INFINITY, scratch: &mut *scratch }.run();
        let mut total = 0.0;
        // From here on `live` holds the blocks that matter with their sums.
        scratch.live.retain(|&(_, top)| top >= largest - NEGLIGIBLE);
        for (block, sum) in &mut scratch.live {
            let start = *block as usize * BLOCK;
            let Some(values) = scratch.exponents[start..].first_chunk_mut::<BLOCK>() else { continue };
            let mut lanes = [0.0; 8];
            for chunk in values.chunks_exact_mut(8) {
                for (lane, value) in chunk.iter_mut().enumerate() {
                    *value = exp(*value - largest);
                    lanes[lane] += *value;
                }
            }
            *sum = lanes.iter().sum();
            total += *sum;
        }
        let log = largest + total.ln();
        let mut rest = uniform * total;
        let last = scratch.live.len().saturating_sub(1);
        for (number, &(block, sum)) in scratch.live.iter().enumerate() {
            if rest < sum || number == last {
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
            rest -= sum;
        }
        (0, log)
    }
}
