//! The particle filter: particles move by the motion's own law and are weighed by likelihoods.
//!
//! Source: Gordon, Salmond, Smith, "Novel approach to nonlinear/non-Gaussian Bayesian state estimation" (1993).

use rand::RngExt;
use rayon::prelude::*;
use smallvec::SmallVec;
use sumprod_graph::{Coordinate, MessageError, Purpose, Space, Stream, wrap_angle};
use sumprod_messages::{Moments, Particles};
use sumprod_models::Motion;
use sumprod_models::cloud::{BLOCK, Cloud, Likelihood, Mover, Source, select};
use sumprod_optimizers::{Reselection, Trigger};

use super::look_ahead::Ahead;
use super::recovery::Recovery;
use super::weights::{Weighing, Weights, largest, wrong};
use super::{prior, summary};
use crate::{Correct, Correction, Filter, FilterError, Predict};

/// Particles from which work is shared among threads: below, handing it out costs more than it saves.
const WORTH_SHARING: usize = 16 * BLOCK;
/// Standard deviations beyond which a residual's density is no longer a number: e^-708 of its peak.
const GATE: f64 = 37.6;

/// A bootstrap particle filter, with a slot for how particles are reselected.
///
/// A step of N particles of d coordinates takes O(N d) and, after the first, allocates nothing that grows with N.
/// The same seed gives the same bits on any number of threads.
///
/// ```
/// use sumprod_filters::{Correct, Filter, ParticleFilter, Predict};
/// use sumprod_graph::Space;
/// use sumprod_messages::Moments;
/// use sumprod_models::Noise;
/// use sumprod_models::cloud::LogLikelihood;
/// use sumprod_models::library::{AnchorRange, ConstantVelocity};
///
/// let prior = Moments::diagonal(&[0.0, 1.0, 0.0, 1.0], &[25.0, 1.0, 25.0, 1.0]);
/// let mut filter = ParticleFilter::new(&Space::real(4), &prior, 1000, 1)?;
/// filter.predict(&ConstantVelocity::white_acceleration(2, 1.0, 0.1)?)?;
/// filter.correct(&AnchorRange::new(100.0, [60.0, -80.0], 4, [0, 2], Noise::isotropic(1, 1.0)?)?)?;
/// // East of a wall, whatever else: a likelihood need be no residual.
/// filter.correct(&LogLikelihood(|x: &[f64]| if x[0] > -5.0 { 0.0 } else { f64::NEG_INFINITY }))?;
/// assert!(filter.effective_sample_size() > 50.0);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct ParticleFilter {
    pub(super) coordinates: Vec<Coordinate>,
    pub(super) cloud: Cloud,
    pub(super) weights: Weights,
    pub(super) seed: u64,
    pub(super) step: u64,
    trigger: Trigger,
    reselection: Option<Box<dyn Reselection>>,
    recovery: Recovery,
    gate: f64,
    pub(super) looks_ahead: bool,
    pub(super) ahead: Option<Ahead>,
    /// Corrections since the last prediction.
    pub(super) corrections: u64,
    pub(super) evaluations: u64,
    pub(super) scratch: Scratch,
}

/// Storage that steps use over again.
#[derive(Default)]
pub(super) struct Scratch {
    pub(super) cloud: Cloud,
    pub(super) chosen: Vec<u32>,
    weighing: Weighing,
}

/// A step of a particle filter: its belief as a message.
pub type ParticleRecord = Particles;

impl ParticleFilter {
    /// `count` particles drawn from a prior; angles of the space are kept in (-π, π].
    ///
    /// # Errors
    ///
    /// Where `count` is zero or above four thousand million, the space has no coordinates, or the prior is no
    /// distribution of its dimension.
    pub fn new(space: &Space, prior: &Moments, count: usize, seed: u64) -> Result<Self, FilterError> {
        let Space::Continuous(coordinates) = space else {
            let reason = "a particle filter needs a continuous state";
            return Err(FilterError::Prior(MessageError::Unsupported(reason.into())));
        };
        if count == 0 || u32::try_from(count).is_err() {
            return Err(FilterError::Setting {
                what: "the number of particles",
                value: count as f64,
                expected: "it must be at least 1 and fit in 32 bits",
            });
        }
        let mut cloud = Cloud::new(coordinates.len(), count);
        let mut random = Stream::new(seed, 0, Purpose::Belief, 0).fast();
        prior::draw(prior, coordinates, &mut random, &mut cloud)?;
        let scratch = Scratch { cloud: cloud.clone(), ..Scratch::default() };
        Ok(Self {
            coordinates: coordinates.clone(),
            weights: Weights::equal(count),
            cloud,
            seed,
            step: 0,
            trigger: Trigger::ALWAYS,
            reselection: None,
            recovery: Recovery::default(),
            gate: GATE,
            looks_ahead: false,
            ahead: None,
            corrections: 0,
            evaluations: 0,
            scratch,
        })
    }

