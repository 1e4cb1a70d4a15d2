//! Sigma points: moments of a function of a Gaussian, by its values at a few points.
//!
//! With L L' = P, the points are the mean and, per column of L, mean ± s L. Values are averaged as offsets from that
//! at the mean, so that angles can be wrapped. Sources: Julier and Uhlmann 2004; Arasaratnam and Haykin 2009.

use sumprod_graph::MessageError;

/// Where sigma points lie and how they are weighted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SigmaPoints {
    /// Distance from the mean in standard deviations.
    spread: f64,
    /// Weight of each point but the mean.
    each: f64,
    /// Sum of the covariance's weights.
    total: f64,
}

impl SigmaPoints {
    /// The 2n points of the cubature rule: s² = n, equal weights.
    pub fn cubature(dimension: usize) -> Self {
        let n = dimension as f64;
        Self { spread: n.sqrt(), each: 0.5 / n, total: 1.0 }
    }

    /// The 2n + 1 points of the scaled unscented transform: s² = α² (n + κ), and β for the mean's part in the
    /// covariance.
    pub fn unscented(dimension: usize, alpha: f64, beta: f64, kappa: f64) -> Self {
        let squared = alpha * alpha * (dimension as f64 + kappa);
        Self { spread: squared.sqrt(), each: 0.5 / squared, total: 2.0 - alpha * alpha + beta }
    }
}

/// Moments of y = f(x) of a Gaussian x.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SigmaMoments<'a> {
    /// Mean of y.
    pub mean: &'a [f64],
    /// Covariance of y (m by m), row-major.
    pub covariance: &'a [f64],
    /// Cross-covariance of y with x (m by n), row-major.
    pub cross: &'a [f64],
}

/// How many numbers [`sigma_moments`] keeps for m values of n coordinates.
pub const fn sigma_storage(m: usize, n: usize) -> usize {
    m * m + m * n + 4 * m + n
}

/// The moments of f, of m values, at a Gaussian of this mean and lower factor L of the covariance (row-major).
///
/// `f` writes y, of length m, for a point; `wrap` brings the angles of a difference of two y into (-π, π].
///
/// # Panics
///
/// Where `storage` is shorter than [`sigma_storage`].
#[inline(always)]
pub fn sigma_moments<'a>(
    points: SigmaPoints,
    at: &[f64],
    lower: &[f64],
    m: usize,
    mut f: impl FnMut(&[f64], &mut [f64]),
    wrap: impl Fn(&mut [f64]),
    storage: &'a mut [f64],
) -> SigmaMoments<'a> {
    let n = at.len();
    let (covariance, storage) = storage.split_at_mut(m * m);
    let (cross, storage) = storage.split_at_mut(m * n);
    let (centre, storage) = storage.split_at_mut(m);
    let (shift, storage) = storage.split_at_mut(m);
    let (above, storage) = storage.split_at_mut(m);
    let (below, storage) = storage.split_at_mut(m);
    let point = &mut storage[..n];
    f(at, centre);
    covariance.fill(0.0);
    cross.fill(0.0);
    shift.fill(0.0);
    point.copy_from_slice(at);
    for column in 0..n {
        for (sign, value) in [(1.0, &mut *above), (-1.0, &mut *below)] {
            for row in column..n {
                point[row] = at[row] + sign * points.spread * lower[row * n + column];
            }
            f(point, value);
            value.iter_mut().zip(&*centre).for_each(|(value, centre)| *value -= centre);
            wrap(value);
        }
        point[column..n].copy_from_slice(&at[column..n]);
        for row in 0..m {
            shift[row] += points.each * (above[row] + below[row]);
            for other in 0..=row {
                covariance[row * m + other] +=
                    points.each * (above[row] * above[other] + below[row] * below[other]);
            }
            let slope = points.each * points.spread * (above[row] - below[row]);
            for k in column..n {
                cross[row * n + k] += slope * lower[k * n + column];
            }
        }
    }
    for row in 0..m {
        for other in 0..=row {
            covariance[row * m + other] += (points.total - 2.0) * shift[row] * shift[other];
            covariance[other * m + row] = covariance[row * m + other];
        }
    }
    centre.iter_mut().zip(&*shift).for_each(|(mean, shift)| *mean += shift);
    SigmaMoments { mean: centre, covariance, cross }
}

