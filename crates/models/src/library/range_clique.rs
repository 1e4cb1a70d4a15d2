//! All ranges to one landmark of which nothing else is known: a clique of the junction tree of range-only SLAM.
//!
//! Given where the ranges were measured from, landmarks are independent; so the ranges to one landmark L join a
//! trajectory (port 0) with a clique (port 1) of the positions they were measured from and L itself:
//!
//! f(trajectory, clique) = δ(positions - those of the trajectory) Πᵣ N(zᵣ; |L - p(r)|, σᵣ²), L flat.
//!
//! Separate factors for each range would make loops between trajectory and landmark. As one factor they make a tree,
//! on which forward-backward is sum-product proper, and a draw of the trajectory followed by one of each clique given
//! it is a joint draw.
//!
//! **To the clique** goes a mixture. The ring of the shortest range is cut into tiles whose sum is a flat prior; in
//! each, Gauss-Newton finds the mode of tile × ranges × what is known of the trajectory, and the component is the
//! Laplace approximation there, its weight included. One range leaves a ring of tiles, two leave two modes, more leave
//! one, with nothing decided beforehand.
//!
//! **To the trajectory** goes a Gaussian: the log of the ranges with the landmark integrated out, mode by mode, expanded
//! to second order at the trajectory's belief. What modes that disagree would add of negative information is left out. A
//! single range constrains no trajectory at all.
//!
//! In the form `gaussian` one component stands for all: the mode that Gauss-Newton reaches from the clique's belief or
//! start, and a direction that no range constrains is as wide as the ring.

mod climb;
mod ring;
mod rules;
mod separator;

use super::checks::{coordinates, finite, size};
use climb::{Component, Expansion, Target, Tile, together};
use ring::{single, tiles};
use separator::Separator;
use std::f64::consts::TAU;
use sumprod_graph::{MessageError, Space};
use sumprod_messages::{DynamicGaussian, Mixture};

/// Most tiles of a ring where the form of the edge sets no limit.
const MOST_TILES: usize = 1_000;
/// Log weight (nats) below the heaviest component's from which a component is left out.
const NEGLIGIBLE: f64 = 15.0;

/// Squared distance of two modes, in units of their spread, within which they are one.
const SAME_MODE: f64 = 1e-4;

/// A range to the landmark.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CliqueRange {
    /// Number of the position that it was measured from, within the clique's.
    pub position: usize,
    /// The measured distance (m).
    pub measured: f64,
    /// Its variance (m²).
    pub variance: f64,
}

/// The ranges to one landmark as one factor of a trajectory (port 0) and of the clique [x₀, y₀, x₁, y₁, …, Lx, Ly]
/// (port 1).
#[derive(Clone, Debug)]
pub struct RangeClique {
    dimensions: [usize; 2],
    /// Coordinates of the trajectory that the clique's positions are, one after the other.
    positions: Vec<usize>,
    ranges: Vec<CliqueRange>,
}

impl RangeClique {
    /// Ranges measured from these positions of a trajectory, each given by its two coordinates in a variable of
    /// `trajectory` coordinates.
    ///
    /// # Errors
    ///
    /// Where there is no range or a range refers to no position, a number is not finite, a variance is not positive,
    /// or the trajectory lacks a coordinate.
    pub fn new(
        trajectory: usize,
        positions: &[[usize; 2]],
        ranges: Vec<CliqueRange>,
    ) -> Result<Self, MessageError> {
        if ranges.is_empty() {
            return Err(MessageError::Unsupported("a clique of ranges needs at least one range".into()));
        }
        for position in positions {
            coordinates("a position of the clique", position, trajectory)?;
        }
        for range in &ranges {
            finite("a range of the clique", &[range.measured])?;
            coordinates("a range of the clique", &[range.position], positions.len())?;
            if !(range.variance > 0.0 && range.variance.is_finite()) {
                let what = "the variance of a range of the clique";
                return Err(MessageError::NotPositiveDefinite { what, pivot: 0, value: range.variance });
            }
        }
        let dimensions = [trajectory, 2 * positions.len() + 2];
        Ok(Self { dimensions, positions: positions.as_flattened().to_vec(), ranges })
    }

    /// The dimensions of the trajectory and of the clique.
    pub fn dimensions(&self) -> &[usize; 2] {
        &self.dimensions
    }

