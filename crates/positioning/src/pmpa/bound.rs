//! The posterior Cramér–Rao bound of a run, at its own trajectory and nodes.
//!
//! For relative measurements, which are linear, no unbiased or Bayesian estimate does better on average; for ranges it
//! is the covariance of the extended Kalman filter at the truth.

use nalgebra::Vector4;

use super::world::{Measured, World, WorldSettings};
use crate::tracking::Recursion;

/// Trace of the bound's position block (m²) at every scan, with the neighbours' data or without.
pub fn position_variances(settings: &WorldSettings, world: &World, neighbours: bool) -> Vec<f64> {
    let start = [settings.start_variance; 4];
    let mut bound = Recursion::new(start, settings.interval, settings.process_variance);
    let variance = settings.measurement_variance;
    let axes = [Vector4::x(), Vector4::z()];
    let scans = world.truth[1..].iter().zip(&world.hearings);
    scans
        .map(|(state, heard)| {
            bound.predict();
            axes.iter().for_each(|axis| bound.measure(axis, variance));
            for hearing in heard.iter().filter(|_| neighbours) {
                match hearing.measured {
                    Measured::Relative(_) => axes.iter().for_each(|axis| bound.measure(axis, variance)),
                    Measured::Range(_) => bound.range(state, world.nodes[hearing.node], variance),
                }
            }
            bound.position_variance()
        })
        .collect()
}
