//! Interacting multiple models: a state that moves by one of several motions, and changes between them.
//!
//! Predict: with μ the modes' probabilities and Π those of changing, cⱼ = Σᵢ Πᵢⱼ μᵢ; mode j starts from the mixture
//! of all modes' beliefs by the weights Πᵢⱼ μᵢ / cⱼ, matched by moments. Correct: μⱼ ∝ cⱼ p(z | j). Source: Blom and
//! Bar-Shalom, "The interacting multiple model algorithm" (1988).

use smallvec::SmallVec;
use sumprod_graph::MessageError;
use sumprod_messages::Moments;
use sumprod_models::{Motion, Residual};

use super::kalman::{Kalman, Square};
use super::{Approximation, GaussianRecord};
use crate::{Correct, Correction, Filter, FilterError, Predict};

/// A bank of Gaussian filters that mix before each prediction, one a motion.
///
/// `predict` takes the motions as a slice, one a mode, in the order of the modes.
#[derive(Clone, Debug, PartialEq)]
pub struct Imm<const D: usize> {
    modes: Vec<Kalman<D>>,
    probabilities: Vec<f64>,
    /// Row by row, the probability of going from one mode to another at a prediction.
    changes: Vec<f64>,
    step: u64,
}

/// A step of a bank: each mode's probability and filter.
#[derive(Clone, Debug, PartialEq)]
pub struct ModeRecord<const D: usize> {
    /// Probability of each mode.
    pub probabilities: Vec<f64>,
    /// Each mode's step.
    pub modes: Vec<GaussianRecord<D>>,
}

/// Sums of probabilities this far from one are taken for a mistake.
const ROUNDING: f64 = 1e-9;

impl<const D: usize> Imm<D> {
    /// A bank that starts every mode from one prior. `probabilities` has an entry a mode, `changes` (row-major) a row
    /// a mode: the probabilities of being in each mode after a prediction.
    ///
    /// # Errors
    ///
    /// Where the prior is no distribution of `D` coordinates, there is no mode, `changes` is not square of as many
    /// rows, or probabilities are negative or do not sum to one.
    pub fn new(prior: &Moments, probabilities: &[f64], changes: &[f64]) -> Result<Self, FilterError> {
        let n = probabilities.len();
        if n == 0 || changes.len() != n * n {
            return Err(FilterError::Setting {
                what: "the number of probabilities of changing mode",
                value: changes.len() as f64,
                expected: "it must be the square of the number of modes, of which there is at least one",
            });
        }
        for row in std::iter::once(probabilities).chain(changes.chunks_exact(n)) {
            let total: f64 = row.iter().sum();
            if row.iter().any(|p| !(0.0..=1.0 + ROUNDING).contains(p)) || (total - 1.0).abs() > ROUNDING {
                return Err(FilterError::Setting {
                    what: "the sum of the modes' probabilities, or of a row of changes,",
                    value: total,
                    expected: "it must be 1, and no term negative",
                });
            }
        }
        let modes = vec![Kalman::new(prior)?; n];
        Ok(Self { modes, probabilities: probabilities.to_vec(), changes: changes.to_vec(), step: 0 })
    }

    /// Treats what is not linear otherwise than by first-order expansion at the mean.
    #[must_use]
    pub fn approximated(mut self, approximation: Approximation) -> Self {
        self.modes = self.modes.into_iter().map(|mode| mode.approximated(approximation)).collect();
        self
    }

    /// Probability of each mode.
    pub fn probabilities(&self) -> &[f64] {
        &self.probabilities
    }

    /// Each mode's filter.
    pub fn modes(&self) -> &[Kalman<D>] {
        &self.modes
    }
}

/// Mean and covariance of a mixture.
fn mixed<'a, const D: usize>(
    parts: impl Iterator<Item = (f64, &'a Kalman<D>)> + Clone,
) -> ([f64; D], Square<D>) {
    let (mut mean, mut covariance) = ([0.0; D], [[0.0; D]; D]);
    for (weight, part) in parts.clone() {
        mean.iter_mut().zip(part.mean()).for_each(|(mean, own)| *mean += weight * own);
    }
    for (weight, part) in parts {
        for row in 0..D {
            for column in 0..D {
                let offset = (part.mean()[row] - mean[row]) * (part.mean()[column] - mean[column]);
                covariance[row][column] += weight * (part.covariance()[row][column] + offset);
            }
        }
    }
    (mean, covariance)
}

