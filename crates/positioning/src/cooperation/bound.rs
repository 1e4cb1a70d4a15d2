//! The error that the best filter would have: the covariance of the joint extended Kalman filter that linearises at the
//! truth, P⁻ = F P F' + G q G', P = (P⁻¹ + H'H / r)⁻¹.
//!
//! Averaged over runs this approximates the posterior Cramér–Rao bound (Tichavský, Muravchik and Nehorai 1998), whose
//! information is averaged over trajectories before it is inverted; this one is conditional on each run's own.

use nalgebra::DMatrix;

use super::geometry::add_information;
use super::network::DIMENSION;
use super::world::{Draw, World};
use crate::error::PositioningError;
use crate::results::BoundStep;

/// The bound at every slice. O(steps · n³) for n state components.
///
/// # Errors
/// [`PositioningError::Results`] where a covariance loses its positive definiteness.
pub fn bound(world: &World, draw: &Draw) -> Result<Vec<BoundStep>, PositioningError> {
    let agents = draw.start.len();
    let n = DIMENSION * agents;
    let t = world.interval;
    let mut covariance =
        DMatrix::from_fn(
            n,
            n,
            |row, column| {
                if row == column { draw.start_variances[row % DIMENSION] } else { 0.0 }
            },
        );
    let mut steps = Vec::with_capacity(draw.slices.len());
    for (k, slice) in draw.slices.iter().enumerate() {
        predict(&mut covariance, t, world.process_variance);
        let mut information = inverse(covariance, k)?;
        add_information(&mut information, slice, &draw.truth[k + 1], &world.anchors, world.range_variance);
        covariance = inverse(information, k)?;
        let trace: f64 = (0..n).filter(|index| index % 2 == 0).map(|index| covariance[(index, index)]).sum();
        let position_variance = trace / agents as f64;
        steps.push(BoundStep { step: k as u32 + 1, time: slice.time, position_variance });
    }
    Ok(steps)
}

/// F P F' + G q G' for pairs [x, v] of coordinates.
fn predict(covariance: &mut DMatrix<f64>, t: f64, variance: f64) {
    let n = covariance.nrows();
    for even in (0..n).step_by(2) {
        for column in 0..n {
            covariance[(even, column)] += t * covariance[(even + 1, column)];
        }
    }
    for even in (0..n).step_by(2) {
        for row in 0..n {
            covariance[(row, even)] += t * covariance[(row, even + 1)];
        }
        let gain = [0.5 * t * t, t];
        for a in 0..2 {
            for b in 0..2 {
                covariance[(even + a, even + b)] += variance * gain[a] * gain[b];
            }
        }
    }
}

fn inverse(matrix: DMatrix<f64>, slice: usize) -> Result<DMatrix<f64>, PositioningError> {
    matrix.cholesky().map(|factor| factor.inverse()).ok_or_else(|| PositioningError::Results {
        problem: format!("the bound's covariance at slice {slice} is not positive definite"),
    })
}
