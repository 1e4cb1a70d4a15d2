//! The space a variable lives in: real and angular coordinates, or finitely many states.

use serde::{Deserialize, Serialize};
use std::f64::consts::{PI, TAU};

/// One coordinate of a continuous variable.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Coordinate {
    /// The real line.
    Real,
    /// The circle, in radians; values that differ by a full turn are the same.
    Angle,
}

/// The space a variable lives in.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Space {
    /// A product of lines and circles, one entry per coordinate.
    Continuous(Vec<Coordinate>),
    /// Finitely many states, numbered from zero.
    Finite(usize),
}

impl Space {
    /// `dimension` real coordinates.
    pub fn real(dimension: usize) -> Self {
        Self::Continuous(vec![Coordinate::Real; dimension])
    }

    /// Continuous coordinates in the order given.
    pub fn new(coordinates: impl Into<Vec<Coordinate>>) -> Self {
        Self::Continuous(coordinates.into())
    }

    /// A planar pose `[x, y, heading]` (m, m, rad).
    pub fn pose2() -> Self {
        Self::new([Coordinate::Real, Coordinate::Real, Coordinate::Angle])
    }

    /// Finitely many states.
    pub fn finite(states: usize) -> Self {
        Self::Finite(states)
    }

    /// Number of coordinates, or of states: what a factor's port must match.
    pub fn dimension(&self) -> usize {
        match self {
            Self::Continuous(coordinates) => coordinates.len(),
            Self::Finite(states) => *states,
        }
    }

    /// Whether coordinate `index` is an angle.
    pub fn is_angle(&self, index: usize) -> bool {
        matches!(self, Self::Continuous(c) if c.get(index) == Some(&Coordinate::Angle))
    }

    /// Whether any coordinate is an angle.
    pub fn has_angles(&self) -> bool {
        matches!(self, Self::Continuous(c) if c.contains(&Coordinate::Angle))
    }

    /// Brings every angular coordinate of `value` into (-π, π].
    pub fn wrap(&self, value: &mut [f64]) {
        if let Self::Continuous(coordinates) = self {
            for (x, _) in value.iter_mut().zip(coordinates).filter(|(_, c)| **c == Coordinate::Angle) {
                *x = wrap_angle(*x);
            }
        }
    }
}

/// The representative of `angle` in (-π, π] (rad); non-finite values are returned as they are.
pub fn wrap_angle(angle: f64) -> f64 {
    if angle > -PI && angle <= PI {
        return angle;
    }
    let wrapped = angle - TAU * (angle / TAU).round();
    if wrapped <= -PI { wrapped + TAU } else { wrapped }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wrapping_keeps_the_angle_modulo_a_turn() {
        for k in -5..=5 {
            for angle in [-3.1, -1.0, 0.0, 0.5, 3.1] {
                assert!((wrap_angle(angle + TAU * f64::from(k)) - angle).abs() < 1e-12);
            }
        }
        assert_eq!(wrap_angle(-PI), PI);
        assert!(wrap_angle(f64::NAN).is_nan());
    }

    #[test]
    fn only_angles_are_wrapped() {
        let mut value = [10.0, 10.0, 10.0];
        Space::pose2().wrap(&mut value);
        assert_eq!(value[..2], [10.0, 10.0]);
        assert!(value[2].abs() <= PI);
    }
}
