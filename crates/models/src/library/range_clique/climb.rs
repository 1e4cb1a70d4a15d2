//! From a start to the mode nearest to it, and the Laplace approximation there.

use super::RangeClique;
use super::separator::Separator;
use crate::library::range::TOUCHING;
use crate::small::{multiply, transpose};
use nalgebra::DMatrix;
use std::f64::consts::TAU;
use sumprod_messages::Cholesky;

/// A stretch of a ring: κ exp(-(t'(L - c))² / 2s²), the share of a flat prior on the landmark L that one component
/// takes over. It is flat across the ring.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Tile {
    /// Its middle c (m).
    pub(super) centre: [f64; 2],
    /// The unit vector t along the ring.
    pub(super) tangent: [f64; 2],
    /// s² (m²).
    pub(super) variance: f64,
    /// ln κ.
    pub(super) log_height: f64,
    /// Distance (m) of the tile's middle from the ring's.
    pub(super) radius: f64,
}

impl Tile {
    /// Whether a landmark is on the tile's side of the ring: a tile is flat across the ring, and so has its mirror image
    /// on the other side, which another tile has charge of.
    pub(super) fn faces(&self, landmark: [f64; 2]) -> bool {
        let outward = [self.tangent[1], -self.tangent[0]];
        let offset: f64 = (0..2).map(|k| outward[k] * (landmark[k] - self.centre[k])).sum();
        offset > -self.radius
    }

    fn offset(&self, landmark: [f64; 2]) -> f64 {
        self.tangent[0] * (landmark[0] - self.centre[0]) + self.tangent[1] * (landmark[1] - self.centre[1])
    }
}

/// A Gaussian over the clique.
pub(super) struct Component {
    /// Log of its integral.
    pub(super) log_weight: f64,
    pub(super) mean: Vec<f64>,
    /// Row-major.
    pub(super) covariance: Vec<f64>,
}

/// The log of an integral over the landmark as a function of the positions, to second order.
pub(super) struct Expansion {
    pub(super) landmark: [f64; 2],
    pub(super) log_value: f64,
    pub(super) gradient: Vec<f64>,
    /// Minus the second derivative, row-major.
    pub(super) information: Vec<f64>,
    /// Sum of the landmark's variances (m²).
    pub(super) spread: f64,
}

/// Gauss-Newton steps at most; from a start on the ring some five are taken.
const STEPS: usize = 40;
/// Halvings of a step that does not descend.
const HALVINGS: usize = 12;
/// Twice the predicted descent (nats) of a step below which the mode is reached.
const REACHED: f64 = 1e-10;

/// Ranges × what is known of the positions × tile.
#[derive(Clone, Copy)]
pub(super) struct Target<'a> {
    pub(super) clique: &'a RangeClique,
    pub(super) separator: Option<&'a Separator>,
    pub(super) tile: Option<&'a Tile>,
}

/// Where a climb has ended: minus the log of the target, up to its heights, with slope and curvature.
struct Summit {
    at: Vec<f64>,
    value: f64,
    slope: Vec<f64>,
    curvature: Vec<f64>,
}