    /// Reselects before a prediction only where the trigger fires; without this, before every one.
    #[must_use]
    pub fn reselecting_when(self, trigger: Trigger) -> Self {
        Self { trigger, ..self }
    }

    /// Reselects in this way; without it systematically, in one pass over blocks.
    #[must_use]
    pub fn reselecting_by(self, reselection: impl Reselection + 'static) -> Self {
        Self { reselection: Some(Box::new(reselection)), ..self }
    }

    /// What to do where no particle explains a measurement.
    #[must_use]
    pub fn recovering_by(self, recovery: Recovery) -> Self {
        Self { recovery, ..self }
    }

    /// Counts a measurement as unexplained where every particle's residual is longer than so many standard
    /// deviations; without this 37.6, where densities end to be numbers.
    ///
    /// # Errors
    ///
    /// Where it is not positive.
    pub fn gated_at(self, deviations: f64) -> Result<Self, FilterError> {
        if deviations > 0.0 {
            return Ok(Self { gate: deviations, ..self });
        }
        let (what, expected) = ("the gate of unexplained measurements", "it must be positive");
        Err(FilterError::Setting { what, value: deviations, expected })
    }

    /// Number of particles.
    pub fn len(&self) -> usize {
        self.cloud.len()
    }

    /// Never: a filter holds at least one particle.
    pub fn is_empty(&self) -> bool {
        self.cloud.is_empty()
    }

    /// Effective sample size (Σ w)² / Σ w², between 1 and the number of particles.
    pub fn effective_sample_size(&self) -> f64 {
        self.weights.effective_sample_size()
    }

    /// Particles at which likelihoods were evaluated so far.
    pub fn likelihood_evaluations(&self) -> u64 {
        self.evaluations
    }

    pub(super) fn seed(&self) -> u64 {
        self.seed
    }

    /// The particles.
    pub fn cloud(&self) -> &Cloud {
        &self.cloud
    }

    /// The weighted mean; angles by the direction of their mean vector.
    pub fn mean(&self) -> Vec<f64> {
        summary::mean(&self.cloud, &self.weights, &self.coordinates, self.parallel())
    }

    /// The belief as a message of a graph.
    ///
    /// # Errors
    ///
    /// Where a coordinate is not finite.
    pub fn particles(&self) -> Result<Particles, FilterError> {
        let logs: Vec<f64> = (0..self.len()).map(|index| self.weights.at(index).ln()).collect();
        Particles::new(&Space::new(self.coordinates.clone()), self.cloud.points(), logs)
            .map_err(FilterError::step(self.step))
    }

    fn parallel(&self) -> bool {
        self.len() >= WORTH_SHARING
    }

    /// Fills the chosen ancestors where reselection is due.
    fn reselect(&mut self) -> Result<bool, FilterError> {
        let count = self.len();
        if self.weights.are_equal() || !self.trigger.fires(self.effective_sample_size(), count) {
            return Ok(false);
        }
        let mut stream = Stream::new(self.seed, self.step, Purpose::Optimizer, 0);
        let chosen = &mut self.scratch.chosen;
        chosen.resize(count, 0);
        match &self.reselection {
            None => {
                let offset = stream.fast().random();
                select(self.weights.selection(), offset, count >= WORTH_SHARING, chosen);
            }
            Some(reselection) => {
                let weights: Vec<f64> = (0..count).map(|index| self.weights.at(index)).collect();
                let ancestors = reselection.ancestors(&weights, count, &mut stream);
                let step = self.step;
                let ancestors = ancestors.map_err(|source| FilterError::Optimizer { step, source })?;
                chosen.iter_mut().zip(ancestors).for_each(|(chosen, index)| *chosen = index as u32);
            }
        }
        Ok(true)
    }

