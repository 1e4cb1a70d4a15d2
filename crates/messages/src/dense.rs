//! Cholesky factors of small matrices held row by row in slices, without allocation.
//!
//! nalgebra's decompositions own their matrices and its dynamic ones live on the heap; a message's arithmetic
//! happens in storage that the caller keeps.

use smallvec::SmallVec;
use sumprod_graph::MessageError;

/// A lower-triangular Cholesky factor L of a symmetric positive definite matrix A = L L'.
///
/// It is held in storage of its own, or, by [`Cholesky::in_place`], in the caller's.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Cholesky<S = SmallVec<[f64; 36]>> {
    dimension: usize,
    /// Row-major; the strict upper triangle is not read. The diagonal holds 1 / L(i, i).
    factor: S,
}

impl Cholesky {
    /// Factorises the `dimension` by `dimension` row-major `matrix`, of which the lower triangle is read.
    ///
    /// # Errors
    ///
    /// [`MessageError::NotPositiveDefinite`] naming `what` and the pivot; [`MessageError::Dimension`] where the
    /// matrix has too few entries.
    #[inline]
    pub fn new(matrix: &[f64], dimension: usize, what: &'static str) -> Result<Self, MessageError> {
        let Some(entries) = matrix.get(..dimension * dimension) else {
            let (found, expected) = (matrix.len(), dimension * dimension);
            return Err(MessageError::Dimension { what, found, expected });
        };
        Self::in_place(SmallVec::from_slice(entries), dimension, what)
    }
}

impl<S: AsRef<[f64]> + AsMut<[f64]>> Cholesky<S> {
    /// As [`Cholesky::new`], in the storage of the matrix itself.
    ///
    /// # Errors
    ///
    /// As [`Cholesky::new`]; the matrix is then spoilt.
    #[inline(always)]
    pub fn in_place(mut matrix: S, dimension: usize, what: &'static str) -> Result<Self, MessageError> {
        let length = matrix.as_ref().len();
        let Some(factor) = matrix.as_mut().get_mut(..dimension * dimension) else {
            let (found, expected) = (length, dimension * dimension);
            return Err(MessageError::Dimension { what, found, expected });
        };
        for row in 0..dimension {
            let diagonal = factor[row * dimension + row];
            for column in 0..=row {
                let (a, b) = (row * dimension, column * dimension);
                let dot: f64 = (0..column).map(|k| factor[a + k] * factor[b + k]).sum();
                let value = factor[a + column] - dot;
                if column < row {
                    factor[a + column] = value * factor[b + column];
                } else if value > pivot_floor(dimension, diagonal) && value.is_finite() {
                    factor[a + row] = 1.0 / value.sqrt();
                } else {
                    return Err(MessageError::NotPositiveDefinite { what, pivot: row, value });
                }
            }
        }
        Ok(Self { dimension, factor: matrix })
    }

    #[inline(always)]
    fn entries(&self) -> &[f64] {
        self.factor.as_ref()
    }

    /// Solves A x = b in place, `b` of the matrix's dimension.
    pub fn solve(&self, b: &mut [f64]) {
        self.solve_lower(b);
        self.solve_upper(b);
    }

    /// Solves A X = B in place, `b` row-major of this many columns.
    #[inline(always)]
    pub fn solve_columns(&self, b: &mut [f64], columns: usize) {
        let d = self.dimension;
        for row in 0..d {
            let (before, rest) = b.split_at_mut(row * columns);
            let own = &mut rest[..columns];
            for (factor, above) in self.entries()[row * d..].iter().zip(before.chunks_exact(columns)) {
                own.iter_mut().zip(above).for_each(|(own, above)| *own -= factor * above);
            }
            own.iter_mut().for_each(|own| *own *= self.entries()[row * d + row]);
        }
        for row in (0..d).rev() {
            let (before, after) = b.split_at_mut((row + 1) * columns);
            let own = &mut before[row * columns..];
            for (k, below) in (row + 1..d).zip(after.chunks_exact(columns)) {
                let factor = self.entries()[k * d + row];
                own.iter_mut().zip(below).for_each(|(own, below)| *own -= factor * below);
            }
            own.iter_mut().for_each(|own| *own *= self.entries()[row * d + row]);
        }
    }

