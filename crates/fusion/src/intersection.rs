//! Fusion where it is not known what two beliefs share.
//!
//! | rule | fused | of errors |
//! |---|---|---|
//! | [`covariance`] | bᵃ^ω bᵇ^(1-ω) | however correlated |
//! | [`split`] | the same of the correlated parts, times the independent ones | with parts known to be independent |
//! | [`inverse`] | P⁻¹ = Pa⁻¹ + Pb⁻¹ - (ω Pa + (1-ω) Pb)⁻¹ | that share some common information, and no more |
//!
//! ω is the one that makes the fused belief least uncertain; the criterion is convex in ω for Gaussians and found by
//! golden section. No rule claims more than it may: the covariance is at least that of the error. Where one belief is
//! better in every direction, an intersection returns it, and gains nothing.
//!
//! Sources: Julier, Uhlmann, "A non-divergent estimation algorithm in the presence of unknown correlations" (1997);
//! Julier, Uhlmann, "General decentralized data fusion with covariance intersection" (2001), of the split form; Noack,
//! Sijs, Reinhardt, Hanebeck, "Decentralized data fusion with inverse covariance intersection" (2017); powers of
//! densities as in Julier, "An empirical study into the use of Chernoff information for robust, distributed fusion of
//! Gaussian mixture models" (2006).

use nalgebra::{DMatrix, DVector};
use sumprod_graph::{Message, MessageError, Messages, Stream};
use sumprod_messages::{Cholesky, Moments};

use crate::{Criterion, Fusible};

/// Width of the interval of ω at which the search ends.
const FOUND: f64 = 1e-9;

/// A belief in two parts: one whose errors may be correlated with anything, one whose errors are independent of all.
#[derive(Clone, Debug, PartialEq)]
pub struct Split<M> {
    /// The part whose correlations are unknown.
    pub correlated: M,
    /// The part that is new, for instance a sensor's last likelihood.
    pub independent: M,
}

/// Multiplies beliefs of one form.
///
/// # Errors
///
/// Where the family has no such product.
pub(crate) fn product<M: Message>(
    beliefs: &[M],
    form: &M::Form,
    stream: &mut Stream,
) -> Result<M, MessageError> {
    let edges: smallvec::SmallVec<[u32; 8]> = (0..beliefs.len() as u32).collect();
    M::product(Messages::new(beliefs, &edges), form, stream)
}

/// The covariance intersection of two beliefs, and the weight ω of the first. O(30) products.
///
/// # Errors
///
/// Where both beliefs leave the same direction open, or the family has no powers.
pub fn covariance<M: Fusible>(
    a: &M,
    b: &M,
    criterion: Criterion,
    form: &M::Form,
    stream: &mut Stream,
) -> Result<(M, f64), MessageError> {
    let fuse = |weight: f64, stream: &mut Stream| weighted(a, b, weight, form, stream);
    let weight = least(|weight| fuse(weight, stream)?.uncertainty(criterion))?;
    Ok((fuse(weight, stream)?, weight))
}

/// The split covariance intersection of two beliefs, and the weight ω of the first one's correlated part. O(30)
/// products.
///
/// # Errors
///
/// As [`covariance`].
pub fn split<M: Fusible>(
    a: &Split<M>,
    b: &Split<M>,
    criterion: Criterion,
    form: &M::Form,
    stream: &mut Stream,
) -> Result<(Split<M>, f64), MessageError> {
    let independent = product(&[a.independent.clone(), b.independent.clone()], form, stream)?;
    let fuse =
        |weight: f64, stream: &mut Stream| weighted(&a.correlated, &b.correlated, weight, form, stream);
    let weight = least(|weight| {
        let correlated = fuse(weight, stream)?;
        product(&[correlated, independent.clone()], form, stream)?.uncertainty(criterion)
    })?;
    Ok((Split { correlated: fuse(weight, stream)?, independent }, weight))
}

/// The inverse covariance intersection of two Gaussian beliefs, and the weight ω of the first one's covariance.
///
/// # Errors
///
/// Where a belief is improper, or not Gaussian.
pub fn inverse<M: Fusible>(a: &M, b: &M, criterion: Criterion) -> Result<(M, f64), MessageError> {
    a.inverse_intersection(b, criterion)
}

