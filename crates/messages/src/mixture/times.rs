//! A mixture times one Gaussian message.

use super::small::{Small, difference, invert, multiply, wrap_point};
use super::{Mixture, size};
use crate::DynamicGaussian;
use sumprod_graph::{Coordinate, MessageError};

/// exp(g'δ - ½ δ'Λδ) with δ = x - c, angular differences wrapped: a Gaussian message written about a point, so that
/// it lies on the branch of its angles that it was found on, and large coordinates keep their digits.
#[derive(Clone, Copy)]
pub(super) struct Local<'a> {
    pub(super) centre: &'a [f64],
    pub(super) gradient: &'a [f64],
    /// Row-major.
    pub(super) information: &'a [f64],
}

impl Mixture {
    /// This mixture times a Gaussian message, proper or not: a mixture of as many components, in closed form; and
    /// the log of the integral of their product, the message being exp(η'x - ½ x'Λx).
    ///
    /// # Errors
    ///
    /// Where dimensions differ, or Λ is so negative that a component has no product with it.
    pub fn times_gaussian(&self, gaussian: &DynamicGaussian) -> Result<(Self, f64), MessageError> {
        let d = self.dimension();
        size("the Gaussian message", gaussian.dimension(), d)?;
        let mut information = Small::from_elem(0.0, d * d);
        gaussian.write_matrix(&mut information);
        let vector = gaussian.information_vector();
        let mut centre = Small::from_elem(0.0, d);
        if self.coordinates.contains(&Coordinate::Angle)
            && let Ok(moments) = gaussian.moments()
        {
            centre.copy_from_slice(&moments.mean);
        }
        let mut gradient = Small::from_elem(0.0, d);
        multiply(&information, &centre, &mut gradient);
        let mut at_centre = 0.0;
        for k in 0..d {
            at_centre += centre[k] * (vector[k] - 0.5 * gradient[k]);
            gradient[k] = vector[k] - gradient[k];
        }
        let local = Local { centre: &centre, gradient: &gradient, information: &information };
        let (product, total) = self.times_local(local)?;
        Ok((product, total + at_centre))
    }

    /// With δ = m - c and ĝ = g - Λδ, a component (m, C) becomes C' = (C⁻¹ + Λ)⁻¹, m' = m + C'ĝ, and its log weight
    /// grows by ½ ln(|C'| / |C|) + g'δ - ½ δ'Λδ + ½ ĝ'C'ĝ. O(N d³).
    pub(super) fn times_local(&self, local: Local<'_>) -> Result<(Self, f64), MessageError> {
        let d = self.dimension();
        let matrices = if self.shared { 1 } else { self.len() };
        let mut covariances = vec![0.0; matrices * d * d];
        let mut shifts = Vec::with_capacity(matrices);
        for (i, posterior) in covariances.chunks_exact_mut(d * d).enumerate() {
            let mut precision = Small::from_elem(0.0, d * d);
            let prior = invert(self.covariance_of(i), d, &mut precision);
            precision.iter_mut().zip(local.information).for_each(|(a, b)| *a += b);
            let (Some(prior), Some(posterior)) = (prior, invert(&precision, d, posterior)) else {
                let what = "the information of a component times the Gaussian message";
                crate::Cholesky::new(&precision, d, what)?;
                return Err(MessageError::NotPositiveDefinite { what, pivot: 0, value: precision[0] });
            };
            shifts.push(-0.5 * (posterior + prior));
        }
        let mut log_weights = Vec::with_capacity(self.len());
        let mut means = Vec::with_capacity(self.means.len());
        let (mut delta, mut gradient) = (Small::from_elem(0.0, d), Small::from_elem(0.0, d));
        let mut step = Small::from_elem(0.0, d);
        for i in 0..self.len() {
            let matrix = if self.shared { 0 } else { i };
            difference(&self.coordinates, self.mean_of(i), local.centre, &mut delta);
            multiply(local.information, &delta, &mut gradient);
            let mut log = self.log_weights[i] + shifts[matrix];
            for k in 0..d {
                log += delta[k] * (local.gradient[k] - 0.5 * gradient[k]);
                gradient[k] = local.gradient[k] - gradient[k];
            }
            multiply(&covariances[matrix * d * d..][..d * d], &gradient, &mut step);
            log += 0.5 * gradient.iter().zip(&step).map(|(a, b)| a * b).sum::<f64>();
            let start = means.len();
            means.extend(local.centre.iter().zip(&delta).zip(&step).map(|((c, delta), s)| c + delta + s));
            wrap_point(&self.coordinates, &mut means[start..]);
            log_weights.push(log);
        }
        Self::assemble(&self.coordinates, log_weights, means, covariances, self.shared)
    }
}
