//! Weighted particles: points that carry a message, with log weights.
//!
//! A set has one of two roles. A **sample** stands for a distribution: averages over it, weighted, are the
//! distribution's. A **likelihood** stands for a function: its log weights are the values of a message at points
//! that some other message provides (pointwise belief propagation; Ihler and McAllester 2009, "Particle belief
//! propagation"). A sample times likelihoods on its points is a sample, and costs one addition per point.

mod family;

pub(crate) use family::carrier;

use crate::Cholesky;
use crate::cumulants::Cumulants;
use crate::kernel::{Kernel, regression};
use crate::moments::Moments;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use sumprod_graph::{Coordinate, MessageError, Space, wrap_angle};

/// Where the points of a predicted state are drawn from, where something is known of it already (a guide: the
/// belief's start, or the product of Gaussian messages that have come first).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Proposal {
    /// From the motion alone.
    Prediction,
    /// From the motion times a widened guide, a share from the motion alone, and smoothed by a kernel: safe where
    /// the guide is approximate. The weights make it a sample of the prediction again.
    #[default]
    Informed,
    /// From the motion times the guide as it is: the optimal proposal where the guide is the exact product of all
    /// other messages, and then the product's weights are equal.
    Optimal,
}

/// How an edge holds particles.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ParticlesForm {
    /// Number of particles.
    pub count: usize,
    /// Number of the sender's particles that a pointwise message averages over; all where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub senders: Option<usize>,
    /// Where predicted points are drawn from.
    #[serde(default)]
    pub proposal: Proposal,
}

impl Default for ParticlesForm {
    fn default() -> Self {
        Self::new(1000)
    }
}

impl ParticlesForm {
    /// `count` particles, averaging over all of the sender's.
    pub fn new(count: usize) -> Self {
        Self { count, senders: None, proposal: Proposal::default() }
    }
}

/// What a set of particles stands for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Role {
    /// A distribution, by weighted samples.
    #[default]
    Sample,
    /// A function, by its log values at the points.
    Likelihood,
}

/// Points shared by all messages that are carried by them.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Support {
    pub(crate) coordinates: Vec<Coordinate>,
    /// Point by point.
    pub(crate) points: Vec<f64>,
    /// Log density the points were drawn from, where it is known.
    pub(crate) log_proposal: Option<Vec<f64>>,
}

/// Weighted particles over a continuous variable.
#[derive(Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Particles {
    pub(crate) support: Arc<Support>,
    #[serde(with = "zero_weights")]
    pub(crate) log_weights: Vec<f64>,
    pub(crate) role: Role,
}

impl Clone for Particles {
    fn clone(&self) -> Self {
        Self { support: self.support.clone(), log_weights: self.log_weights.clone(), role: self.role }
    }

    /// Reuses the storage of `self`, which a derived `clone_from` would not.
    fn clone_from(&mut self, source: &Self) {
        self.support.clone_from(&source.support);
        self.log_weights.clone_from(&source.log_weights);
        self.role = source.role;
    }
}

impl Particles {
    /// A sample from its points (point by point, each of the space's dimension) and log weights.
    ///
    /// # Errors
    ///
    /// Where sizes do not agree, a number is NaN, or no weight is positive.
    pub fn new(space: &Space, points: Vec<f64>, log_weights: Vec<f64>) -> Result<Self, MessageError> {
        let (Space::Continuous(_) | Space::Se2, Some(coordinates)) = (space, space.coordinates()) else {
            return Err(MessageError::Unsupported("particles need a continuous variable".into()));
        };
        if coordinates.is_empty() {
            return Err(MessageError::Unsupported("particles need a variable with coordinates".into()));
        }
        let (found, expected) = (points.len(), coordinates.len() * log_weights.len());
        if found != expected {
            return Err(MessageError::Dimension { what: "the particles' points", found, expected });
        }
        if let Some(&value) = points.iter().find(|value| !value.is_finite()) {
            return Err(MessageError::NotFinite { what: "a particle's coordinate", value });
        }
        let support = Arc::new(Support { coordinates: coordinates.to_vec(), points, log_proposal: None });
        let mut particles = Self { support, log_weights, role: Role::Sample };
        particles.normalise("the particles")?;
        Ok(particles)
    }

