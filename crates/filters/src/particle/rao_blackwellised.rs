//! The Rao-Blackwellised particle filter: some coordinates by particles, the others by a Gaussian a particle.
//!
//! Given the sampled coordinates u, motion and measurement must be linear in the others l, or nearly: they are
//! expanded to first order at each particle's mean of l. With F_l the Jacobian by l and P a particle's covariance,
//! the next state is Gaussian with mean f(u, l̄) and covariance F_l P F_l' + B B'. Ordered as (u, l), its factor
//! [A, 0; C, E] gives u' = f_u + A z with z ~ N(0, I), and l' ~ N(f_l + C z, E E'). A measurement weighs a particle by
//! N(r; 0, J_l P J_l' + R) and corrects its l. Source: Schön, Gustafsson, Nordlund, "Marginalized particle filters for
//! mixed linear/nonlinear state-space models" (2005).

use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use smallvec::SmallVec;
use sumprod_graph::{MessageError, Purpose, Stream};
use sumprod_messages::Moments;
use sumprod_models::cloud::{Selection, select};
use sumprod_models::moments::{
    Line, add_product_transposed, correct, correction_storage, cross_covariance, heavy_log_density,
    linearise_motion, linearise_residual, noise_against, semidefinite_factor,
};
use sumprod_models::{Motion, Residual};
use sumprod_optimizers::{Trigger, effective_sample_size};

use crate::gaussian::checks;
use crate::{Correct, Correction, Filter, FilterError, Predict};

/// Particles that draw from one stream.
const SHARE: usize = 64;

type Vector = SmallVec<[f64; 6]>;
type Matrix = SmallVec<[f64; 36]>;

/// A particle filter whose particles hold part of the state as a Gaussian.
///
/// A step takes O(N d³). All coordinates are real: an angle counts its turns.
#[derive(Clone, Debug, PartialEq)]
pub struct RaoBlackwellised {
    /// The coordinates in the order (sampled, others).
    order: Vec<usize>,
    sampled: usize,
    particles: Vec<Particle>,
    log_weights: Vec<f64>,
    trigger: Trigger,
    seed: u64,
    step: u64,
}

#[derive(Clone, Debug, PartialEq)]
struct Particle {
    /// The state: sampled coordinates as drawn, the others at their mean; in the state's own order.
    state: Vector,
    /// Covariance of the coordinates that are not sampled, row-major.
    covariance: Matrix,
}

impl RaoBlackwellised {
    /// `count` particles of a prior, which sample these coordinates.
    ///
    /// # Errors
    ///
    /// Where `count` is zero, a sampled coordinate is given twice or is none of the prior's, all or none are sampled,
    /// or the prior is no distribution.
    pub fn new(prior: &Moments, sampled: &[usize], count: usize, seed: u64) -> Result<Self, FilterError> {
        let d = prior.dimension();
        checks::distribution(prior, d)?;
        for (place, &index) in sampled.iter().enumerate() {
            if index >= d || sampled[..place].contains(&index) {
                let expected = "each must be one of the prior's coordinates, and given once";
                return Err(FilterError::Setting {
                    what: "a sampled coordinate",
                    value: index as f64,
                    expected,
                });
            }
        }
        if sampled.is_empty() || sampled.len() == d {
            let (what, value) = ("the number of sampled coordinates", sampled.len() as f64);
            let expected = "at least one must be sampled and one not; use a particle or a Kalman filter";
            return Err(FilterError::Setting { what, value, expected });
        }
        if count == 0 {
            let (what, expected) = ("the number of particles", "it must be at least 1");
            return Err(FilterError::Setting { what, value: 0.0, expected });
        }
        let others = (0..d).filter(|index| !sampled.contains(index));
        let order: Vec<usize> = sampled.iter().copied().chain(others).collect();
        let ordered: Matrix = order
            .iter()
            .flat_map(|&row| order.iter().map(move |&column| (row, column)))
            .map(|(row, column)| prior.covariance_at(row, column))
            .collect();
        let mut filter = Self {
            order,
            sampled: sampled.len(),
            particles: Vec::new(),
            log_weights: vec![0.0; count],
            trigger: Trigger::ALWAYS,
            seed,
            step: 0,
        };
        let mut random = Stream::new(seed, 0, Purpose::Belief, 0).fast();
        for _ in 0..count {
            let drawn = filter.draw(&prior.mean, &ordered, "the covariance", &mut random);
            filter.particles.push(drawn.map_err(FilterError::Prior)?);
        }
        Ok(filter)
    }

    /// Reselects before a prediction only where the trigger fires; without this, before every one.
    #[must_use]
    pub fn reselecting_when(self, trigger: Trigger) -> Self {
        Self { trigger, ..self }
    }

    /// Number of particles.
    pub fn len(&self) -> usize {
        self.particles.len()
    }

    /// Never: a filter holds at least one particle.
    pub fn is_empty(&self) -> bool {
        self.particles.is_empty()
    }

