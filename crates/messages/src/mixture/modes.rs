//! Modes of a product of mixtures, and how much of it lies in the basin of each.
//!
//! Every point climbs by x ← (Σₗᵢ rₗᵢ Cₗᵢ⁻¹)⁻¹ Σₗᵢ rₗᵢ Cₗᵢ⁻¹ mₗᵢ, rₗᵢ the share of component i in mixture l at x. Each
//! step maximises a lower bound of Σₗ ln pₗ that touches it at x, so no step descends; for a single mixture it is the
//! Gaussian mean shift (Carreira-Perpiñán 2000, "Mode-finding for mixtures of Gaussian distributions"). The product
//! itself is never formed.

use super::Mixture;
use super::product::check_inputs;
use super::small::{Small, difference, invert, multiply, wrap_point};
use crate::Particles;
use serde::{Deserialize, Serialize};
use sumprod_graph::MessageError;

/// A local maximum of a density.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Mode {
    /// Where it is, by coordinate.
    pub location: Vec<f64>,
    /// Log density there; of a product, up to the log of its normaliser.
    pub log_density: f64,
    /// Share of the given points' weight that climbs to it.
    pub mass: f64,
}

/// Steps that a point may take; a mean shift that has not arrived by then lies on a ridge.
const STEPS: usize = 500;

/// Squared step, in units of the local kernel, below which a point has arrived.
const ARRIVED: f64 = 1e-10;

/// Squared distance, in the same unit, within which two ends are one mode.
const SAME: f64 = 0.01;

/// The modes of the product of `inputs` that `points` climb to, heaviest first; their masses are exact for the
/// points' weights, and within sampling noise the product's where the points are a sample of it.
///
/// O(M T Σₗ Nₗ d²) for M points and T steps each.
///
/// # Errors
///
/// Where there is no input or they differ in their coordinates, or there are no points or of other coordinates.
pub fn modes(inputs: &[&Mixture], points: &Particles) -> Result<Vec<Mode>, MessageError> {
    let first = check_inputs(inputs)?;
    if points.coordinates() != first.coordinates() {
        let (found, expected) = (points.dimension(), first.dimension());
        return Err(MessageError::Dimension { what: "the points that climb to modes", found, expected });
    }
    let mut climber = Climber::new(inputs);
    let mut modes: Vec<Mode> = Vec::new();
    let weights = points.weights();
    let d = first.dimension();
    for (point, weight) in points.points().chunks_exact(d).zip(&weights) {
        let mut x = Small::from_slice(point);
        let mut reached = None;
        for _ in 0..STEPS {
            let squared = climber.step(&mut x);
            // Close enough to a known mode counts as arrived there once the steps have become small.
            if squared < 1e-3 * SAME {
                reached = modes.iter().position(|mode| climber.distance(&x, &mode.location) < SAME);
            }
            if reached.is_some() || squared < ARRIVED {
                break;
            }
        }
        let reached =
            reached.or_else(|| modes.iter().position(|mode| climber.distance(&x, &mode.location) < SAME));
        match reached {
            Some(number) => modes[number].mass += weight,
            None => {
                // A new mode is worth its digits.
                for _ in 0..STEPS {
                    if climber.step(&mut x) < 1e-4 * ARRIVED {
                        break;
                    }
                }
                let log_density = inputs.iter().map(|input| input.log_density(&x)).sum::<Result<f64, _>>()?;
                modes.push(Mode { location: x.to_vec(), log_density, mass: *weight });
            }
        }
    }
    modes.sort_by(|a, b| b.mass.total_cmp(&a.mass));
    Ok(modes)
}

impl Mixture {
    /// The modes of this mixture with the share of its weight in the basin of each, by `count` draws that climb.
    ///
    /// # Errors
    ///
    /// Where `count` is zero.
    pub fn modes(&self, count: usize, stream: &mut sumprod_graph::Stream) -> Result<Vec<Mode>, MessageError> {
        modes(&[self], &self.sample_systematic(count, stream)?)
    }
}

/// The step, with its storage.
struct Climber<'a> {
    inputs: Vec<Input<'a>>,
    precision: Small,
    gradient: Small,
    covariance: Small,
    offset: Small,
    scaled: Small,
    shares: Vec<f64>,
    offsets: Vec<f64>,
}

