//! What a Gaussian filter refuses.

use nalgebra::DMatrix;
use sumprod_graph::MessageError;
use sumprod_messages::Moments;
use sumprod_models::Residual;

use crate::FilterError;

/// Checks that moments are a distribution of this dimension; a direction may be known exactly.
///
/// # Errors
///
/// [`FilterError::Prior`] with the entry or the eigenvalue that is wrong.
pub(crate) fn distribution(moments: &Moments, dimension: usize) -> Result<(), FilterError> {
    let Moments { mean, covariance } = moments;
    let sizes =
        [("the mean", mean.len(), dimension), ("the covariance", covariance.len(), dimension * dimension)];
    for (what, found, expected) in sizes {
        if found != expected {
            return Err(FilterError::Prior(MessageError::Dimension { what, found, expected }));
        }
    }
    if let Some(&value) = mean.iter().find(|value| !value.is_finite()) {
        return Err(FilterError::Prior(MessageError::NotFinite { what: "an entry of the mean", value }));
    }
    if let Some(&value) = covariance.iter().find(|value| !value.is_finite()) {
        return Err(FilterError::Prior(MessageError::NotFinite {
            what: "an entry of the covariance",
            value,
        }));
    }
    let matrix = DMatrix::from_row_slice(dimension, dimension, covariance);
    let largest = matrix.amax();
    if (&matrix - matrix.transpose()).amax() > 1e-9 * largest {
        return Err(FilterError::Prior(MessageError::Unsupported("the covariance is not symmetric".into())));
    }
    let eigen = matrix.symmetric_eigen();
    match eigen.eigenvalues.iter().enumerate().find(|(_, value)| **value < -1e-12 * largest) {
        Some((pivot, &value)) => Err(FilterError::Prior(MessageError::NotPositiveDefinite {
            what: "the covariance",
            pivot,
            value,
        })),
        None => Ok(()),
    }
}

/// Checks that a residual is of one variable of this dimension.
///
/// # Errors
///
/// The dimension found.
pub(crate) fn measured<R: Residual>(residual: &R, expected: usize) -> Result<(), MessageError> {
    match residual.dimensions() {
        [found] if *found == expected => Ok(()),
        [found] => Err(MessageError::Dimension { what: "the measured state", found: *found, expected }),
        ports => {
            let what = "the list of a measurement's variables";
            Err(MessageError::Dimension { what, found: ports.len(), expected: 1 })
        }
    }
}

/// Checks that what a step made is finite and has no negative variance.
///
/// # Errors
///
/// The first entry that is not, under the name of its matrix.
#[inline(always)]
pub(crate) fn step(mean: &[f64], covariance: &[f64], what: &'static str) -> Result<(), MessageError> {
    // Nothing but what is not finite survives a multiplication by zero.
    let stain = |values: &[f64]| values.iter().map(|value| value * 0.0).sum::<f64>();
    let stain = stain(mean) + stain(covariance);
    let least = covariance.iter().step_by(mean.len() + 1).copied().fold(0.0, f64::min);
    if stain == 0.0 && least >= 0.0 { Ok(()) } else { Err(refused(mean, covariance, what)) }
}

#[cold]
fn refused(mean: &[f64], covariance: &[f64], what: &'static str) -> MessageError {
    if let Some(&value) = mean.iter().chain(covariance).find(|value| !value.is_finite()) {
        return MessageError::NotFinite { what, value };
    }
    let mut variances = covariance.iter().step_by(mean.len() + 1).enumerate();
    let (pivot, &value) = variances.find(|(_, variance)| **variance < 0.0).unwrap_or((0, &f64::NAN));
    MessageError::NotPositiveDefinite { what, pivot, value }
}
