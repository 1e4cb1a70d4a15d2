//! Linear-Gaussian factors of any arity.

use super::checks::{finite, size};
use crate::{Chart, Noise, Real, Residual};
use sumprod_graph::MessageError;

/// Σₖ Aₖ xₖ ~ N(b, R): r(x) = Σₖ Aₖ xₖ - b.
#[derive(Clone, Debug)]
pub struct LinearGaussian {
    /// Per port: the matrix, residual by port dimension, row-major.
    matrices: Vec<Vec<f64>>,
    dimensions: Vec<usize>,
    target: Vec<f64>,
    noise: Noise,
}

impl LinearGaussian {
    /// A factor with one matrix per port (row-major, as many rows as `target` has entries).
    ///
    /// # Errors
    ///
    /// Where there is no matrix, the sizes of matrices, target and noise do not agree, or an entry is not finite.
    pub fn new(matrices: &[&[f64]], target: &[f64], noise: Noise) -> Result<Self, MessageError> {
        let rows = target.len();
        size("the noise", noise.dimension(), rows)?;
        finite("an entry of the target", target)?;
        if matrices.is_empty() {
            return Err(MessageError::Dimension { what: "the list of matrices", found: 0, expected: 1 });
        }
        let mut dimensions = Vec::with_capacity(matrices.len());
        for matrix in matrices {
            if rows == 0 || matrix.is_empty() || !matrix.len().is_multiple_of(rows) {
                return Err(MessageError::Dimension {
                    what: "a matrix",
                    found: matrix.len(),
                    expected: rows,
                });
            }
            finite("an entry of a matrix", *matrix)?;
            dimensions.push(matrix.len() / rows);
        }
        let matrices = matrices.iter().map(|matrix| matrix.to_vec()).collect();
        Ok(Self { matrices, dimensions, target: target.to_vec(), noise })
    }
}

impl Residual for LinearGaussian {
    fn dimensions(&self) -> &[usize] {
        &self.dimensions
    }

    fn noise(&self) -> &Noise {
        &self.noise
    }

    fn residual<T: Real>(&self, x: &[&[T]], out: &mut [T]) {
        for (row, (out, target)) in out.iter_mut().zip(&self.target).enumerate() {
            let mut sum = T::from(-*target);
            for ((matrix, x), &d) in self.matrices.iter().zip(x).zip(&self.dimensions) {
                for (x, entry) in x.iter().zip(&matrix[row * d..]) {
                    sum += *x * *entry;
                }
            }
            *out = sum;
        }
    }

    fn closed_form(&self, x: &[&[f64]], residual: &mut [f64], jacobian: &mut [f64]) -> Option<Chart> {
        self.residual(x, residual);
        let wide = self.dimensions.iter().sum::<usize>();
        for (row, entries) in jacobian.chunks_exact_mut(wide).enumerate() {
            let mut start = 0;
            for (matrix, &d) in self.matrices.iter().zip(&self.dimensions) {
                entries[start..start + d].copy_from_slice(&matrix[row * d..][..d]);
                start += d;
            }
        }
        Some(Chart::Coordinates)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn matrices_that_do_not_fit_are_refused() {
        let error = |matrices: &[&[f64]], target: &[f64], components| {
            let noise = Noise::isotropic(components, 1.0).unwrap();
            LinearGaussian::new(matrices, target, noise).err()
        };
        assert_eq!(error(&[&[1.0, 0.0, 0.0, 1.0], &[1.0, 2.0]], &[0.0; 2], 2), None);
        for (matrices, components, what, found, expected) in [
            (&[&[1.0; 4][..]][..], 3, "the noise", 3, 2),
            (&[&[1.0; 4], &[1.0; 3]], 2, "a matrix", 3, 2),
            (&[&[]], 2, "a matrix", 0, 2),
            (&[], 2, "the list of matrices", 0, 1),
        ] {
            let expected = Some(MessageError::Dimension { what, found, expected });
            assert_eq!(error(matrices, &[0.0; 2], components), expected);
        }
        let infinite = |what| Some(MessageError::NotFinite { what, value: f64::INFINITY });
        assert_eq!(error(&[&[1.0, f64::INFINITY]], &[0.0], 1), infinite("an entry of a matrix"));
        assert_eq!(error(&[&[1.0]], &[f64::INFINITY], 1), infinite("an entry of the target"));
    }
}
