//! The noise of a residual.

use crate::small::check_symmetric;
use serde::{Deserialize, Serialize};
use smallvec::SmallVec;
use std::f64::consts::TAU;
use sumprod_graph::MessageError;
use sumprod_messages::Cholesky;
use thiserror::Error;

/// Why a noise model cannot be made.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum NoiseError {
    /// A variance that is not positive and finite.
    #[error("variance {index} is {value}; a variance must be positive and finite")]
    Variance {
        /// Which one.
        index: usize,
        /// Its value.
        value: f64,
    },
    /// A covariance of the wrong size.
    #[error("a covariance of {found} numbers is not square")]
    NotSquare {
        /// How many numbers were given.
        found: usize,
    },
    /// A covariance that is not symmetric positive definite.
    #[error("{0}")]
    Covariance(#[from] MessageError),
    /// Degrees of freedom that are not positive and finite.
    #[error("{0} degrees of freedom; a Student-t distribution needs a positive, finite number")]
    DegreesOfFreedom(f64),
}

/// The distribution of a residual: zero-mean Gaussian or Student-t, with a covariance (of a Student-t, its scale
/// matrix).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Noise {
    dimension: usize,
    covariance: SmallVec<[f64; 9]>,
    information: SmallVec<[f64; 9]>,
    /// Upper triangular W with W'W the information; row-major.
    whitening: SmallVec<[f64; 9]>,
    degrees_of_freedom: Option<f64>,
    log_normaliser: f64,
}

impl Noise {
    /// Gaussian noise of this covariance (row-major).
    ///
    /// # Errors
    ///
    /// Where it is not square, or not symmetric positive definite.
    pub fn gaussian(covariance: &[f64]) -> Result<Self, NoiseError> {
        let dimension = covariance.len().isqrt();
        if dimension * dimension != covariance.len() || dimension == 0 {
            return Err(NoiseError::NotSquare { found: covariance.len() });
        }
        check_symmetric(covariance, dimension, "the noise covariance")?;
        let factor = Cholesky::new(covariance, dimension, "the noise covariance")?;
        let mut information = SmallVec::from_elem(0.0, dimension * dimension);
        factor.inverse(&mut information);
        let log_normaliser = -0.5 * (dimension as f64 * TAU.ln() + factor.log_determinant());
        let covariance = SmallVec::from_slice(covariance);
        let whitening = upper_root(&information, dimension)?;
        Ok(Self { dimension, covariance, information, whitening, degrees_of_freedom: None, log_normaliser })
    }

    /// Gaussian noise of a process covariance, for a solve that divides by it. Where directions are exact, though no
    /// coordinate is, all coordinates get a hundred-millionth more variance: the method of weighting (Van Loan 1985), which
    /// leaves means and covariances wrong by about that share.
    pub(crate) fn held(mut covariance: Vec<f64>) -> Result<Self, MessageError> {
        let d = covariance.len().isqrt();
        if let Some(exact) = (0..d).find(|k| covariance[k * (d + 1)] <= 0.0) {
            return Err(MessageError::Unsupported(format!(
                "its process noise leaves coordinate {exact} of the state exact; make that coordinate a variable of its \
                 own that all steps share, or give it some noise"
            )));
        }
        if least_pivot(&covariance, d) < HELD {
            (0..d).for_each(|k| covariance[k * (d + 1)] *= 1.0 + HELD);
        }
        Self::gaussian(&covariance).map_err(|error| MessageError::Unsupported(error.to_string()))
    }

    /// Independent Gaussian noise of these variances.
    ///
    /// # Errors
    ///
    /// Where a variance is not positive and finite.
    pub fn diagonal(variances: &[f64]) -> Result<Self, NoiseError> {
        let bad = variances.iter().enumerate().find(|(_, value)| !(**value > 0.0 && value.is_finite()));
        if let Some((index, &value)) = bad {
            return Err(NoiseError::Variance { index, value });
        }
        let n = variances.len();
        let mut covariance = vec![0.0; n * n];
        for (k, variance) in variances.iter().enumerate() {
            covariance[k * n + k] = *variance;
        }
        Self::gaussian(&covariance)
    }

