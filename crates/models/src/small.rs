//! Matrix arithmetic on row-major slices, in storage that the caller keeps.

use smallvec::SmallVec;
use sumprod_graph::MessageError;
use sumprod_messages::Cholesky;

/// Storage for a matrix of up to six by six without the heap.
pub(crate) type Matrix = SmallVec<[f64; 36]>;
/// Storage for a vector of up to six without the heap.
pub(crate) type Vector = SmallVec<[f64; 6]>;

pub(crate) fn zeros(count: usize) -> Matrix {
    SmallVec::from_elem(0.0, count)
}

pub(crate) fn zero_vector(count: usize) -> Vector {
    SmallVec::from_elem(0.0, count)
}

/// Adds A (rows by inner) times B (inner by columns) to `out`.
pub(crate) fn multiply_add(a: &[f64], b: &[f64], inner: usize, columns: usize, out: &mut [f64]) {
    for (row, out) in a.chunks_exact(inner).zip(out.chunks_exact_mut(columns)) {
        for (&a, b) in row.iter().zip(b.chunks_exact(columns)) {
            if a != 0.0 {
                for (out, b) in out.iter_mut().zip(b) {
                    *out += a * b;
                }
            }
        }
    }
}

/// A (rows by inner) times B (inner by columns).
pub(crate) fn multiply(a: &[f64], b: &[f64], inner: usize, columns: usize) -> Matrix {
    let mut out = zeros(a.len() / inner * columns);
    multiply_add(a, b, inner, columns, &mut out);
    out
}

/// The transpose of A (rows by columns).
pub(crate) fn transpose(a: &[f64], rows: usize, columns: usize) -> Matrix {
    let mut out = zeros(a.len());
    for row in 0..rows {
        for column in 0..columns {
            out[column * rows + row] = a[row * columns + column];
        }
    }
    out
}

/// Replaces a square matrix by the mean of itself and its transpose.
#[inline(always)]
pub(crate) fn symmetrise(a: &mut [f64], dimension: usize) {
    for row in 0..dimension {
        for column in 0..row {
            let mean = 0.5 * (a[row * dimension + column] + a[column * dimension + row]);
            a[row * dimension + column] = mean;
            a[column * dimension + row] = mean;
        }
    }
}

/// Checks that a square matrix is finite and, but for rounding, its own transpose.
///
/// # Errors
///
/// The first entry that is not.
pub(crate) fn check_symmetric(a: &[f64], dimension: usize, what: &'static str) -> Result<(), MessageError> {
    if let Some(&value) = a.iter().find(|value| !value.is_finite()) {
        return Err(MessageError::NotFinite { what, value });
    }
    let allowed = 1e-9 * a.iter().map(|x| x.abs()).fold(0.0, f64::max);
    for row in 0..dimension {
        for column in 0..row {
            let (below, above) = (a[row * dimension + column], a[column * dimension + row]);
            if (below - above).abs() > allowed {
                return Err(MessageError::Unsupported(format!(
                    "{what} is not symmetric: entry ({row}, {column}) is {below}, entry ({column}, {row}) is {above}"
                )));
            }
        }
    }
    Ok(())
}

/// Solves A X = B by Gaussian elimination with partial pivoting; A (d by d) is overwritten, B (d by columns)
/// becomes X.
pub(crate) fn solve(
    a: &mut [f64],
    dimension: usize,
    b: &mut [f64],
    columns: usize,
    what: &'static str,
) -> Result<(), MessageError> {
    let d = dimension;
    for pivot in 0..d {
        let largest = (pivot..d).max_by(|&i, &j| a[i * d + pivot].abs().total_cmp(&a[j * d + pivot].abs()));
        let row = largest.unwrap_or(pivot);
        let value = a[row * d + pivot];
        if !(value.abs() > 0.0 && value.is_finite()) {
            return Err(MessageError::Unsupported(format!(
                "{what} is singular: pivot {pivot} is {value:.3e}"
            )));
        }
        if row != pivot {
            for column in 0..d {
                a.swap(row * d + column, pivot * d + column);
            }
            for column in 0..columns {
                b.swap(row * columns + column, pivot * columns + column);
            }
        }
        for below in pivot + 1..d {
            let factor = a[below * d + pivot] / value;
            if factor == 0.0 {
                continue;
            }
            for column in pivot..d {
                a[below * d + column] -= factor * a[pivot * d + column];
            }
            for column in 0..columns {
                b[below * columns + column] -= factor * b[pivot * columns + column];
            }
        }
    }
    for row in (0..d).rev() {
        for column in 0..columns {
            let mut value = b[row * columns + column];
            for k in row + 1..d {
                value -= a[row * d + k] * b[k * columns + column];
            }
            b[row * columns + column] = value / a[row * d + row];
        }
    }
    Ok(())
}