    /// Coordinates of the trajectory that the clique's positions are, one after the other.
    pub fn positions(&self) -> &[usize] {
        &self.positions
    }

    /// Middle and radius (m) of the shortest range's ring around a trajectory at `trajectory`; the origin where it lacks a
    /// coordinate.
    pub fn ring(&self, trajectory: &[f64]) -> ([f64; 2], f64) {
        let shortest = self.shortest();
        let first = 2 * shortest.position;
        let middle = [first, first + 1].map(|k| {
            self.positions.get(k).and_then(|&coordinate| trajectory.get(coordinate)).copied().unwrap_or(0.0)
        });
        (middle, shortest.measured)
    }

    /// Log density of the ranges at positions, one after the other, and a landmark, normalised in the ranges.
    ///
    /// # Panics
    ///
    /// Where there are fewer positions than the clique's.
    pub fn log_density(&self, positions: &[f64], landmark: [f64; 2]) -> f64 {
        let each = self.ranges.iter().map(|range| {
            let from = &positions[2 * range.position..];
            let residual = (landmark[0] - from[0]).hypot(landmark[1] - from[1]) - range.measured;
            -0.5 * (residual * residual / range.variance + (TAU * range.variance).ln())
        });
        each.sum()
    }

    /// The clique's distribution, given what is known of the trajectory without these ranges, by at most `most`
    /// components; and the log of its integral, the evidence of these ranges. O(tiles · positions³).
    ///
    /// # Errors
    ///
    /// Where the trajectory leaves a position open, or no component is left.
    pub fn mixture(&self, trajectory: &DynamicGaussian, most: usize) -> Result<(Mixture, f64), MessageError> {
        let separator = Separator::new(trajectory, &self.positions)?;
        let ring = self.cut(&separator.mean, Some(&separator), most);
        let target = Target { clique: self, separator: Some(&separator), tile: None };
        let own = separator.mean.len();
        let components = ring.iter().filter_map(|tile| {
            let component = Target { tile: Some(tile), ..target }.component(&separator.mean, tile.centre)?;
            tile.faces([component.mean[own], component.mean[own + 1]]).then_some(component)
        });
        self.assemble(components.collect())
    }

    /// As [`RangeClique::mixture`] by the one component that is reached from a landmark at `start` (m).
    ///
    /// # Errors
    ///
    /// As [`RangeClique::mixture`].
    pub fn gaussian(
        &self,
        trajectory: &DynamicGaussian,
        start: [f64; 2],
    ) -> Result<(Mixture, f64), MessageError> {
        let separator = Separator::new(trajectory, &self.positions)?;
        let shortest = self.shortest();
        let radius = shortest.measured.max(shortest.variance.sqrt());
        let tile = single(self.centre(&separator.mean), radius, start);
        let target = Target { clique: self, separator: Some(&separator), tile: None };
        let d = self.dimensions[1];
        let known = |component: &Component| {
            let spread: f64 = (d - 2..d).map(|k| component.covariance[k * d + k]).sum();
            spread < 2.0 * tile.variance
        };
        let component = target
            .component(&separator.mean, start)
            .filter(known)
            .or_else(|| Target { tile: Some(&tile), ..target }.component(&separator.mean, start));
        self.assemble(component.into_iter().collect())
    }

    /// The message to a trajectory that is believed to be at `trajectory`, by all modes of the landmark.
    ///
    /// # Errors
    ///
    /// Where `trajectory` has not the trajectory's dimension, or a number is not finite.
    pub fn to_trajectory(&self, trajectory: &[f64]) -> Result<DynamicGaussian, MessageError> {
        let positions = self.positions_of(trajectory)?;
        if self.ranges.len() == 1 {
            return self.expanded(&positions, &[]);
        }
        let ring = self.cut(&positions, None, MOST_TILES);
        let target = Target { clique: self, separator: None, tile: None };
        let tiled = |tile| Target { tile: Some(tile), ..target }.expansion(&positions, tile.centre);
        let starts: Vec<Expansion> = ring.iter().filter_map(tiled).collect();
        let largest = starts.iter().map(|start| start.log_value).fold(f64::NEG_INFINITY, f64::max);
        let mut modes: Vec<Expansion> = Vec::new();
        for start in starts.iter().filter(|start| start.log_value > largest - NEGLIGIBLE) {
            let Some(mode) = target.expansion(&positions, start.landmark) else { continue };
            let near = |other: &Expansion| {
                let [x, y] = [0, 1].map(|k| mode.landmark[k] - other.landmark[k]);
                x * x + y * y < SAME_MODE * mode.spread
            };
            if !modes.iter().any(near) {
                modes.push(mode);
            }
        }
        self.expanded(&positions, &modes)
    }

