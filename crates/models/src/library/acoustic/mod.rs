//! Times of flight of sound under water, where nodes move while it travels and their clocks are wrong.
//!
//! | factor | measured |
//! |---|---|
//! | [`PseudoRange`] | when a node hears an anchor, by the node's clock |
//! | [`NodePseudoRange`] | when a node hears another node, by the two nodes' clocks |
//! | [`RoundTrip`] | how long an anchor waits for a node's reply, by the anchor's clock |
//! | [`TravelTime`] | how long sound of unknown speed takes to a place and back |
//!
//! A node's state is `[x, vx, y, vy, z, vz]` (m, m/s), and with its clock `[…, β, α]`. The clock reads f(t) at time t;
//! β = c (f(t) - t) is how far it is ahead *now*, in metres of sound at speed c, and α = c (f'(t) - 1) how fast it gains
//! (m/s). Over an interval T it moves as a position of velocity α does, so that
//! [`ConstantVelocity`](super::ConstantVelocity) with a fourth axis is the motion of both. Offset and rate at a fixed
//! epoch instead, f(t) = a t + b, have a derivative c t that grows without bound, and at the epoch of Unix time no
//! covariance of theirs stays positive definite.
//!
//! Source: Gao, Wang, Chen, Shen, "A one-way prediction based joint self-localization and synchronization algorithm for
//! mobile underwater acoustic asynchronous networks" (2022), of which d(t) at one instant is replaced by the path that
//! sound takes to a node that moves.

mod pseudo_range;
mod round_trip;
mod travel_time;

pub use pseudo_range::{NodePseudoRange, PseudoRange};
pub use round_trip::RoundTrip;
pub use travel_time::TravelTime;

use super::checks::{finite, positive, size};
use super::range::length;
use crate::{Noise, Real};
use sumprod_graph::MessageError;

/// Coordinates of a node's state with its clock.
const WITH_CLOCK: usize = 8;
/// Places of β and α in it.
const OFFSET: usize = 6;
const RATE: usize = 7;

/// Position and velocity of a state.
#[inline(always)]
fn kinematics<T: Real>(state: &[T]) -> ([T; 3], [T; 3]) {
    ([state[0], state[2], state[4]], [state[1], state[3], state[5]])
}

/// The path of sound of speed c to a node that is at `offset` from its source when it is sent, and moves at `velocity`:
/// s = c τ with |q + v τ| = c τ, so that τ = (q·v + √((q·v)² + (c² - v²) q²)) / (c² - v²). No finite number where v ≥ c.
#[inline(always)]
fn pursuit<T: Real>(offset: [T; 3], velocity: [T; 3], speed: f64) -> T {
    let dot = |a: [T; 3], b: [T; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let along = dot(offset, velocity);
    let lead = -dot(velocity, velocity) + speed * speed;
    let root = length([along, lead.sqrt() * length(offset)]);
    (along + root) / lead * speed
}

/// Refuses what no time of flight can be made of.
fn check(measured: f64, place: &[f64], speed: f64, noise: &Noise) -> Result<(), MessageError> {
    finite("the measured path", &[measured])?;
    finite("the anchor's position", place)?;
    positive("the speed of sound", speed)?;
    size("the noise of the path", noise.dimension(), 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sound_meets_the_node_where_it_then_is() {
        for velocity in [[0.0; 3], [7.0, 6.0, 5.0], [-300.0, 20.0, 900.0]] {
            for offset in [[100.0, -200.0, 50.0], [0.0, 0.0, 0.0], [0.0, 3.0, 0.0]] {
                let path = pursuit(offset, velocity, 1500.0);
                let there: [f64; 3] = std::array::from_fn(|k| offset[k] + velocity[k] * path / 1500.0);
                assert!((length(there) - path).abs() < 1e-9, "{velocity:?} {offset:?}: {path}");
            }
        }
    }

    #[test]
    fn sound_never_reaches_what_is_faster() {
        let path: f64 = pursuit([10.0, 0.0, 0.0], [1600.0, 0.0, 0.0], 1500.0);
        assert!(path.is_nan());
    }
}
