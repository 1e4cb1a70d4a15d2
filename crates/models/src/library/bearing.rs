//! Bearings, alone and with a range, from a planar pose [x, y, heading] to a point.

use super::checks::{coordinates, finite, size};
use super::range::{TOUCHING, distance};
use crate::packed::is_packed;
use crate::{Noise, Real, Residual};
use sumprod_graph::MessageError;

/// The direction of a point seen from a pose, measured from its heading (rad, anticlockwise):
/// r = atan2(q_y - p_y, q_x - p_x) - θ - z.
#[derive(Clone, Debug)]
pub struct Bearing {
    measured: f64,
    target: Option<[f64; 2]>,
    dimensions: Vec<usize>,
    noise: Noise,
}

impl Bearing {
    /// A bearing from a pose (port 0) to a point or pose of `dimension` coordinates (port 1), the first two its
    /// position.
    ///
    /// # Errors
    ///
    /// Where the bearing is not finite, `dimension` is below two, or the noise has not one component.
    pub fn new(measured: f64, dimension: usize, noise: Noise) -> Result<Self, MessageError> {
        finite("the measured bearing", &[measured])?;
        coordinates("the bearing's target", &[0, 1], dimension)?;
        size("the noise of the bearing", noise.dimension(), 1)?;
        Ok(Self { measured, target: None, dimensions: vec![3, dimension], noise })
    }

    /// A bearing to a known point (m).
    ///
    /// # Errors
    ///
    /// Where the bearing or the anchor is not finite, or the noise has not one component.
    pub fn to_anchor(measured: f64, anchor: [f64; 2], noise: Noise) -> Result<Self, MessageError> {
        finite("the measured bearing", &[measured])?;
        finite("the anchor's position", &anchor)?;
        size("the noise of the bearing", noise.dimension(), 1)?;
        Ok(Self { measured, target: Some(anchor), dimensions: vec![3], noise })
    }
}

/// The offset from the pose at port 0 to the target, known or at port 1.
fn offset<T: Real>(x: &[&[T]], target: Option<[f64; 2]>) -> [T; 2] {
    match target {
        Some(anchor) => [-x[0][0] + anchor[0], -x[0][1] + anchor[1]],
        None => [x[1][0] - x[0][0], x[1][1] - x[0][1]],
    }
}

/// The direction of an offset (rad); at coincident points it is left open, without a derivative.
fn direction<T: Real>([east, north]: [T; 2]) -> T {
    let touching = || (east * east + north * north).re() < TOUCHING * TOUCHING;
    if !is_packed::<T>() && touching() { T::from(0.0) } else { north.atan2(east) }
}

impl Residual for Bearing {
    fn dimensions(&self) -> &[usize] {
        &self.dimensions
    }

    fn noise(&self) -> &Noise {
        &self.noise
    }

    fn residual<T: Real>(&self, x: &[&[T]], out: &mut [T]) {
        out[0] = direction(offset(x, self.target)) - x[0][2] - self.measured;
    }

    fn known_place(&self) -> Option<&[f64]> {
        self.target.as_ref().map(<[f64; 2]>::as_slice)
    }

    fn angles(&self) -> &[usize] {
        &[0]
    }
}

/// Range (m) and bearing (rad) of a point seen from a pose.
#[derive(Clone, Debug)]
pub struct RangeBearing {
    measured: [f64; 2],
    target: Option<[f64; 2]>,
    dimensions: Vec<usize>,
    noise: Noise,
}

impl RangeBearing {
    /// Range and bearing from a pose (port 0) to a point or pose of `dimension` coordinates (port 1), the first
    /// two its position.
    ///
    /// # Errors
    ///
    /// Where a measured number is not finite, `dimension` is below two, or the noise has not two components.
    pub fn new(range: f64, bearing: f64, dimension: usize, noise: Noise) -> Result<Self, MessageError> {
        finite("the measured range", &[range])?;
        finite("the measured bearing", &[bearing])?;
        coordinates("the target of range and bearing", &[0, 1], dimension)?;
        size("the noise of range and bearing", noise.dimension(), 2)?;
        Ok(Self { measured: [range, bearing], target: None, dimensions: vec![3, dimension], noise })
    }

