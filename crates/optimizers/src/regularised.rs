//! Regularisation: each particle is drawn anew from a kernel around it, then weighed.
//!
//! Source: Musso, Oudjane, Le Gland, "Improving regularised particle filters" (2001); the kernel is
//! [`CloudKernel`].

use rand_distr::{Distribution, StandardNormal};
use sumprod_graph::FastStream;

use crate::error::OptimizerError;
use crate::frame::CloudKernel;
use crate::moves::{Move, Moved, Validity};
use crate::target::Target;

/// Draws each point from the kernel around its particle, and weighs it by the likelihood.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Regularised {
    scale: f64,
}

impl Default for Regularised {
    /// Silverman's width.
    fn default() -> Self {
        Self { scale: 1.0 }
    }
}

impl Regularised {
    /// A kernel `scale` times as wide as Silverman's.
    ///
    /// # Errors
    ///
    /// Where `scale` is negative or not finite.
    pub fn scaled(scale: f64) -> Result<Self, OptimizerError> {
        Ok(Self { scale: kernel_scale(scale)? })
    }
}

impl Move for Regularised {
    fn advance(&self, target: &mut Target<'_>, random: &mut FastStream) -> Result<Moved, OptimizerError> {
        let kernel = CloudKernel::of(target.prior(), self.scale)?;
        let mut standard = vec![0.0; target.prior().points().len()];
        standard.iter_mut().for_each(|u| *u = StandardNormal.sample(random));
        let (points, log_weights) = weighed_kernels(target, &kernel, &standard)?;
        Moved::weighed(target, points, log_weights)
    }

    fn validity(&self) -> Validity {
        Validity::Smoothed
    }
}

/// Checks the factor of a kernel's width.
pub(crate) fn kernel_scale(scale: f64) -> Result<f64, OptimizerError> {
    if scale.is_finite() && scale >= 0.0 {
        return Ok(scale);
    }
    let must = "it must be finite and not negative";
    Err(OptimizerError::Parameter { what: "the factor of the kernel's width", value: scale, must })
}

/// One point from the kernel of each particle of the prior, at the standard coordinates given, and its log weight:
/// the particle's times the likelihood.
pub(crate) fn weighed_kernels(
    target: &mut Target<'_>,
    kernel: &CloudKernel,
    standard: &[f64],
) -> Result<(Vec<f64>, Vec<f64>), OptimizerError> {
    let prior = target.prior();
    let points = placed(target, kernel, 0..prior.len(), standard);
    let mut log_weights = vec![0.0; prior.len()];
    target.log_likelihood(&points, &mut log_weights)?;
    for (weight, prior) in log_weights.iter_mut().zip(prior.log_weights()) {
        *weight += prior;
    }
    Ok((points, log_weights))
}

/// The points at the standard coordinates given, each in the kernel of the particle that `centres` names.
pub(crate) fn placed(
    target: &Target<'_>,
    kernel: &CloudKernel,
    centres: impl Iterator<Item = usize>,
    standard: &[f64],
) -> Vec<f64> {
    let (prior, d) = (target.prior(), target.dimension());
    let mut points = vec![0.0; standard.len()];
    for ((point, u), centre) in points.chunks_exact_mut(d).zip(standard.chunks_exact(d)).zip(centres) {
        kernel.place(prior.point(centre), u, point);
    }
    target.wrap(&mut points);
    points
}