    /// A sample of equal weights.
    ///
    /// # Errors
    ///
    /// As [`Particles::new`].
    pub fn equally_weighted(space: &Space, points: Vec<f64>) -> Result<Self, MessageError> {
        let count = points.len() / space.dimension().max(1);
        Self::new(space, points, vec![0.0; count])
    }

    /// The log values of a function at the points of `carrier`: a message that `carrier`'s belief can absorb.
    ///
    /// # Errors
    ///
    /// Where there is not one value per point, or a value is NaN.
    pub fn likelihood(carrier: &Self, log_values: Vec<f64>) -> Result<Self, MessageError> {
        let (found, expected) = (log_values.len(), carrier.len());
        if found != expected {
            return Err(MessageError::Dimension { what: "the likelihood's values", found, expected });
        }
        if let Some(&value) = log_values.iter().find(|value| value.is_nan() || **value == f64::INFINITY) {
            return Err(MessageError::NotFinite { what: "a log likelihood", value });
        }
        Ok(Self { support: carrier.support.clone(), log_weights: log_values, role: Role::Likelihood })
    }

    /// Becomes the likelihood on `carrier`'s points whose log values `fill` writes; reuses storage.
    ///
    /// # Errors
    ///
    /// Whatever `fill` returns, and where a value is NaN.
    pub fn become_likelihood(
        &mut self,
        carrier: &Self,
        fill: impl FnOnce(&mut [f64]) -> Result<(), MessageError>,
    ) -> Result<(), MessageError> {
        self.support.clone_from(&carrier.support);
        self.role = Role::Likelihood;
        self.log_weights.clear();
        self.log_weights.resize(carrier.len(), 0.0);
        fill(&mut self.log_weights)?;
        match self.log_weights.iter().find(|value| value.is_nan() || **value == f64::INFINITY) {
            Some(&value) => Err(MessageError::NotFinite { what: "a log likelihood", value }),
            None => Ok(()),
        }
    }

    /// Becomes a sample of `count` points that `fill` writes with their log weights; reuses storage where no
    /// other message shares it.
    ///
    /// # Errors
    ///
    /// Whatever `fill` returns, and as [`Particles::new`].
    pub fn become_sample(
        &mut self,
        coordinates: &[Coordinate],
        count: usize,
        fill: impl FnOnce(&mut [f64], &mut [f64]) -> Result<(), MessageError>,
    ) -> Result<(), MessageError> {
        if Arc::get_mut(&mut self.support).is_none() {
            self.support = Arc::new(Support::default());
        }
        let Some(support) = Arc::get_mut(&mut self.support) else {
            return Err(MessageError::Unsupported("the particles' storage is shared".into()));
        };
        support.coordinates.clear();
        support.coordinates.extend_from_slice(coordinates);
        support.log_proposal = None;
        support.points.clear();
        support.points.resize(count * coordinates.len(), 0.0);
        self.role = Role::Sample;
        self.log_weights.clear();
        self.log_weights.resize(count, 0.0);
        fill(&mut support.points, &mut self.log_weights)?;
        if let Some(&value) = support.points.iter().find(|value| !value.is_finite()) {
            return Err(MessageError::NotFinite { what: "a particle's coordinate", value });
        }
        self.normalise("the particles")
    }

    /// Number of particles.
    pub fn len(&self) -> usize {
        self.log_weights.len()
    }

    /// Whether there is none: the vacuous message.
    pub fn is_empty(&self) -> bool {
        self.log_weights.is_empty()
    }

    /// Number of coordinates.
    pub fn dimension(&self) -> usize {
        self.support.coordinates.len()
    }

    /// The coordinates, real or angular.
    pub fn coordinates(&self) -> &[Coordinate] {
        &self.support.coordinates
    }

    /// What the set stands for.
    pub fn role(&self) -> Role {
        self.role
    }

    /// The points, one after the other.
    pub fn points(&self) -> &[f64] {
        &self.support.points
    }

    /// One point.
    pub fn point(&self, index: usize) -> &[f64] {
        let d = self.dimension();
        &self.support.points[index * d..(index + 1) * d]
    }

    /// Log weights; of a sample, the largest total is normalised to log 1.
    pub fn log_weights(&self) -> &[f64] {
        &self.log_weights
    }