    /// Solves L y = b in place.
    #[inline(always)]
    pub fn solve_lower(&self, b: &mut [f64]) {
        let d = self.dimension;
        for row in 0..d {
            let dot: f64 = (0..row).map(|k| self.entries()[row * d + k] * b[k]).sum();
            b[row] = (b[row] - dot) * self.entries()[row * d + row];
        }
    }

    /// Solves L' x = b in place.
    pub fn solve_upper(&self, b: &mut [f64]) {
        let d = self.dimension;
        for row in (0..d).rev() {
            let dot: f64 = (row + 1..d).map(|k| self.entries()[k * d + row] * b[k]).sum();
            b[row] = (b[row] - dot) * self.entries()[row * d + row];
        }
    }

    /// Computes L z into `out`, for instance a draw of covariance A from a standard normal `z`.
    pub fn multiply_lower(&self, z: &[f64], out: &mut [f64]) {
        let d = self.dimension;
        for row in 0..d {
            let below: f64 = (0..row).map(|k| self.entries()[row * d + k] * z[k]).sum();
            out[row] = below + z[row] / self.entries()[row * d + row];
        }
    }

    /// Writes the inverse of A, row-major, into `out`.
    pub fn inverse(&self, out: &mut [f64]) {
        let d = self.dimension;
        for column in 0..d {
            let mut unit: SmallVec<[f64; 6]> = SmallVec::from_elem(0.0, d);
            unit[column] = 1.0;
            self.solve(&mut unit);
            for row in 0..d {
                out[row * d + column] = unit[row];
            }
        }
    }

    /// Log determinant of A.
    #[inline(always)]
    pub fn log_determinant(&self) -> f64 {
        let d = self.dimension;
        -2.0 * (0..d).map(|k| self.entries()[k * d + k].ln()).sum::<f64>()
    }

    /// Squared Mahalanobis length x' A⁻¹ x; overwrites `x`.
    #[inline(always)]
    pub fn squared_length(&self, x: &mut [f64]) -> f64 {
        self.solve_lower(x);
        x.iter().map(|y| y * y).sum()
    }
}

/// The pivot below which a positive value is rounding: a singular matrix rarely gives exact zeros.
#[inline]
pub(crate) fn pivot_floor(dimension: usize, diagonal: f64) -> f64 {
    dimension as f64 * f64::EPSILON * diagonal
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_inverse_times_the_matrix_is_the_identity() {
        let a = [4.0, 2.0, -1.0, 2.0, 5.0, 0.5, -1.0, 0.5, 3.0];
        let cholesky = Cholesky::new(&a, 3, "test matrix").unwrap();
        let mut inverse = [0.0; 9];
        cholesky.inverse(&mut inverse);
        for row in 0..3 {
            for column in 0..3 {
                let product: f64 = (0..3).map(|k| a[row * 3 + k] * inverse[k * 3 + column]).sum();
                assert!((product - f64::from(u8::from(row == column))).abs() < 1e-14);
            }
        }
        let mut columns = [1.0, 0.0, 2.0, -1.0, 0.5, 3.0];
        cholesky.solve_columns(&mut columns, 2);
        for (column, b) in [[1.0, 2.0, 0.5], [0.0, -1.0, 3.0]].iter_mut().enumerate() {
            cholesky.solve(b);
            assert!((0..3).all(|row| (columns[row * 2 + column] - b[row]).abs() < 1e-14));
        }
        let determinant: f64 = 4.0 * (15.0 - 0.25) - 2.0 * (6.0 + 0.5) - (1.0 + 5.0);
        assert!((cholesky.log_determinant() - determinant.ln()).abs() < 1e-13);
    }

    #[test]
    fn a_pivot_of_rounding_is_none() {
        // Rank one; in floating point its last pivot is 1e-16.
        let ray = [2.0, -1.0, -1.0, 0.5];
        assert!(Cholesky::new(&ray, 2, "the ray").is_err());
        let near = [2.0, -1.0, -1.0, 0.5 + 1e-12];
        assert!(Cholesky::new(&near, 2, "the ray, nearly").is_ok());
        // Scales of coordinates do not matter.
        assert!(Cholesky::new(&[1e-30, 0.0, 0.0, 1e30], 2, "scales").is_ok());
    }

    #[test]
    fn an_indefinite_matrix_names_its_pivot() {
        let error = Cholesky::new(&[1.0, 2.0, 2.0, 1.0], 2, "the information").unwrap_err();
        assert_eq!(
            error,
            MessageError::NotPositiveDefinite { what: "the information", pivot: 1, value: -3.0 }
        );
    }
}
