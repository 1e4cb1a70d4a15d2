//! Bearings, alone and with a range, from a planar pose [x, y, heading] to a point.

use super::range::{TOUCHING, distance};
use crate::{Noise, Real, Residual};

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
    pub fn new(measured: f64, dimension: usize, noise: Noise) -> Self {
        Self { measured, target: None, dimensions: vec![3, dimension], noise }
    }

    /// A bearing to a known point (m).
    pub fn to_anchor(measured: f64, anchor: [f64; 2], noise: Noise) -> Self {
        Self { measured, target: Some(anchor), dimensions: vec![3], noise }
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
    let squared = (east * east + north * north).re();
    if squared < TOUCHING * TOUCHING { T::from(0.0) } else { north.atan2(east) }
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
    pub fn new(range: f64, bearing: f64, dimension: usize, noise: Noise) -> Self {
        Self { measured: [range, bearing], target: None, dimensions: vec![3, dimension], noise }
    }

    /// Range and bearing to a known point (m).
    pub fn to_anchor(range: f64, bearing: f64, anchor: [f64; 2], noise: Noise) -> Self {
        Self { measured: [range, bearing], target: Some(anchor), dimensions: vec![3], noise }
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

    fn angles(&self) -> &[usize] {
        &[1]
    }
}