    /// Effective sample size of the weights.
    pub fn effective_sample_size(&self) -> f64 {
        effective_sample_size(&self.weights())
    }

    /// Weights that sum to one.
    pub fn weights(&self) -> Vec<f64> {
        let largest = self.log_weights.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let mut weights: Vec<f64> = self.log_weights.iter().map(|log| (log - largest).exp()).collect();
        let total: f64 = weights.iter().sum();
        weights.iter_mut().for_each(|weight| *weight /= total);
        weights
    }

    /// A particle of a Gaussian of this mean (in the state's order) and covariance (in this filter's order).
    fn draw(
        &self,
        mean: &[f64],
        covariance: &[f64],
        what: &'static str,
        random: &mut sumprod_graph::FastStream,
    ) -> Result<Particle, MessageError> {
        let (d, s) = (mean.len(), self.sampled);
        let mut lower = Matrix::from_elem(0.0, d * d);
        semidefinite_factor(covariance, d, what, &mut lower)?;
        let z: Vector = (0..s).map(|_| StandardNormal.sample(random)).collect();
        let mut state = Vector::from_slice(mean);
        for (row, &coordinate) in self.order.iter().enumerate() {
            state[coordinate] += z.iter().zip(&lower[row * d..]).map(|(z, l)| z * l).sum::<f64>();
        }
        let l = d - s;
        let mut own = Matrix::from_elem(0.0, l * l);
        for row in 0..l {
            for column in 0..l {
                own[row * l + column] =
                    (s..d).map(|k| lower[(s + row) * d + k] * lower[(s + column) * d + k]).sum();
            }
        }
        Ok(Particle { state, covariance: own })
    }

    fn moved<M: Motion>(
        &self,
        particle: &Particle,
        motion: &M,
        random: &mut sumprod_graph::FastStream,
    ) -> Result<Particle, MessageError> {
        let (d, s) = (self.order.len(), self.sampled);
        let l = d - s;
        let (mut next, mut jacobian) = (Vector::from_elem(0.0, d), Matrix::from_elem(0.0, d * d));
        linearise_motion(motion, &particle.state, &mut next, &mut jacobian);
        let noise = motion.noise(&particle.state);
        let sources = noise.sources();
        let slope: Matrix = self
            .order
            .iter()
            .flat_map(|&row| self.order[s..].iter().map(move |&column| row * d + column))
            .map(|index| jacobian[index])
            .collect();
        let factor: Matrix = self
            .order
            .iter()
            .flat_map(|&row| noise.factor()[row * sources..][..sources].iter().copied())
            .collect();
        let mut cross = Matrix::from_elem(0.0, d * l);
        cross_covariance(&slope, &particle.covariance, l, &mut cross);
        let mut spread = Matrix::from_elem(0.0, d * d);
        add_product_transposed(&cross, &slope, l, &mut spread);
        add_product_transposed(&factor, &factor, sources, &mut spread);
        self.draw(&next, &spread, "the predicted covariance", random)
    }

    fn corrected<R: Residual>(
        &self,
        particle: &Particle,
        residual: &R,
    ) -> Result<(Particle, f64, Vector), MessageError> {
        let (d, s) = (self.order.len(), self.sampled);
        let m = residual.noise().dimension();
        let mut value: Vector = SmallVec::from_elem(0.0, m);
        let mut full = Matrix::from_elem(0.0, m * d);
        linearise_residual(residual, &particle.state, &mut value, &mut full);
        let others = &self.order[s..];
        let jacobian: Matrix = (0..m)
            .flat_map(|row| others.iter().map(move |&column| row * d + column))
            .map(|i| full[i])
            .collect();
        let mut noise = Matrix::from_elem(0.0, m * m);
        noise_against(residual.noise(), &value, &jacobian, &particle.covariance, &mut noise);
        let mut mean: Vector = others.iter().map(|&index| particle.state[index]).collect();
        let mut next = particle.clone();
        let line = Line { value: &value, jacobian: &jacobian, noise: &noise };
        let mut storage: SmallVec<[f64; 128]> = SmallVec::from_elem(0.0, correction_storage(m, mean.len()));
        let found = correct(line, &mut mean, &mut next.covariance, &mut storage)?;
        let noise = residual.noise();
        let log_likelihood = match noise.degrees_of_freedom() {
            None => found.log_likelihood,
            Some(_) => heavy_log_density(noise, &value, &jacobian, &particle.covariance)?,
        };
        others.iter().zip(mean).for_each(|(&index, mean)| next.state[index] = mean);
        Ok((next, log_likelihood, value))
    }
}