/// A lower L with L L' = P for a positive semidefinite P (row-major): a pivot that is zero but for rounding has a
/// zero column.
///
/// # Errors
///
/// Where a pivot is negative beyond rounding, or not finite.
#[inline(always)]
pub fn semidefinite_factor(
    matrix: &[f64],
    d: usize,
    what: &'static str,
    lower: &mut [f64],
) -> Result<(), MessageError> {
    for column in 0..d {
        let diagonal = matrix[column * d + column];
        let mut pivot = diagonal;
        for k in 0..column {
            pivot -= lower[column * d + k] * lower[column * d + k];
        }
        let rounding = 1e-13 * d as f64 * diagonal.abs();
        if !(pivot >= -rounding && pivot.is_finite()) {
            return Err(MessageError::NotPositiveDefinite { what, pivot: column, value: pivot });
        }
        let root = if pivot > rounding { pivot.sqrt() } else { 0.0 };
        let reciprocal = if root > 0.0 { root.recip() } else { 0.0 };
        lower[column * d + column] = root;
        for row in 0..d {
            if row > column {
                let mut value = matrix[row * d + column];
                for k in 0..column {
                    value -= lower[row * d + k] * lower[column * d + k];
                }
                lower[row * d + column] = value * reciprocal;
            } else if row < column {
                lower[row * d + column] = 0.0;
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_factor_of_a_singular_matrix_gives_it_back() {
        let (a, d) = ([4.0, 2.0, 0.0, 2.0, 1.0, 0.0, 0.0, 0.0, 9.0], 3);
        let mut lower = [7.0; 9];
        semidefinite_factor(&a, d, "test", &mut lower).unwrap();
        for row in 0..d {
            for column in 0..d {
                let product: f64 = (0..d).map(|k| lower[row * d + k] * lower[column * d + k]).sum();
                assert!((product - a[row * d + column]).abs() < 1e-14);
            }
        }
        let error = semidefinite_factor(&[1.0, 2.0, 2.0, 1.0], 2, "test", &mut [0.0; 4]).unwrap_err();
        assert_eq!(error, MessageError::NotPositiveDefinite { what: "test", pivot: 1, value: -3.0 });
    }

    /// Of y = x₀² + x₁ with x ~ N(m, P): mean m₀² + P₀₀ + m₁, cross-covariance 2 m₀ P₀· + P₁· for both rules; the
    /// variance's 2 P₀₀² is the unscented rule's for n + κ = 3 without more than one nonlinear coordinate.
    #[test]
    fn quadratic_moments_are_exact() {
        let (at, covariance) = ([1.5, -0.5], [0.4, 0.1, 0.1, 0.3]);
        let mut lower = [0.0; 4];
        semidefinite_factor(&covariance, 2, "test", &mut lower).unwrap();
        let f = |x: &[f64], y: &mut [f64]| y[0] = x[0] * x[0] + x[1];
        for points in [SigmaPoints::cubature(2), SigmaPoints::unscented(2, 1.0, 0.0, 1.0)] {
            let mut storage = [0.0; sigma_storage(1, 2)];
            let found = sigma_moments(points, &at, &lower, 1, f, |_| (), &mut storage);
            assert!((found.mean[0] - (2.25 + 0.4 - 0.5)).abs() < 1e-13);
            assert!((found.cross[0] - (3.0 * 0.4 + 0.1)).abs() < 1e-13);
            assert!((found.cross[1] - (3.0 * 0.1 + 0.3)).abs() < 1e-13);
        }
        let mut storage = [0.0; sigma_storage(1, 2)];
        let points = SigmaPoints::unscented(2, 1.0, 0.0, 1.0);
        let found = sigma_moments(points, &at, &lower, 1, f, |_| (), &mut storage);
        let exact = 9.0 * 0.4 + 2.0 * 3.0 * 0.1 + 0.3 + 2.0 * 0.16;
        assert!((found.covariance[0] - exact).abs() < 1e-13, "{} {exact}", found.covariance[0]);
    }
}
