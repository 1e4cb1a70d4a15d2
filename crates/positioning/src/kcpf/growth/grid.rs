//! The exact filter of a state on a line: a density on equally spaced cells.
//!
//! A prediction moves each cell's mass to f(x), shared between the two nearest cells, and convolves with the process
//! noise. Sharing adds at most h²/4 to a variance of Q, h the width of a cell.

use sumprod_models::cloud::log_values;
use sumprod_models::{Motion, Residual};

use super::super::track::{Step, TAILS};
use super::WorldSettings;
use crate::error::PositioningError;
use crate::results::MethodRun;

/// The state's range: four deviations of the process noise beyond the farthest that its mean can stay.
const REACH: f64 = 50.0;
/// Deviations of the process noise after which its density is left out: 1e-14 of the mass.
const TAIL: f64 = 8.0;

/// Runs the filter over the steps.
///
/// # Errors
/// [`PositioningError::Method`] where no cell explains a measurement.
pub fn run<M: Motion, R: Residual>(
    world: &WorldSettings,
    cells: usize,
    steps: &[Step<M, R>],
    out: &mut MethodRun,
) -> Result<(), PositioningError> {
    let width = 2.0 * REACH / (cells - 1) as f64;
    let places: Vec<f64> = (0..cells).map(|cell| cell as f64 * width - REACH).collect();
    let kernel = half_kernel(world.process_variance, width);
    let mut density: Vec<f64> = places.iter().map(|x| (-0.5 * x * x / world.start_variance).exp()).collect();
    let total: f64 = density.iter().sum();
    density.iter_mut().for_each(|mass| *mass /= total);
    let mut logs = vec![0.0; cells];
    let mut log_evidence = 0.0;
    for (number, step) in (1..).zip(steps) {
        let fail =
            |source: Box<dyn std::error::Error + Send + Sync>| PositioningError::method(&out.id, source);
        let moved = moved(&density, &places, width, &step.motion);
        density = convolved(&moved, &kernel);
        log_values(&step.measurement, &places, &mut logs);
        let largest = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        for (mass, log) in density.iter_mut().zip(&logs) {
            *mass *= (log - largest).exp();
        }
        let total: f64 = density.iter().sum();
        if !(total > 0.0 && total.is_finite()) {
            let problem = format!(
                "step {number}: no cell of the grid explains the measurement (total {total}); use more cells or a wider noise"
            );
            return Err(fail(problem.into()));
        }
        density.iter_mut().for_each(|mass| *mass /= total);
        log_evidence += total.ln() + largest;
        let mean: f64 = density.iter().zip(&places).map(|(mass, x)| mass * x).sum();
        let variance: f64 = density.iter().zip(&places).map(|(mass, x)| mass * (x - mean).powi(2)).sum();
        let interval = TAILS.map(|tail| quantile(&density, &places, width, tail));
        out.push_with_intervals(number, step.time, 0, &step.truth, &[mean], &[variance], &[interval])?;
    }
    out.diagnose("log_evidence", log_evidence);
    Ok(())
}

/// Cells to one side of the process noise's density, the middle first; both sides sum to one.
fn half_kernel(variance: f64, width: f64) -> Vec<f64> {
    let reach = ((TAIL * variance.sqrt() / width).ceil() as usize).max(1);
    let mut half: Vec<f64> =
        (0..=reach).map(|k| (-0.5 * (k as f64 * width).powi(2) / variance).exp()).collect();
    let total = 2.0 * half.iter().sum::<f64>() - half[0];
    half.iter_mut().for_each(|value| *value /= total);
    half
}

fn moved<M: Motion>(density: &[f64], places: &[f64], width: f64, motion: &M) -> Vec<f64> {
    let mut moved = vec![0.0; density.len()];
    let last = density.len() - 2;
    for (mass, x) in density.iter().zip(places) {
        let mut next = [0.0];
        motion.step(&[*x], &mut next);
        let at = ((next[0] + REACH) / width).clamp(0.0, (last + 1) as f64);
        let cell = (at as usize).min(last);
        let share = at - cell as f64;
        moved[cell] += (1.0 - share) * mass;
        moved[cell + 1] += share * mass;
    }
    moved
}

/// What the noise carries beyond the ends is lost, which the normalisation that follows makes good.
fn convolved(density: &[f64], half: &[f64]) -> Vec<f64> {
    let mut sum = vec![0.0; density.len()];
    for (cell, mass) in density.iter().enumerate().filter(|(_, mass)| **mass > 0.0) {
        for (place, weight) in sum[cell..].iter_mut().zip(half) {
            *place += mass * weight;
        }
        for (place, weight) in sum[..cell].iter_mut().rev().zip(&half[1..]) {
            *place += mass * weight;
        }
    }
    sum
}

/// Where the cumulative mass, spread evenly over each cell, reaches a share.
fn quantile(density: &[f64], places: &[f64], width: f64, share: f64) -> f64 {
    let mut below = 0.0;
    for (mass, x) in density.iter().zip(places) {
        if below + mass >= share && *mass > 0.0 {
            return x + width * ((share - below) / mass - 0.5);
        }
        below += mass;
    }
    REACH
}
