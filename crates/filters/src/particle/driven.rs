//! The optimizer-driven particle filter: predicted particles become the posterior's by whatever move is put in.
//!
//! With [`Weigh`](sumprod_optimizers::Weigh) it is the bootstrap filter, with
//! [`Regularised`](sumprod_optimizers::Regularised) the regularised one, and with a user's own move a filter of their
//! own. Likelihoods are counted, so that moves can be compared at equal cost.

use std::sync::{Mutex, PoisonError};

use rand::RngExt;
use sumprod_graph::{Coordinate, FastStream, MessageError, Purpose, Space, Stream};
use sumprod_messages::{Evaluator, Mixture, Moments, Particles};
use sumprod_models::Motion;
use sumprod_models::cloud::{BLOCK, Cloud, Likelihood, Mover, Source, log_values};
use sumprod_optimizers::{
    LogDensity, Move, Moved, OptimizerError, PriorDensity, Reselection, Systematic, Target, Trigger, Validity,
};

use super::prior;
use super::recovery::Recovery;
use crate::{Correct, Correction, Filter, FilterError, Predict};

/// A particle filter that corrects by a [`Move`].
///
/// ```
/// use sumprod_filters::{Correct, DrivenFilter, Filter, Predict};
/// use sumprod_graph::Space;
/// use sumprod_messages::Moments;
/// use sumprod_models::Noise;
/// use sumprod_models::library::{AnchorRange, ConstantVelocity};
/// use sumprod_optimizers::QuantumMetropolis;
///
/// let prior = Moments::diagonal(&[0.0, 1.0, 0.0, 1.0], &[25.0, 1.0, 25.0, 1.0]);
/// let movement = Box::new(QuantumMetropolis::default());
/// let mut filter = DrivenFilter::new(&Space::real(4), &prior, 200, 1, movement)?;
/// filter.predict(&ConstantVelocity::held_acceleration(2, 1.0, 0.1)?)?;
/// filter.correct(&AnchorRange::new(100.0, [60.0, -80.0], 4, [0, 2], Noise::isotropic(1, 1.0)?)?)?;
/// assert_eq!(filter.evaluations(), 6 * 200);
/// assert!(filter.particles().distinct_fraction() > 0.9);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct DrivenFilter {
    movement: Box<dyn Move>,
    reselection: Box<dyn Reselection>,
    trigger: Trigger,
    recovery: Recovery,
    gate: f64,
    coordinates: Vec<Coordinate>,
    particles: Particles,
    knows_density: bool,
    /// The predicted density, where it is wanted and no correction has changed it yet.
    density: Option<Mixture>,
    /// The predicted particle that each stems from; empty where they were drawn anew.
    origins: Vec<usize>,
    told: Told,
    seed: u64,
    step: u64,
    /// Moves since the last prediction.
    moves: u64,
    settled: bool,
    evaluations: u64,
}

/// What the last correction's move told besides its particles.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Told {
    /// Log of the estimated evidence, where the move estimates it.
    pub log_evidence: Option<f64>,
    /// Share of accepted proposals, where the move proposes.
    pub acceptance: Option<f64>,
    /// Effective sample size before anything was reselected within the move.
    pub effective_sample_size: f64,
    /// Length of the shortest residual at the points that the move tried, in standard deviations of the measurement's
    /// noise; infinite where the likelihood has no residual, or the move was not made.
    pub nearest: f64,
}

