//! A particle filter whose correction is a move: whatever an optimizer makes of the predicted particles.
//!
//! There is no reselection beside the move. A move that hands on weighted particles is followed by a prediction that
//! keeps their weights.

use rand_distr::{Distribution, StandardNormal};
use sumprod_graph::{FastStream, MessageError, Purpose, Space, Stream, wrap_angle};
use sumprod_messages::{Evaluator, Mixture, Moments, Particles};
use sumprod_models::{Motion, Residual};
use sumprod_optimizers::{LogDensity, Move, Moved, OptimizerError, Target, Validity};

pub(crate) struct Driven {
    movement: Box<dyn Move>,
    marginal: bool,
    particles: Particles,
    seed: u64,
    step: u64,
    evaluations: u64,
}

impl Driven {
    /// `count` particles of a Gaussian prior. With `marginal` the move is given the predicted density
    /// Σ w_j N(x; f(x_j), Q), which takes a process noise of full rank that is the same everywhere.
    pub fn new(
        movement: Box<dyn Move>,
        marginal: bool,
        prior: &Moments,
        count: usize,
        seed: u64,
    ) -> Result<Self, OptimizerError> {
        let space = Space::real(prior.dimension());
        let Moments { mean, covariance } = prior.clone();
        let start = Mixture::with_shared_covariance(&space, vec![0.0], mean, covariance)?;
        let particles = start.sample(count, &mut Stream::new(seed, 0, Purpose::Belief, 0))?;
        Ok(Self { movement, marginal, particles, seed, step: 0, evaluations: 0 })
    }

    /// One step: through `motion`, then by `likelihood`.
    pub fn advance<M: Motion>(
        &mut self,
        motion: &M,
        likelihood: &dyn LogDensity,
    ) -> Result<Moved, OptimizerError> {
        self.step += 1;
        let stream = |purpose| Stream::new(self.seed, self.step, purpose, 0);
        let (ahead, predicted) = self.predict(motion, &mut stream(Purpose::Belief).fast())?;
        let marginal = if self.marginal { Some(self.marginal(motion, ahead)?) } else { None };
        let density = marginal.as_ref().map(|marginal| Density(Evaluator::new(marginal)));
        let mut target = Target::new(&predicted, likelihood)?;
        if let Some(density) = &density {
            target = target.with_prior_density(density);
        }
        let moved = self.movement.apply(&mut target, &mut stream(Purpose::Optimizer))?;
        self.evaluations += target.evaluations();
        self.particles.clone_from(&moved.particles);
        Ok(moved)
    }

    fn marginal<M: Motion>(&self, motion: &M, ahead: Vec<f64>) -> Result<Mixture, MessageError> {
        let covariance = motion.noise(self.particles.point(0)).covariance();
        let logs = self.particles.log_weights().to_vec();
        Mixture::with_shared_covariance(&self.space(), logs, ahead, covariance)
    }

    fn space(&self) -> Space {
        Space::new(self.particles.coordinates())
    }

    /// Points at which likelihoods have been evaluated.
    pub fn evaluations(&self) -> u64 {
        self.evaluations
    }

    /// The particles moved without noise, and with it.
    fn predict<M: Motion>(
        &self,
        motion: &M,
        random: &mut FastStream,
    ) -> Result<(Vec<f64>, Particles), MessageError> {
        let d = self.particles.dimension();
        let mut ahead = vec![0.0; self.particles.points().len()];
        for (next, point) in ahead.chunks_exact_mut(d).zip(self.particles.points().chunks_exact(d)) {
            motion.step(point, next);
        }
        let mut noisy = ahead.clone();
        for (next, point) in noisy.chunks_exact_mut(d).zip(self.particles.points().chunks_exact(d)) {
            let noise = motion.noise(point);
            let sources = noise.sources();
            for source in 0..sources {
                let normal: f64 = StandardNormal.sample(random);
                for (k, next) in next.iter_mut().enumerate() {
                    *next += noise.factor()[k * sources + source] * normal;
                }
            }
        }
        // What is printed of a literal move says that weights start equal at every step.
        let forgets = self.movement.validity() == Validity::Literal;
        let logs =
            if forgets { vec![0.0; self.particles.len()] } else { self.particles.log_weights().to_vec() };
        Ok((ahead, Particles::new(&self.space(), noisy, logs)?))
    }
}

struct Density<'a>(Evaluator<'a>);

impl LogDensity for Density<'_> {
    fn log_values(&self, points: &[f64], values: &mut [f64]) -> Result<(), OptimizerError> {
        /// Far below the noise that a finite number of particles leaves in weights.
        const TOLERANCE: f64 = 1e-6;
        Ok(self.0.log_densities_within(points, TOLERANCE, values)?)
    }
}

/// The likelihood of a measurement.
pub(crate) struct Measured<'a, R>(pub &'a R);

impl<R: Residual> LogDensity for Measured<'_, R> {
    fn log_values(&self, points: &[f64], values: &mut [f64]) -> Result<(), OptimizerError> {
        let noise = self.0.noise();
        let mut residual = vec![0.0; noise.dimension()];
        let dimension = points.len() / values.len().max(1);
        for (point, value) in points.chunks_exact(dimension.max(1)).zip(values) {
            self.0.residual(&[point], &mut residual);
            self.0.angles().iter().for_each(|&angle| residual[angle] = wrap_angle(residual[angle]));
            *value = noise.log_density(&residual);
        }
        Ok(())
    }
}