impl<const D: usize, M: Motion> Predict<[M]> for Imm<D> {
    fn predict(&mut self, motions: &[M]) -> Result<(), FilterError> {
        let n = self.modes.len();
        if motions.len() != n {
            let (found, expected) = (motions.len(), n);
            let what = "the list of motions, one a mode,";
            return Err(FilterError::step(self.step)(MessageError::Dimension { what, found, expected }));
        }
        let mut next = Vec::with_capacity(n);
        let mut probabilities = Vec::with_capacity(n);
        for (to, motion) in motions.iter().enumerate() {
            let weights: Vec<f64> =
                (0..n).map(|from| self.changes[from * n + to] * self.probabilities[from]).collect();
            let total: f64 = weights.iter().sum();
            let mut mode = self.modes[to].clone();
            if total > 0.0 {
                let parts = weights.iter().map(|weight| weight / total).zip(&self.modes);
                let (mean, covariance) = mixed(parts);
                mode.stand_at(mean, covariance);
            }
            mode.predict(motion)?;
            next.push(mode);
            probabilities.push(total);
        }
        (self.modes, self.probabilities) = (next, probabilities);
        self.step += 1;
        Ok(())
    }
}

impl<const D: usize, M: Motion> Predict<Vec<M>> for Imm<D> {
    fn predict(&mut self, motions: &Vec<M>) -> Result<(), FilterError> {
        self.predict(motions.as_slice())
    }
}

impl<const D: usize, R: Residual> Correct<R> for Imm<D> {
    fn correct(&mut self, measurement: &R) -> Result<Correction, FilterError> {
        let mut modes = self.modes.clone();
        let corrections: Result<Vec<Correction>, FilterError> =
            modes.iter_mut().map(|mode| mode.correct(measurement)).collect();
        let corrections = corrections?;
        let logs: Vec<f64> = self
            .probabilities
            .iter()
            .zip(&corrections)
            .map(|(probability, correction)| probability.ln() + correction.log_likelihood)
            .collect();
        let largest = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let weights: Vec<f64> = logs.iter().map(|log| (log - largest).exp()).collect();
        let total: f64 = weights.iter().sum();
        if !total.is_finite() {
            let what = "the modes' likelihood";
            return Err(FilterError::step(self.step)(MessageError::NotFinite { what, value: total }));
        }
        // The innovation's own mixture, by the probabilities before.
        let m = measurement.noise().dimension();
        let mut innovation: SmallVec<[f64; 6]> = SmallVec::from_elem(0.0, m);
        let mut innovation_covariance: SmallVec<[f64; 9]> = SmallVec::from_elem(0.0, m * m);
        let parts = || self.probabilities.iter().zip(&corrections);
        for (weight, own) in parts() {
            innovation.iter_mut().zip(&own.innovation).for_each(|(sum, own)| *sum += weight * own);
        }
        for (weight, own) in parts() {
            for row in 0..m {
                for column in 0..m {
                    let offset = (own.innovation[row] - innovation[row])
                        * (own.innovation[column] - innovation[column]);
                    innovation_covariance[row * m + column] +=
                        weight * (own.innovation_covariance[row * m + column] + offset);
                }
            }
        }
        self.modes = modes;
        self.probabilities = weights.iter().map(|weight| weight / total).collect();
        let log_likelihood = largest + total.ln();
        Ok(Correction { log_likelihood, innovation, innovation_covariance, recovered: false })
    }
}

impl<const D: usize> Filter for Imm<D> {
    type Record = ModeRecord<D>;

    fn moments(&self) -> Moments {
        let (mean, covariance) = mixed(self.probabilities.iter().copied().zip(&self.modes));
        Moments { mean: mean.to_vec(), covariance: covariance.as_flattened().to_vec() }
    }

    fn step(&self) -> u64 {
        self.step
    }

    fn record(&self) -> ModeRecord<D> {
        let modes = self.modes.iter().map(Filter::record).collect();
        ModeRecord { probabilities: self.probabilities.clone(), modes }
    }
}
