//! Symmetric positive definite matrices of a few rows, in slices of the caller.

use crate::Cholesky;
use crate::dense::pivot_floor;
use smallvec::SmallVec;
use sumprod_graph::{Coordinate, wrap_angle};

/// A vector or matrix of a component; up to four coordinates without the heap.
pub(crate) type Small = SmallVec<[f64; 16]>;

/// Writes the inverse of the row-major `matrix` into `out` and returns the log determinant; none where the matrix
/// is not positive definite.
pub(crate) fn invert(matrix: &[f64], d: usize, out: &mut [f64]) -> Option<f64> {
    match d {
        1 => {
            out[0] = 1.0 / matrix[0];
            (matrix[0] > 0.0 && out[0].is_finite()).then(|| matrix[0].ln())
        }
        2 => {
            let determinant = matrix[0] * matrix[3] - matrix[2] * matrix[2];
            if !(matrix[0] > 0.0 && determinant > 0.0 && determinant.is_finite()) {
                return None;
            }
            let inverse = 1.0 / determinant;
            out[0] = matrix[3] * inverse;
            out[3] = matrix[0] * inverse;
            out[1] = -matrix[2] * inverse;
            out[2] = out[1];
            Some(determinant.ln())
        }
        3 => Fixed::<3>::new(matrix)?.invert(out),
        4 => Fixed::<4>::new(matrix)?.invert(out),
        _ => {
            let factor = Cholesky::new(matrix, d, "a covariance").ok()?;
            factor.inverse(out);
            Some(factor.log_determinant())
        }
    }
}

/// A Cholesky factor in registers.
struct Fixed<const D: usize> {
    /// Lower triangle; the diagonal holds reciprocals.
    factor: [[f64; D]; D],
    log_determinant: f64,
}

impl<const D: usize> Fixed<D> {
    #[inline(always)]
    fn new(matrix: &[f64]) -> Option<Self> {
        let mut factor = [[0.0; D]; D];
        let mut determinant = 1.0;
        for row in 0..D {
            for column in 0..=row {
                let dot: f64 = (0..column).map(|k| factor[row][k] * factor[column][k]).sum();
                let value = matrix[row * D + column] - dot;
                if column < row {
                    factor[row][column] = value * factor[column][column];
                } else if value > pivot_floor(D, matrix[row * D + row]) && value.is_finite() {
                    determinant *= value;
                    factor[row][row] = 1.0 / value.sqrt();
                } else {
                    return None;
                }
            }
        }
        let log_determinant = if determinant > f64::MIN_POSITIVE && determinant.is_finite() {
            determinant.ln()
        } else {
            (0..D).map(|k| -2.0 * factor[k][k].ln()).sum()
        };
        Some(Self { factor, log_determinant })
    }

    /// Writes W'W with W = L⁻¹.
    #[inline(always)]
    fn invert(self, out: &mut [f64]) -> Option<f64> {
        let mut inverse = [[0.0; D]; D];
        for row in 0..D {
            let (above, below) = inverse.split_at_mut(row);
            for (column, entry) in below[0][..row].iter_mut().enumerate() {
                let dot: f64 = (column..row).map(|k| self.factor[row][k] * above[k][column]).sum();
                *entry = -dot * self.factor[row][row];
            }
            below[0][row] = self.factor[row][row];
        }
        for row in 0..D {
            for column in 0..=row {
                let entry = (row..D).map(|k| inverse[k][row] * inverse[k][column]).sum();
                out[row * D + column] = entry;
                out[column * D + row] = entry;
            }
        }
        Some(self.log_determinant)
    }
}

/// Log determinant of a row-major matrix; none where it is not positive definite.
pub(crate) fn log_determinant(matrix: &[f64], d: usize) -> Option<f64> {
    let determinant = match d {
        1 => matrix[0],
        2 if matrix[0] > 0.0 => matrix[0] * matrix[3] - matrix[2] * matrix[2],
        3 => return Fixed::<3>::new(matrix).map(|factor| factor.log_determinant),
        4 => return Fixed::<4>::new(matrix).map(|factor| factor.log_determinant),
        _ => return whitener(matrix, d).map(|(_, log)| log),
    };
    (determinant > 0.0 && determinant.is_finite()).then(|| determinant.ln())
}

/// Lower Cholesky factor of the row-major `matrix`, the upper triangle zero; none where it is not positive definite.
pub(crate) fn root(matrix: &[f64], d: usize) -> Option<Small> {
    let mut factor = Small::from_elem(0.0, d * d);
    for row in 0..d {
        for column in 0..=row {
            let dot: f64 = (0..column).map(|k| factor[row * d + k] * factor[column * d + k]).sum();
            let value = matrix[row * d + column] - dot;
            if row == column {
                if !(value > 0.0 && value.is_finite()) {
                    return None;
                }
                factor[row * d + row] = value.sqrt();
            } else {
                factor[row * d + column] = value / factor[column * d + column];
            }
        }
    }
    Some(factor)
}

