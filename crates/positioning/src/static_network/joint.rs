//! The last word on a network: the moments of its joint posterior, mirror images and all.
//!
//! Messages around loops count evidence more than once, and a Gaussian belief knows one image of its agent alone. So
//! the beliefs are taken for a place to start from: folds that fit better are made ([`super::folds`]); the covariance
//! of each agent is then that of a joint Gaussian over a window around it, everybody beyond counting with the belief
//! that messages gave; and what may as well be otherwise is mixed in by its weight. Windows have one size, so that the
//! whole is linear in the agents.

use nalgebra::{Matrix2, Vector2};
use rayon::prelude::*;
use std::collections::BTreeMap;

use super::folds::{Folds, search};
use super::loose::{loose, moments};
use super::posterior::Posterior;

/// Side of the tiles whose agents share a window, and width of the margin around them (m): some twenty-five agents, and
/// a hundred with the margin.
const TILE: f64 = 50.0;
const MARGIN: f64 = 30.0;
/// Agents above which a window is left to the messages: those who are no network, but one crowd.
const CROWD: usize = 500;
/// Variance (m²) of those who say nothing of their neighbours.
const NOWHERE: f64 = 1e8;

/// Mean and covariance of a position (m, m²).
pub(super) type Moments = (Vector2<f64>, Matrix2<f64>);

/// What the joint posterior says.
#[derive(Debug)]
pub(super) struct Joint {
    /// Of each agent.
    pub(super) moments: Vec<Moments>,
    /// Groups that were folded over.
    pub(super) folds_undone: usize,
    /// Mirror images that were mixed in.
    pub(super) images: usize,
    /// Agents that their ranges leave on an arc.
    pub(super) on_an_arc: usize,
}

/// The moments of the joint posterior around the state that `posterior` is in; `beliefs` are what messages found, and
/// `one_mode` the deviation (m) up to which an agent is in one place.
pub(super) fn joint(mut posterior: Posterior, beliefs: Vec<Moments>, one_mode: f64) -> Joint {
    let loose = loose(&posterior, one_mode);
    let spread =
        |agent: usize, covariance| if loose[agent] { Matrix2::identity() * NOWHERE } else { covariance };
    for agent in 0..posterior.agents() {
        posterior.spreads[agent] = spread(agent, Matrix2::zeros());
    }
    let folds = search(&mut posterior);
    let mut found = beliefs;
    for (agent, (_, covariance)) in found.iter().enumerate() {
        posterior.spreads[agent] = spread(agent, *covariance);
    }
    for (agent, moments) in windows(&posterior, &loose) {
        found[agent] = moments;
    }
    mix(&folds, &mut found);
    // Whoever is on an arc is placed last, among neighbours that are where they are.
    for (agent, (mean, covariance)) in found.iter().enumerate() {
        posterior.places[agent] = (*mean).into();
        posterior.spreads[agent] = spread(agent, *covariance);
    }
    let near = posterior.reach(&posterior.places);
    let on_an_arc: Vec<usize> = (0..loose.len()).filter(|&agent| loose[agent]).collect();
    let placed: Vec<Option<Moments>> =
        on_an_arc.par_iter().map(|&agent| moments(&posterior, &near, agent)).collect();
    for (&agent, moments) in on_an_arc.iter().zip(placed) {
        found[agent] = moments.unwrap_or(found[agent]);
    }
    Joint {
        moments: found,
        folds_undone: folds.undone,
        images: folds.images.len(),
        on_an_arc: on_an_arc.len(),
    }
}

/// Moments of all agents that are in one place, each from the joint Gaussian of the window around its tile.
fn windows(posterior: &Posterior, loose: &[bool]) -> Vec<(usize, Moments)> {
    let mut tiles: BTreeMap<[i64; 2], Vec<usize>> = BTreeMap::new();
    for agent in (0..posterior.agents()).filter(|&agent| !loose[agent]) {
        let tile = posterior.places[agent].map(|x| (x / TILE).floor() as i64);
        tiles.entry(tile).or_default().push(agent);
    }
    let all: Vec<(&[i64; 2], &Vec<usize>)> = tiles.iter().collect();
    let window = |&(tile, own): &(&[i64; 2], &Vec<usize>)| -> Vec<(usize, Moments)> {
        let low = tile.map(|index| index as f64 * TILE - MARGIN);
        let width = TILE + 2.0 * MARGIN;
        let mut part: Vec<usize> = Vec::new();
        for column in -1..=1 {
            for row in -1..=1 {
                let beside = [tile[0].saturating_add(column), tile[1].saturating_add(row)];
                part.extend(tiles.get(&beside).into_iter().flatten().filter(|&&agent| {
                    let place = posterior.places[agent];
                    (0..2).all(|axis| place[axis] >= low[axis] && place[axis] - low[axis] <= width)
                }));
            }
        }
        part.sort_unstable();
        part.dedup();
        if part.len() > CROWD {
            return Vec::new();
        }
        let from: Vec<[f64; 2]> = part.iter().map(|&agent| posterior.places[agent]).collect();
        let Some(settled) = posterior.settle(&part, &from) else { return Vec::new() };
        let covariances = settled.covariances();
        let inner = own.iter().filter_map(|agent| Some((*agent, part.binary_search(agent).ok()?)));
        inner.map(|(agent, place)| (agent, (Vector2::from(settled.at[place]), covariances[place]))).collect()
    };
    all.par_iter().flat_map_iter(window).collect()
}

/// Mixes mirror images in, those of one agent taken as excluding each other.
fn mix(folds: &Folds, found: &mut [Moments]) {
    let mut images: BTreeMap<usize, Vec<(f64, Moments)>> = BTreeMap::new();
    for image in &folds.images {
        for (place, &agent) in image.part.iter().enumerate() {
            let mean = found[agent].0 + Vector2::from(image.offsets[place]);
            let entry = images.entry(agent).or_insert_with(|| vec![(1.0, found[agent])]);
            entry.push((image.weight, (mean, image.covariances[place])));
        }
    }
    for (agent, modes) in images {
        let total: f64 = modes.iter().map(|(weight, _)| weight).sum();
        let mean: Vector2<f64> = modes.iter().map(|(weight, (mean, _))| mean * (weight / total)).sum();
        let covariance = modes
            .iter()
            .map(|(weight, (centre, covariance))| {
                let offset = centre - mean;
                (covariance + offset * offset.transpose()) * (weight / total)
            })
            .sum();
        found[agent] = (mean, covariance);
    }
}
