//! Travel times to a place that stands still, through water of unknown speed of sound.

use super::check;
use crate::library::checks::finite;
use crate::library::range::length;
use crate::{Noise, Real, Residual};
use sumprod_graph::MessageError;

/// A two-way travel time (s) from where a ship pings to a transponder and to where the ship hears it:
/// r = (|p - a| + |p - b|) / c + δ - z, with p (m) at port 0, c (m/s) at port 1, and δ the time that the transponder takes
/// to turn around. Rays are straight.
#[derive(Clone, Debug)]
pub struct TravelTime {
    measured: f64,
    sent: [f64; 3],
    heard: [f64; 3],
    turn_around: f64,
    noise: Noise,
}

impl TravelTime {
    /// A travel time z (s) between two places of the ship (m).
    ///
    /// # Errors
    ///
    /// Where a number is not finite, or the noise has not one component.
    pub fn new(
        measured: f64,
        sent: [f64; 3],
        heard: [f64; 3],
        turn_around: f64,
        noise: Noise,
    ) -> Result<Self, MessageError> {
        check(measured, &sent, 1.0, &noise)?;
        finite("the place where the ship hears", &heard)?;
        finite("the turn-around time", &[turn_around])?;
        Ok(Self { measured, sent, heard, turn_around, noise })
    }
}

impl Residual for TravelTime {
    fn dimensions(&self) -> &[usize] {
        &[3, 1]
    }

    fn noise(&self) -> &Noise {
        &self.noise
    }

    fn known_place(&self) -> Option<&[f64]> {
        Some(&self.sent)
    }

    #[inline]
    fn residual<T: Real>(&self, x: &[&[T]], out: &mut [T]) {
        let from = |place: &[f64; 3]| length(std::array::from_fn::<T, 3, _>(|k| x[0][k] - place[k]));
        let path = from(&self.sent) + from(&self.heard);
        out[0] = path / x[1][0] + (self.turn_around - self.measured);
    }
}