/// Inverse of the lower Cholesky factor of `matrix` and the log determinant of `matrix`: x ↦ W x has unit
/// covariance.
pub(crate) fn whitener(matrix: &[f64], d: usize) -> Option<(Small, f64)> {
    let factor = root(matrix, d)?;
    let mut inverse = Small::from_elem(0.0, d * d);
    let mut log_determinant = 0.0;
    for row in 0..d {
        let pivot = factor[row * d + row];
        log_determinant += 2.0 * pivot.ln();
        inverse[row * d + row] = 1.0 / pivot;
        for column in 0..row {
            let dot: f64 = (column..row).map(|k| factor[row * d + k] * inverse[k * d + column]).sum();
            inverse[row * d + column] = -dot / pivot;
        }
    }
    Some((inverse, log_determinant))
}

/// out = matrix × vector, row-major.
pub(crate) fn multiply(matrix: &[f64], vector: &[f64], out: &mut [f64]) {
    let d = vector.len();
    for (row, value) in out.iter_mut().enumerate().take(d) {
        *value = (0..d).map(|k| matrix[row * d + k] * vector[k]).sum();
    }
}

/// out = W C W', all row-major.
pub(crate) fn congruence(w: &[f64], c: &[f64], d: usize, out: &mut [f64]) {
    let mut half = Small::from_elem(0.0, d * d);
    for row in 0..d {
        for column in 0..d {
            half[row * d + column] = (0..d).map(|k| w[row * d + k] * c[k * d + column]).sum();
        }
    }
    for row in 0..d {
        for column in 0..d {
            out[row * d + column] = (0..d).map(|k| half[row * d + k] * w[column * d + k]).sum();
        }
    }
}

/// out = a - b by coordinate, angular differences wrapped.
pub(crate) fn difference(coordinates: &[Coordinate], a: &[f64], b: &[f64], out: &mut [f64]) {
    for (k, kind) in coordinates.iter().enumerate() {
        let value = a[k] - b[k];
        out[k] = if *kind == Coordinate::Angle { wrap_angle(value) } else { value };
    }
}

/// Brings the angular coordinates of a point into (-π, π].
pub(crate) fn wrap_point(coordinates: &[Coordinate], point: &mut [f64]) {
    for (k, kind) in coordinates.iter().enumerate() {
        if *kind == Coordinate::Angle {
            point[k] = wrap_angle(point[k]);
        }
    }
}

/// The product of two Gaussians, N(x; a, A) N(x; b, B) = N(a; b, A + B) N(x; m, C).
pub(crate) struct Pair {
    /// A (A + B)⁻¹.
    pub(crate) gain: Small,
    /// C = A (A + B)⁻¹ B.
    pub(crate) covariance: Small,
}

impl Pair {
    /// From the covariances A and B; none where their sum is singular.
    pub(crate) fn new(a: &[f64], b: &[f64], d: usize) -> Option<Self> {
        if let ([a], [b]) = (a, b) {
            let gain = a / (a + b);
            let covariance = gain * b;
            let fits = covariance > 0.0 && gain.is_finite();
            return fits.then(|| Self {
                gain: Small::from_slice(&[gain]),
                covariance: Small::from_slice(&[covariance]),
            });
        }
        let mut total = Small::from_elem(0.0, d * d);
        total.iter_mut().zip(a.iter().zip(b)).for_each(|(sum, (x, y))| *sum = x + y);
        let mut inverse = Small::from_elem(0.0, d * d);
        invert(&total, d, &mut inverse)?;
        let mut gain = Small::from_elem(0.0, d * d);
        let mut covariance = total;
        for row in 0..d {
            for column in 0..d {
                let mut sum = 0.0;
                for k in 0..d {
                    sum += a[row * d + k] * inverse[k * d + column];
                }
                gain[row * d + column] = sum;
            }
        }
        for row in 0..d {
            for column in 0..=row {
                let mut sum = 0.0;
                for k in 0..d {
                    sum += gain[row * d + k] * b[k * d + column];
                }
                covariance[row * d + column] = sum;
                covariance[column * d + row] = sum;
            }
        }
        Some(Self { gain, covariance })
    }

    /// m = a + A (A + B)⁻¹ (b - a), appended to `out`.
    pub(crate) fn push_mean(&self, coordinates: &[Coordinate], a: &[f64], b: &[f64], out: &mut Vec<f64>) {
        let d = a.len();
        match (self.gain.as_slice(), coordinates) {
            ([gain], [Coordinate::Real]) => out.push(a[0] + gain * (b[0] - a[0])),
            ([xx, xy, yx, yy], [Coordinate::Real, Coordinate::Real]) => {
                let (x, y) = (b[0] - a[0], b[1] - a[1]);
                out.extend([a[0] + xx * x + xy * y, a[1] + yx * x + yy * y]);
            }
            (gain, _) => {
                let mut offset = Small::from_elem(0.0, d);
                difference(coordinates, b, a, &mut offset);
                let start = out.len();
                for row in 0..d {
                    out.push(a[row] + (0..d).map(|k| gain[row * d + k] * offset[k]).sum::<f64>());
                }
                wrap_point(coordinates, &mut out[start..]);
            }
        }
    }
}
