//! One-way times of flight, heard by a clock that is wrong.

use super::{OFFSET, RATE, WITH_CLOCK, check, kinematics, pursuit};
use crate::library::checks::finite;
use crate::library::range::length;
use crate::{Noise, Real, Residual};
use sumprod_graph::MessageError;

/// What a node's clock reads when it hears an anchor, less when the anchor spoke, in metres:
/// r = (1 + α/c) s + β - z, with s the path of sound to the node.
///
/// The state is that at the emission. Where it is of an earlier time by `age`, position and β are moved on by it.
///
/// The path's derivative is u / (1 - u·v/c) by the position and τ u / (1 - u·v/c) by the velocity, u = (q + v τ) / (c τ):
/// a pseudo-range tells of the velocity.
#[derive(Clone, Debug)]
pub struct PseudoRange {
    measured: f64,
    anchor: [f64; 3],
    speed: f64,
    age: f64,
    still: bool,
    noise: Noise,
}

impl PseudoRange {
    /// A pseudo-range z (m) to an anchor (m), at a speed of sound c (m/s).
    ///
    /// # Errors
    ///
    /// Where a number is not finite, the speed not positive, or the noise has not one component.
    pub fn new(measured: f64, anchor: [f64; 3], speed: f64, noise: Noise) -> Result<Self, MessageError> {
        check(measured, &anchor, speed, &noise)?;
        Ok(Self { measured, anchor, speed, age: 0.0, still: false, noise })
    }

    /// The emission came this long (s) after the state's time; before it where negative.
    ///
    /// # Errors
    ///
    /// Where the age is not finite.
    pub fn aged(self, age: f64) -> Result<Self, MessageError> {
        finite("the age of the state", &[age])?;
        Ok(Self { age, ..self })
    }

    /// Takes the node to stand still at the state's position, whatever its velocity.
    #[must_use]
    pub fn still(self) -> Self {
        Self { still: true, ..self }
    }
}

impl Residual for PseudoRange {
    fn dimensions(&self) -> &[usize] {
        &[WITH_CLOCK]
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
        let path = if self.still {
            length(std::array::from_fn::<T, 3, _>(|k| position[k] - self.anchor[k]))
        } else {
            let offset = std::array::from_fn(|k| position[k] + velocity[k] * self.age - self.anchor[k]);
            pursuit(offset, velocity, self.speed)
        };
        let (offset, rate) = (x[0][OFFSET], x[0][RATE]);
        out[0] = path * (rate / self.speed + 1.0) + offset + rate * self.age - self.measured;
    }
}

/// What a node's clock (port 1) reads when it hears another node (port 0), less what that one's clock read when it spoke,
/// in metres: r = (1 + α₁/c) s + β₁ - β₀ - z. Both states are those at the emission.
#[derive(Clone, Debug)]
pub struct NodePseudoRange {
    measured: f64,
    speed: f64,
    noise: Noise,
}

impl NodePseudoRange {
    /// A pseudo-range z (m) at a speed of sound c (m/s).
    ///
    /// # Errors
    ///
    /// As [`PseudoRange::new`].
    pub fn new(measured: f64, speed: f64, noise: Noise) -> Result<Self, MessageError> {
        check(measured, &[], speed, &noise)?;
        Ok(Self { measured, speed, noise })
    }
}

impl Residual for NodePseudoRange {
    fn dimensions(&self) -> &[usize] {
        &[WITH_CLOCK, WITH_CLOCK]
    }

    fn noise(&self) -> &Noise {
        &self.noise
    }

    #[inline]
    fn residual<T: Real>(&self, x: &[&[T]], out: &mut [T]) {
        let (from, _) = kinematics(x[0]);
        let (to, velocity) = kinematics(x[1]);
        let path = pursuit(std::array::from_fn(|k| to[k] - from[k]), velocity, self.speed);
        out[0] = path * (x[1][RATE] / self.speed + 1.0) + x[1][OFFSET] - x[0][OFFSET] - self.measured;
    }
}
