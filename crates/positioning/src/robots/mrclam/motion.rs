//! One robot's motion by its commands.
//!
//! The state is [x, y, θ, w, v, g]: position (m), heading (rad), the errors of the turn and the forward scale of the
//! odometry, and the scale error of the ranges that the robot's camera reads. Without calibration it is [x, y, θ].

use serde::{Deserialize, Serialize};
use sumprod_models::{Motion, ProcessNoise, Real};

use super::commands::Driven;

/// Variances by which a robot's state wanders, a second.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Drift {
    /// Of the position along each axis (m²/s).
    pub position_variance: f64,
    /// Of the heading (rad²/s).
    pub heading_variance: f64,
    /// Of the turn scale (1/s).
    pub turn_scale_variance: f64,
    /// Of the forward scale (1/s).
    pub forward_scale_variance: f64,
    /// Of the range scale (1/s).
    pub range_scale_variance: f64,
}

/// Number of coordinates of one robot's state.
pub fn dimension(calibrated: bool) -> usize {
    if calibrated { 6 } else { 3 }
}

/// The pose [x, y, θ] after driving: with φ = (1 + w) Δθ, u = θ + φ/2 and s = (1 + v) Δs, it is
/// [x + s cos u, y + s sin u, θ + φ].
pub(super) fn driven_pose<T: Real>(state: &[T], driven: Driven, calibrated: bool) -> [T; 3] {
    let (turn, distance) = if calibrated {
        ((state[3] + 1.0) * driven.turn, (state[4] + 1.0) * driven.distance)
    } else {
        (T::from(driven.turn), T::from(driven.distance))
    };
    let course = state[2] + turn * 0.5;
    [state[0] + course.cos() * distance, state[1] + course.sin() * distance, state[2] + turn]
}

/// A robot that follows its commands for some time.
#[derive(Clone, Copy, Debug)]
pub struct CommandedMotion {
    /// What is commanded.
    pub driven: Driven,
    /// For how long (s).
    pub duration: f64,
    /// How the state wanders meanwhile.
    pub drift: Drift,
    /// Whether the state holds the three scale errors.
    pub calibrated: bool,
}

impl Motion for CommandedMotion {
    fn dimension(&self) -> usize {
        dimension(self.calibrated)
    }

    fn step<T: Real>(&self, state: &[T], next: &mut [T]) {
        next.copy_from_slice(state);
        next[..3].copy_from_slice(&driven_pose(state, self.driven, self.calibrated));
    }

    fn noise(&self, _state: &[f64]) -> ProcessNoise {
        let d = self.dimension();
        let rates = [
            self.drift.position_variance,
            self.drift.position_variance,
            self.drift.heading_variance,
            self.drift.turn_scale_variance,
            self.drift.forward_scale_variance,
            self.drift.range_scale_variance,
        ];
        let mut factor = vec![0.0; d * d];
        for (k, rate) in (0..d).zip(rates) {
            factor[k * d + k] = (rate * self.duration).sqrt();
        }
        ProcessNoise::from_factor(d, &factor)
    }
}
