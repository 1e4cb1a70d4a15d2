//! Arithmetic that the compiler can vectorise: no branch, no call, the same operations in every lane.
//!
//! The functions here are inlined into loops that [`widest`] compiles for the widest instructions of the machine.
//! They serve every crate whose loops run over many numbers.
//! No operation is fused and sums have a fixed order, so that every machine computes the same bits.

use std::f64::consts::{FRAC_2_PI, FRAC_PI_2, FRAC_PI_4, LN_2, LOG2_E, PI, SQRT_2, TAU};

/// Adding this number rounds to the nearest integer, which its lowest bits then hold.
const ROUND: f64 = 6_755_399_441_055_744.0;

/// Below this exponent [`exp`] returns its value there, the smallest that is no subnormal number.
pub const LOWEST_EXPONENT: f64 = -708.0;

/// Runs `work` compiled for the widest vector instructions that this machine has; its `call` must be inlined.
#[inline(always)]
pub fn widest<W: pulp::NullaryFnOnce>(work: W) -> W::Output {
    pulp::Arch::new().dispatch(work)
}

/// e to the power `x`, for `x` up to 709, to a relative error of 5e-16; -708 stands for what is below it.
#[inline(always)]
pub fn exp(x: f64) -> f64 {
    // The high part of ln 2 ends in zeros, so that its product with a small integer is exact.
    const HIGH: f64 = 0.693_147_180_369_123_8;
    const LOW: f64 = 1.908_214_929_270_587_7e-10;
    let x = if x > LOWEST_EXPONENT { x } else { LOWEST_EXPONENT };
    let shifted = x * LOG2_E + ROUND;
    let integer = shifted - ROUND;
    let r = (x - integer * HIGH) - integer * LOW;
    let r2 = r * r;
    let r4 = r2 * r2;
    let low = (1.0 + r) + r2 * (1.0 / 2.0 + r * (1.0 / 6.0));
    let middle = (1.0 / 24.0 + r * (1.0 / 120.0)) + r2 * (1.0 / 720.0 + r * (1.0 / 5_040.0));
    let high = (1.0 / 40_320.0 + r * (1.0 / 362_880.0)) + r2 * (1.0 / 3_628_800.0 + r * (1.0 / 39_916_800.0));
    let series = low + r4 * (middle + r4 * (high + r4 * (1.0 / 479_001_600.0)));
    series * f64::from_bits((shifted.to_bits() << 52).wrapping_add(1023 << 52))
}

/// Natural logarithm of a positive normal number, to a relative error of 1e-15 (absolute near one).
#[inline(always)]
pub fn ln(x: f64) -> f64 {
    let bits = x.to_bits();
    // The exponent by an exact conversion through the mantissa of 2^52, which vectorises where a cast does not.
    let exponent = f64::from_bits((bits >> 52) | 0x4330_0000_0000_0000) - 4_503_599_627_371_519.0;
    let mantissa = f64::from_bits((bits & 0x000f_ffff_ffff_ffff) | 0x3ff0_0000_0000_0000);
    let large = mantissa > SQRT_2;
    let mantissa = if large { 0.5 * mantissa } else { mantissa };
    let exponent = if large { exponent + 1.0 } else { exponent };
    let s = (mantissa - 1.0) / (mantissa + 1.0);
    let s2 = s * s;
    let s4 = s2 * s2;
    let s8 = s4 * s4;
    let low = (1.0 + s2 * (1.0 / 3.0)) + s4 * (1.0 / 5.0 + s2 * (1.0 / 7.0));
    let middle = (1.0 / 9.0 + s2 * (1.0 / 11.0)) + s4 * (1.0 / 13.0 + s2 * (1.0 / 15.0));
    let high = (1.0 / 17.0 + s2 * (1.0 / 19.0)) + s4 * (1.0 / 21.0);
    exponent * LN_2 + 2.0 * s * (low + s8 * (middle + s8 * high))
}

/// Largest angle (rad) that [`sin_cos`] reduces to full accuracy.
pub const LARGEST_ANGLE: f64 = 1e6;