    /// Weighs by a likelihood without asking whether it explains anything.
    pub(super) fn weigh<L: Likelihood>(&mut self, likelihood: &L) -> Result<Outcome, FilterError> {
        self.evaluations += self.len() as u64;
        let parallel = self.parallel();
        let m = likelihood.components();
        let (cloud, weights) = (&self.cloud, &self.weights);
        let blocks: Vec<&[f64]> = cloud.blocks().collect();
        let sums = weights.weigh(parallel, &mut self.scratch.weighing, |block, logs, residuals| {
            let nearest = likelihood.add_log(blocks[block], logs, residuals);
            let mut innovation: SmallVec<[f64; 6]> = SmallVec::from_elem(0.0, m);
            let (relative, scale) = weights.block(block);
            for (innovation, values) in innovation.iter_mut().zip(residuals.chunks_exact(BLOCK)) {
                *innovation = -scale * summary::dot(relative, values);
            }
            (nearest, innovation)
        });
        if let Some((index, value)) = wrong(&sums) {
            let mut point = vec![0.0; cloud.dimension()];
            cloud.read(index, &mut point);
            let reason = format!(
                "the log likelihood of particle {index} at {point:?} is {value}; it must be finite or minus infinity"
            );
            return Err(FilterError::step(self.step)(MessageError::Unsupported(reason)));
        }
        let nearest = sums.iter().map(|(_, (nearest, _))| *nearest).fold(f64::INFINITY, f64::min);
        let unexplained = if largest(&sums) == f64::NEG_INFINITY {
            Some("its likelihood is zero at each".to_owned())
        } else if m > 0 && nearest > self.gate * self.gate {
            let deviations = nearest.sqrt();
            Some(format!("the nearest is {deviations:.1} standard deviations of its noise away"))
        } else {
            None
        };
        if let Some(how) = unexplained {
            return Ok(Outcome::Unexplained(how));
        }
        let total = weights.total();
        let mut innovation: SmallVec<[f64; 6]> = SmallVec::from_elem(0.0, m);
        for (_, (_, own)) in &sums {
            innovation.iter_mut().zip(own).for_each(|(sum, own)| *sum += own / total);
        }
        let (before, after) = self.weights.commit(&mut self.scratch.weighing, &sums);
        let log_likelihood = after - before;
        Ok(Outcome::Weighed(Correction { log_likelihood, innovation, ..Correction::default() }))
    }

    /// Corrects in the way that the user chose.
    fn attempt<L: Likelihood>(&mut self, likelihood: &L) -> Result<Outcome, FilterError> {
        match self.ahead.take() {
            Some(ahead) => self.choose_and_weigh(&ahead, likelihood),
            None => self.weigh(likelihood),
        }
    }

    /// Brings the angles of the cloud in preparation into (-π, π].
    pub(super) fn wrap_scratch(&mut self) {
        let size = (BLOCK * self.coordinates.len()).max(1);
        let angle = |(k, kind): (usize, &Coordinate)| (*kind == Coordinate::Angle).then_some(k);
        for k in self.coordinates.iter().enumerate().filter_map(angle) {
            for block in self.scratch.cloud.values_mut().chunks_mut(size) {
                block[k * BLOCK..][..BLOCK].iter_mut().for_each(|x| *x = wrap_angle(*x));
            }
        }
    }

    /// Makes the particles' next attempt, as the recovery has it.
    fn recover(&mut self) -> Result<(), FilterError> {
        let mut random = Stream::new(self.seed, self.step, Purpose::Belief, self.corrections).fast();
        match &self.recovery {
            Recovery::Fail | Recovery::KeepPrediction => Ok(()),
            Recovery::Redraw(from) => {
                prior::draw(from, &self.coordinates, &mut random, &mut self.scratch.cloud)?;
                std::mem::swap(&mut self.cloud, &mut self.scratch.cloud);
                self.weights.become_equal(self.cloud.len());
                Ok(())
            }
            Recovery::Widen(factor) => {
                let covariance = self.moments().covariance.iter().map(|entry| entry * factor).collect();
                let spread = Moments { mean: vec![0.0; self.coordinates.len()], covariance };
                prior::add(&spread, &self.coordinates, &mut random, &mut self.cloud)
            }
        }
    }
}

