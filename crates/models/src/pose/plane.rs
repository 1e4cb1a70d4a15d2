//! Poses in the plane, SE(2).

use super::{half_cotangent, turn_ratios};
use crate::Real;
use sumprod_graph::wrap_angle;

/// A pose in the plane: position (m) and heading (rad).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose2<T = f64> {
    /// East.
    pub x: T,
    /// North.
    pub y: T,
    /// Counter-clockwise from east.
    pub heading: T,
}

impl<T: Real> Pose2<T> {
    /// The pose stored as `[x, y, heading]`.
    #[inline]
    pub fn read(stored: &[T]) -> Self {
        Self { x: stored[0], y: stored[1], heading: stored[2] }
    }

    /// `[x, y, heading]`.
    #[inline]
    pub fn stored(&self) -> [T; 3] {
        [self.x, self.y, self.heading]
    }

    /// Writes `[x, y, heading]`.
    pub fn write(&self, stored: &mut [T]) {
        (stored[0], stored[1], stored[2]) = (self.x, self.y, self.heading);
    }

    /// A point given in this pose's frame, in the frame the pose is given in.
    #[inline]
    pub fn transform(&self, point: [T; 2]) -> [T; 2] {
        let (sine, cosine) = self.heading.sin_cos();
        [self.x + cosine * point[0] - sine * point[1], self.y + sine * point[0] + cosine * point[1]]
    }

    /// A point in this pose's frame.
    #[inline]
    pub fn local(&self, point: [T; 2]) -> [T; 2] {
        let (sine, cosine) = self.heading.sin_cos();
        let (east, north) = (point[0] - self.x, point[1] - self.y);
        [cosine * east + sine * north, -sine * east + cosine * north]
    }

    /// This pose, then `step` in its frame; the heading is not wrapped.
    #[inline]
    pub fn compose(&self, step: &Self) -> Self {
        let [x, y] = self.transform([step.x, step.y]);
        Self { x, y, heading: self.heading + step.heading }
    }

    /// `other` as seen from this pose: the inverse of this, composed with it.
    #[inline]
    pub fn between(&self, other: &Self) -> Self {
        let [x, y] = self.local([other.x, other.y]);
        Self { x, y, heading: other.heading - self.heading }
    }

    /// The pose reached from the origin by the constant velocity `[vx, vy, ω]` in unit time.
    pub fn exp(velocity: [T; 3]) -> Self {
        let [forward, left, turn] = velocity;
        let [sine, versine, _] = turn_ratios(turn);
        let versine = versine * turn;
        Self { x: sine * forward - versine * left, y: versine * forward + sine * left, heading: turn }
    }

    /// The velocity that reaches this pose in unit time, turning by less than half a turn.
    #[inline]
    pub fn log(&self) -> [T; 3] {
        let turn = self.heading + (wrap_angle(self.heading.re()) - self.heading.re());
        let (cotangent, half) = (half_cotangent(turn), turn * 0.5);
        [cotangent * self.x + half * self.y, cotangent * self.y - half * self.x, turn]
    }
}

impl Pose2<f64> {
    /// The inverse of the right Jacobian at a velocity, row-major: Log(Exp(ξ) Exp(δ)) = ξ + J⁻¹ δ.
    pub fn right_jacobian_inverse(velocity: [f64; 3]) -> [f64; 9] {
        let [forward, left, turn] = velocity;
        let [_, versine, rest] = turn_ratios(turn);
        let rest = rest * turn;
        let (a, b) = (forward * rest - left * versine, forward * versine + left * rest);
        let (cotangent, half) = (half_cotangent(turn), 0.5 * turn);
        [
            cotangent,
            -half,
            -(cotangent * a - half * b),
            half,
            cotangent,
            -(half * a + cotangent * b),
            0.0,
            0.0,
            1.0,
        ]
    }

    /// The adjoint, row-major: X Exp(δ) X⁻¹ = Exp(Ad δ).
    pub fn adjoint(&self) -> [f64; 9] {
        let (sine, cosine) = self.heading.sin_cos();
        [cosine, -sine, self.y, sine, cosine, -self.x, 0.0, 0.0, 1.0]
    }
}
