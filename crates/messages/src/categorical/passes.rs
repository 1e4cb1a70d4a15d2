//! Loops over the states of a message, in the machine's vectors where there are many states.
//!
//! Values are held where all are within [`LEAST`] of the largest, which is one to rounding.

use crate::vector::{greater, largest, least, ln, sum, vanishing_exp};
use pulp::{Arch, NullaryFnOnce, Scalar, Simd, WithSimd};

/// The least value that is held as such, and the least sum of values that is sure to have lost nothing to underflow.
pub(super) const LEAST: f64 = 1e-290;

/// States up to which choosing instructions takes longer than they save.
const FEW: usize = 8;

#[inline(always)]
fn fast<W: WithSimd>(states: usize, work: W) -> W::Output {
    if states <= FEW { work.with_simd(Scalar::new()) } else { Arch::new().dispatch(work) }
}

/// Makes the largest logarithm zero, where it is finite; returns what was the largest, and a sum that is NaN where a
/// logarithm is.
pub(super) fn normalise_logs(logs: &mut [f64]) -> (f64, f64) {
    struct Normalise<'a>(&'a mut [f64]);
    impl NullaryFnOnce for Normalise<'_> {
        type Output = (f64, f64);
        #[inline(always)]
        fn call(self) -> (f64, f64) {
            let (largest, sum) = (largest(self.0), sum(self.0));
            let shift = if largest.is_finite() { largest } else { 0.0 };
            for log in self.0 {
                *log -= shift;
            }
            (largest, sum)
        }
    }
    fast(logs.len(), Normalise(logs))
}

/// Writes values over their largest into `out`; false where that one or the least is out of range, or one is NaN.
pub(super) fn normalised_values(values: &[f64], out: &mut [f64]) -> bool {
    struct Normalised<'a>(&'a [f64], &'a mut [f64]);
    impl WithSimd for Normalised<'_> {
        type Output = bool;
        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) -> bool {
            let Some(scale) = Bounds::of(simd, self.0).scale(simd) else { return false };
            let mut numbers = true;
            for (out, value) in self.1.iter_mut().zip(self.0) {
                *out = value * scale;
                numbers &= !out.is_nan();
            }
            numbers
        }
    }
    fast(values.len(), Normalised(values, out))
}

/// The least and the largest of values, lane by lane, without regard for NaN.
struct Bounds<S: Simd> {
    least: S::f64s,
    largest: S::f64s,
    /// Of what fills no vector.
    rest: (f64, f64),
}

impl<S: Simd> Bounds<S> {
    #[inline(always)]
    fn new(simd: S) -> Self {
        let (least, largest) = (simd.splat_f64s(f64::INFINITY), simd.splat_f64s(f64::NEG_INFINITY));
        Self { least, largest, rest: (f64::INFINITY, f64::NEG_INFINITY) }
    }

    #[inline(always)]
    fn of(simd: S, values: &[f64]) -> Self {
        let mut bounds = Self::new(simd);
        let (vectors, rest) = S::as_simd_f64s(values);
        for &vector in vectors {
            bounds.add(simd, vector);
        }
        for &value in rest {
            bounds.add_one(value);
        }
        bounds
    }

    #[inline(always)]
    fn add(&mut self, simd: S, values: S::f64s) {
        self.least = simd.min_f64s(values, self.least);
        self.largest = simd.max_f64s(values, self.largest);
    }

    #[inline(always)]
    fn add_one(&mut self, value: f64) {
        self.rest = (lesser(value, self.rest.0), greater(value, self.rest.1));
    }

    /// One over the largest value; none where that one or the least is out of range.
    #[inline(always)]
    fn scale(self, simd: S) -> Option<f64> {
        let least = lesser(simd.reduce_min_f64s(self.least), self.rest.0);
        let largest = greater(simd.reduce_max_f64s(self.largest), self.rest.1);
        let scale = 1.0 / largest;
        (least >= LEAST && least * scale >= LEAST && largest < f64::INFINITY).then_some(scale)
    }
}

/// The lesser number, without regard for NaN.
#[inline(always)]
fn lesser(a: f64, b: f64) -> f64 {
    if a < b { a } else { b }
}

/// As [`normalised_values`], in place.
pub(super) fn normalise_values(values: &mut [f64]) -> bool {
    struct Normalise<'a>(&'a mut [f64]);
    impl WithSimd for Normalise<'_> {
        type Output = bool;
        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) -> bool {
            let Some(scale) = Bounds::of(simd, self.0).scale(simd) else { return false };
            for value in self.0 {
                *value *= scale;
            }
            true
        }
    }
    fast(values.len(), Normalise(values))
}