/// A generalised inverse G of a symmetric positive semidefinite matrix A, A G A = A: the pseudo-inverse of A scaled
/// to a unit diagonal, so that coordinates of different units are measured alike.
pub(crate) fn generalised_inverse(a: &[f64], dimension: usize) -> Matrix {
    let scales: Vector = (0..dimension)
        .map(|k| {
            let own = a[k * dimension + k];
            if own > 0.0 { own.sqrt().recip() } else { 0.0 }
        })
        .collect();
    let scaled = |row: usize, column: usize| scales[row] * a[row * dimension + column] * scales[column];
    let eigen = nalgebra::DMatrix::from_fn(dimension, dimension, scaled).symmetric_eigen();
    let threshold = 1e-12 * eigen.eigenvalues.amax();
    let mut out = zeros(dimension * dimension);
    for (value, vector) in eigen.eigenvalues.iter().zip(eigen.eigenvectors.column_iter()) {
        if *value > threshold {
            for row in 0..dimension {
                for column in 0..dimension {
                    out[row * dimension + column] +=
                        scales[row] * vector[row] * vector[column] * scales[column] / value;
                }
            }
        }
    }
    out
}

/// A distribution by its moments.
pub(crate) struct Proper {
    pub(crate) mean: Vector,
    pub(crate) covariance: Matrix,
    /// How much correlation inflates a variance at most, maxₖ Λₖₖ Pₖₖ ≥ 1: the digits that the moments have lost.
    pub(crate) inflation: f64,
}

/// Inflation beyond which a direction is open for all that double precision can tell.
const OPEN: f64 = 1e13;
/// Inflation up to which moments serve; beyond it, the information form keeps digits that moments lose.
pub(crate) const WELL_CONDITIONED: f64 = 1e6;

/// The moments of an information form; none where it leaves a direction open, or only rounding closes it.
pub(crate) fn proper(information: &[f64], vector: &[f64]) -> Option<Proper> {
    let d = vector.len();
    let factor = Cholesky::new(information, d, "the information").ok()?;
    let mut covariance = zeros(d * d);
    factor.inverse(&mut covariance);
    let inflation = inflation(information, &covariance, d);
    if inflation >= OPEN {
        return None;
    }
    let mut mean = Vector::from_slice(vector);
    factor.solve(&mut mean);
    Some(Proper { mean, covariance, inflation })
}

/// The inverse of a covariance.
///
/// # Errors
///
/// Where it is not positive definite, or only by rounding.
pub(crate) fn invert(covariance: &[f64], d: usize, what: &'static str) -> Result<Matrix, MessageError> {
    let factor = Cholesky::new(covariance, d, what)?;
    let mut information = zeros(d * d);
    factor.inverse(&mut information);
    let weakest = (0..d).find(|k| covariance[k * d + k] * information[k * d + k] >= OPEN);
    match weakest {
        Some(pivot) => {
            let value = information[pivot * d + pivot].recip();
            Err(MessageError::NotPositiveDefinite { what, pivot, value })
        }
        None => Ok(information),
    }
}

/// The largest product of diagonal entries of a matrix and its inverse.
fn inflation(matrix: &[f64], inverse: &[f64], d: usize) -> f64 {
    (0..d).map(|k| matrix[k * d + k] * inverse[k * d + k]).fold(1.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn elimination_solves_with_pivoting() {
        let a = [0.0, 2.0, 1.0, 1.0, -1.0, 3.0, 4.0, 0.5, -2.0];
        let x = [1.0, -2.0, 0.5];
        let mut b = multiply(&a, &x, 3, 1);
        let mut work = a;
        solve(&mut work, 3, &mut b, 1, "test").unwrap();
        assert!(b.iter().zip(&x).all(|(b, x)| (b - x).abs() < 1e-14));
        assert!(solve(&mut [1.0, 2.0, 2.0, 4.0], 2, &mut [1.0, 1.0], 1, "test").is_err());
    }

    #[test]
    fn the_generalised_inverse_inverts_on_the_range() {
        let a = [2.0, 2.0, 2.0, 2.0];
        let inverse = generalised_inverse(&a, 2);
        let back = multiply(&multiply(&a, &inverse, 2, 2), &a, 2, 2);
        assert!(back.iter().zip(&a).all(|(x, y)| (x - y).abs() < 1e-12));
    }
}