struct Input<'a> {
    mixture: &'a Mixture,
    /// Inverse covariances, one where they are shared, and half their log determinants.
    precisions: Vec<f64>,
    half_log_determinants: Vec<f64>,
}

impl<'a> Climber<'a> {
    fn new(inputs: &[&'a Mixture]) -> Self {
        let d = inputs.first().map_or(0, |input| input.dimension());
        let prepare = |mixture: &&'a Mixture| {
            let matrices = if mixture.shared { 1 } else { mixture.len() };
            let mut precisions = vec![0.0; matrices * d * d];
            let half_log_determinants = precisions
                .chunks_exact_mut(d * d)
                .enumerate()
                .map(|(i, out)| 0.5 * invert(mixture.covariance_of(i), d, out).unwrap_or(f64::INFINITY))
                .collect();
            Input { mixture, precisions, half_log_determinants }
        };
        Self {
            inputs: inputs.iter().map(prepare).collect(),
            precision: Small::from_elem(0.0, d * d),
            gradient: Small::from_elem(0.0, d),
            covariance: Small::from_elem(0.0, d * d),
            offset: Small::from_elem(0.0, d),
            scaled: Small::from_elem(0.0, d),
            shares: Vec::new(),
            offsets: Vec::new(),
        }
    }

    /// One step from `x`; returns its squared length in the local kernel, and leaves that kernel's precision.
    fn step(&mut self, x: &mut Small) -> f64 {
        let d = x.len();
        self.precision.iter_mut().for_each(|entry| *entry = 0.0);
        self.gradient.iter_mut().for_each(|entry| *entry = 0.0);
        for input in &self.inputs {
            let mixture = input.mixture;
            self.shares.clear();
            self.offsets.clear();
            let mut largest = f64::NEG_INFINITY;
            for i in 0..mixture.len() {
                let matrix = if mixture.shared { 0 } else { i };
                difference(mixture.coordinates(), mixture.mean_of(i), x, &mut self.offset);
                multiply(&input.precisions[matrix * d * d..][..d * d], &self.offset, &mut self.scaled);
                let squared: f64 = self.offset.iter().zip(&self.scaled).map(|(a, b)| a * b).sum();
                let log = mixture.log_weights()[i] - 0.5 * squared - input.half_log_determinants[matrix];
                largest = largest.max(log);
                self.shares.push(log);
                self.offsets.extend_from_slice(&self.scaled);
            }
            self.shares
                .iter_mut()
                .for_each(|log| *log = if *log > largest - 44.0 { (*log - largest).exp() } else { 0.0 });
            let total: f64 = self.shares.iter().sum();
            for (i, share) in self.shares.iter().enumerate().filter(|(_, share)| **share > 0.0) {
                let share = share / total;
                let matrix = if mixture.shared { 0 } else { i };
                for (sum, force) in self.gradient.iter_mut().zip(&self.offsets[i * d..]) {
                    *sum += share * force;
                }
                for (sum, entry) in
                    self.precision.iter_mut().zip(&input.precisions[matrix * d * d..][..d * d])
                {
                    *sum += share * entry;
                }
            }
        }
        if invert(&self.precision, d, &mut self.covariance).is_none() {
            return 0.0;
        }
        multiply(&self.covariance, &self.gradient, &mut self.scaled);
        let squared = self.scaled.iter().zip(&self.gradient).map(|(a, b)| a * b).sum();
        x.iter_mut().zip(&self.scaled).for_each(|(x, step)| *x += step);
        if let Some(input) = self.inputs.first() {
            wrap_point(input.mixture.coordinates(), x);
        }
        squared
    }

    /// Squared distance in the local kernel of the last step.
    fn distance(&mut self, a: &[f64], b: &[f64]) -> f64 {
        let Some(input) = self.inputs.first() else { return 0.0 };
        difference(input.mixture.coordinates(), a, b, &mut self.offset);
        multiply(&self.precision, &self.offset, &mut self.scaled);
        self.offset.iter().zip(&self.scaled).map(|(x, y)| x * y).sum()
    }
}
