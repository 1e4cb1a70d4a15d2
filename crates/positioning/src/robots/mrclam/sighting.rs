//! What a camera says of a subject: range and bearing, taken some time before the slice that they are used in.

use serde::{Deserialize, Serialize};
use sumprod_models::library::distance;
use sumprod_models::{Noise, NoiseError, Real, Residual};

use super::commands::Driven;
use super::motion::{dimension, driven_pose};

/// Sightings of one subject closer together than this (s) count as this far apart.
const SHORTEST_GAP_S: f64 = 0.01;

/// The noise of the cameras.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Camera {
    /// Variance of a range at no distance (m²).
    pub range_variance: f64,
    /// What it grows by with the square of the range.
    pub range_variance_growth: f64,
    /// Variance of a bearing (rad²).
    pub bearing_variance: f64,
    /// Time in which the correlation of a camera's errors on one subject falls to 1/e (s); zero if they are white.
    pub correlation_s: f64,
    /// Degrees of freedom of a Student-t distribution; Gaussian if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub degrees_of_freedom: Option<f64>,
}

impl Camera {
    /// How much less a sighting tells than an independent one, `gap` seconds after the same observer's last of the
    /// same subject; none for its first.
    ///
    /// The errors of n sightings correlated by a = exp(-gap/τ) from one to the next (a first-order autoregression of
    /// correlation R and variance σ²) tell of a constant 1'R⁻¹1/σ² = (n (1 - a) + 2a) / ((1 + a) σ²): as much as
    /// n independent ones of (1 + a)/(1 - a) times the variance, which is the factor. Taken as white they make a
    /// filter over-confident where a subject stays in view.
    pub fn variance_factor(&self, gap: Option<f64>) -> f64 {
        match gap {
            Some(gap) if self.correlation_s > 0.0 => {
                let correlation = (-gap.max(SHORTEST_GAP_S) / self.correlation_s).exp();
                (1.0 + correlation) / (1.0 - correlation)
            }
            _ => 1.0,
        }
    }

    /// The noise of a range of this length (m).
    ///
    /// # Errors
    /// Where a variance is not positive.
    pub fn range_noise(&self, range: f64, factor: f64) -> Result<Noise, NoiseError> {
        self.noise((self.range_variance + self.range_variance_growth * range * range) * factor)
    }

    /// The noise of a bearing.
    ///
    /// # Errors
    /// Where a variance is not positive.
    pub fn bearing_noise(&self, factor: f64) -> Result<Noise, NoiseError> {
        self.noise(self.bearing_variance * factor)
    }

    fn noise(&self, variance: f64) -> Result<Noise, NoiseError> {
        let noise = Noise::isotropic(1, variance)?;
        match self.degrees_of_freedom {
            Some(nu) => noise.student_t(nu),
            None => Ok(noise),
        }
    }
}

/// Who saw what, and how far each has driven from the slice back to the sighting.
#[derive(Clone, Debug)]
pub struct Geometry {
    dimensions: Vec<usize>,
    landmark: Option<[f64; 2]>,
    observer: Driven,
    subject: Driven,
    calibrated: bool,
}

impl Geometry {
    /// A robot's sighting of a landmark (m).
    pub fn of_landmark(landmark: [f64; 2], observer: Driven, calibrated: bool) -> Self {
        let dimensions = vec![dimension(calibrated)];
        Self { dimensions, landmark: Some(landmark), observer, subject: Driven::default(), calibrated }
    }

    /// A robot's sighting of another robot: ports observer and subject.
    pub fn of_robot(observer: Driven, subject: Driven, calibrated: bool) -> Self {
        let dimensions = vec![dimension(calibrated); 2];
        Self { dimensions, landmark: None, observer, subject, calibrated }
    }

    /// The offset from observer to subject (m) and the observer's heading (rad) at the time of the sighting.
    fn at_sighting<T: Real>(&self, x: &[&[T]]) -> ([T; 2], T) {
        let observer = driven_pose(x[0], self.observer, self.calibrated);
        let offset = match self.landmark {
            Some([east, north]) => [-observer[0] + east, -observer[1] + north],
            None => {
                let subject = driven_pose(x[1], self.subject, self.calibrated);
                [subject[0] - observer[0], subject[1] - observer[1]]
            }
        };
        (offset, observer[2])
    }
}