    /// Weights that sum to one.
    pub fn weights(&self) -> Vec<f64> {
        let largest = self.largest_log_weight();
        let mut weights: Vec<f64> = self.log_weights.iter().map(|log| (log - largest).exp()).collect();
        let total: f64 = weights.iter().sum();
        weights.iter_mut().for_each(|weight| *weight /= total);
        weights
    }

    /// Effective sample size (Σw)² / Σw², between one and the number of particles; zero where no weight is
    /// positive.
    pub fn effective_sample_size(&self) -> f64 {
        let largest = self.largest_log_weight();
        let (sum, squares) = self.log_weights.iter().fold((0.0, 0.0), |(sum, squares), log| {
            let weight = (log - largest).exp();
            (sum + weight, squares + weight * weight)
        });
        if squares > 0.0 { sum * sum / squares } else { 0.0 }
    }

    /// Weighted mean; angles by the direction of the mean vector.
    pub fn mean(&self) -> Vec<f64> {
        let weights = self.weights();
        let d = self.dimension();
        (0..d)
            .map(|coordinate| {
                let values = weights.iter().zip(self.support.points.iter().skip(coordinate).step_by(d));
                match self.support.coordinates[coordinate] {
                    Coordinate::Real => values.map(|(weight, x)| weight * x).sum(),
                    Coordinate::Angle => {
                        let (sine, cosine) = values.fold((0.0, 0.0), |(s, c), (weight, x)| {
                            (s + weight * x.sin(), c + weight * x.cos())
                        });
                        sine.atan2(cosine)
                    }
                }
            })
            .collect()
    }

    /// Weighted mean and covariance about it, angular differences wrapped.
    pub fn moments(&self) -> Moments {
        let mean = self.mean();
        let d = mean.len();
        let mut covariance = vec![0.0; d * d];
        let mut offset = vec![0.0; d];
        for (weight, point) in self.weights().iter().zip(self.support.points.chunks_exact(d.max(1))) {
            self.offset(point, &mean, &mut offset);
            for row in 0..d {
                for column in 0..=row {
                    covariance[row * d + column] += weight * offset[row] * offset[column];
                }
            }
        }
        for row in 0..d {
            for column in 0..row {
                covariance[column * d + row] = covariance[row * d + column];
            }
        }
        Moments { mean, covariance }
    }

    /// Cumulants about the mean of `moments`, in the units of their covariance.
    pub(crate) fn cumulants(&self, moments: &Moments) -> Result<Cumulants, MessageError> {
        let d = moments.dimension();
        let factor = Cholesky::new(&moments.covariance, d, "the covariance of the particles")?;
        let mut cumulants = Cumulants::new(d);
        let mut offset = vec![0.0; d];
        for (weight, point) in self.weights().iter().zip(self.support.points.chunks_exact(d.max(1))) {
            self.offset(point, &moments.mean, &mut offset);
            factor.solve_lower(&mut offset);
            cumulants.add_point(*weight, &offset);
        }
        Ok(cumulants)
    }

    /// The particles on some of their coordinates.
    pub(crate) fn marginal(&self, read: &[usize]) -> Self {
        let coordinates = read.iter().map(|&k| self.support.coordinates[k]).collect();
        let d = self.dimension().max(1);
        let points = self.support.points.chunks_exact(d);
        let points = points.flat_map(|point| read.iter().map(|&k| point[k])).collect();
        let support = Arc::new(Support { coordinates, points, log_proposal: None });
        Self { support, log_weights: self.log_weights.clone(), role: self.role }
    }

    pub(crate) fn offset(&self, point: &[f64], from: &[f64], out: &mut [f64]) {
        for (coordinate, kind) in self.support.coordinates.iter().enumerate() {
            let difference = point[coordinate] - from[coordinate];
            out[coordinate] = if *kind == Coordinate::Angle { wrap_angle(difference) } else { difference };
        }
    }

