//! The weights of a cloud, block by block.

use rayon::prelude::*;
use sumprod_messages::vector::{self, greater};
use sumprod_models::cloud::BLOCK;

static ONES: [f64; BLOCK] = [1.0; BLOCK];

/// Weights by their logs, and relative to the largest of each block.
#[derive(Clone, Debug, Default)]
pub(crate) struct Weights {
    /// Log weights of any scale; not kept while all are equal.
    logs: Vec<f64>,
    count: usize,
    /// exp(log - the block's largest); not kept while all are equal.
    relative: Vec<f64>,
    /// What makes the relative weights of a block comparable with others'.
    scales: Vec<f64>,
    /// Sum of each block's weights, scaled.
    totals: Vec<f64>,
    /// Whether all weights are equal.
    equal: bool,
    /// Log of the sum of exp(log weight).
    log_total: f64,
    effective: f64,
}

/// What weighing one block found.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BlockSum {
    largest: f64,
    sum: f64,
    squares: f64,
    /// The first particle of the block whose log likelihood is no number, and that.
    wrong: Option<(usize, f64)>,
}

impl Weights {
    /// `count` equal weights.
    pub(crate) fn equal(count: usize) -> Self {
        let mut weights = Self::default();
        weights.become_equal(count);
        weights
    }

    pub(crate) fn become_equal(&mut self, count: usize) {
        self.count = count;
        self.equal = true;
        let blocks = count.div_ceil(BLOCK);
        self.scales.clear();
        self.scales.resize(blocks, 1.0);
        self.totals.clear();
        self.totals.extend((0..blocks).map(|block| (count - block * BLOCK).min(BLOCK) as f64));
        self.log_total = (count as f64).ln();
        self.effective = count as f64;
    }

    /// Takes these log weights, of any scale, of which one at least is finite.
    pub(crate) fn become_logs(&mut self, logs: &[f64]) {
        self.become_equal(logs.len());
        let mut weighing = Weighing::default();
        let sums = self.weigh(false, &mut weighing, |block, own, _| {
            own.copy_from_slice(&logs[block * BLOCK..][..own.len()]);
        });
        self.commit(&mut weighing, &sums);
    }

    /// Log of the sum of exp(log weight).
    pub(crate) fn log_total(&self) -> f64 {
        self.log_total
    }

    pub(crate) fn len(&self) -> usize {
        self.count
    }

    /// Sum of the weights.
    pub(crate) fn total(&self) -> f64 {
        self.totals.iter().sum()
    }

    pub(crate) fn are_equal(&self) -> bool {
        self.equal
    }

    pub(crate) fn effective_sample_size(&self) -> f64 {
        self.effective
    }

    /// The weight of a particle, of the same scale for all.
    #[inline(always)]
    pub(crate) fn at(&self, particle: usize) -> f64 {
        if self.equal { 1.0 } else { self.relative[particle] * self.scales[particle / BLOCK] }
    }

    /// A block's relative weights, and what they are to be multiplied by.
    pub(crate) fn block(&self, block: usize) -> (&[f64], f64) {
        let start = block * BLOCK;
        let length = (self.count - start).min(BLOCK);
        let relative = if self.equal { &ONES[..length] } else { &self.relative[start..][..length] };
        (relative, self.scales[block])
    }