    /// Range and bearing to a known point (m).
    ///
    /// # Errors
    ///
    /// Where a measured number or the anchor is not finite, or the noise has not two components.
    pub fn to_anchor(range: f64, bearing: f64, anchor: [f64; 2], noise: Noise) -> Result<Self, MessageError> {
        finite("the measured range", &[range])?;
        finite("the measured bearing", &[bearing])?;
        finite("the anchor's position", &anchor)?;
        size("the noise of range and bearing", noise.dimension(), 2)?;
        Ok(Self { measured: [range, bearing], target: Some(anchor), dimensions: vec![3], noise })
    }
}

impl Residual for RangeBearing {
    fn dimensions(&self) -> &[usize] {
        &self.dimensions
    }

    fn noise(&self) -> &Noise {
        &self.noise
    }

    fn residual<T: Real>(&self, x: &[&[T]], out: &mut [T]) {
        let [east, north] = offset(x, self.target);
        out[0] = distance(east, north) - self.measured[0];
        out[1] = direction([east, north]) - x[0][2] - self.measured[1];
    }

    fn known_place(&self) -> Option<&[f64]> {
        self.target.as_ref().map(<[f64; 2]>::as_slice)
    }

    fn angles(&self) -> &[usize] {
        &[1]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(components: usize) -> Noise {
        Noise::isotropic(components, 1.0).unwrap()
    }

    fn not_finite(result: Result<impl Sized, MessageError>, expected: &str) {
        let error = result.err();
        assert!(matches!(error, Some(MessageError::NotFinite { what, .. }) if what == expected), "{error:?}");
    }

    #[test]
    fn numbers_that_are_not_finite_are_refused() {
        for bad in [f64::NAN, f64::INFINITY] {
            not_finite(Bearing::new(bad, 2, noise(1)), "the measured bearing");
            not_finite(Bearing::to_anchor(bad, [0.0; 2], noise(1)), "the measured bearing");
            not_finite(Bearing::to_anchor(0.0, [0.0, bad], noise(1)), "the anchor's position");
            not_finite(RangeBearing::new(bad, 0.0, 2, noise(2)), "the measured range");
            not_finite(RangeBearing::new(1.0, bad, 2, noise(2)), "the measured bearing");
            not_finite(RangeBearing::to_anchor(bad, 0.0, [0.0; 2], noise(2)), "the measured range");
            not_finite(RangeBearing::to_anchor(1.0, bad, [0.0; 2], noise(2)), "the measured bearing");
            not_finite(RangeBearing::to_anchor(1.0, 0.0, [bad, 0.0], noise(2)), "the anchor's position");
        }
    }

    #[test]
    fn a_target_without_a_position_is_refused() {
        for (dimension, index) in [(0, 0), (1, 1)] {
            assert_eq!(
                Bearing::new(0.1, dimension, noise(1)).unwrap_err(),
                MessageError::Coordinate { what: "the bearing's target", index, dimension }
            );
            assert_eq!(
                RangeBearing::new(1.0, 0.1, dimension, noise(2)).unwrap_err(),
                MessageError::Coordinate { what: "the target of range and bearing", index, dimension }
            );
        }
    }

    #[test]
    fn noise_of_another_size_is_refused() {
        let what = "the noise of the bearing";
        let error = Some(MessageError::Dimension { what, found: 2, expected: 1 });
        assert_eq!(Bearing::new(0.1, 2, noise(2)).err(), error);
        assert_eq!(Bearing::to_anchor(0.1, [0.0; 2], noise(2)).err(), error);
        let what = "the noise of range and bearing";
        let error = Some(MessageError::Dimension { what, found: 1, expected: 2 });
        assert_eq!(RangeBearing::new(1.0, 0.1, 2, noise(1)).err(), error);
        assert_eq!(RangeBearing::to_anchor(1.0, 0.1, [0.0; 2], noise(1)).err(), error);
    }
}