/// How a correction ended.
pub(super) enum Outcome {
    Weighed(Correction),
    Unexplained(String),
}

impl<M: Motion> Predict<M> for ParticleFilter {
    fn predict(&mut self, motion: &M) -> Result<(), FilterError> {
        let d = self.coordinates.len();
        if motion.dimension() != d {
            let (found, expected) = (motion.dimension(), d);
            let source = MessageError::Dimension { what: "the motion", found, expected };
            return Err(FilterError::Step { step: self.step, source });
        }
        self.ahead = None;
        if self.looks_ahead {
            self.remember(motion);
        }
        let reselected = !self.looks_ahead && self.reselect()?;
        let mover = Mover::new(motion, &self.coordinates);
        let (seed, step, parallel, count) = (self.seed, self.step, self.parallel(), self.len());
        let (cloud, chosen) = (&self.cloud, &self.scratch.chosen);
        let advance = |draws: &mut Vec<f64>, (block, to): (usize, &mut [f64])| -> bool {
            let mut random = Stream::new(seed, step, Purpose::Message, block as u64).fast();
            let own = (count - block * BLOCK).min(BLOCK);
            let first = block * BLOCK;
            let from = Source { cloud, first, ancestors: reselected.then(|| &chosen[first..][..own]) };
            mover.advance(own, from, &mut random, draws, to)
        };
        let next = self.scratch.cloud.values_mut();
        let finite = if parallel {
            let blocks = next.par_chunks_mut(BLOCK * d).enumerate();
            blocks.map_init(Vec::new, advance).reduce(|| true, |a, b| a & b)
        } else {
            let mut draws = Vec::new();
            let blocks = next.chunks_mut(BLOCK * d).enumerate();
            blocks.fold(true, |all, block| all & advance(&mut draws, block))
        };
        if !finite {
            let value = summary::not_finite(&self.scratch.cloud);
            let source = MessageError::NotFinite { what: "a coordinate of a predicted particle", value };
            return Err(FilterError::Step { step: self.step, source });
        }
        std::mem::swap(&mut self.cloud, &mut self.scratch.cloud);
        if reselected {
            self.weights.become_equal(count);
        }
        self.step += 1;
        self.corrections = 0;
        Ok(())
    }
}

impl<L: Likelihood> Correct<L> for ParticleFilter {
    fn correct(&mut self, measurement: &L) -> Result<Correction, FilterError> {
        let d = self.coordinates.len();
        let dimension = measurement.dimension().map_err(FilterError::step(self.step))?;
        if let Some(found) = dimension.filter(|&found| found != d) {
            let source = MessageError::Dimension { what: "the measured state", found, expected: d };
            return Err(FilterError::Step { step: self.step, source });
        }
        self.corrections += 1;
        let how = match self.attempt(measurement)? {
            Outcome::Weighed(correction) => return Ok(correction),
            Outcome::Unexplained(how) => how,
        };
        let (step, count) = (self.step, self.len());
        let failed = |how, remedy| Err(FilterError::Unexplained { step, count, how, remedy });
        match self.recovery {
            Recovery::Fail => failed(how, "use more particles, a wider noise, or a recovery"),
            Recovery::KeepPrediction => {
                Ok(Correction { log_likelihood: f64::NEG_INFINITY, recovered: true, ..Correction::default() })
            }
            Recovery::Widen(_) | Recovery::Redraw(_) => {
                let (cloud, weights) = (self.cloud.clone(), self.weights.clone());
                let again = self.recover().and_then(|()| self.attempt(measurement));
                match again {
                    Ok(Outcome::Weighed(correction)) => Ok(Correction { recovered: true, ..correction }),
                    Ok(Outcome::Unexplained(how)) => {
                        (self.cloud, self.weights) = (cloud, weights);
                        failed(how, "the recovery did not reach it either; make it wider")
                    }
                    Err(error) => {
                        (self.cloud, self.weights) = (cloud, weights);
                        Err(error)
                    }
                }
            }
        }
    }
}

impl Filter for ParticleFilter {
    type Record = ParticleRecord;

    fn moments(&self) -> Moments {
        summary::moments(&self.cloud, &self.weights, &self.coordinates, self.parallel())
    }

    fn step(&self) -> u64 {
        self.step
    }

    fn record(&self) -> ParticleRecord {
        self.particles().unwrap_or_default()
    }
}