    /// Independent Gaussian noise of one variance in each of `dimension` components.
    ///
    /// # Errors
    ///
    /// As [`Noise::diagonal`].
    pub fn isotropic(dimension: usize, variance: f64) -> Result<Self, NoiseError> {
        Self::diagonal(&vec![variance; dimension])
    }

    /// The same scale R with Student-t tails: large residuals lose weight, by (ν + d) / (ν + E r'R⁻¹r) in Gaussian
    /// rules (Lange, Little and Taylor 1989), the expectation being over the beliefs.
    ///
    /// # Errors
    ///
    /// Where ν is not positive and finite.
    pub fn student_t(mut self, degrees_of_freedom: f64) -> Result<Self, NoiseError> {
        if !(degrees_of_freedom > 0.0 && degrees_of_freedom.is_finite()) {
            return Err(NoiseError::DegreesOfFreedom(degrees_of_freedom));
        }
        let (d, nu) = (self.dimension as f64, degrees_of_freedom);
        self.degrees_of_freedom = Some(nu);
        let gaussian = self.log_normaliser + 0.5 * d * TAU.ln();
        self.log_normaliser = gaussian + log_gamma(0.5 * (nu + d))
            - log_gamma(0.5 * nu)
            - 0.5 * d * (nu * std::f64::consts::PI).ln();
        Ok(self)
    }

    /// Number of components.
    pub fn dimension(&self) -> usize {
        self.dimension
    }

    /// The covariance, or of a Student-t its scale matrix; row-major.
    pub fn covariance(&self) -> &[f64] {
        &self.covariance
    }

    /// The inverse of [`Noise::covariance`]; row-major.
    pub fn information(&self) -> &[f64] {
        &self.information
    }

    /// Degrees of freedom of a Student-t; none of a Gaussian.
    pub fn degrees_of_freedom(&self) -> Option<f64> {
        self.degrees_of_freedom
    }

    /// Normalised log density of a residual.
    #[inline]
    pub fn log_density(&self, residual: &[f64]) -> f64 {
        let squared = self.squared_length(residual);
        match self.degrees_of_freedom {
            None => self.log_normaliser - 0.5 * squared,
            Some(nu) => self.log_normaliser - 0.5 * (nu + self.dimension as f64) * (squared / nu).ln_1p(),
        }
    }

    /// The largest log density there is, that of a zero residual.
    pub fn log_peak(&self) -> f64 {
        self.log_normaliser
    }

    /// Multiplies a matrix of as many rows as the noise has components (row-major) by W, W'W = R⁻¹: residuals become
    /// independent with unit variance. In place.
    #[inline]
    pub fn whiten(&self, rows: &mut [f64]) {
        let d = self.dimension;
        let columns = rows.len() / d;
        for row in 0..d {
            let (head, below) = rows[row * columns..].split_at_mut(columns);
            let own = self.whitening[row * d + row];
            head.iter_mut().for_each(|entry| *entry *= own);
            for (offset, other) in below.chunks_exact(columns).enumerate() {
                let weight = self.whitening[row * d + row + 1 + offset];
                if weight != 0.0 {
                    head.iter_mut().zip(other).for_each(|(entry, other)| *entry += weight * other);
                }
            }
        }
    }

    /// Squared Mahalanobis length r'R⁻¹r.
    #[inline]
    pub fn squared_length(&self, residual: &[f64]) -> f64 {
        let d = self.dimension;
        if d == 1 {
            return residual[0] * residual[0] * self.information[0];
        }
        let mut sum = 0.0;
        for row in 0..d {
            let dot: f64 = (0..d).map(|column| self.information[row * d + column] * residual[column]).sum();
            sum += residual[row] * dot;
        }
        sum
    }

    /// E r'R⁻¹r = r̄'R⁻¹r̄ + tr R⁻¹V for a residual of mean r̄ and covariance V (row-major).
    pub fn expected_squared_length(&self, mean: &[f64], covariance: &[f64]) -> f64 {
        let trace: f64 = self.information.iter().zip(covariance).map(|(w, v)| w * v).sum();
        self.squared_length(mean) + trace
    }

    /// The weight a Gaussian rule gives a residual of this squared length: one for Gaussian noise.
    pub fn weight(&self, squared_length: f64) -> f64 {
        match self.degrees_of_freedom {
            None => 1.0,
            Some(nu) => (nu + self.dimension as f64) / (nu + squared_length),
        }
    }
}