    /// The message to a trajectory that is believed to be at `trajectory`, by the mode that is reached from a landmark
    /// at `start` (m).
    ///
    /// # Errors
    ///
    /// As [`RangeClique::to_trajectory`].
    pub fn gaussian_to_trajectory(
        &self,
        trajectory: &[f64],
        start: [f64; 2],
    ) -> Result<DynamicGaussian, MessageError> {
        let positions = self.positions_of(trajectory)?;
        let target = Target { clique: self, separator: None, tile: None };
        let mode = target.expansion(&positions, start);
        self.expanded(&positions, mode.as_slice())
    }

    fn positions_of(&self, trajectory: &[f64]) -> Result<Vec<f64>, MessageError> {
        size("the trajectory of a clique", trajectory.len(), self.dimensions[0])?;
        Ok(self.positions.iter().map(|&coordinate| trajectory[coordinate]).collect())
    }

    /// The sum of these modes as a message.
    fn expanded(&self, positions: &[f64], modes: &[Expansion]) -> Result<DynamicGaussian, MessageError> {
        let (n, own) = (self.dimensions[0], positions.len());
        let radius = self.shortest().measured;
        // A landmark that may be anywhere on a ring can be at any distance from anywhere: that says nothing.
        let open = modes.iter().any(|mode| mode.spread > radius * radius);
        if self.ranges.len() == 1 || modes.is_empty() || open {
            return Ok(DynamicGaussian::flat(n));
        }
        let (gradient, curvature) = together(modes, own);
        let (mut information, mut vector) = (vec![0.0; n * n], vec![0.0; n]);
        for (row, &to) in self.positions.iter().enumerate() {
            let entries = &curvature[row * own..][..own];
            vector[to] = gradient[row] + entries.iter().zip(positions).map(|(a, x)| a * x).sum::<f64>();
            for (&entry, &from) in entries.iter().zip(&self.positions) {
                information[to * n + from] = entry;
            }
        }
        DynamicGaussian::from_information(&information, &vector)
    }

    fn shortest(&self) -> CliqueRange {
        self.ranges.iter().fold(
            self.ranges[0],
            |best, range| {
                if range.measured < best.measured { *range } else { best }
            },
        )
    }

    fn centre(&self, positions: &[f64]) -> [f64; 2] {
        let first = 2 * self.shortest().position;
        [positions[first], positions[first + 1]]
    }

    /// The ring of the shortest range in tiles, at most `most`.
    fn cut(&self, positions: &[f64], separator: Option<&Separator>, most: usize) -> Vec<Tile> {
        let shortest = self.shortest();
        let (x, own) = (2 * shortest.position, positions.len());
        let blur = separator.map_or(0.0, |separator| {
            0.5 * (separator.covariance[x * own + x] + separator.covariance[(x + 1) * own + x + 1])
        });
        let deviation = (shortest.variance + blur).sqrt();
        tiles(self.centre(positions), shortest.measured, deviation, most.min(MOST_TILES))
    }

    fn assemble(&self, components: Vec<Component>) -> Result<(Mixture, f64), MessageError> {
        let heaviest =
            components.iter().map(|component| component.log_weight).fold(f64::NEG_INFINITY, f64::max);
        let (mut log_weights, mut means, mut covariances) = (Vec::new(), Vec::new(), Vec::new());
        let mut total = 0.0;
        for component in components.iter().filter(|component| component.log_weight > heaviest - NEGLIGIBLE) {
            total += (component.log_weight - heaviest).exp();
            log_weights.push(component.log_weight);
            means.extend_from_slice(&component.mean);
            covariances.extend_from_slice(&component.covariance);
        }
        if log_weights.is_empty() {
            let reason = "the ranges to a landmark and the trajectory agree nowhere in double precision";
            return Err(MessageError::Unsupported(reason.into()));
        }
        let space = Space::real(self.dimensions[1]);
        Ok((Mixture::new(&space, log_weights, means, covariances)?, heaviest + total.ln()))
    }
}
