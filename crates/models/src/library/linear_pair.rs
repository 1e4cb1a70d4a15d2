//! A linear-Gaussian factor between two variables of one static dimension, for graphs of a single family.

use super::checks::finite;
use nalgebra::{SMatrix, SVector};
use sumprod_graph::{Factor, Incoming, MessageError, Port, Stream};
use sumprod_messages::{Gaussian, GaussianForm};

/// A x₀ + B x₁ ~ N(b, R) by its joint information, all of it computed once: a message is one D by D Cholesky
/// factor and a Schur complement, Λ = J₁₁ - J₁₀ (J₀₀ + Λ₀)⁻¹ J₀₁.
#[derive(Clone, Debug)]
pub struct LinearPair<const D: usize> {
    own: [SMatrix<f64, D, D>; 2],
    /// Block (0, 1) of the joint information.
    cross: SMatrix<f64, D, D>,
    vector: [SVector<f64, D>; 2],
}

impl<const D: usize> LinearPair<D> {
    /// The factor of A, B (both M by D), the target b and the noise covariance R.
    ///
    /// # Errors
    ///
    /// Where an entry, or one of the joint information that follows, is not finite, or R is not positive definite.
    pub fn new<const M: usize>(
        a: &SMatrix<f64, M, D>,
        b: &SMatrix<f64, M, D>,
        target: &SVector<f64, M>,
        covariance: &SMatrix<f64, M, M>,
    ) -> Result<Self, MessageError> {
        finite("an entry of the first matrix", a)?;
        finite("an entry of the second matrix", b)?;
        finite("an entry of the target", target)?;
        finite("an entry of the noise covariance", covariance)?;
        let not_definite = MessageError::NotPositiveDefinite {
            what: "the noise covariance",
            pivot: 0,
            value: covariance[(0, 0)],
        };
        let information = covariance.cholesky().ok_or(not_definite)?.inverse();
        let (weighted_a, weighted_b) = (a.transpose() * information, b.transpose() * information);
        let own = [weighted_a * a, weighted_b * b];
        let cross = weighted_a * b;
        let vector = [weighted_a * target, weighted_b * target];
        finite("an entry of the joint information", own.iter().flatten().chain(&cross))?;
        finite("an entry of the joint information vector", vector.iter().flatten())?;
        Ok(Self { own, cross, vector })
    }

    #[inline]
    fn send(&self, to: Port, incoming: &Gaussian<D>) -> Result<Gaussian<D>, MessageError> {
        let from = 1 - to;
        let mut system = self.own[from] + incoming.information();
        let (mut columns, mut vector) = (
            if to == 1 { self.cross } else { self.cross.transpose() },
            self.vector[from] + incoming.information_vector(),
        );
        // With system L L', half-solved columns C and vector c: Λ = J - C'C and η = h - C'c.
        for k in 0..D {
            let mut pivot = system[(k, k)];
            for j in 0..k {
                pivot -= system[(k, j)] * system[(k, j)];
            }
            let definite = pivot > 0.0;
            if !definite {
                return Err(MessageError::NotPositiveDefinite {
                    what: "the sum over a port",
                    pivot: k,
                    value: pivot,
                });
            }
            let reciprocal = 1.0 / pivot.sqrt();
            for row in k + 1..D {
                let mut value = system[(row, k)];
                for j in 0..k {
                    value -= system[(row, j)] * system[(k, j)];
                }
                system[(row, k)] = value * reciprocal;
            }
            for column in 0..D {
                let mut value = columns[(k, column)];
                for j in 0..k {
                    value -= system[(k, j)] * columns[(j, column)];
                }
                columns[(k, column)] = value * reciprocal;
            }
            let mut value = vector[k];
            for j in 0..k {
                value -= system[(k, j)] * vector[j];
            }
            vector[k] = value * reciprocal;
        }
        let mut information = self.own[to];
        let mut eta = self.vector[to];
        for row in 0..D {
            for column in 0..=row {
                let mut value = information[(row, column)];
                for k in 0..D {
                    value -= columns[(k, row)] * columns[(k, column)];
                }
                information[(row, column)] = value;
                information[(column, row)] = value;
            }
            for k in 0..D {
                eta[row] -= columns[(k, row)] * vector[k];
            }
        }
        Ok(Gaussian::from_information(information, eta))
    }
}

impl<const D: usize> Factor<Gaussian<D>> for LinearPair<D> {
    fn dimensions(&self) -> &[usize] {
        &[D, D]
    }

    fn message(
        &self,
        to: Port,
        incoming: &Incoming<'_, Gaussian<D>>,
        _form: &GaussianForm,
        _stream: &mut Stream,
    ) -> Result<Gaussian<D>, MessageError> {
        self.send(to, incoming.message(1 - to))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix2, Vector2};

    #[test]
    fn numbers_that_are_not_finite_are_refused() {
        let (one, zero) = (Matrix2::identity(), Vector2::zeros());
        assert!(LinearPair::new(&one, &one, &zero, &one).is_ok());
        for bad in [f64::NAN, f64::INFINITY] {
            // Above the diagonal, where a Cholesky factor does not look.
            let matrix = Matrix2::new(1.0, bad, 0.0, 1.0);
            let vector = Vector2::new(0.0, bad);
            for (result, expected) in [
                (LinearPair::new(&matrix, &one, &zero, &one), "an entry of the first matrix"),
                (LinearPair::new(&one, &matrix, &zero, &one), "an entry of the second matrix"),
                (LinearPair::new(&one, &one, &vector, &one), "an entry of the target"),
                (LinearPair::new(&one, &one, &zero, &matrix), "an entry of the noise covariance"),
            ] {
                let error = result.err();
                assert!(
                    matches!(error, Some(MessageError::NotFinite { what, .. }) if what == expected),
                    "{error:?}"
                );
            }
        }
        let overflow = LinearPair::new(&(one * 1e200), &one, &zero, &one).unwrap_err();
        assert_eq!(overflow.to_string(), "an entry of the joint information is inf");
        assert!(LinearPair::new(&one, &one, &zero, &(one * 1e-320)).is_err());
    }
}