/// Applies `f` to every particle's index with the stream of its share, in parallel over shares.
fn each<T: Send>(
    count: usize,
    stream: impl Fn(usize) -> Stream + Sync,
    f: impl Fn(usize, &mut sumprod_graph::FastStream) -> Result<T, MessageError> + Sync,
) -> Result<Vec<T>, MessageError> {
    let shares: Vec<Result<Vec<T>, MessageError>> = (0..count.div_ceil(SHARE))
        .into_par_iter()
        .map(|share| {
            let mut random = stream(share).fast();
            (share * SHARE..((share + 1) * SHARE).min(count)).map(|index| f(index, &mut random)).collect()
        })
        .collect();
    let mut all = Vec::with_capacity(count);
    for share in shares {
        all.extend(share?);
    }
    Ok(all)
}

impl<M: Motion> Predict<M> for RaoBlackwellised {
    fn predict(&mut self, motion: &M) -> Result<(), FilterError> {
        let failed = FilterError::step(self.step);
        let (d, count) = (self.order.len(), self.len());
        if motion.dimension() != d {
            let (found, expected) = (motion.dimension(), d);
            return Err(failed(MessageError::Dimension { what: "the motion", found, expected }));
        }
        let weights = self.weights();
        let mut ancestors: Vec<u32> = (0..count as u32).collect();
        let reselected = self.trigger.fires(effective_sample_size(&weights), count);
        if reselected {
            let blocks = weights.chunks(sumprod_models::cloud::BLOCK);
            let totals: Vec<f64> = blocks.map(|block| block.iter().sum()).collect();
            let scales = vec![1.0; totals.len()];
            let offset = Stream::new(self.seed, self.step, Purpose::Optimizer, 0).fast().random();
            let selection = Selection { weights: &weights, scales: &scales, totals: &totals };
            select(selection, offset, false, &mut ancestors);
        }
        let (seed, step) = (self.seed, self.step);
        let stream = |share: usize| Stream::new(seed, step, Purpose::Message, share as u64);
        let moved = each(count, stream, |index, random| {
            self.moved(&self.particles[ancestors[index] as usize], motion, random)
        });
        self.particles = moved.map_err(failed)?;
        if reselected {
            self.log_weights.fill(0.0);
        }
        self.step += 1;
        Ok(())
    }
}

impl<R: Residual> Correct<R> for RaoBlackwellised {
    fn correct(&mut self, measurement: &R) -> Result<Correction, FilterError> {
        let failed = FilterError::step(self.step);
        checks::measured(measurement, self.order.len()).map_err(&failed)?;
        let stream = |share: usize| Stream::new(self.seed, self.step, Purpose::Belief, share as u64);
        let found = each(self.len(), stream, |index, _| self.corrected(&self.particles[index], measurement));
        let found = found.map_err(&failed)?;
        let weights = self.weights();
        let log_sum = |logs: &[f64]| {
            let largest = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            largest + logs.iter().map(|log| (log - largest).exp()).sum::<f64>().ln()
        };
        let before = log_sum(&self.log_weights);
        let logs: Vec<f64> =
            self.log_weights.iter().zip(&found).map(|(old, (_, new, _))| old + new).collect();
        let after = log_sum(&logs);
        if !after.is_finite() {
            let (step, count) = (self.step, self.len());
            let how = format!("the sum of its likelihoods has the logarithm {after}");
            let remedy = "use more particles or a wider noise";
            return Err(FilterError::Unexplained { step, count, how, remedy });
        }
        let mut innovation: SmallVec<[f64; 6]> = SmallVec::from_elem(0.0, measurement.noise().dimension());
        for (weight, (_, _, value)) in weights.iter().zip(&found) {
            innovation.iter_mut().zip(value).for_each(|(sum, value)| *sum -= weight * value);
        }
        self.log_weights = logs.iter().map(|log| log - after).collect();
        self.particles = found.into_iter().map(|(particle, _, _)| particle).collect();
        Ok(Correction { log_likelihood: after - before, innovation, ..Correction::default() })
    }
}

impl Filter for RaoBlackwellised {
    type Record = Moments;

    fn moments(&self) -> Moments {
        let (d, s) = (self.order.len(), self.sampled);
        let weights = self.weights();
        let (mut mean, mut covariance) = (vec![0.0; d], vec![0.0; d * d]);
        for (weight, particle) in weights.iter().zip(&self.particles) {
            mean.iter_mut().zip(&particle.state).for_each(|(mean, x)| *mean += weight * x);
        }
        for (weight, particle) in weights.iter().zip(&self.particles) {
            for row in 0..d {
                for column in 0..d {
                    covariance[row * d + column] +=
                        weight * (particle.state[row] - mean[row]) * (particle.state[column] - mean[column]);
                }
            }
            for (row, &to) in self.order[s..].iter().enumerate() {
                for (column, &from) in self.order[s..].iter().enumerate() {
                    covariance[to * d + from] += weight * particle.covariance[row * (d - s) + column];
                }
            }
        }
        Moments { mean, covariance }
    }

    fn step(&self) -> u64 {
        self.step
    }

    fn record(&self) -> Moments {
        self.moments()
    }
}
