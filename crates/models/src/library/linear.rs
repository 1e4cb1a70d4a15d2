//! Linear-Gaussian factors of any arity.

use crate::{Noise, Real, Residual};
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
    /// Where the sizes of matrices, target and noise do not agree.
    pub fn new(matrices: &[&[f64]], target: &[f64], noise: Noise) -> Result<Self, MessageError> {
        let rows = target.len();
        if noise.dimension() != rows {
            let (found, expected) = (noise.dimension(), rows);
            return Err(MessageError::Dimension { what: "the noise", found, expected });
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
}
