//! Predictions and corrections of a mean and a covariance: what Gaussian filters and the motion's Gaussian rule run
//! on.
//!
//! Matrices are row-major slices. The functions are inlined and keep what they compute on the way in storage of the
//! caller's, so that where a caller's dimensions are fixed at compile time their loops are unrolled.

mod sigma;

pub use sigma::{SigmaMoments, SigmaPoints, semidefinite_factor, sigma_moments, sigma_storage};

use crate::dual::{Lanes, differentiate};
use crate::small::Matrix;
use crate::{Chart, Motion, Noise, Residual};
use smallvec::SmallVec;
use std::f64::consts::TAU;
use sumprod_graph::{MessageError, wrap_angle};
use sumprod_messages::Cholesky;

/// The next state f(x) and the Jacobian F at `x`, by dual numbers where it is not constant.
#[inline(always)]
pub fn linearise_motion<M: Motion>(motion: &M, x: &[f64], next: &mut [f64], jacobian: &mut [f64]) {
    if motion.constant_transition(jacobian) {
        motion.step(x, next);
    } else {
        differentiate(x, next, jacobian, |x: &[Lanes], out: &mut [Lanes]| motion.step(x, out));
    }
}

/// The residual of one variable at `x`, angles wrapped, and its Jacobian there, by dual numbers where it has no
/// closed form.
#[inline(always)]
pub fn linearise_residual<R: Residual>(residual: &R, x: &[f64], value: &mut [f64], jacobian: &mut [f64]) {
    let known = residual.degrees_of_freedom() == residual.dimensions()
        && residual.closed_form(&[x], value, jacobian) == Some(Chart::Coordinates);
    if !known {
        differentiate(x, value, jacobian, |x: &[Lanes], out: &mut [Lanes]| residual.residual(&[x], out));
    }
    residual.angles().iter().for_each(|&angle| value[angle] = wrap_angle(value[angle]));
}

/// Writes A B' for A (`rows` by d) and a symmetric B (d by d): the cross-covariance of A x with x.
#[inline(always)]
pub fn cross_covariance(a: &[f64], symmetric: &[f64], d: usize, out: &mut [f64]) {
    for (a, out) in a.chunks_exact(d).zip(out.chunks_exact_mut(d)) {
        out.fill(0.0);
        for (a, row) in a.iter().zip(symmetric.chunks_exact(d)) {
            for (out, b) in out.iter_mut().zip(row) {
                *out += a * b;
            }
        }
    }
}

/// Adds A B' to `out` for A and B of `inner` columns.
#[inline(always)]
pub fn add_product_transposed(a: &[f64], b: &[f64], inner: usize, out: &mut [f64]) {
    let columns = b.len() / inner;
    for (a, out) in a.chunks_exact(inner).zip(out.chunks_exact_mut(columns)) {
        for (out, b) in out.iter_mut().zip(b.chunks_exact(inner)) {
            *out += a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        }
    }
}

/// The covariance F P F' of F x, and F P, its cross-covariance with x.
#[inline(always)]
pub fn propagate(jacobian: &[f64], covariance: &[f64], d: usize, cross: &mut [f64], predicted: &mut [f64]) {
    cross_covariance(jacobian, covariance, d, cross);
    predicted.fill(0.0);
    add_product_transposed(cross, jacobian, d, predicted);
}

/// Replaces a square matrix by the mean of itself and its transpose.
#[inline(always)]
pub fn symmetrise(matrix: &mut [f64], d: usize) {
    crate::small::symmetrise(matrix, d);
}

/// A measurement made linear about a state: the residual there, its Jacobian (m by d) and the covariance (m by m) of
/// the noise and of what the line leaves out.
#[derive(Clone, Copy, Debug)]
pub struct Line<'a> {
    /// The residual at the state's mean.
    pub value: &'a [f64],
    /// The Jacobian, row-major.
    pub jacobian: &'a [f64],
    /// The covariance, row-major.
    pub noise: &'a [f64],
}

