//! Two-way times of flight to a node that moves before it replies.

use super::{check, kinematics, pursuit};
use crate::library::checks::finite;
use crate::library::range::length;
use crate::{Noise, Real, Residual};
use sumprod_graph::MessageError;

/// Coordinates that a round trip reads of a state.
const KINEMATICS: usize = 6;

/// How long sound travels from an anchor to a node and, `delay` after it came, back, in metres: r = s + |p' - a| - z, with
/// s the path out and p' where the node is when it replies.
///
/// Port 0 is the state at the emission, port 1 one at a later time, from which p' is taken along its velocity; or one
/// state is both.
#[derive(Clone, Debug)]
pub struct RoundTrip {
    measured: f64,
    anchor: [f64; 3],
    speed: f64,
    /// From the node's hearing to its reply (s).
    delay: f64,
    /// From port 0's time to port 1's (s).
    later: f64,
    still: bool,
    dimensions: [usize; 2],
    ports: usize,
    noise: Noise,
}

impl RoundTrip {
    /// A round trip z (m) from an anchor (m), at a speed of sound c (m/s) and a reply after `delay` (s), to a state of
    /// `dimension` coordinates that begins with `[x, vx, y, vy, z, vz]`.
    ///
    /// # Errors
    ///
    /// Where a number is not finite, the speed not positive, the state has fewer than six coordinates, or the noise has
    /// not one component.
    pub fn new(
        measured: f64,
        anchor: [f64; 3],
        speed: f64,
        delay: f64,
        dimension: usize,
        noise: Noise,
    ) -> Result<Self, MessageError> {
        check(measured, &anchor, speed, &noise)?;
        finite("the delay of the reply", &[delay])?;
        if dimension < KINEMATICS {
            let what = "the state of a round trip";
            return Err(MessageError::Dimension { what, found: dimension, expected: KINEMATICS });
        }
        let dimensions = [dimension; 2];
        Ok(Self { measured, anchor, speed, delay, later: 0.0, still: false, dimensions, ports: 1, noise })
    }

    /// The reply is seen from a second state, of a time later by this (s).
    ///
    /// # Errors
    ///
    /// Where it is not finite.
    pub fn replying_from(self, later: f64) -> Result<Self, MessageError> {
        finite("the time between the states of a round trip", &[later])?;
        Ok(Self { later, ports: 2, ..self })
    }

    /// Takes the path out to be the distance at the emission, as if the node moved from its hearing on alone.
    #[must_use]
    pub fn still_outward(self) -> Self {
        Self { still: true, ..self }
    }
}

impl Residual for RoundTrip {
    fn dimensions(&self) -> &[usize] {
        &self.dimensions[..self.ports]
    }

    fn noise(&self) -> &Noise {
        &self.noise
    }

    fn known_place(&self) -> Option<&[f64]> {
        Some(&self.anchor)
    }

    #[inline]
    fn residual<T: Real>(&self, x: &[&[T]], out: &mut [T]) {
        let (position, velocity) = kinematics(x[0]);
        let offset = std::array::from_fn(|k| position[k] - self.anchor[k]);
        let outward = if self.still { length(offset) } else { pursuit(offset, velocity, self.speed) };
        let (position, velocity) = kinematics(x[self.ports - 1]);
        let wait = outward / self.speed + (self.delay - self.later);
        let back = std::array::from_fn::<T, 3, _>(|k| position[k] + velocity[k] * wait - self.anchor[k]);
        out[0] = outward + length(back) - self.measured;
    }
}