/// Multiplies values by others.
pub(super) fn multiply(values: &mut [f64], others: &[f64]) {
    struct Multiply<'a>(&'a mut [f64], &'a [f64]);
    impl NullaryFnOnce for Multiply<'_> {
        type Output = ();
        #[inline(always)]
        fn call(self) {
            for (value, other) in self.0.iter_mut().zip(self.1) {
                *value *= other;
            }
        }
    }
    fast(values.len(), Multiply(values, others));
}

/// Writes quotients of values over the largest of them into `out`; false as [`normalised_values`].
pub(super) fn quotients(values: &[f64], others: &[f64], out: &mut [f64]) -> bool {
    struct Quotients<'a>(&'a [f64], &'a [f64], &'a mut [f64]);
    impl WithSimd for Quotients<'_> {
        type Output = bool;
        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) -> bool {
            let mut bounds = Bounds::new(simd);
            let (values, last_values) = S::as_simd_f64s(self.0);
            let (others, last_others) = S::as_simd_f64s(self.1);
            let (outs, last_outs) = S::as_mut_simd_f64s(self.2);
            for ((out, &value), &other) in outs.iter_mut().zip(values).zip(others) {
                *out = simd.div_f64s(value, other);
                bounds.add(simd, *out);
            }
            for ((out, value), other) in last_outs.iter_mut().zip(last_values).zip(last_others) {
                *out = value / other;
                bounds.add_one(*out);
            }
            let Some(scale) = bounds.scale(simd) else { return false };
            let all = simd.splat_f64s(scale);
            for out in outs {
                *out = simd.mul_f64s(*out, all);
            }
            for out in last_outs {
                *out *= scale;
            }
            true
        }
    }
    fast(values.len(), Quotients(values, others, out))
}

/// The largest absolute logarithm of a ratio, of states at which either value is above `seen`.
pub(super) fn largest_ratio(values: &[f64], others: &[f64], seen: f64) -> f64 {
    struct Ratios<'a>(&'a [f64], &'a [f64], f64);
    impl NullaryFnOnce for Ratios<'_> {
        type Output = f64;
        #[inline(always)]
        fn call(self) -> f64 {
            const LANES: usize = 8;
            let (mut up, mut down) = ([1.0; LANES], [1.0; LANES]);
            for (values, others) in self.0.chunks(LANES).zip(self.1.chunks(LANES)) {
                let lanes = up.iter_mut().zip(&mut down);
                for ((&value, &other), (up, down)) in values.iter().zip(others).zip(lanes) {
                    let ratio = if greater(value, other) > self.2 { value / other } else { 1.0 };
                    *up = greater(ratio, *up);
                    *down = if ratio < *down { ratio } else { *down };
                }
            }
            greater(ln(largest(&up)), -ln(least(&down)))
        }
    }
    fast(values.len(), Ratios(values, others, seen))
}

/// Writes the logarithms of values, all of them positive and normal, into `out`, the largest zero.
pub(super) fn logarithms(values: &[f64], out: &mut [f64]) {
    struct Logarithms<'a>(&'a [f64], &'a mut [f64]);
    impl NullaryFnOnce for Logarithms<'_> {
        type Output = ();
        #[inline(always)]
        fn call(self) {
            let shift = ln(largest(self.0));
            for (out, value) in self.1.iter_mut().zip(self.0) {
                *out = ln(*value) - shift;
            }
        }
    }
    fast(values.len(), Logarithms(values, out));
}

/// e to the power of each entry, zero where it is below the range of doubles.
pub(super) fn exponentials(logs: &mut [f64]) {
    struct Exponentials<'a>(&'a mut [f64]);
    impl NullaryFnOnce for Exponentials<'_> {
        type Output = ();
        #[inline(always)]
        fn call(self) {
            for log in self.0 {
                *log = vanishing_exp(*log);
            }
        }
    }
    fast(logs.len(), Exponentials(logs));
}

/// Moves logarithms towards older ones, keeping the share `damping` of these.
pub(super) fn damp(logs: &mut [f64], older: &[f64], damping: f64) {
    for (log, old) in logs.iter_mut().zip(older) {
        *log = (1.0 - damping) * *log + damping * old;
    }
}

/// The largest change of a logarithm where either is above `seen`; NaN where one is not a number.
pub(super) fn largest_difference(logs: &[f64], older: &[f64], seen: f64) -> f64 {
    let (mut largest, mut sum) = (0.0, 0.0);
    for (now, before) in logs.iter().zip(older) {
        let moved = if greater(*now, *before) > seen { (now - before).abs() } else { 0.0 };
        largest = greater(largest, moved);
        sum += moved;
    }
    if f64::is_nan(sum) { sum } else { largest }
}
