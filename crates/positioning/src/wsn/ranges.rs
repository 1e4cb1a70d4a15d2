//! The ranges of one scan as one residual.

use sumprod_models::library::distance;
use sumprod_models::{Noise, NoiseError, Real, Residual};

use super::world::Reading;

/// Coordinates of the state [x, vx, y, vy] that make the position.
const POSITION: [usize; 2] = [0, 2];

/// What several sensors measure of one state at once: r_j = |p - s_j| - z_j.
#[derive(Clone, Debug)]
pub struct Ranges {
    measured: Vec<([f64; 2], f64)>,
    noise: Noise,
}

impl Ranges {
    /// The readings, at least one, of sensors at these places (m), each of this variance (m²).
    ///
    /// # Errors
    /// Where there is no reading, or the variance is not positive.
    pub fn new(sensors: &[[f64; 2]], readings: &[Reading], variance: f64) -> Result<Self, NoiseError> {
        Ok(Self {
            measured: readings.iter().map(|reading| (sensors[reading.sensor], reading.range)).collect(),
            noise: Noise::isotropic(readings.len(), variance)?,
        })
    }
}

impl Residual for Ranges {
    fn dimensions(&self) -> &[usize] {
        &[4]
    }

    fn noise(&self) -> &Noise {
        &self.noise
    }

    #[inline]
    fn residual<T: Real>(&self, x: &[&[T]], out: &mut [T]) {
        let [east, north] = POSITION;
        for ((place, range), out) in self.measured.iter().zip(out) {
            *out = distance(x[0][east] - place[0], x[0][north] - place[1]) - *range;
        }
    }
}
