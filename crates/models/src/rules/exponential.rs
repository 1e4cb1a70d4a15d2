//! Sums of exponentials without a branch, so that the compiler spreads them over vector lanes: what a pointwise
//! particle message spends its time on.

/// Exponents below this count as this one: the result is near the smallest normal number.
const LOWEST: f64 = -708.0;
/// 1.5 · 2⁵²: adding it leaves a number's nearest integer in the low bits of the sum.
const ROUNDER: f64 = 6_755_399_441_055_744.0;
/// ln 2 in two parts, the first with trailing zeros so that its product with an exponent is exact.
const LN_2_HIGH: f64 = 0.693_147_180_369_123_8;
const LN_2_LOW: f64 = 1.908_214_929_270_587_7e-10;
/// 1 / k! for even and odd k from 12 down to 2: the next term is below 2e-16 on |r| ≤ ½ ln 2.
const EVEN: [f64; 6] = [1.0 / 479_001_600.0, 1.0 / 3_628_800.0, 1.0 / 40_320.0, 1.0 / 720.0, 1.0 / 24.0, 0.5];
const ODD: [f64; 5] = [1.0 / 39_916_800.0, 1.0 / 362_880.0, 1.0 / 5_040.0, 1.0 / 120.0, 1.0 / 6.0];

/// eˣ for x ≤ 700 as 2ᵏ eʳ, x = k ln 2 + r; relative error below 1e-15, e⁻⁷⁰⁸ for anything less, NaN for NaN.
#[inline(always)]
fn exponential(x: f64) -> f64 {
    // A maximum that would drop a NaN is not wanted here.
    let bounded = if x < LOWEST { LOWEST } else { x };
    let shifted = bounded * std::f64::consts::LOG2_E + ROUNDER;
    let k = shifted - ROUNDER;
    let r = (bounded - k * LN_2_HIGH) - k * LN_2_LOW;
    // Two chains of half the length: their latencies overlap.
    let square = r * r;
    let mut even = EVEN[0];
    for coefficient in &EVEN[1..] {
        even = even * square + coefficient;
    }
    let mut odd = ODD[0];
    for coefficient in &ODD[1..] {
        odd = odd * square + coefficient;
    }
    let mantissa = 1.0 + (r + square * (even + r * odd));
    mantissa * f64::from_bits(shifted.to_bits().wrapping_add(1023) << 52)
}

/// Numbers worked on at a time, in storage that stays in the nearest cache.
const BLOCK: usize = 64;
/// Partial sums, whose number fixes the order of addition.
const PARTIAL: usize = 8;

/// Σ exp(f(value)) over `values`; no f(value) may be above 700, and what is below -708 counts as e⁻⁷⁰⁸.
#[inline(always)]
fn sum_of(values: &[f64], exponent: impl Fn(f64) -> f64) -> f64 {
    let mut block = [0.0; BLOCK];
    let mut sums = [0.0; PARTIAL];
    for values in values.chunks(BLOCK) {
        let terms = &mut block[..values.len()];
        for (term, value) in terms.iter_mut().zip(values) {
            *term = exponential(exponent(*value));
        }
        let (whole, rest) = terms.as_chunks::<PARTIAL>();
        for terms in whole {
            for (sum, term) in sums.iter_mut().zip(terms) {
                *sum += term;
            }
        }
        for (sum, term) in sums.iter_mut().zip(rest) {
            *sum += term;
        }
    }
    sums.iter().sum()
}

/// Σ exp(log - shift) for finite `shift` and no log above `shift` + 700.
pub(crate) fn sum_of_exponentials(logs: &[f64], shift: f64) -> f64 {
    sum_of(logs, |log| log - shift)
}

/// Σ exp(shift - ½ w r²) over residuals r, each term at most e⁷⁰⁰.
pub(crate) fn sum_of_gaussians(residuals: &[f64], weight: f64, shift: f64) -> f64 {
    let half = -0.5 * weight;
    sum_of(residuals, |residual| half * (residual * residual) + shift)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_exponential_is_accurate_to_the_last_digits() {
        for index in 0..200_000 {
            let x = -707.9 + 0.00354 * f64::from(index);
            let exact = x.exp();
            assert!((exponential(x) / exact - 1.0).abs() < 1e-15, "at {x}");
        }
        assert_eq!(exponential(0.0), 1.0);
    }

    #[test]
    fn what_is_too_small_is_next_to_nothing_and_what_is_no_number_stays_none() {
        for x in [-709.0, -1e300, f64::NEG_INFINITY] {
            assert!(exponential(x) < 1e-307);
        }
        assert!(exponential(f64::NAN).is_nan());
        assert!(sum_of_exponentials(&[0.0, f64::NAN], 0.0).is_nan());
    }

    #[test]
    fn sums_agree_with_the_standard_library() {
        let logs: Vec<f64> = (0..37).map(|k| -0.3 * f64::from(k) + 5.0).collect();
        let exact: f64 = logs.iter().map(|log| (log - 5.0).exp()).sum();
        assert!((sum_of_exponentials(&logs, 5.0) / exact - 1.0).abs() < 1e-15);
        assert_eq!(sum_of_exponentials(&[], 0.0), 0.0);
        let residuals: Vec<f64> = (0..137).map(|k| 0.05 * f64::from(k) - 3.0).collect();
        let exact: f64 = residuals.iter().map(|r| (2.0 - 1.5 * r * r).exp()).sum();
        assert!((sum_of_gaussians(&residuals, 3.0, 2.0) / exact - 1.0).abs() < 1e-15);
    }
}
