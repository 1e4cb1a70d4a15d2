//! The product of two mixtures, component by component.

use super::super::Mixture;
use super::super::kernels::{Kernels, Query, Scratch};
use super::super::small::Pair;
use sumprod_graph::{Coordinate, MessageError};

/// Pairs that room is made for at once.
const ROOM: usize = 100_000;

/// A product of two mixtures.
pub(super) struct PairProduct {
    pub(super) mixture: Mixture,
    pub(super) log_normaliser: f64,
}

/// The product of `a` and `b`: every pair whose weight is within `cut` nats of the largest. The pairs left out weigh
/// less than N_a N_b e^-cut together. O(N_a N_b), less where kernels are narrow.
pub(super) fn multiply(a: &Mixture, b: &Mixture, cut: f64) -> Result<PairProduct, MessageError> {
    let (a, b) = if a.len() <= b.len() { (a, b) } else { (b, a) };
    let kernels = Kernels::new(b);
    let d = a.dimension();
    let shared = a.shared && b.shared;
    let mut scratch = Scratch::default();
    let room = (a.len() * b.len()).min(ROOM);
    let mut log_weights = Vec::with_capacity(room);
    let mut means = Vec::with_capacity(room * d);
    let mut covariances = Vec::with_capacity(if shared { d * d } else { room * d * d });
    let mut chosen: Vec<u32> = Vec::new();
    let mut largest = f64::NEG_INFINITY;
    let mut pair = None;
    for i in 0..a.len() {
        let (mean, covariance) = (a.mean_of(i), a.covariance_of(i));
        if i == 0 || !a.shared {
            pair = if b.shared { Some(pair_of(covariance, b.covariance_of(0), d)?) } else { None };
        }
        let own = a.log_weights()[i];
        chosen.clear();
        let query = Query { mean, covariance, heat: 1.0 };
        let threshold = largest - cut - own;
        let top = kernels.collect(query, threshold, &mut scratch, |numbers, logs, constant| {
            log_weights.extend(logs.iter().map(|log| own + constant + log));
            chosen.extend_from_slice(numbers);
        });
        let Some(top) = top else { return Err(singular(covariance, d)) };
        largest = largest.max(own + top);
        if let (true, Some(pair), [Coordinate::Real]) = (shared, &pair, a.coordinates()) {
            let (from, gain) = (mean[0], pair.gain[0]);
            means.extend(chosen.iter().map(|&j| from + gain * (b.means[j as usize] - from)));
            continue;
        }
        for &j in &chosen {
            let j = j as usize;
            let own_pair;
            let pair = match &pair {
                Some(pair) => pair,
                None => {
                    own_pair = pair_of(covariance, b.covariance_of(j), d)?;
                    &own_pair
                }
            };
            pair.push_mean(&a.coordinates, mean, b.mean_of(j), &mut means);
            if !shared {
                covariances.extend_from_slice(&pair.covariance);
            }
        }
    }
    if let (true, Some(pair)) = (shared, &pair) {
        covariances.extend_from_slice(&pair.covariance);
    }
    retain(&mut log_weights, &mut means, &mut covariances, d, shared, largest - cut);
    let (mixture, log_normaliser) =
        Mixture::assemble(&a.coordinates, log_weights, means, covariances, shared)?;
    Ok(PairProduct { mixture, log_normaliser })
}

fn pair_of(a: &[f64], b: &[f64], d: usize) -> Result<Pair, MessageError> {
    Pair::new(a, b, d).ok_or_else(|| singular(a, d))
}

fn singular(covariance: &[f64], d: usize) -> MessageError {
    let what = "the sum of two components' covariances";
    MessageError::NotPositiveDefinite { what, pivot: d - 1, value: covariance[d * d - 1] }
}

/// Drops what fell below the cut only once a heavier pair was found.
fn retain(
    log_weights: &mut Vec<f64>,
    means: &mut Vec<f64>,
    covariances: &mut Vec<f64>,
    d: usize,
    shared: bool,
    floor: f64,
) {
    if floor == f64::NEG_INFINITY || log_weights.iter().all(|&log| log >= floor) {
        return;
    }
    let mut kept = 0;
    for i in 0..log_weights.len() {
        if log_weights[i] < floor {
            continue;
        }
        log_weights[kept] = log_weights[i];
        means.copy_within(i * d..(i + 1) * d, kept * d);
        if !shared {
            covariances.copy_within(i * d * d..(i + 1) * d * d, kept * d * d);
        }
        kept += 1;
    }
    log_weights.truncate(kept);
    means.truncate(kept * d);
    if !shared {
        covariances.truncate(kept * d * d);
    }
}
