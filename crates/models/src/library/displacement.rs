//! A measured displacement between two points of one static dimension, for graphs of a single family.

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
    pub fn from_information(displacement: SVector<f64, D>, information: SMatrix<f64, D, D>) -> Self {
        Self { information, pull: information * displacement }
    }

    /// A displacement by its measured value and covariance R.
    ///
    /// # Errors
    ///
    /// Where R is not positive definite.
    pub fn new(displacement: SVector<f64, D>, covariance: SMatrix<f64, D, D>) -> Result<Self, MessageError> {
        let message = Gaussian::from_moments(displacement, covariance)?;
        Ok(Self { information: *message.information(), pull: *message.information_vector() })
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
