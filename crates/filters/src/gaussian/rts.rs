//! The Rauch-Tung-Striebel smoother: the backward pass of the chain.
//!
//! With C the cross-covariance of the next state with this one and P⁻ the next state's predicted covariance,
//! G = C' (P⁻)⁻¹, m ← m + G (m⁺ - m⁻), P ← P + G (P⁺ - P⁻) G'. Where P⁻ is singular, as after a start known exactly,
//! a generalised inverse serves: C has no part outside its range. Source: Rauch, Tung, Striebel 1965.

use sumprod_messages::{Cholesky, Moments};
use sumprod_models::moments::generalised_inverse;

use super::{GaussianRecord, Square};
use crate::Run;

/// Each step's moments by all measurements of the run.
pub(crate) fn smooth<const D: usize, M>(run: &Run<GaussianRecord<D>, M>) -> Vec<Moments> {
    let mut smoothed: Vec<([f64; D], Square<D>)> = Vec::with_capacity(run.records.len());
    for (k, record) in run.records.iter().enumerate().rev() {
        let next = smoothed.last().copied();
        let moved = run.motions.get(k + 1).is_some_and(Option::is_some);
        smoothed.push(match next {
            None => (record.mean, record.covariance),
            // Two steps of one time are one state.
            Some(next) if !moved => next,
            Some(next) => back(record, &run.records[k + 1], next),
        });
    }
    smoothed.reverse();
    let each = smoothed.iter();
    each.map(|(mean, covariance)| Moments {
        mean: mean.to_vec(),
        covariance: covariance.as_flattened().to_vec(),
    })
    .collect()
}

fn back<const D: usize>(
    record: &GaussianRecord<D>,
    after: &GaussianRecord<D>,
    (next_mean, next_covariance): ([f64; D], Square<D>),
) -> ([f64; D], Square<D>) {
    let predicted = &after.prediction;
    let flat = predicted.covariance.as_flattened();
    let mut gain = [[0.0; D]; D];
    match Cholesky::new(flat, D, "the predicted covariance") {
        Ok(factor) => {
            for (row, gain) in gain.iter_mut().enumerate() {
                *gain = std::array::from_fn(|k| predicted.cross[k][row]);
                factor.solve(gain);
            }
        }
        Err(_) => {
            let inverse = generalised_inverse(flat, D);
            for (row, gain) in gain.iter_mut().enumerate() {
                *gain = std::array::from_fn(|column| {
                    (0..D).map(|k| predicted.cross[k][row] * inverse[k * D + column]).sum()
                });
            }
        }
    }
    let (mut mean, mut covariance) = (record.mean, record.covariance);
    for (row, gain) in gain.iter().enumerate() {
        mean[row] += (0..D).map(|k| gain[k] * (next_mean[k] - predicted.mean[k])).sum::<f64>();
    }
    let moved: Square<D> = std::array::from_fn(|row| {
        std::array::from_fn(|column| {
            (0..D)
                .map(|k| gain[row][k] * (next_covariance[k][column] - predicted.covariance[k][column]))
                .sum()
        })
    });
    for row in 0..D {
        for column in 0..=row {
            let change: f64 = (0..D).map(|k| moved[row][k] * gain[column][k]).sum();
            covariance[row][column] += change;
            covariance[column][row] = covariance[row][column];
        }
    }
    (mean, covariance)
}