/// Sine and cosine of an angle up to [`LARGEST_ANGLE`] (rad), to an absolute error of 4e-16: Taylor series about the
/// nearest multiple of a right angle.
#[inline(always)]
pub fn sin_cos(angle: f64) -> (f64, f64) {
    // π/2 in three parts, the first two with trailing zeros so that their products with the quadrant are exact.
    const HIGH: f64 = 1.570_796_251_296_997;
    const MIDDLE: f64 = 7.549_789_415_861_596e-8;
    const LOW: f64 = 5.390_302_858_158_119e-15;
    let shifted = angle * FRAC_2_PI + ROUND;
    let quadrant = shifted - ROUND;
    let r = ((angle - quadrant * HIGH) - quadrant * MIDDLE) - quadrant * LOW;
    let r2 = r * r;
    let r4 = r2 * r2;
    let r8 = r4 * r4;
    let sine = r + r
        * r2
        * (((-1.0 / 6.0 + r2 * (1.0 / 120.0)) + r4 * (-1.0 / 5_040.0 + r2 * (1.0 / 362_880.0)))
            + r8 * ((-1.0 / 39_916_800.0 + r2 * (1.0 / 6_227_020_800.0))
                + r4 * (-1.0 / 1_307_674_368_000.0)));
    let cosine = (1.0 - 0.5 * r2)
        + r4 * (((1.0 / 24.0 + r2 * (-1.0 / 720.0)) + r4 * (1.0 / 40_320.0 + r2 * (-1.0 / 3_628_800.0)))
            + r8 * ((1.0 / 479_001_600.0 + r2 * (-1.0 / 87_178_291_200.0))
                + r4 * (1.0 / 20_922_789_888_000.0)));
    let turns = shifted.to_bits();
    let (a, b) = if turns & 1 == 0 { (sine, cosine) } else { (cosine, sine) };
    // The second bit of the quadrant is the sign of the sine, that of the next quadrant the cosine's.
    let signed = |value: f64, quadrant: u64| f64::from_bits(value.to_bits() ^ ((quadrant & 2) << 62));
    (signed(a, turns), signed(b, turns.wrapping_add(1)))
}

/// The angle of the vector (`x`, `y`) in [-π, π] (rad), to an absolute error of 5e-16; zero for the zero vector.
///
/// Rational approximation of the arc tangent by Moshier (Cephes).
#[inline(always)]
pub fn atan2(y: f64, x: f64) -> f64 {
    let (ax, ay) = (x.abs(), y.abs());
    let steep = ay > ax;
    let (less, more) = if steep { (ax, ay) } else { (ay, ax) };
    let far = less > 0.66 * more;
    let numerator = if far { less - more } else { less };
    let denominator = if far { less + more } else { more };
    let denominator = if denominator > 0.0 { denominator } else { 1.0 };
    let t = numerator / denominator;
    let z = t * t;
    let top = (((-8.750_608_600_031_904e-1 * z - 1.615_753_718_733_365e1) * z - 7.500_855_792_314_705e1) * z
        - 1.228_866_684_490_136_1e2)
        * z
        - 6.485_021_904_942_025e1;
    let bottom =
        ((((z + 2.485_846_490_142_306e1) * z + 1.650_270_098_316_988_5e2) * z + 4.328_810_604_912_903e2) * z
            + 4.853_903_996_359_137e2)
            * z
            + 1.945_506_571_482_614e2;
    let small = t + t * (z * top / bottom);
    let first = if far { FRAC_PI_4 + small } else { small };
    let acute = if steep { FRAC_PI_2 - first } else { first };
    let upper = if x < 0.0 { PI - acute } else { acute };
    f64::from_bits(upper.to_bits() ^ (y.to_bits() & (1 << 63)))
}

/// The nearest integer, of numbers of moderate size.
#[inline(always)]
pub fn round(x: f64) -> f64 {
    (x + ROUND) - ROUND
}

/// The representative of an angle in [-π, π] (rad), for angles of moderate size.
#[inline(always)]
pub fn wrap(angle: f64) -> f64 {
    angle - TAU * round(angle * (1.0 / TAU))
}

/// The greater number, without regard for NaN: one instruction.
#[inline(always)]
pub fn greater(a: f64, b: f64) -> f64 {
    if a > b { a } else { b }
}

/// Writes e to the power `logs` - `shift` into `out` and returns the sum; what is below e^-708 counts as zero.
pub fn exponentials(logs: &[f64], shift: f64, out: &mut Vec<f64>) -> f64 {
    out.clear();
    out.resize(logs.len(), 0.0);
    widest(Exponentials { logs, shift, out })
}

struct Exponentials<'a> {
    logs: &'a [f64],
    shift: f64,
    out: &'a mut [f64],
}

impl pulp::NullaryFnOnce for Exponentials<'_> {
    type Output = f64;

    #[inline(always)]
    fn call(self) -> f64 {
        for (log, out) in self.logs.iter().zip(&mut *self.out) {
            *out = vanishing_exp(log - self.shift);
        }
        sum(self.out)
    }
}

/// The sum of e to the power `logs` - `shift`, as [`exponentials`] but for the order, in storage of fixed size.
pub fn sum_of_exponentials(logs: &[f64], shift: f64) -> f64 {
    let mut total = 0.0;
    each_stretch(logs, shift, |_, stretch| {
        total += sum(stretch);
        true
    });
    total
}

/// Logarithm of the sum of exponentials; minus infinity of none. The largest where that is infinite, NaN where a logarithm
/// is.
pub fn log_sum(logs: &[f64]) -> f64 {
    let largest = largest(logs);
    if logs.iter().any(|log| log.is_nan()) {
        return f64::NAN;
    }
    if !largest.is_finite() {
        return largest;
    }
    if logs.len() < 32 {
        return largest + logs.iter().map(|log| exp(log - largest)).sum::<f64>().ln();
    }
    largest + sum_of_exponentials(logs, largest).ln()
}