fn weighted<M: Fusible>(
    a: &M,
    b: &M,
    weight: f64,
    form: &M::Form,
    stream: &mut Stream,
) -> Result<M, MessageError> {
    // The ends are beliefs as they stand, so that nothing is lost to a power of zero.
    if weight <= 0.0 {
        return Ok(b.clone());
    }
    if weight >= 1.0 {
        return Ok(a.clone());
    }
    product(&[a.power(weight)?, b.power(1.0 - weight)?], form, stream)
}

/// The weight from 0 to 1 of the least value, by golden section; the ends are asked for themselves. What cannot be
/// computed counts as infinite, and is told where nothing can be.
fn least(mut value: impl FnMut(f64) -> Result<f64, MessageError>) -> Result<f64, MessageError> {
    const RATIO: f64 = 0.618_033_988_749_894_9;
    let mut failure = None;
    let mut at = |weight: f64| {
        value(weight).map_or_else(
            |error| {
                failure.get_or_insert(error);
                f64::INFINITY
            },
            |found| if found.is_nan() { f64::INFINITY } else { found },
        )
    };
    let (mut low, mut high) = (0.0, 1.0);
    let (mut left, mut right) = (1.0 - RATIO, RATIO);
    let ends = [(at(0.0), 0.0), (at(1.0), 1.0)];
    let (mut at_left, mut at_right) = (at(left), at(right));
    while high - low > FOUND {
        if at_left <= at_right {
            (high, right, at_right) = (right, left, at_left);
            left = high - RATIO * (high - low);
            at_left = at(left);
        } else {
            (low, left, at_left) = (left, right, at_right);
            right = low + RATIO * (high - low);
            at_right = at(right);
        }
    }
    let middle = 0.5 * (low + high);
    let (value, weight) =
        ends.into_iter().fold((at(middle), middle), |best, end| if end.0 <= best.0 { end } else { best });
    match failure {
        Some(error) if value.is_infinite() => Err(error),
        _ => Ok(weight),
    }
}

/// Log determinant of a symmetric positive definite row-major matrix.
pub(crate) fn log_determinant(matrix: &[f64], d: usize) -> Result<f64, MessageError> {
    Ok(Cholesky::new(matrix, d, "the belief")?.log_determinant())
}

/// [`inverse`] by moments. With Γ = ω Pa + (1-ω) Pb the mean is P (Pa⁻¹ - ω Γ⁻¹) a + P (Pb⁻¹ - (1-ω) Γ⁻¹) b.
pub(crate) fn inverse_moments(
    a: &Moments,
    b: &Moments,
    criterion: Criterion,
) -> Result<(Moments, f64), MessageError> {
    let d = a.dimension();
    if b.dimension() != d {
        let what = "the other belief";
        return Err(MessageError::Dimension { what, found: b.dimension(), expected: d });
    }
    let matrix = |moments: &Moments| DMatrix::from_row_slice(d, d, &moments.covariance);
    let invert = |matrix: &DMatrix<f64>| {
        let mut inverse = vec![0.0; d * d];
        Cholesky::new(matrix.as_slice(), d, "a covariance of the inverse intersection")?
            .inverse(&mut inverse);
        Ok::<_, MessageError>(DMatrix::from_row_slice(d, d, &inverse))
    };
    let (cov_a, cov_b) = (matrix(a), matrix(b));
    let (info_a, info_b) = (invert(&cov_a)?, invert(&cov_b)?);
    let shared = |weight: f64| invert(&(&cov_a * weight + &cov_b * (1.0 - weight)));
    let fused = |weight: f64| Ok::<_, MessageError>(&info_a + &info_b - shared(weight)?);
    let weight = least(|weight| match criterion {
        Criterion::Determinant => Ok(-0.5 * log_determinant(fused(weight)?.as_slice(), d)?),
        Criterion::Trace => Ok(0.5 * invert(&fused(weight)?)?.trace().ln()),
    })?;
    let (gamma, covariance) = (shared(weight)?, invert(&fused(weight)?)?);
    let (mean_a, mean_b) = (DVector::from_column_slice(&a.mean), DVector::from_column_slice(&b.mean));
    let pulled = (&info_a - &gamma * weight) * mean_a + (&info_b - &gamma * (1.0 - weight)) * mean_b;
    let mean = &covariance * pulled;
    Ok((Moments { mean: mean.as_slice().to_vec(), covariance: covariance.as_slice().to_vec() }, weight))
}