/// The range of a sighting: r = (1 + g) |q - p| - z, with g the observer's.
#[derive(Clone, Debug)]
pub struct SightedRange {
    /// Measured range (m).
    pub measured: f64,
    /// Who saw what.
    pub geometry: Geometry,
    /// Its noise.
    pub noise: Noise,
}

impl Residual for SightedRange {
    fn dimensions(&self) -> &[usize] {
        &self.geometry.dimensions
    }

    fn noise(&self) -> &Noise {
        &self.noise
    }

    fn residual<T: Real>(&self, x: &[&[T]], out: &mut [T]) {
        let ([east, north], _) = self.geometry.at_sighting(x);
        let range = distance(east, north);
        let read = if self.geometry.calibrated { range * (x[0][5] + 1.0) } else { range };
        out[0] = read - self.measured;
    }
}

/// The bearing of a sighting: r = atan2(q_y - p_y, q_x - p_x) - θ - z.
#[derive(Clone, Debug)]
pub struct SightedBearing {
    /// Measured bearing from the observer's heading (rad, anticlockwise).
    pub measured: f64,
    /// Who saw what.
    pub geometry: Geometry,
    /// Its noise.
    pub noise: Noise,
}

impl Residual for SightedBearing {
    fn dimensions(&self) -> &[usize] {
        &self.geometry.dimensions
    }

    fn noise(&self) -> &Noise {
        &self.noise
    }

    fn residual<T: Real>(&self, x: &[&[T]], out: &mut [T]) {
        let ([east, north], heading) = self.geometry.at_sighting(x);
        out[0] = north.atan2(east) - heading - self.measured;
    }

    fn angles(&self) -> &[usize] {
        &[0]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sumprod_models::check_residual;

    const CAMERA: Camera = Camera {
        range_variance: 0.0025,
        range_variance_growth: 0.0016,
        bearing_variance: 1.44e-4,
        correlation_s: 4.0,
        degrees_of_freedom: Some(4.0),
    };

    /// Variance of the best estimate of a constant from `n` errors correlated by `a` to the power of their distance:
    /// the inverse of 1'R⁻¹1, which for an autoregression is (1 + a) / (n (1 - a) + 2 a).
    #[test]
    fn the_factor_is_the_limit_of_the_exact_variance() {
        let gap = 0.5;
        let correlation = (-gap / CAMERA.correlation_s).exp();
        let exact = |n: f64| (1.0 + correlation) / (n * (1.0 - correlation) + 2.0 * correlation);
        let n = 1e6;
        assert!((CAMERA.variance_factor(Some(gap)) / (n * exact(n)) - 1.0).abs() < 1e-4);
        assert_eq!(CAMERA.variance_factor(None), 1.0);
        assert!((CAMERA.variance_factor(Some(1e4)) - 1.0).abs() < 1e-12);
        assert!(CAMERA.variance_factor(Some(0.0)).is_finite());
    }

    #[test]
    fn residuals_vanish_at_what_was_seen_and_their_derivatives_are_right() {
        let observer = Driven { distance: -0.1, turn: -0.05 };
        let subject = Driven { distance: -0.2, turn: 0.03 };
        let states: [&[f64]; 2] = [&[1.0, 2.0, 0.4, 0.05, -0.03, 0.02], &[3.0, 1.0, -2.0, 0.0, 0.04, 0.0]];
        let from = driven_pose(states[0], observer, true);
        let to = driven_pose(states[1], subject, true);
        let (east, north) = (to[0] - from[0], to[1] - from[1]);
        let geometry = Geometry::of_robot(observer, subject, true);
        let range = SightedRange {
            measured: 1.02 * east.hypot(north),
            geometry: geometry.clone(),
            noise: CAMERA.range_noise(2.0, 1.0).unwrap(),
        };
        let bearing = SightedBearing {
            measured: north.atan2(east) - from[2],
            geometry,
            noise: CAMERA.bearing_noise(1.0).unwrap(),
        };
        let mut residual = [1.0];
        range.residual(&states, &mut residual);
        assert!(residual[0].abs() < 1e-12);
        bearing.residual(&states, &mut residual);
        assert!(residual[0].abs() < 1e-12);
        check_residual(&range, &states, 1e-6).unwrap();
        check_residual(&bearing, &states, 1e-6).unwrap();
    }
}
