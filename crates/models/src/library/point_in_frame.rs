//! A point seen from a pose, in the pose's own frame.

use super::checks::{coordinates, finite, size};
use crate::pose::{Pose2, Pose3};
use crate::{Noise, Real, Residual};
use sumprod_graph::MessageError;

/// The measured place z of a point (port 1) in the frame of a pose (port 0): r = R'(p - t) - z.
///
/// With two measured numbers the pose is one of the plane, `[x, y, heading]`; with three it is one of space.
#[derive(Clone, Debug)]
pub struct PointInFrame {
    measured: Vec<f64>,
    dimensions: [usize; 2],
    noise: Noise,
}

impl PointInFrame {
    /// A point (m) whose variable has `dimension` coordinates, its position the first of them.
    ///
    /// # Errors
    ///
    /// Where there are not two or three measured numbers, one is not finite, the variable has fewer coordinates, or
    /// the noise has not as many components.
    pub fn new(measured: &[f64], dimension: usize, noise: Noise) -> Result<Self, MessageError> {
        let n = measured.len();
        if !(n == 2 || n == 3) {
            return Err(MessageError::Dimension { what: "the measured point", found: n, expected: 2 });
        }
        finite("the measured point", measured)?;
        coordinates("the point's position", &[n - 1], dimension)?;
        size("the noise of the point", noise.dimension(), n)?;
        let pose = if n == 2 { 3 } else { 7 };
        Ok(Self { measured: measured.to_vec(), dimensions: [pose, dimension], noise })
    }
}

impl Residual for PointInFrame {
    fn dimensions(&self) -> &[usize] {
        &self.dimensions
    }

    fn noise(&self) -> &Noise {
        &self.noise
    }

    fn residual<T: Real>(&self, x: &[&[T]], out: &mut [T]) {
        if self.measured.len() == 2 {
            out.copy_from_slice(&Pose2::read(x[0]).local([x[1][0], x[1][1]]));
        } else {
            out.copy_from_slice(&Pose3::read(x[0]).local([x[1][0], x[1][1], x[1][2]]));
        }
        for (out, measured) in out.iter_mut().zip(&self.measured) {
            *out -= *measured;
        }
    }
}
