//! A measured displacement between two points of one static dimension, for graphs of a single family.

mod plane;

use super::checks::finite;
use nalgebra::{SMatrix, SVector};
use sumprod_graph::{Factor, Incoming, MessageError, MessageStreams, Port, Stream};
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

impl<const D: usize> Displacement<D> {
    /// Apart, so that the plane's registers are its own.
    #[inline(never)]
    fn one_by_one(
        &self,
        incoming: &Incoming<'_, Gaussian<D>>,
        forms: &[GaussianForm],
        streams: MessageStreams,
        out: &mut [Gaussian<D>],
    ) -> Result<(), (Port, MessageError)> {
        for (to, (out, form)) in out.iter_mut().zip(forms).enumerate() {
            self.message_into(to, incoming, form, &mut streams.of(to), out).map_err(|error| (to, error))?;
        }
        Ok(())
    }
}

/// The inverse of a symmetric matrix; two by two, the case that large graphs are made of, without leaving registers.
#[inline]
fn invert<const D: usize>(matrix: &SMatrix<f64, D, D>) -> Result<SMatrix<f64, D, D>, MessageError> {
    if D != 2 {
        let what = "the sum over a port";
        let failed = || MessageError::NotPositiveDefinite { what, pivot: 0, value: matrix[(0, 0)] };
        return matrix.try_inverse().ok_or_else(failed);
    }
    let (a, b, d) = (matrix[(0, 0)], matrix[(1, 0)], matrix[(1, 1)]);
    let determinant = a * d - b * b;
    let definite = a > 0.0 && determinant > 0.0;
    if !definite {
        return Err(plane::indefinite(a, determinant));
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
        let gain = self.information * invert(&(self.information + other.information()))?;
        let information = gain * other.information();
        let vector = pull + gain * (other.information_vector() - pull);
        *out = Gaussian::from_information((information + information.transpose()) * 0.5, vector);
        Ok(())
    }

    #[inline]
    fn all_messages_into(
        &self,
        incoming: &Incoming<'_, Gaussian<D>>,
        forms: &[GaussianForm],
        streams: MessageStreams,
        out: &mut [Gaussian<D>],
    ) -> Result<(), (Port, MessageError)> {
        if let (true, [first, second]) = (D == 2, &mut *out) {
            let j = &self.information;
            let own = [j[(0, 0)], j[(1, 0)], j[(1, 1)]];
            // The message to port 0 is made from the one at port 1, and the other way round.
            let sent = plane::both_ways(
                own,
                [self.pull[0], self.pull[1]],
                [plane::read(incoming.message(1)), plane::read(incoming.message(0))],
            )?;
            (*first, *second) = (plane::write(sent, 0), plane::write(sent, 1));
            return Ok(());
        }
        self.one_by_one(incoming, forms, streams, out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix2, Vector2};

    #[test]
    fn both_messages_at_once_are_those_one_by_one() {
        let factor = Displacement::new(Vector2::new(1.0, -2.0), Matrix2::new(2.0, 0.5, 0.5, 1.0)).unwrap();
        let known = Gaussian::from_information(Matrix2::new(3.0, -1.0, -1.0, 2.0), Vector2::new(0.5, 4.0));
        // Nothing is known across the direction (1, 1); nothing at all.
        let line = Gaussian::from_information(Matrix2::repeat(0.7), Vector2::repeat(-0.2));
        let nothing = Gaussian::default();
        let sharp = Gaussian::from_information(Matrix2::identity() * 1e9, Vector2::new(1e9, 2e9));
        for messages in [[known, line], [line, nothing], [nothing, sharp], [sharp, known]] {
            let incoming = Incoming::new(&messages, &messages, &[0, 1]);
            let (forms, streams) = ([GaussianForm::default(); 2], MessageStreams::new(1, 1, 0));
            let (mut together, mut apart) = ([nothing; 2], [nothing; 2]);
            factor.all_messages_into(&incoming, &forms, streams, &mut together).unwrap();
            factor.one_by_one(&incoming, &forms, streams, &mut apart).unwrap();
            for (together, apart) in together.iter().zip(&apart) {
                let information = together.information() - apart.information();
                let vector = together.information_vector() - apart.information_vector();
                assert!(information.norm() < 1e-12 && vector.norm() < 1e-11, "{together:?} {apart:?}");
            }
        }
    }

    #[test]
    fn an_indefinite_sum_names_its_port() {
        let factor = Displacement::new(Vector2::zeros(), Matrix2::identity()).unwrap();
        let taken = Gaussian::from_information(-Matrix2::identity() * 2.0, Vector2::zeros());
        let taken = [Gaussian::default(), taken];
        let incoming = Incoming::new(&taken, &taken, &[0, 1]);
        let mut out = [Gaussian::default(); 2];
        let outcome = factor.all_messages_into(
            &incoming,
            &[GaussianForm::default(); 2],
            MessageStreams::new(1, 1, 0),
            &mut out,
        );
        assert!(matches!(outcome, Err((0, MessageError::NotPositiveDefinite { .. }))), "{outcome:?}");
    }

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
