//! Poses as Lie groups, written for any [`Real`] number: composition, exponential and logarithm, and the derivatives
//! that residuals between poses need.
//!
//! Steps are taken in the pose's own frame: x moves to x Exp(δ), with δ in the order translation, then rotation.
//! Source: Solà, Deray and Atchuthan (2018), "A micro Lie theory for state estimation in robotics"; Barfoot (2017),
//! "State estimation for robotics", chapter 7.

mod plane;
mod space;

pub use plane::Pose2;
pub use space::Pose3;

use crate::Real;

/// Angle below which series serve, squared (rad²); their first term left out is below rounding.
const SERIES: f64 = 2.5e-3;

/// sin θ / θ, (1 - cos θ) / θ² and (θ - sin θ) / θ³, which are smooth at zero but not as they are written.
fn turn_ratios<T: Real>(angle: T) -> [T; 3] {
    let s = angle * angle;
    if s.re() < SERIES {
        return [
            s * (s * (s / -5040.0 + 1.0 / 120.0) - 1.0 / 6.0) + 1.0,
            s * (s * (s / -40320.0 + 1.0 / 720.0) - 1.0 / 24.0) + 0.5,
            s * (s * (s / -362_880.0 + 1.0 / 5040.0) - 1.0 / 120.0) + 1.0 / 6.0,
        ];
    }
    let sine = angle.sin();
    let half = (angle * 0.5).sin();
    [sine / angle, half * half * 2.0 / s, (angle - sine) / (s * angle)]
}

/// (θ / 2) cot(θ / 2), one at zero.
fn half_cotangent<T: Real>(angle: T) -> T {
    let s = angle * angle;
    if s.re() < SERIES {
        return -s * (s * (s / 30240.0 + 1.0 / 720.0) + 1.0 / 12.0) + 1.0;
    }
    let half = angle * 0.5;
    let (sine, cosine) = half.sin_cos();
    half * cosine / sine
}
