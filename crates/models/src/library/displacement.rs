//! A measured displacement between two points of one static dimension, for graphs of a single family.

use super::checks::finite;
use nalgebra::{SMatrix, SVector};
use sumprod_graph::{Factor, Incoming, MessageError, Port, Stream};
use sumprod_messages::{Gaussian, GaussianForm};

/// x₁ - x₀ ~ N(z, R), with J = R⁻¹: the message from either end is the other end's moved by z and widened by R,
/// Λ = J (J + Λ₀)⁻¹ Λ₀, written without forming a covariance so that improper messages pass.
#[derive(Clone, Debug)]
pub struct Displacement<const D: usize> {
    information: SMatrix<f64, D, D>,
    /// J z.
    pull: SVector<f64, D>,
}

impl<const D: usize> Displacement<D> {
    /// A displacement by its measured value and information J = R⁻¹.
    ///
    /// # Errors
    ///
    /// Where an entry of the displacement, of J or of their product is not finite.
    pub fn from_information(
        displacement: SVector<f64, D>,
        information: SMatrix<f64, D, D>,
    ) -> Result<Self, MessageError> {
        finite("an entry of the displacement", &displacement)?;
        finite("an entry of the displacement's information", &information)?;
        let pull = information * displacement;
        finite("the displacement weighted by its information", &pull)?;
        Ok(Self { information, pull })
    }

    /// A displacement by its measured value and covariance R.
    ///
    /// # Errors
    ///
    /// Where an entry is not finite, or R is not positive definite.
    pub fn new(displacement: SVector<f64, D>, covariance: SMatrix<f64, D, D>) -> Result<Self, MessageError> {
        finite("an entry of the displacement's covariance", &covariance)?;
        let message = Gaussian::from_moments(displacement, covariance)?;
        Self::from_information(displacement, *message.information())
    }
}

/// The inverse of a symmetric matrix; two by two, the case that large graphs are made of, without leaving registers.
#[inline]
fn invert<const D: usize>(matrix: &SMatrix<f64, D, D>) -> Result<SMatrix<f64, D, D>, MessageError> {
    let failed = |value| MessageError::NotPositiveDefinite { what: "the sum over a port", pivot: 0, value };
    if D != 2 {
        return matrix.try_inverse().ok_or_else(|| failed(matrix[(0, 0)]));
    }
    let (a, b, d) = (matrix[(0, 0)], matrix[(1, 0)], matrix[(1, 1)]);
    let determinant = a * d - b * b;
    let definite = determinant > 0.0;
    if !definite {
        return Err(failed(determinant));
    }
    let scale = 1.0 / determinant;
    let inverse = [d * scale, -b * scale, a * scale];
    Ok(SMatrix::from_fn(|row, column| inverse[row + column]))
}

impl<const D: usize> Factor<Gaussian<D>> for Displacement<D> {
    fn dimensions(&self) -> &[usize] {
        &[D, D]
    }

    fn message(
        &self,
        to: Port,
        incoming: &Incoming<'_, Gaussian<D>>,
        form: &GaussianForm,
        stream: &mut Stream,
    ) -> Result<Gaussian<D>, MessageError> {
        let mut out = Gaussian::default();
        self.message_into(to, incoming, form, stream, &mut out)?;
        Ok(out)
    }

    #[inline]
    fn message_into(
        &self,
        to: Port,
        incoming: &Incoming<'_, Gaussian<D>>,
        _form: &GaussianForm,
        _stream: &mut Stream,
        out: &mut Gaussian<D>,
    ) -> Result<(), MessageError> {
        let other = incoming.message(1 - to);
        let pull = if to == 1 { self.pull } else { -self.pull };
        // Summing the other end out of the joint information [J, -J; -J, J].
        let inverse = invert(&(self.information + other.information()))?;
        let gain = self.information * inverse;
        let information = self.information - gain * self.information;
        let vector = pull + gain * (other.information_vector() - pull);
        *out = Gaussian::from_information(information, vector);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix2, Vector2};

    #[test]
    fn numbers_that_are_not_finite_are_refused() {
        let (shift, one) = (Vector2::new(1.0, -2.0), Matrix2::identity());
        for bad in [f64::NAN, f64::INFINITY] {
            let bad_shift = Vector2::new(0.0, bad);
            // Above the diagonal, where a Cholesky factor does not look.
            let bad_matrix = Matrix2::new(1.0, bad, 0.0, 1.0);
            for result in [
                Displacement::new(bad_shift, one),
                Displacement::new(shift, bad_matrix),
                Displacement::from_information(bad_shift, one),
                Displacement::from_information(shift, bad_matrix),
            ] {
                let error = result.err();
                assert!(matches!(error, Some(MessageError::NotFinite { .. })), "{error:?}");
            }
        }
        let overflow = Displacement::from_information(shift * 1e200, one * 1e200).unwrap_err();
        assert!(overflow.to_string().starts_with("the displacement weighted by its information is"));
        assert!(Displacement::new(shift, one * 1e-320).is_err(), "a covariance without a finite inverse");
    }
}