impl Target<'_> {
    /// The component at the mode near these positions and this landmark; none where a direction is left open.
    pub(super) fn component(&self, positions: &[f64], landmark: [f64; 2]) -> Option<Component> {
        let summit = self.climb(positions, landmark, 0)?;
        let d = summit.at.len();
        let factor = Cholesky::new(&summit.curvature, d, "the curvature of a clique").ok()?;
        let mut covariance = vec![0.0; d * d];
        factor.inverse(&mut covariance);
        let log_weight =
            self.log_heights() - summit.value + 0.5 * (d as f64 * TAU.ln() - factor.log_determinant());
        let finite =
            log_weight.is_finite() && summit.at.iter().chain(&covariance).all(|entry| entry.is_finite());
        finite.then_some(Component { log_weight, mean: summit.at, covariance })
    }

    /// The landmark integrated out with the positions held where they are; none where a direction is left open.
    pub(super) fn expansion(&self, positions: &[f64], landmark: [f64; 2]) -> Option<Expansion> {
        let own = positions.len();
        let summit = self.climb(positions, landmark, own)?;
        let landmark = [summit.at[own], summit.at[own + 1]];
        let d = own + 2;
        let entry = |row: usize, column: usize| summit.curvature[row * d + column];
        let inner = [entry(own, own), entry(own, own + 1), entry(own + 1, own), entry(own + 1, own + 1)];
        let factor = Cholesky::new(&inner, 2, "the curvature of a landmark").ok()?;
        let mut inverse = [0.0; 4];
        factor.inverse(&mut inverse);
        // What the landmark absorbs of the ranges' information on the positions.
        let mixed: Vec<f64> = (0..own).flat_map(|row| [entry(row, own), entry(row, own + 1)]).collect();
        let absorbed = multiply(&multiply(&mixed, &inverse, 2, 2), &transpose(&mixed, own, 2), 2, own);
        let information = (0..own * own).map(|k| entry(k / own, k % own) - absorbed[k]).collect();
        let log_value = self.log_heights() - summit.value + TAU.ln() - 0.5 * factor.log_determinant();
        let gradient = summit.slope[..own].iter().map(|slope| -slope).collect();
        let spread = inverse[0] + inverse[3];
        log_value.is_finite().then_some(Expansion { landmark, log_value, gradient, information, spread })
    }

    fn log_heights(&self) -> f64 {
        let ranges = self.clique.ranges.iter().map(|range| -0.5 * (TAU * range.variance).ln());
        ranges.sum::<f64>()
            + self.separator.map_or(0.0, |separator| separator.log_peak)
            + self.tile.map_or(0.0, |tile| tile.log_height)
    }

    /// Gauss-Newton steps, halved until they descend; the first `held` coordinates stay.
    fn climb(&self, positions: &[f64], landmark: [f64; 2], held: usize) -> Option<Summit> {
        let at: Vec<f64> = positions.iter().copied().chain(landmark).collect();
        let d = at.len();
        let free = d - held;
        let value = self.value(&at);
        let mut summit = Summit { value, slope: vec![0.0; d], curvature: vec![0.0; d * d], at };
        let mut trial = summit.at.clone();
        let mut block = vec![0.0; free * free];
        for _ in 0..STEPS {
            self.expand(&mut summit);
            for (row, block) in block.chunks_exact_mut(free).enumerate() {
                block.copy_from_slice(&summit.curvature[(held + row) * d + held..][..free]);
            }
            let slope = &summit.slope[held..];
            let mut step: Vec<f64> = slope.iter().map(|slope| -slope).collect();
            Cholesky::new(&block, free, "the curvature of a clique").ok()?.solve(&mut step);
            let descent = -step.iter().zip(slope).map(|(step, slope)| step * slope).sum::<f64>();
            if descent < REACHED {
                return Some(summit);
            }
            let mut length = 1.0;
            let lower = (0..HALVINGS).find_map(|_| {
                for (k, step) in step.iter().enumerate() {
                    trial[held + k] = summit.at[held + k] + length * step;
                }
                let found = self.value(&trial);
                let enough = found <= summit.value - 1e-4 * length * descent;
                length *= 0.5;
                enough.then_some(found)
            });
            let Some(lower) = lower else { return Some(summit) };
            summit.value = lower;
            summit.at.copy_from_slice(&trial);
        }
        self.expand(&mut summit);
        Some(summit)
    }

    fn value(&self, at: &[f64]) -> f64 {
        let (positions, landmark) = at.split_at(at.len() - 2);
        let landmark = [landmark[0], landmark[1]];
        let ranges: f64 = self
            .clique
            .ranges
            .iter()
            .map(|range| {
                let position = &positions[2 * range.position..];
                let distance = (landmark[0] - position[0]).hypot(landmark[1] - position[1]);
                0.5 * (distance - range.measured).powi(2) / range.variance
            })
            .sum();
        let tile = self.tile.map_or(0.0, |tile| 0.5 * tile.offset(landmark).powi(2) / tile.variance);
        self.separator.map_or(0.0, |separator| separator.half_squared_length(positions)) + ranges + tile
    }

    /// Writes the slope and the Gauss-Newton curvature at the summit's point.
    fn expand(&self, summit: &mut Summit) {
        let Summit { at, slope, curvature, .. } = summit;
        let d = at.len();
        let own = d - 2;
        curvature.fill(0.0);
        slope.fill(0.0);
        if let Some(separator) = self.separator {
            for row in 0..own {
                for column in 0..own {
                    let entry = separator.information[row * own + column];
                    curvature[row * d + column] = entry;
                    slope[row] += entry * (at[column] - separator.mean[column]);
                }
            }
        }
        let mut add = |places: &[usize], gradient: &[f64], residual: f64, variance: f64| {
            for (&row, a) in places.iter().zip(gradient) {
                slope[row] += a * residual / variance;
                for (&column, b) in places.iter().zip(gradient) {
                    curvature[row * d + column] += a * b / variance;
                }
            }
        };
        for range in &self.clique.ranges {
            let first = 2 * range.position;
            let (x, y) = (at[own] - at[first], at[own + 1] - at[first + 1]);
            let distance = x.hypot(y);
            if distance < TOUCHING {
                continue;
            }
            let (x, y) = (x / distance, y / distance);
            let places = [first, first + 1, own, own + 1];
            add(&places, &[-x, -y, x, y], distance - range.measured, range.variance);
        }
        if let Some(tile) = self.tile {
            add(&[own, own + 1], &tile.tangent, tile.offset([at[own], at[own + 1]]), tile.variance);
        }
    }
}

/// The log of a sum of expansions about the same positions as one expansion, its information without the negative
/// part that disagreement between them makes: its gradient and information.
///
/// With shares rₖ, g = Σ rₖ gₖ and Λ = Σ rₖ (Λₖ - gₖ gₖ') + g g'.
pub(super) fn together(expansions: &[Expansion], positions: usize) -> (Vec<f64>, Vec<f64>) {
    let n = positions;
    let largest = expansions.iter().map(|expansion| expansion.log_value).fold(f64::NEG_INFINITY, f64::max);
    let shares: Vec<f64> = expansions.iter().map(|expansion| (expansion.log_value - largest).exp()).collect();
    let total: f64 = shares.iter().sum();
    let mut gradient = vec![0.0; n];
    let mut information: DMatrix<f64> = DMatrix::zeros(n, n);
    for (expansion, share) in expansions.iter().zip(&shares) {
        for row in 0..n {
            gradient[row] += share / total * expansion.gradient[row];
            for column in 0..n {
                let outer = expansion.gradient[row] * expansion.gradient[column];
                information[(row, column)] +=
                    share / total * (expansion.information[row * n + column] - outer);
            }
        }
    }
    for row in 0..n {
        for column in 0..n {
            information[(row, column)] += gradient[row] * gradient[column];
        }
    }
    let eigen = (&information + information.transpose()).scale(0.5).symmetric_eigen();
    let kept: DMatrix<f64> = DMatrix::from_diagonal(&eigen.eigenvalues.map(|value: f64| value.max(0.0)));
    let information: DMatrix<f64> = &eigen.eigenvectors * kept * eigen.eigenvectors.transpose();
    (gradient, information.as_slice().to_vec())
}
