//! Moving values about their spaces, and measuring how far they are apart.

use crate::pose::{Pose2, Pose3};
use sumprod_graph::{Space, wrap_angle};

/// A space whose values are moved by steps in local coordinates, as many as it has degrees of freedom.
///
/// # Laws
///
/// `retract` by `local(x, y)` takes x to y; by zero it changes nothing; `local` after `retract` gives the step back
/// while rotations stay below half a turn. Local coordinates of real and angular coordinates are differences, of a pose
/// the logarithm in its own frame, translation before rotation.
pub trait Manifold {
    /// Moves `value` by `step`.
    fn retract(&self, value: &mut [f64], step: &[f64]);

    /// Writes the step from `from` to `to`.
    fn local(&self, from: &[f64], to: &[f64], step: &mut [f64]);

    /// Writes the derivative of the stored coordinates by the step, at a step of zero: row-major, dimension by
    /// degrees of freedom. False where it is the identity, and `out` is then arbitrary.
    fn step_derivative(&self, value: &[f64], out: &mut [f64]) -> bool;

    /// Writes the value that stands for an unknown one: zero, or the pose at the origin.
    fn origin(&self, value: &mut [f64]);

    /// Brings a value into its canonical form: angles wrapped, quaternions of unit length.
    fn normalise(&self, value: &mut [f64]);
}

impl Manifold for Space {
    fn retract(&self, value: &mut [f64], step: &[f64]) {
        match self {
            Space::Se2 => {
                let moved = Pose2::read(value).compose(&Pose2::exp([step[0], step[1], step[2]]));
                Pose2 { heading: wrap_angle(moved.heading), ..moved }.write(value);
            }
            Space::Se3 => {
                let step = [step[0], step[1], step[2], step[3], step[4], step[5]];
                Pose3::read(value).compose(&Pose3::exp(step)).normalised().write(value);
            }
            _ => {
                value.iter_mut().zip(step).for_each(|(value, step)| *value += step);
                self.wrap(value);
            }
        }
    }

    fn local(&self, from: &[f64], to: &[f64], step: &mut [f64]) {
        match self {
            Space::Se2 => step.copy_from_slice(&Pose2::read(from).between(&Pose2::read(to)).log()),
            Space::Se3 => step.copy_from_slice(&Pose3::read(from).between(&Pose3::read(to)).log()),
            _ => {
                for ((step, to), from) in step.iter_mut().zip(to).zip(from) {
                    *step = to - from;
                }
                self.wrap(step);
            }
        }
    }

    fn step_derivative(&self, value: &[f64], out: &mut [f64]) -> bool {
        match self {
            Space::Se2 => {
                let (sine, cosine) = value[2].sin_cos();
                out.copy_from_slice(&[cosine, -sine, 0.0, sine, cosine, 0.0, 0.0, 0.0, 1.0]);
                true
            }
            Space::Se3 => {
                let pose = Pose3::read(value);
                out.fill(0.0);
                for (row, entries) in pose.matrix().iter().enumerate() {
                    out[6 * row..][..3].copy_from_slice(entries);
                }
                // q (ω/2, 0): the vector part moves by (w I + [v]) ω / 2, the real part by -v'ω / 2.
                let [x, y, z, w] = pose.rotation.map(|q| 0.5 * q);
                out[6 * 3 + 3..][..3].copy_from_slice(&[w, -z, y]);
                out[6 * 4 + 3..][..3].copy_from_slice(&[z, w, -x]);
                out[6 * 5 + 3..][..3].copy_from_slice(&[-y, x, w]);
                out[6 * 6 + 3..][..3].copy_from_slice(&[-x, -y, -z]);
                true
            }
            _ => false,
        }
    }

    fn origin(&self, value: &mut [f64]) {
        value.fill(0.0);
        if *self == Space::Se3 {
            value[6] = 1.0;
        }
    }

    fn normalise(&self, value: &mut [f64]) {
        match self {
            Space::Se3 => Pose3::read(value).normalised().write(value),
            _ => self.wrap(value),
        }
    }
}
