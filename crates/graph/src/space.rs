//! The space a variable lives in: real and angular coordinates, poses, or finitely many states.

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
    /// A pose in the plane, SE(2): `[x, y, heading]` (m, m, rad), moved by steps in the pose's own frame.
    Se2,
    /// A pose in space, SE(3): `[x, y, z, qx, qy, qz, qw]` (m and a unit quaternion), moved by steps in the pose's
    /// own frame.
    Se3,
}

/// Coordinates of [`Space::Se2`].
const PLANAR_POSE: [Coordinate; 3] = [Coordinate::Real, Coordinate::Real, Coordinate::Angle];
/// Coordinates of [`Space::Se3`]; those of a quaternion are neither free nor angles.
const SPATIAL_POSE: [Coordinate; 7] = [Coordinate::Real; 7];

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

    /// The coordinates that are stored of a value; none of finite spaces.
    pub fn coordinates(&self) -> Option<&[Coordinate]> {
        match self {
            Self::Continuous(coordinates) => Some(coordinates),
            Self::Finite(_) => None,
            Self::Se2 => Some(&PLANAR_POSE),
            Self::Se3 => Some(&SPATIAL_POSE),
        }
    }

    /// Number of stored coordinates, or of states: what a factor's port must match.
    pub fn dimension(&self) -> usize {
        match self {
            Self::Finite(states) => *states,
            _ => self.coordinates().map_or(0, <[Coordinate]>::len),
        }
    }

    /// Number of directions in which a value can be moved: the size of a covariance. Less than the dimension where
    /// the coordinates are not free (six of a pose in space); none of finite spaces.
    pub fn degrees_of_freedom(&self) -> usize {
        match self {
            Self::Finite(_) => 0,
            Self::Se3 => 6,
            _ => self.dimension(),
        }
    }

    /// Whether coordinate `index` is an angle.
    pub fn is_angle(&self, index: usize) -> bool {
        self.coordinates().is_some_and(|c| c.get(index) == Some(&Coordinate::Angle))
    }

    /// Whether any coordinate is an angle.
    pub fn has_angles(&self) -> bool {
        self.coordinates().is_some_and(|c| c.contains(&Coordinate::Angle))
    }

    /// Brings every angular coordinate of `value` into (-π, π].
    pub fn wrap(&self, value: &mut [f64]) {
        let coordinates = self.coordinates().unwrap_or_default();
        for (x, _) in value.iter_mut().zip(coordinates).filter(|(_, c)| **c == Coordinate::Angle) {
            *x = wrap_angle(*x);
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
    fn a_pose_stores_more_numbers_than_it_has_freedoms() {
        assert_eq!((Space::Se3.dimension(), Space::Se3.degrees_of_freedom()), (7, 6));
        assert_eq!((Space::Se2.dimension(), Space::Se2.degrees_of_freedom()), (3, 3));
        assert!(Space::Se2.is_angle(2) && !Space::Se3.has_angles());
        assert_eq!((Space::finite(4).dimension(), Space::finite(4).degrees_of_freedom()), (4, 0));
    }

    #[test]
    fn only_angles_are_wrapped() {
        let mut value = [10.0, 10.0, 10.0];
        Space::pose2().wrap(&mut value);
        assert_eq!(value[..2], [10.0, 10.0]);
        assert!(value[2].abs() <= PI);
    }
}