impl DrivenFilter {
    /// `count` particles drawn from a prior; angles of the space are kept in (-π, π].
    ///
    /// # Errors
    ///
    /// Where `count` is zero, the space is not continuous, or the prior is no distribution of its dimension.
    pub fn new(
        space: &Space,
        prior: &Moments,
        count: usize,
        seed: u64,
        movement: Box<dyn Move>,
    ) -> Result<Self, FilterError> {
        let Space::Continuous(coordinates) = space else {
            let reason = "a particle filter needs a continuous state";
            return Err(FilterError::Prior(MessageError::Unsupported(reason.into())));
        };
        if count == 0 {
            let (what, expected) = ("the number of particles", "it must be at least 1");
            return Err(FilterError::Setting { what, value: 0.0, expected });
        }
        let mut cloud = Cloud::new(coordinates.len(), count);
        let mut random = Stream::new(seed, 0, Purpose::Belief, 0).fast();
        prior::draw(prior, coordinates, &mut random, &mut cloud)?;
        Ok(Self {
            movement,
            reselection: Box::new(Systematic),
            trigger: Trigger::ALWAYS,
            recovery: Recovery::Fail,
            gate: f64::INFINITY,
            coordinates: coordinates.clone(),
            particles: Particles::equally_weighted(space, cloud.points()).map_err(FilterError::Prior)?,
            knows_density: false,
            density: None,
            origins: (0..count).collect(),
            told: Told::default(),
            seed,
            step: 0,
            moves: 0,
            settled: true,
            evaluations: 0,
        })
    }

    /// Reselects before a prediction only where the trigger fires; without this, before every one.
    #[must_use]
    pub fn reselecting_when(self, trigger: Trigger) -> Self {
        Self { trigger, ..self }
    }

    /// Reselects in this way; without it systematically.
    #[must_use]
    pub fn reselecting_by(self, reselection: impl Reselection + 'static) -> Self {
        Self { reselection: Box::new(reselection), ..self }
    }

    /// Gives the move the density of the prediction, Σ wⱼ N(x; f(xⱼ), Q), at the first correction of a step. Takes a
    /// process noise of full rank that is the same at every state; each density costs up to N kernels.
    #[must_use]
    pub fn knowing_density(self) -> Self {
        Self { knows_density: true, ..self }
    }

    /// What to do where no particle explains a measurement.
    #[must_use]
    pub fn recovering_by(self, recovery: Recovery) -> Self {
        Self { recovery, ..self }
    }

    /// Counts a measurement as unexplained where the residual is longer than so many standard deviations at every
    /// point that the move tried. Without this the likeliest points are taken however unlikely they are, and a
    /// measurement is unexplained only where its likelihood is zero everywhere.
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

    /// The particles.
    pub fn particles(&self) -> &Particles {
        &self.particles
    }

    /// Number of points at which likelihoods have been evaluated so far.
    pub fn evaluations(&self) -> u64 {
        self.evaluations
    }

    /// What the last correction's move told.
    pub fn told(&self) -> Told {
        self.told
    }

    /// How many of the particles last predicted have offspring among the present ones; none where these were drawn
    /// anew.
    pub fn unique_ancestors(&self) -> Option<usize> {
        let mut origins = self.origins.clone();
        origins.sort_unstable();
        origins.dedup();
        (!origins.is_empty()).then_some(origins.len())
    }

    /// Reselects where it is due: a step's last act, which the next prediction does where it was left out.
    ///
    /// # Errors
    ///
    /// Where the weights cannot be reselected by.
    pub fn settle(&mut self) -> Result<(), FilterError> {
        let count = self.particles.len();
        let due = !self.settled && self.trigger.fires(self.particles.effective_sample_size(), count);
        self.settled = true;
        if !due {
            return Ok(());
        }
        let step = self.step;
        let mut stream = Stream::new(self.seed, step, Purpose::Optimizer, 0);
        let ancestors = self
            .reselection
            .ancestors(&self.particles.weights(), count, &mut stream)
            .map_err(|source| FilterError::Optimizer { step, source })?;
        let points = ancestors.iter().flat_map(|&ancestor| self.particles.point(ancestor)).copied().collect();
        if !self.origins.is_empty() {
            self.origins = ancestors.iter().map(|&ancestor| self.origins[ancestor]).collect();
        }
        self.particles =
            Particles::equally_weighted(&self.space(), points).map_err(FilterError::step(step))?;
        Ok(())
    }

    fn space(&self) -> Space {
        Space::new(self.coordinates.clone())
    }

