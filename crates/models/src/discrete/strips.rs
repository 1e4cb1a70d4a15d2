//! A matrix stored for sums over its rows, in vectors of the machine's width.

use pulp::{Arch, Simd, WithSimd};

/// Vectors of a row that are summed at once: as many as the registers of a core hold beside their operands.
const WIDEST: usize = 13;

/// Bytes that rows are aligned to, so that loading a vector touches one cache line.
const ALIGNMENT: usize = 64;

/// Rows of equal length, each filled up to a multiple of the machine's vectors.
#[derive(Debug)]
pub(super) struct Strips {
    /// Numbers from one row to the next.
    stride: usize,
    /// Where the first row begins.
    start: usize,
    numbers: Vec<f64>,
}

/// How rows are combined.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Combine {
    /// Σ over rows of weight times row.
    Sum,
    /// The maximum over rows of weight plus row.
    Maximum,
}

impl Strips {
    pub(super) fn new(rows: usize, columns: usize, value: impl Fn(usize, usize) -> f64) -> Self {
        let stride = columns.next_multiple_of(Arch::new().dispatch(Lanes));
        let mut numbers = vec![0.0; rows * stride + ALIGNMENT / size_of::<f64>()];
        // Only speed depends on it.
        let start = numbers.as_ptr().align_offset(ALIGNMENT).min(ALIGNMENT / size_of::<f64>());
        for (row, strip) in numbers[start..].chunks_exact_mut(stride).take(rows).enumerate() {
            for (column, entry) in strip[..columns].iter_mut().enumerate() {
                *entry = value(row, column);
            }
        }
        Self { stride, start, numbers }
    }

    /// Numbers of a row with what fills it up: the length of the results.
    pub(super) fn stride(&self) -> usize {
        self.stride
    }

    /// The rows with these weights combined, into `out`; what fills up the rows is combined too.
    pub(super) fn combine(&self, how: Combine, weights: &[f64], out: &mut [f64]) {
        let (stride, rows) = (self.stride, &self.numbers[self.start..]);
        Arch::new().dispatch(Combined { how, stride, rows, weights, out });
    }
}

/// Asks for the numbers of a vector.
struct Lanes;

impl WithSimd for Lanes {
    type Output = usize;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) -> usize {
        S::F64_LANES
    }
}

struct Combined<'a> {
    how: Combine,
    stride: usize,
    rows: &'a [f64],
    weights: &'a [f64],
    out: &'a mut [f64],
}

impl WithSimd for Combined<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { how, stride, rows, weights, out } = self;
        let (rows, out) = (S::as_simd_f64s(rows).0, S::as_mut_simd_f64s(out).0);
        let stride = stride / S::F64_LANES;
        let mut from = 0;
        while from < stride {
            let width = (stride - from).min(WIDEST);
            let out = &mut out[from..from + width];
            macro_rules! block {
                ($($vectors:literal)*) => {
                    match (width, how) {
                        $(($vectors, Combine::Sum) => block::<S, $vectors, false>(simd, rows, stride, from, weights, out),)*
                        $(($vectors, Combine::Maximum) => block::<S, $vectors, true>(simd, rows, stride, from, weights, out),)*
                        _ => {}
                    }
                };
            }
            block!(1 2 3 4 5 6 7 8 9 10 11 12 13);
            from += width;
        }
    }
}

/// `N` vectors per row combined, held in registers from the first row to the last.
#[inline(always)]
fn block<S: Simd, const N: usize, const MAXIMUM: bool>(
    simd: S,
    rows: &[S::f64s],
    stride: usize,
    from: usize,
    weights: &[f64],
    out: &mut [S::f64s],
) {
    let mut results = [simd.splat_f64s(if MAXIMUM { f64::NEG_INFINITY } else { 0.0 }); N];
    for (row, &weight) in rows.chunks_exact(stride).zip(weights) {
        let Some(vectors) = row[from..].first_chunk::<N>() else { continue };
        let weight = simd.splat_f64s(weight);
        for (result, &vector) in results.iter_mut().zip(vectors) {
            *result = if MAXIMUM {
                simd.max_f64s(simd.add_f64s(vector, weight), *result)
            } else {
                // Fused on every machine: the same bits.
                simd.mul_add_f64s(vector, weight, *result)
            };
        }
    }
    out.copy_from_slice(&results);
}