/// Calls `visit` with e to the power `logs` - `shift`, a stretch at a time and where it begins, until it returns false.
pub fn each_stretch(logs: &[f64], shift: f64, mut visit: impl FnMut(usize, &[f64]) -> bool) {
    const STRETCH: usize = 512;
    let mut values = [0.0; STRETCH];
    for (number, logs) in logs.chunks(STRETCH).enumerate() {
        let out = &mut values[..logs.len()];
        widest(Exponentials { logs, shift, out: &mut *out });
        if !visit(number * STRETCH, out) {
            break;
        }
    }
}

/// The largest number, minus infinity of none, without regard for NaN: in eight interleaved parts.
#[inline(always)]
pub fn largest(values: &[f64]) -> f64 {
    let mut lanes = [f64::NEG_INFINITY; 8];
    let (chunks, rest) = values.as_chunks::<8>();
    for chunk in chunks {
        for (lane, &value) in lanes.iter_mut().zip(chunk) {
            *lane = greater(value, *lane);
        }
    }
    lanes.iter().chain(rest).fold(f64::NEG_INFINITY, |best, &value| greater(value, best))
}

/// The least number, infinity of none, without regard for NaN: in eight interleaved parts.
#[inline(always)]
pub fn least(values: &[f64]) -> f64 {
    let mut lanes = [f64::INFINITY; 8];
    let (chunks, rest) = values.as_chunks::<8>();
    for chunk in chunks {
        for (lane, &value) in lanes.iter_mut().zip(chunk) {
            *lane = if value < *lane { value } else { *lane };
        }
    }
    lanes.iter().chain(rest).fold(f64::INFINITY, |best, &value| if value < best { value } else { best })
}

/// The sum in eight interleaved parts: a fixed order that vectorises.
#[inline(always)]
pub fn sum(values: &[f64]) -> f64 {
    let mut lanes = [0.0; 8];
    let (chunks, rest) = values.as_chunks::<8>();
    for chunk in chunks {
        for (lane, value) in lanes.iter_mut().zip(chunk) {
            *lane += value;
        }
    }
    lanes.iter().sum::<f64>() + rest.iter().sum::<f64>()
}

/// As [`exp`], zero below its least value.
#[inline(always)]
pub(crate) fn vanishing_exp(x: f64) -> f64 {
    let value = exp(x);
    if x > LOWEST_EXPONENT { value } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_largest_is_found_wherever_it_is() {
        for length in 0..30 {
            for place in 0..length {
                let values: Vec<f64> =
                    (0..length).map(|k| if k == place { -1.0 } else { -2.0 - k as f64 }).collect();
                assert_eq!(largest(&values), -1.0);
                let opposite: Vec<f64> = values.iter().map(|value| -value).collect();
                assert_eq!(least(&opposite), 1.0);
            }
        }
        assert_eq!((largest(&[]), least(&[])), (f64::NEG_INFINITY, f64::INFINITY));
    }

    #[test]
    fn the_exponential_agrees_with_the_library() {
        let mut x = -707.9;
        while x < 20.0 {
            let exact = f64::exp(x);
            assert!((exp(x) / exact - 1.0).abs() < 1e-14, "exp({x})");
            x += 0.013_7;
        }
        assert_eq!(exp(0.0), 1.0);
        assert!(exp(f64::NEG_INFINITY) < 4e-308);
    }

    #[test]
    fn the_logarithm_agrees_with_the_library() {
        let mut x = 1e-300;
        while x < 1e300 {
            assert!((ln(x) - f64::ln(x)).abs() <= 1e-15 * f64::ln(x).abs().max(1.0), "ln({x})");
            x *= 1.003_7;
        }
        assert_eq!(ln(1.0), 0.0);
    }

    #[test]
    fn sines_and_angles_agree_with_the_library() {
        for k in -40_000..40_000 {
            let angle = 0.013_7 * f64::from(k);
            let (sine, cosine) = sin_cos(angle);
            assert!((sine - angle.sin()).abs() < 4e-16 && (cosine - angle.cos()).abs() < 4e-16, "{angle}");
            let (sine, cosine) = sin_cos(25.0 * angle.abs().powi(2));
            let exact = (25.0 * angle.abs().powi(2)).sin_cos();
            let allowed = if 25.0 * angle * angle < LARGEST_ANGLE { 4e-16 } else { 1e-6 };
            assert!((sine - exact.0).abs() < allowed && (cosine - exact.1).abs() < allowed, "{angle}");
            let (x, y) = ((1.0 + angle.abs()) * angle.cos(), (1.0 + angle.abs()) * angle.sin());
            assert!((atan2(y, x) - y.atan2(x)).abs() < 5e-16, "{y} {x}");
        }
        assert_eq!((atan2(0.0, 0.0), atan2(0.0, -1.0), atan2(-2.0, 0.0)), (0.0, PI, -FRAC_PI_2));
        assert!(atan2(f64::NAN, 1.0).is_nan() && sin_cos(f64::NAN).0.is_nan());
    }

    #[test]
    fn wrapping_agrees_with_the_graph() {
        for k in -40..40 {
            let angle = 0.37 * f64::from(k);
            assert!((wrap(angle) - sumprod_graph::wrap_angle(angle)).abs() < 1e-14);
        }
    }
}