/// The covariance to put beside a residual of this value and Jacobian at a state of this covariance P: the noise's
/// own, divided, where the noise has heavy tails, by its weight at the squared length to expect,
/// r'R⁻¹r + tr R⁻¹ J P J', as the residual's Gaussian rule does. Written to `own`.
#[inline(always)]
pub fn noise_against(noise: &Noise, value: &[f64], jacobian: &[f64], covariance: &[f64], own: &mut [f64]) {
    own.copy_from_slice(noise.covariance());
    if noise.degrees_of_freedom().is_some() {
        let (m, d) = (value.len(), covariance.len().isqrt());
        let (mut cross, mut spread) = (Matrix::from_elem(0.0, m * d), Matrix::from_elem(0.0, m * m));
        cross_covariance(jacobian, covariance, d, &mut cross);
        add_product_transposed(&cross, jacobian, d, &mut spread);
        let weight = noise.weight(noise.expected_squared_length(value, &spread));
        own.iter_mut().for_each(|entry| *entry /= weight);
    }
}

/// What a correction found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Corrected<'a> {
    /// log N(e; 0, S) of the residual e.
    pub log_likelihood: f64,
    /// S = J P J' + R, row-major.
    pub innovation_covariance: &'a [f64],
}

/// How many numbers [`correct`] and [`correct_by_regression`] keep for a residual of `m` components.
pub const fn correction_storage(m: usize, d: usize) -> usize {
    3 * m * d + 2 * m * m + m
}

/// Corrects a mean and a covariance by a line: K = P J' S⁻¹, x - K e, and (I - K J) P (I - K J)' + K R K' (Joseph).
///
/// # Errors
///
/// Where the innovation covariance S is not positive definite; mean and covariance are then as before.
///
/// # Panics
///
/// Where `storage` is shorter than [`correction_storage`].
#[inline(always)]
pub fn correct<'a>(
    line: Line<'_>,
    mean: &mut [f64],
    covariance: &mut [f64],
    storage: &'a mut [f64],
) -> Result<Corrected<'a>, MessageError> {
    let (d, m) = (mean.len(), line.value.len());
    let (cross, storage) = storage.split_at_mut(m * d);
    let (rest, storage) = storage.split_at_mut(m * d);
    let (spread, storage) = storage.split_at_mut(m * m);
    cross_covariance(line.jacobian, covariance, d, cross);
    spread.copy_from_slice(line.noise);
    add_product_transposed(cross, line.jacobian, d, spread);
    let Gain { gain, log_likelihood } = gain(line.value, cross, spread, d, storage)?;
    for (gain, value) in gain.chunks_exact(d).zip(line.value) {
        mean.iter_mut().zip(gain).for_each(|(x, gain)| *x -= gain * value);
    }
    // A P = P - K (J P), then (A P) A' = A P - (A P J') K', to which K R K' is added.
    for (gain, cross) in gain.chunks_exact(d).zip(cross.chunks_exact(d)) {
        for (row, gain) in covariance.chunks_exact_mut(d).zip(gain) {
            row.iter_mut().zip(cross).for_each(|(p, cross)| *p -= gain * cross);
        }
    }
    rest.fill(0.0);
    add_product_transposed(covariance, line.jacobian, d, rest);
    for (row, rest) in rest.chunks_exact_mut(m).enumerate() {
        for (k, rest) in rest.iter_mut().enumerate() {
            let noise: f64 = (0..m).map(|j| gain[j * d + row] * line.noise[j * m + k]).sum();
            *rest = noise - *rest;
        }
    }
    for (row, rest) in covariance.chunks_exact_mut(d).zip(rest.chunks_exact(m)) {
        for (rest, gain) in rest.iter().zip(gain.chunks_exact(d)) {
            row.iter_mut().zip(gain).for_each(|(p, gain)| *p += rest * gain);
        }
    }
    symmetrise(covariance, d);
    Ok(Corrected { log_likelihood, innovation_covariance: spread })
}

