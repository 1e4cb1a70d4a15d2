//! Motion in the plane at a turn rate that is part of the state [x, vx, y, vy, ω].

use super::checks::positive;
use crate::{Motion, ProcessNoise, Real};
use sumprod_graph::MessageError;

/// Angles turned in a step below this are taken to second order: the next term is 1e-13 of the first.
const SMALL: f64 = 1e-3;

/// A coordinated turn: over an interval T the velocity turns by ω T (anticlockwise, rad) and the position follows the
/// arc,
///
/// x' = x + s vx - c vy, y' = y + c vx + s vy, s = sin(ω T) / ω, c = (1 - cos(ω T)) / ω.
///
/// The noise is an acceleration held over the interval along each axis, and a step of the turn rate; its covariance
/// has rank 3 of 5. Source: Bar-Shalom, Li, Kirubarajan, *Estimation with Applications to Tracking and Navigation*
/// (2001), 11.7.
#[derive(Clone, Debug)]
pub struct CoordinatedTurn {
    interval: f64,
    noise: ProcessNoise,
}

impl CoordinatedTurn {
    /// Over `interval` (s), with the variances of the acceleration along each axis (m²/s⁴) and of the step of the
    /// turn rate (rad²/s²).
    ///
    /// # Errors
    ///
    /// Where the interval is not positive, or a variance is negative or not finite.
    pub fn new(
        interval: f64,
        acceleration_variance: f64,
        turn_rate_variance: f64,
    ) -> Result<Self, MessageError> {
        positive("the interval", interval)?;
        let (position, velocity) = (0.5 * interval * interval, interval);
        #[rustfmt::skip]
        let gain = [
            position, 0.0, 0.0,
            velocity, 0.0, 0.0,
            0.0, position, 0.0,
            0.0, velocity, 0.0,
            0.0, 0.0, 1.0,
        ];
        let (a, w) = (acceleration_variance, turn_rate_variance);
        let noise = ProcessNoise::driven(&gain, &[a, 0.0, 0.0, 0.0, a, 0.0, 0.0, 0.0, w])?;
        Ok(Self { interval, noise })
    }
}

impl Motion for CoordinatedTurn {
    fn dimension(&self) -> usize {
        5
    }

    fn step<T: Real>(&self, state: &[T], next: &mut [T]) {
        let (rate, t) = (state[4], self.interval);
        let turned = rate * t;
        let (sine, cosine) = (turned.sin(), turned.cos());
        let (s, c) = if turned.re().abs() < SMALL {
            let square = turned * turned;
            ((-square / 6.0 + 1.0) * t, (-square / 12.0 + 1.0) * turned * (0.5 * t))
        } else {
            (sine / rate, (-cosine + 1.0) / rate)
        };
        next[0] = state[0] + s * state[1] - c * state[3];
        next[1] = cosine * state[1] - sine * state[3];
        next[2] = state[2] + c * state[1] + s * state[3];
        next[3] = sine * state[1] + cosine * state[3];
        next[4] = rate;
    }

    fn noise(&self, _state: &[f64]) -> ProcessNoise {
        self.noise.clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    #[test]
    fn a_whole_turn_comes_back_and_no_turn_goes_straight() {
        let motion = CoordinatedTurn::new(1.0, 4.0, 1e-3).unwrap();
        let mut state = [3.0, 2.0, -1.0, 0.5, TAU / 12.0];
        let start = state;
        for _ in 0..12 {
            let before = state;
            motion.step(&before, &mut state);
        }
        assert!(state.iter().zip(start).all(|(a, b)| (a - b).abs() < 1e-12), "{state:?}");
        let mut next = [0.0; 5];
        motion.step(&[3.0, 2.0, -1.0, 0.5, 0.0], &mut next);
        assert_eq!(next, [5.0, 2.0, -0.5, 0.5, 0.0]);
    }

    #[test]
    fn the_expansion_meets_the_formula_where_it_takes_over() {
        let motion = CoordinatedTurn::new(1.0, 4.0, 1e-3).unwrap();
        let at = |rate: f64| {
            let mut next = [0.0; 5];
            motion.step(&[0.0, 300.0, 0.0, 200.0, rate], &mut next);
            next
        };
        let (below, above) = (at(SMALL * (1.0 - 1e-12)), at(SMALL * (1.0 + 1e-12)));
        assert!(below.iter().zip(above).all(|(a, b)| (a - b).abs() < 1e-9), "{below:?} {above:?}");
    }
}