/// The share of its own variance that is added to each coordinate of a process noise that is singular.
const HELD: f64 = 1e-8;

/// The smallest pivot of the Cholesky factor of a covariance, as a share of the coordinate's variance.
fn least_pivot(covariance: &[f64], d: usize) -> f64 {
    let mut rest = covariance.to_vec();
    let mut least = f64::INFINITY;
    for k in 0..d {
        let pivot = rest[k * (d + 1)];
        least = least.min(pivot / covariance[k * (d + 1)]);
        if pivot <= 0.0 {
            return 0.0;
        }
        for row in k + 1..d {
            let factor = rest[row * d + k] / pivot;
            for column in k + 1..d {
                rest[row * d + column] -= factor * rest[k * d + column];
            }
        }
    }
    least
}

/// The transposed Cholesky factor of a symmetric positive definite matrix (row-major).
fn upper_root(matrix: &[f64], dimension: usize) -> Result<SmallVec<[f64; 9]>, MessageError> {
    let factor = Cholesky::new(matrix, dimension, "the inverse of the noise covariance")?;
    let mut root = SmallVec::from_elem(0.0, dimension * dimension);
    for column in 0..dimension {
        let (mut unit, mut image): (SmallVec<[f64; 6]>, SmallVec<[f64; 6]>) =
            (SmallVec::from_elem(0.0, dimension), SmallVec::from_elem(0.0, dimension));
        unit[column] = 1.0;
        factor.multiply_lower(&unit, &mut image);
        root[column * dimension..][..dimension].copy_from_slice(&image);
    }
    Ok(root)
}

/// Log gamma function by Lanczos' series with g = 7 and nine terms; relative error below 1e-14 for x > 0.
fn log_gamma(x: f64) -> f64 {
    const COEFFICIENTS: [f64; 9] = [
        0.999_999_999_999_809_9,
        676.520_368_121_885_1,
        -1_259.139_216_722_402_8,
        771.323_428_777_653_1,
        -176.615_029_162_140_6,
        12.507_343_278_686_905,
        -0.138_571_095_265_720_12,
        9.984_369_578_019_572e-6,
        1.505_632_735_149_311_6e-7,
    ];
    if x < 0.5 {
        use std::f64::consts::PI;
        return (PI / (PI * x).sin()).ln() - log_gamma(1.0 - x);
    }
    let x = x - 1.0;
    let series = COEFFICIENTS[1..]
        .iter()
        .enumerate()
        .fold(COEFFICIENTS[0], |sum, (k, c)| sum + c / (x + k as f64 + 1.0));
    let t = x + 7.5;
    0.5 * TAU.ln() + (x + 0.5) * t.ln() - t + series.ln()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn densities_integrate_to_one() {
        let gaussian = Noise::isotropic(1, 4.0).unwrap();
        let student = Noise::isotropic(1, 4.0).unwrap().student_t(3.0).unwrap();
        for (noise, reach, tolerance) in [(gaussian, 40.0, 1e-9), (student, 4000.0, 1e-6)] {
            let step = 0.01;
            let count = (2.0 * reach / step) as usize;
            let sum: f64 =
                (0..count).map(|k| noise.log_density(&[-reach + (k as f64 + 0.5) * step]).exp() * step).sum();
            assert!((sum - 1.0).abs() < tolerance, "{sum}");
        }
    }

    #[test]
    fn log_gamma_at_known_points() {
        for (x, exact) in [(1.0, 0.0), (0.5, std::f64::consts::PI.sqrt().ln()), (5.0, 24.0_f64.ln())] {
            assert!((log_gamma(x) - exact).abs() < 1e-13);
        }
    }

    #[test]
    fn bad_noise_is_refused_with_its_numbers() {
        assert_eq!(Noise::diagonal(&[1.0, -2.0]), Err(NoiseError::Variance { index: 1, value: -2.0 }));
        assert!(Noise::gaussian(&[1.0, 2.0, 2.0, 1.0]).is_err());
        assert_eq!(Noise::gaussian(&[1.0, 2.0]), Err(NoiseError::NotSquare { found: 2 }));
        assert!(Noise::isotropic(1, 1.0).unwrap().student_t(0.0).is_err());
    }
}