    /// Weighted quantile of a coordinate: the smallest value whose cumulative weight reaches `probability`.
    /// Angles are measured from their mean. None where there are no particles or no such coordinate.
    pub fn quantile(&self, coordinate: usize, probability: f64) -> Option<f64> {
        let d = self.dimension();
        let kind = *self.support.coordinates.get(coordinate)?;
        let centre = if kind == Coordinate::Angle { self.mean()[coordinate] } else { 0.0 };
        let values = self.support.points.iter().skip(coordinate).step_by(d);
        let place = |x: f64| if kind == Coordinate::Angle { centre + wrap_angle(x - centre) } else { x };
        let mut sorted: Vec<(f64, f64)> = values.map(|&x| place(x)).zip(self.weights()).collect();
        sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut reached = 0.0;
        for &(value, weight) in &sorted {
            reached += weight;
            if reached >= probability {
                return Some(value);
            }
        }
        sorted.last().map(|last| last.0)
    }

    /// Number of different points over the number of points; zero where there is none.
    pub fn distinct_fraction(&self) -> f64 {
        let d = self.dimension().max(1);
        let mut order: Vec<&[f64]> = self.support.points.chunks_exact(d).collect();
        let compare = |a: &&[f64], b: &&[f64]| {
            a.iter()
                .zip(b.iter())
                .map(|(x, y)| x.total_cmp(y))
                .find(|o| o.is_ne())
                .unwrap_or(std::cmp::Ordering::Equal)
        };
        order.sort_by(compare);
        order.dedup();
        order.len() as f64 / self.len().max(1) as f64
    }

    /// Whether both are carried by the same points.
    pub fn same_support(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.support, &other.support) || self.support == other.support
    }

    pub(crate) fn largest_log_weight(&self) -> f64 {
        self.log_weights.iter().copied().fold(f64::NEG_INFINITY, f64::max)
    }

    /// Shifts the log weights so that the weights of a sample sum to one; a likelihood only loses its maximum.
    pub(crate) fn normalise(&mut self, what: &'static str) -> Result<(), MessageError> {
        let largest = self.largest_log_weight();
        if let Some(&value) = self.log_weights.iter().find(|value| value.is_nan()) {
            return Err(MessageError::NotFinite { what: "a log weight", value });
        }
        if !largest.is_finite() {
            let remedy = "use more particles, a proposal nearer the measurement, or a wider noise";
            return Err(MessageError::NoWeight { what, largest, remedy });
        }
        let total: f64 = self.log_weights.iter().map(|log| (log - largest).exp()).sum();
        let shift = if self.role == Role::Sample { largest + total.ln() } else { largest };
        self.log_weights.iter_mut().for_each(|log| *log -= shift);
        Ok(())
    }

    /// Multiplies by the message `other` at this set's points: by addition on the same points, else through a
    /// kernel density of a sample or a kernel regression of a likelihood.
    pub(crate) fn absorb(&mut self, other: &Self) -> Result<(), MessageError> {
        if other.is_empty() {
            return Ok(());
        }
        if self.dimension() != other.dimension() {
            let (found, expected) = (other.dimension(), self.dimension());
            return Err(MessageError::Dimension { what: "a message of the product", found, expected });
        }
        let shared = self.same_support(other);
        if shared && !(self.role == Role::Sample && other.role == Role::Sample) {
            for (a, b) in self.log_weights.iter_mut().zip(&other.log_weights) {
                *a += b;
            }
            if other.role == Role::Sample {
                self.role = Role::Sample;
            }
            return Ok(());
        }
        let kernel = Kernel::silverman(other)?;
        for (point, log) in
            self.support.points.chunks_exact(self.support.coordinates.len()).zip(&mut self.log_weights)
        {
            *log += match other.role {
                Role::Sample => kernel.log_density(other, point),
                Role::Likelihood => regression(&kernel, other, point),
            };
        }
        Ok(())
    }
}

/// Log weights in formats that know no infinity: a weight of zero is written as none.
mod zero_weights {
    use serde::{Deserialize, Deserializer, Serializer};

    pub(super) fn serialize<S: Serializer>(log_weights: &[f64], serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(log_weights.iter().map(|&log| (log != f64::NEG_INFINITY).then_some(log)))
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<f64>, D::Error> {
        let log_weights = Vec::<Option<f64>>::deserialize(deserializer)?;
        Ok(log_weights.into_iter().map(|log| log.unwrap_or(f64::NEG_INFINITY)).collect())
    }
}