struct Gain<'a> {
    /// Row k is the gain's column k.
    gain: &'a [f64],
    log_likelihood: f64,
}

/// The gain C' S⁻¹ of a residual r of covariance S (m by m) whose cross-covariance with the state is C (m by d), and
/// log N(r; 0, S).
#[inline(always)]
fn gain<'a>(
    value: &[f64],
    cross: &[f64],
    spread: &[f64],
    d: usize,
    storage: &'a mut [f64],
) -> Result<Gain<'a>, MessageError> {
    let m = value.len();
    let (gain, storage) = storage.split_at_mut(m * d);
    let (factor, storage) = storage.split_at_mut(m * m);
    let innovation = &mut storage[..m];
    factor.copy_from_slice(spread);
    let factor = Cholesky::in_place(factor, m, "the innovation covariance")?;
    gain.copy_from_slice(cross);
    factor.solve_columns(gain, d);
    innovation.copy_from_slice(value);
    let squared = factor.squared_length(innovation);
    let log_likelihood = -0.5 * (squared + factor.log_determinant() + m as f64 * TAU.ln());
    Ok(Gain { gain, log_likelihood })
}

/// Corrects a mean and a covariance by a residual's regression on the state: its mean r, covariance S and
/// cross-covariance with the state C (m by d). m ← m - K r, P ← P - K C with K = C' S⁻¹; returns log N(r; 0, S).
///
/// # Errors
///
/// Where S is not positive definite; mean and covariance are then as before.
///
/// # Panics
///
/// Where `storage` is shorter than [`correction_storage`].
#[inline(always)]
pub fn correct_by_regression(
    value: &[f64],
    cross: &[f64],
    spread: &[f64],
    mean: &mut [f64],
    covariance: &mut [f64],
    storage: &mut [f64],
) -> Result<f64, MessageError> {
    let d = mean.len();
    let Gain { gain, log_likelihood } = gain(value, cross, spread, d, storage)?;
    for ((gain, cross), value) in gain.chunks_exact(d).zip(cross.chunks_exact(d)).zip(value) {
        mean.iter_mut().zip(gain).for_each(|(x, gain)| *x -= gain * value);
        for (row, gain) in covariance.chunks_exact_mut(d).zip(gain) {
            row.iter_mut().zip(cross).for_each(|(p, cross)| *p -= gain * cross);
        }
    }
    symmetrise(covariance, d);
    Ok(log_likelihood)
}

/// Log density of a residual of heavy-tailed noise at a state of this covariance P: the Student-t distribution of the
/// noise's degrees of freedom and scale J P J' + R, which has the tails of the exact one and its spread for small P.
///
/// # Errors
///
/// Where the scale is not positive definite.
pub fn heavy_log_density(
    noise: &Noise,
    value: &[f64],
    jacobian: &[f64],
    covariance: &[f64],
) -> Result<f64, MessageError> {
    let (m, d) = (value.len(), covariance.len().isqrt());
    let mut cross = Matrix::from_elem(0.0, m * d);
    cross_covariance(jacobian, covariance, d, &mut cross);
    let mut scale: SmallVec<[f64; 9]> = SmallVec::from_slice(noise.covariance());
    add_product_transposed(&cross, jacobian, d, &mut scale);
    symmetrise(&mut scale, m);
    let wide = Noise::gaussian(&scale).and_then(|wide| match noise.degrees_of_freedom() {
        Some(nu) => wide.student_t(nu),
        None => Ok(wide),
    });
    match wide {
        Ok(wide) => Ok(wide.log_density(value)),
        Err(error) => Err(MessageError::Unsupported(format!("the innovation's scale: {error}"))),
    }
}

/// A generalised inverse of a symmetric positive semidefinite matrix (row-major), by its own units.
pub fn generalised_inverse(matrix: &[f64], d: usize) -> Vec<f64> {
    crate::small::generalised_inverse(matrix, d).to_vec()
}
