//! A matrix stored for sums over its rows, in vectors of four.

use sumprod_messages::vector::widest;

/// Four numbers that start at a multiple of their size, so that loading them touches one cache line.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(align(32))]
struct Four([f64; 4]);

/// Vectors of a row that are summed at once: as many as the registers of a core hold beside their operands.
const WIDEST: usize = 13;

/// Rows of equal length, each filled up with zeros to a multiple of four.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Strips {
    columns: usize,
    stride: usize,
    rows: Vec<Four>,
}

impl Strips {
    pub(super) fn new(rows: usize, columns: usize, value: impl Fn(usize, usize) -> f64) -> Self {
        let stride = columns.div_ceil(4);
        let mut out = vec![Four::default(); rows * stride];
        for (row, strip) in out.chunks_exact_mut(stride).enumerate() {
            for column in 0..columns {
                strip[column / 4].0[column % 4] = value(row, column);
            }
        }
        Self { columns, stride, rows: out }
    }

    /// Σ over rows of weight times row, into `out`, which has as many entries as there are columns.
    pub(super) fn weighted_sum(&self, weights: &[f64], out: &mut [f64]) {
        widest(WeightedSum { strips: self, weights, out });
    }
}

struct WeightedSum<'a> {
    strips: &'a Strips,
    weights: &'a [f64],
    out: &'a mut [f64],
}

impl pulp::NullaryFnOnce for WeightedSum<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Strips { columns, stride, rows } = self.strips;
        let mut from = 0;
        while from < *stride {
            let width = (stride - from).min(WIDEST);
            let end = (4 * (from + width)).min(*columns);
            let out = &mut self.out[4 * from..end];
            macro_rules! block {
                ($($vectors:literal)*) => {
                    match width {
                        $($vectors => block::<$vectors>(rows, *stride, from, self.weights, out),)*
                        _ => {}
                    }
                };
            }
            block!(1 2 3 4 5 6 7 8 9 10 11 12 13);
            from += width;
        }
    }
}

/// The sum of `N` vectors per row, held in registers from the first row to the last.
#[inline(always)]
fn block<const N: usize>(rows: &[Four], stride: usize, from: usize, weights: &[f64], out: &mut [f64]) {
    let mut sums = [[0.0; 4]; N];
    for (row, &weight) in rows.chunks_exact(stride).zip(weights) {
        let (vectors, _) = row[from..].split_at(N);
        for (sum, vector) in sums.iter_mut().zip(vectors) {
            for (sum, value) in sum.iter_mut().zip(&vector.0) {
                // Fused where the machine can; where it cannot, the library gives the same bits.
                *sum = value.mul_add(weight, *sum);
            }
        }
    }
    for (out, sum) in out.chunks_mut(4).zip(&sums) {
        out.copy_from_slice(&sum[..out.len()]);
    }
}