    /// What a selection needs of weights that are not all equal.
    pub(crate) fn selection(&self) -> sumprod_models::cloud::Selection<'_> {
        sumprod_models::cloud::Selection {
            weights: &self.relative,
            scales: &self.scales,
            totals: &self.totals,
        }
    }

    /// Multiplies the weights by likelihoods. `add` is given a block's number and its log weights, to which it adds
    /// the log likelihoods, and storage that lasts; it returns what the caller wants to know of the block, and
    /// these come back in order.
    ///
    /// Nothing has changed where the outcome is not taken over by [`Weights::commit`].
    pub(crate) fn weigh<T: Send>(
        &self,
        parallel: bool,
        into: &mut Weighing,
        add: impl Fn(usize, &mut [f64], &mut Vec<f64>) -> T + Sync,
    ) -> Vec<(BlockSum, T)> {
        let count = self.len();
        into.logs.resize(count, 0.0);
        into.relative.resize(count, 0.0);
        let one = |room: &mut Vec<f64>, (block, (logs, relative)): (usize, (&mut [f64], &mut [f64]))| {
            if self.equal {
                logs.fill(0.0);
            } else {
                logs.copy_from_slice(&self.logs[block * BLOCK..][..logs.len()]);
            }
            let told = add(block, logs, room);
            (vector::widest(Exponentiate { logs, relative }), told)
        };
        if parallel {
            let blocks = into.logs.par_chunks_mut(BLOCK).zip(into.relative.par_chunks_mut(BLOCK)).enumerate();
            blocks.map_init(Vec::new, one).collect()
        } else {
            let mut room = Vec::new();
            let blocks = into.logs.chunks_mut(BLOCK).zip(into.relative.chunks_mut(BLOCK)).enumerate();
            blocks.map(|block| one(&mut room, block)).collect()
        }
    }

    /// Takes over what was weighed, and returns the log of the sum of weights before and after.
    pub(crate) fn commit<T>(&mut self, weighing: &mut Weighing, sums: &[(BlockSum, T)]) -> (f64, f64) {
        let before = self.log_total;
        std::mem::swap(&mut self.logs, &mut weighing.logs);
        std::mem::swap(&mut self.relative, &mut weighing.relative);
        self.equal = false;
        let largest = sums.iter().map(|(sum, _)| sum.largest).fold(f64::NEG_INFINITY, f64::max);
        self.scales.clear();
        self.totals.clear();
        let (mut total, mut squares) = (0.0, 0.0);
        for (sum, _) in sums {
            let scale = (sum.largest - largest).exp();
            self.scales.push(scale);
            self.totals.push(sum.sum * scale);
            total += sum.sum * scale;
            squares += sum.squares * scale * scale;
        }
        self.log_total = largest + total.ln();
        self.effective = total * total / squares;
        (before, self.log_total)
    }
}

/// Storage for weights that are not yet taken over.
#[derive(Clone, Debug, Default)]
pub(crate) struct Weighing {
    logs: Vec<f64>,
    relative: Vec<f64>,
}

/// The largest log weight of what was weighed.
pub(crate) fn largest<T>(sums: &[(BlockSum, T)]) -> f64 {
    sums.iter().map(|(sum, _)| sum.largest).fold(f64::NEG_INFINITY, f64::max)
}

/// The first particle whose log likelihood is no number or plus infinity, and that.
pub(crate) fn wrong<T>(sums: &[(BlockSum, T)]) -> Option<(usize, f64)> {
    let each = sums.iter().enumerate();
    each.filter_map(|(block, (sum, _))| sum.wrong.map(|(index, value)| (block * BLOCK + index, value))).next()
}

struct Exponentiate<'a> {
    logs: &'a [f64],
    relative: &'a mut [f64],
}

impl pulp::NullaryFnOnce for Exponentiate<'_> {
    type Output = BlockSum;

    #[inline(always)]
    fn call(self) -> BlockSum {
        let mut lanes = [f64::NEG_INFINITY; 8];
        // Counts what is neither finite nor minus infinity: a maximum would drop a NaN.
        let mut doubt = [0.0; 8];
        let (chunks, rest) = self.logs.as_chunks::<8>();
        for chunk in chunks {
            for ((lane, doubt), log) in lanes.iter_mut().zip(&mut doubt).zip(chunk) {
                *lane = greater(*log, *lane);
                *doubt += if *log < f64::INFINITY { 0.0 } else { 1.0 };
            }
        }
        for (log, (lane, doubt)) in rest.iter().zip(lanes.iter_mut().zip(&mut doubt)) {
            *lane = greater(*log, *lane);
            *doubt += if *log < f64::INFINITY { 0.0 } else { 1.0 };
        }
        if doubt.iter().sum::<f64>() > 0.0 {
            let index = self.logs.iter().position(|log| log.is_nan() || *log == f64::INFINITY).unwrap_or(0);
            let wrong = Some((index, self.logs[index]));
            return BlockSum { largest: f64::NEG_INFINITY, sum: 0.0, squares: 0.0, wrong };
        }
        let largest = lanes.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        if largest == f64::NEG_INFINITY {
            self.relative.fill(0.0);
            return BlockSum { largest, sum: 0.0, squares: 0.0, wrong: None };
        }
        for (out, log) in self.relative.iter_mut().zip(self.logs) {
            let exponent = log - largest;
            let value = vector::exp(exponent);
            *out = if exponent > vector::LOWEST_EXPONENT { value } else { 0.0 };
        }
        let (mut sums, mut squares) = ([0.0; 8], [0.0; 8]);
        let (chunks, rest) = self.relative.as_chunks::<8>();
        for chunk in chunks {
            for ((sum, square), x) in sums.iter_mut().zip(&mut squares).zip(chunk) {
                *sum += x;
                *square += x * x;
            }
        }
        for ((sum, square), x) in sums.iter_mut().zip(&mut squares).zip(rest) {
            *sum += x;
            *square += x * x;
        }
        BlockSum { largest, sum: sums.iter().sum(), squares: squares.iter().sum(), wrong: None }
    }
}
