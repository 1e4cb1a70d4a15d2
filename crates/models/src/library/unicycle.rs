//! Planar odometry of a wheeled robot, state [x, y, heading].

use crate::{Motion, ProcessNoise, Real};
use sumprod_graph::MessageError;

/// A distance d driven while the heading turns by φ: x' = x + d cos(θ + φ/2), y' = y + d sin(θ + φ/2), θ' = θ + φ.
///
/// The noise is independent along the track, across it, and in heading.
#[derive(Clone, Debug)]
pub struct Unicycle {
    distance: f64,
    turn: f64,
    /// Standard deviations along, across, and of the heading.
    spread: [f64; 3],
}

impl Unicycle {
    /// `distance` (m) driven while turning by `turn` (rad), with the variances of the error along the track (m²),
    /// across it (m²), and of the turn (rad²).
    ///
    /// # Errors
    ///
    /// Where a number is not finite, or a variance negative.
    pub fn new(distance: f64, turn: f64, variances: [f64; 3]) -> Result<Self, MessageError> {
        for (what, value) in [("the distance driven", distance), ("the turn", turn)] {
            if !value.is_finite() {
                return Err(MessageError::NotFinite { what, value });
            }
        }
        if let Some((pivot, &value)) =
            variances.iter().enumerate().find(|(_, v)| !(**v >= 0.0 && v.is_finite()))
        {
            return Err(MessageError::NotPositiveDefinite { what: "the odometry's variance", pivot, value });
        }
        Ok(Self { distance, turn, spread: variances.map(f64::sqrt) })
    }
}

impl Motion for Unicycle {
    fn dimension(&self) -> usize {
        3
    }

    fn step<T: Real>(&self, state: &[T], next: &mut [T]) {
        let course = state[2] + 0.5 * self.turn;
        next[0] = state[0] + course.cos() * self.distance;
        next[1] = state[1] + course.sin() * self.distance;
        next[2] = state[2] + self.turn;
    }

    fn noise(&self, state: &[f64]) -> ProcessNoise {
        let (sine, cosine) = (state[2] + 0.5 * self.turn).sin_cos();
        let [along, across, heading] = self.spread;
        let factor =
            [cosine * along, -sine * across, 0.0, sine * along, cosine * across, 0.0, 0.0, 0.0, heading];
        ProcessNoise::from_factor(3, &factor)
    }
}
