//! Forward filtering, backward simulation: whole trajectories of the past, given all measurements.
//!
//! From a particle of the last step backwards, the state before x' is particle i of its step with probability
//! proportional to wᵢ N(x'; f(xᵢ), Q(xᵢ)). The law needs the motion's density, so Q must have full rank. Source:
//! Godsill, Doucet, West, "Monte Carlo smoothing for nonlinear time series" (2004).

use rand::RngExt;
use rayon::prelude::*;
use sumprod_graph::{Coordinate, FastStream, MessageError, Purpose, Space, Stream, wrap_angle};
use sumprod_messages::{Cholesky, Particles};
use sumprod_models::Motion;

use super::ParticleFilter;
use crate::{FilterError, Run, Smooth};

/// Trajectories that draw from one stream.
const SHARE: usize = 64;

impl<M: Motion> Smooth<M> for ParticleFilter {
    /// As many equally weighted trajectories as there are particles: one set of particles a step, of which those of
    /// one index are one trajectory.
    type Smoothed = Vec<Particles>;

    /// O(N²) a step.
    fn smooth(&self, run: &Run<Particles, M>) -> Result<Vec<Particles>, FilterError> {
        let Some(last) = run.records.last() else { return Ok(Vec::new()) };
        let (d, count) = (last.dimension(), last.len());
        let share = |step: usize, share: usize| {
            Stream::new(self.seed(), step as u64, Purpose::User(0), share as u64).fast()
        };
        let mut points = draw_last(last, &mut share(run.records.len(), 0));
        let mut smoothed = vec![self.sample(last, &points, run.records.len())?];
        for (k, record) in run.records.iter().enumerate().rev().skip(1) {
            // Two steps of one time are one state.
            if let Some(Some(motion)) = run.motions.get(k + 1) {
                let kernels = Kernels::new(record, motion).map_err(FilterError::step(k as u64))?;
                let mut before = vec![0.0; count * d];
                let drawn: Result<(), MessageError> = before
                    .par_chunks_mut(SHARE * d)
                    .zip(points.par_chunks(SHARE * d))
                    .enumerate()
                    .try_for_each(|(index, (before, after))| {
                        let mut random = share(k, index);
                        let mut weights = vec![0.0; record.len()];
                        for (before, after) in before.chunks_exact_mut(d).zip(after.chunks_exact(d)) {
                            let chosen = kernels.choose(record, after, &mut weights, &mut random)?;
                            before.copy_from_slice(record.point(chosen));
                        }
                        Ok(())
                    });
                drawn.map_err(FilterError::step(k as u64))?;
                points = before;
            }
            smoothed.push(self.sample(record, &points, k)?);
        }
        smoothed.reverse();
        Ok(smoothed)
    }
}

impl ParticleFilter {
    fn sample(&self, like: &Particles, points: &[f64], step: usize) -> Result<Particles, FilterError> {
        Particles::equally_weighted(&Space::new(like.coordinates()), points.to_vec())
            .map_err(FilterError::step(step as u64))
    }
}

/// As many draws from the last step's belief as it has particles.
fn draw_last(last: &Particles, random: &mut FastStream) -> Vec<f64> {
    let weights = last.weights();
    let mut points = Vec::with_capacity(last.points().len());
    for _ in 0..last.len() {
        points.extend_from_slice(last.point(pick(&weights, weights.iter().sum(), random)));
    }
    points
}

/// An index with probability proportional to its weight.
fn pick(weights: &[f64], total: f64, random: &mut FastStream) -> usize {
    let target = total * random.random::<f64>();
    let mut reached = 0.0;
    let mut last = 0;
    for (index, weight) in weights.iter().enumerate().filter(|(_, weight)| **weight > 0.0) {
        reached += weight;
        last = index;
        if reached > target {
            break;
        }
    }
    last
}

/// Where each particle of a step would go.
struct Kernels {
    centres: Vec<f64>,
    /// One a particle, or one for all.
    factors: Vec<Cholesky>,
    log_determinants: Vec<f64>,
    coordinates: Vec<Coordinate>,
}

impl Kernels {
    fn new<M: Motion>(record: &Particles, motion: &M) -> Result<Self, MessageError> {
        let d = record.dimension();
        let mut centres = vec![0.0; record.points().len()];
        for (centre, point) in centres.chunks_exact_mut(d).zip(record.points().chunks_exact(d)) {
            motion.step(point, centre);
        }
        let factor = |covariance: &[f64]| {
            Cholesky::new(covariance, d, "the process noise").map_err(|error| {
                MessageError::Unsupported(format!(
                    "{error}: a motion without a density cannot be simulated backwards; smooth with a Gaussian filter, \
                     or give every direction some noise"
                ))
            })
        };
        let factors: Vec<Cholesky> = match motion.constant_noise() {
            Some(noise) => vec![factor(&noise.covariance())?],
            None => record
                .points()
                .chunks_exact(d)
                .map(|point| factor(&motion.noise(point).covariance()))
                .collect::<Result<_, _>>()?,
        };
        let log_determinants = factors.iter().map(Cholesky::log_determinant).collect();
        Ok(Self { centres, factors, log_determinants, coordinates: record.coordinates().to_vec() })
    }

    fn choose(
        &self,
        record: &Particles,
        after: &[f64],
        weights: &mut [f64],
        random: &mut FastStream,
    ) -> Result<usize, MessageError> {
        let d = after.len();
        let mut offset = vec![0.0; d];
        for (index, centre) in self.centres.chunks_exact(d).enumerate() {
            for (k, kind) in self.coordinates.iter().enumerate() {
                let difference = after[k] - centre[k];
                offset[k] = if *kind == Coordinate::Angle { wrap_angle(difference) } else { difference };
            }
            let own = index.min(self.factors.len() - 1);
            let squared = self.factors[own].squared_length(&mut offset);
            weights[index] = record.log_weights()[index] - 0.5 * (squared + self.log_determinants[own]);
        }
        let largest = weights.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        if !largest.is_finite() {
            let what = "the transition to a smoothed particle";
            return Err(MessageError::NotFinite { what, value: largest });
        }
        weights.iter_mut().for_each(|weight| *weight = (*weight - largest).exp());
        Ok(pick(weights, weights.iter().sum(), random))
    }
}