    /// Moves the particles by a likelihood and tells the shortest residual, in deviations; or the reason why nothing
    /// explains the measurement.
    fn moved<L: Likelihood>(&mut self, likelihood: &L) -> Result<Result<(Moved, f64), String>, FilterError> {
        let step = self.step;
        let points = AtPoints { likelihood, nearest: Mutex::new(f64::INFINITY) };
        let density =
            self.density.as_ref().map(|mixture| Density { mixture, evaluator: Evaluator::new(mixture) });
        let failed = |source| FilterError::Optimizer { step, source };
        let mut target = Target::new(&self.particles, &points).map_err(failed)?;
        if let Some(density) = &density {
            target = target.with_prior_density(density);
        }
        let mut stream = Stream::new(self.seed, step, Purpose::Optimizer, 1 + self.moves);
        let outcome = self.movement.apply(&mut target, &mut stream);
        self.evaluations += target.evaluations();
        self.moves += 1;
        let moved = match outcome {
            Err(OptimizerError::Unexplained { .. }) => {
                return Ok(Err("its likelihood is zero at each".into()));
            }
            other => other.map_err(failed)?,
        };
        let nearest = points.nearest.into_inner().unwrap_or_else(PoisonError::into_inner).sqrt();
        if likelihood.components() > 0 && nearest > self.gate {
            let how = format!("the nearest is {nearest:.1} standard deviations of its noise away");
            return Ok(Err(how));
        }
        Ok(Ok((moved, nearest)))
    }

    fn take(&mut self, (moved, nearest): (Moved, f64), recovered: bool) -> Correction {
        self.origins = moved.ancestors.iter().filter_map(|&index| self.origins.get(index)).copied().collect();
        self.told = Told {
            log_evidence: moved.log_evidence,
            acceptance: moved.acceptance,
            effective_sample_size: moved.effective_sample_size,
            nearest,
        };
        self.particles = moved.particles;
        self.density = None;
        self.settled = false;
        let log_likelihood = moved.log_evidence.unwrap_or(f64::NAN);
        Correction { log_likelihood, recovered, ..Correction::default() }
    }

    /// The particles as the recovery has them for another attempt.
    fn recovered(&self) -> Result<Option<Particles>, FilterError> {
        let (d, count) = (self.coordinates.len(), self.particles.len());
        let (mut cloud, from) = match &self.recovery {
            Recovery::Fail | Recovery::KeepPrediction => return Ok(None),
            Recovery::Redraw(from) => (Cloud::new(d, count), from.clone()),
            Recovery::Widen(factor) => {
                let covariance = self.moments().covariance.iter().map(|entry| entry * factor).collect();
                (Cloud::from_points(d, self.particles.points()), Moments { mean: vec![0.0; d], covariance })
            }
        };
        let mut random = Stream::new(self.seed, self.step, Purpose::Belief, 1 + self.moves).fast();
        prior::add(&from, &self.coordinates, &mut random, &mut cloud)?;
        let particles = Particles::equally_weighted(&self.space(), cloud.points());
        particles.map(Some).map_err(FilterError::step(self.step))
    }
}

impl<M: Motion> Predict<M> for DrivenFilter {
    fn predict(&mut self, motion: &M) -> Result<(), FilterError> {
        let d = self.coordinates.len();
        let failed = FilterError::step(self.step);
        if motion.dimension() != d {
            let (found, expected) = (motion.dimension(), d);
            return Err(failed(MessageError::Dimension { what: "the motion", found, expected }));
        }
        self.settle()?;
        let mover = Mover::new(motion, &self.coordinates);
        let (from, count) = (Cloud::from_points(d, self.particles.points()), self.particles.len());
        let source = |block: usize| Source { cloud: &from, first: block * BLOCK, ancestors: None };
        let mut next = Cloud::new(d, count);
        let mut draws = Vec::new();
        for (block, to) in next.values_mut().chunks_mut(BLOCK * d).enumerate() {
            let mut random = Stream::new(self.seed, self.step, Purpose::Message, block as u64).fast();
            let own = (count - block * BLOCK).min(BLOCK);
            mover.advance(own, source(block), &mut random, &mut draws, to);
        }
        let mut density = None;
        if self.knows_density {
            let mut centres = Cloud::new(d, count);
            for (block, to) in centres.values_mut().chunks_mut(BLOCK * d).enumerate() {
                let own = (count - block * BLOCK).min(BLOCK);
                mover.centres(own, source(block), to);
            }
            let covariance = motion.noise(self.particles.point(0)).covariance();
            let logs = self.particles.log_weights().to_vec();
            let mixture = Mixture::with_shared_covariance(&self.space(), logs, centres.points(), covariance);
            density = Some(mixture.map_err(&failed)?);
        }
        // What is printed of a literal move has its weights start equal at every step.
        let forgets = self.movement.validity() == Validity::Literal;
        let logs = if forgets { vec![0.0; count] } else { self.particles.log_weights().to_vec() };
        self.particles = Particles::new(&self.space(), next.points(), logs).map_err(failed)?;
        self.density = density;
        self.origins = (0..count).collect();
        self.step += 1;
        self.moves = 0;
        Ok(())
    }
}

impl<L: Likelihood> Correct<L> for DrivenFilter {
    /// The log-likelihood is NaN where the move estimates no evidence.
    fn correct(&mut self, measurement: &L) -> Result<Correction, FilterError> {
        let (step, d) = (self.step, self.coordinates.len());
        let dimension = measurement.dimension().map_err(FilterError::step(step))?;
        if let Some(found) = dimension.filter(|&found| found != d) {
            let source = MessageError::Dimension { what: "the measured state", found, expected: d };
            return Err(FilterError::Step { step, source });
        }
        let how = match self.moved(measurement)? {
            Ok(moved) => return Ok(self.take(moved, false)),
            Err(how) => how,
        };
        let count = self.particles.len();
        if self.recovery == Recovery::KeepPrediction {
            let effective_sample_size = self.particles.effective_sample_size();
            self.told = Told { effective_sample_size, nearest: f64::INFINITY, ..Told::default() };
            let log_likelihood = f64::NEG_INFINITY;
            return Ok(Correction { log_likelihood, recovered: true, ..Correction::default() });
        }
        let Some(particles) = self.recovered()? else {
            let remedy = "use more particles, a wider noise, or a recovery";
            return Err(FilterError::Unexplained { step, count, how, remedy });
        };
        let (before, density) = (std::mem::replace(&mut self.particles, particles), self.density.take());
        let error = match self.moved(measurement) {
            Ok(Ok(moved)) => {
                self.origins.clear();
                return Ok(self.take(moved, true));
            }
            Ok(Err(how)) => {
                let remedy = "the recovery did not reach it either; make it wider";
                FilterError::Unexplained { step, count, how, remedy }
            }
            Err(error) => error,
        };
        (self.particles, self.density) = (before, density);
        Err(error)
    }
}

impl Filter for DrivenFilter {
    type Record = Particles;

    fn moments(&self) -> Moments {
        self.particles.moments()
    }

    fn step(&self) -> u64 {
        self.step
    }

    fn record(&self) -> Particles {
        self.particles.clone()
    }
}

/// A likelihood of blocks at points row by row, and the least squared residual met.
struct AtPoints<'a, L> {
    likelihood: &'a L,
    nearest: Mutex<f64>,
}

impl<L: Likelihood> LogDensity for AtPoints<'_, L> {
    fn log_values(&self, points: &[f64], values: &mut [f64]) -> Result<(), OptimizerError> {
        let least = log_values(self.likelihood, points, values);
        let mut nearest = self.nearest.lock().unwrap_or_else(PoisonError::into_inner);
        *nearest = nearest.min(least);
        Ok(())
    }
}

/// The density of a prediction.
struct Density<'a> {
    mixture: &'a Mixture,
    evaluator: Evaluator<'a>,
}

impl LogDensity for Density<'_> {
    fn log_values(&self, points: &[f64], values: &mut [f64]) -> Result<(), OptimizerError> {
        /// Far below the noise that a finite number of particles leaves in weights.
        const TOLERANCE: f64 = 1e-6;
        Ok(self.evaluator.log_densities_within(points, TOLERANCE, values)?)
    }
}

impl PriorDensity for Density<'_> {
    fn draw(&self, count: usize, random: &mut FastStream) -> Result<Vec<f64>, OptimizerError> {
        let mut stream = Stream::new(random.random(), 0, Purpose::Optimizer, 0);
        Ok(self.mixture.sample_systematic(count, &mut stream)?.points().to_vec())
    }
}
