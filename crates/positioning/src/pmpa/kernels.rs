//! P-MPA by products of kernel mixtures: every message about the position is a mixture, and a scan is their product.
//!
//! | message | known kernels | printed kernels |
//! |---|---|---|
//! | prediction | at F xᵢ, variance Q T⁴/4 | at drawn F xᵢ + G u, variance N^(1/6) |
//! | of itself | one Gaussian, variance R | the same |
//! | relative | one Gaussian about p_j + z, R | N draws about it, N^(1/6) |
//! | range | evenly on the circle about p_j, R | N draws: distance N(z, R), any angle; N^(1/6) |
//! | velocity | given the position: vᵢ + (2/T)(p - F xᵢ) | copied from the chosen prediction |
//!
//! A ring of kernels has nearly the radial profile N(ρ; z, R) ρ^(-1/2), where the likelihood of a range has N(ρ; z, R):
//! points are weighed by the ratio of the two, and redrawn by their weights. A predicted particle's share in a point p of the product is that of its
//! kernel in the prediction's density at p, whatever the other messages are.
//!
//! Source: Fan, Wang, Zhou (2018), sections 2.3 and 3, for the printed form. Its prose has a label drawn given the
//! labels of the other messages, and so is it done.

use rand::RngExt;
use std::f64::consts::TAU;
use sumprod_graph::{FastStream, MessageError, Purpose, Space, Stream};
use sumprod_messages::{Evaluator, Literal, Mixture, Particles};
use sumprod_optimizers::Reselection;

use super::method::{KernelRule, MethodSettings, ring_kernels};
use super::world::{Hearing, Measured, World, WorldSettings};
use crate::error::PositioningError;
use crate::results::MethodRun;
use crate::tracking::normal;

type Failure = Box<dyn std::error::Error + Send + Sync>;

/// What the streams of a scan are drawn for.
const MESSAGES: u16 = 0;
const PRODUCT: u16 = 1;
const SELECTION: u16 = 2;

/// What a scan says of its product.
#[derive(Default)]
struct Quality {
    scans: f64,
    effective: f64,
    divergence: (f64, f64),
    label_change: (f64, f64),
}

/// The filter: its particles are states, x, vx, y, vy, all of one weight.
pub(super) struct KernelFilter<'a> {
    settings: &'a WorldSettings,
    method: &'a MethodSettings,
    rule: KernelRule,
    world: &'a World,
    seed: u64,
    states: Vec<[f64; 4]>,
    quality: Quality,
}

impl<'a> KernelFilter<'a> {
    pub(super) fn new(
        settings: &'a WorldSettings,
        method: &'a MethodSettings,
        rule: KernelRule,
        world: &'a World,
        seed: u64,
    ) -> Self {
        let mut random = Stream::new(seed, 0, Purpose::User(MESSAGES), 0).fast();
        let deviation = settings.start_variance.sqrt();
        let draw = |_| settings.start.map(|value| value + deviation * normal(&mut random));
        let states = (0..method.kernel_count()).map(draw).collect();
        Self { settings, method, rule, world, seed, states, quality: Quality::default() }
    }

    /// Runs all scans and scores each.
    pub(super) fn run(mut self, out: &mut MethodRun) -> Result<(), PositioningError> {
        for step in 1..=self.settings.steps as usize {
            let moved = match self.rule {
                KernelRule::Known => self.known(step),
                KernelRule::Printed => self.printed(step),
            };
            moved.map_err(|error| PositioningError::method(&out.id, error))?;
            self.score(step, out)?;
        }
        self.quality.report(out);
        Ok(())
    }

    fn stream(&self, step: usize, purpose: u16) -> Stream {
        Stream::new(self.seed, step as u64, Purpose::User(purpose), 0)
    }

    fn heard(&self, step: usize) -> &'a [Hearing] {
        if self.method.neighbours { &self.world.hearings[step - 1] } else { &[] }
    }

    /// Positions of the states, a kernel on each.
    fn prediction(&self, variance: f64) -> Result<Mixture, MessageError> {
        let centres = self.states.iter().flat_map(|state| [state[0], state[2]]).collect();
        kernels(centres, variance)
    }

    fn known(&mut self, step: usize) -> Result<(), Failure> {
        let (t, r) = (self.settings.interval, self.settings.measurement_variance);
        let noise = 0.25 * self.settings.process_variance * t.powi(4);
        let mut random = self.stream(step, MESSAGES).fast();
        for state in &mut self.states {
            (state[0], state[2]) = (state[0] + t * state[1], state[2] + t * state[3]);
        }
        let mut messages = vec![self.prediction(noise)?];
        if self.method.z_self {
            messages.push(kernels(self.world.fixes[step - 1].to_vec(), r)?);
        }
        let mut rings: Vec<([f64; 2], f64, usize)> = Vec::new();
        for hearing in self.heard(step) {
            let node = self.world.nodes[hearing.node];
            messages.push(match hearing.measured {
                Measured::Relative(offset) => kernels(vec![node[0] + offset[0], node[1] + offset[1]], r)?,
                Measured::Range(range) => {
                    rings.push((node, range, messages.len()));
                    kernels(ring(node, range, r.sqrt(), random.random()), r)?
                }
            });
        }
        let inputs: Vec<&Mixture> = messages.iter().collect();
        let count = self.states.len();
        let product =
            self.method.kernel_product().product(&inputs, count, &mut self.stream(step, PRODUCT))?;
        let mut logs = product.particles.log_weights().to_vec();
        let mut densities = vec![0.0; logs.len()];
        for (node, range, message) in rings {
            Evaluator::new(&messages[message]).log_densities(product.particles.points(), &mut densities)?;
            let points = product.particles.points().chunks_exact(2);
            for ((log, density), p) in logs.iter_mut().zip(&densities).zip(points) {
                let residual = range - (p[0] - node[0]).hypot(p[1] - node[1]);
                *log -= 0.5 * residual * residual / r + density;
            }
        }
        let points = product.particles.points().to_vec();
        let weighed = Particles::new(&Space::real(2), points, logs)?;
        self.quality.take(weighed.effective_sample_size(), &product.quality);
        self.condition(step, &weighed, noise)
    }

    /// Redraws the points by their weights and gives each the velocity of a predicted state that may have led there.
    fn condition(&mut self, step: usize, weighed: &Particles, noise: f64) -> Result<(), Failure> {
        let t = self.settings.interval;
        let count = self.states.len();
        let mut stream = self.stream(step, SELECTION);
        let chosen = self.method.resampling.reselect(weighed, count, &mut stream)?;
        let mut random = stream.fast();
        let mut shares = vec![0.0; count];
        let mut next = Vec::with_capacity(count);
        for p in chosen.points().chunks_exact(2) {
            let squared = |state: &[f64; 4]| ((p[0] - state[0]).powi(2) + (p[1] - state[2]).powi(2)) / noise;
            let nearest: f64 = self.states.iter().map(squared).fold(f64::INFINITY, f64::min);
            let mut sum: f64 = 0.0;
            for (share, state) in shares.iter_mut().zip(&self.states) {
                sum += (0.5 * (nearest - squared(state))).exp();
                *share = sum;
            }
            let height = sum * random.random::<f64>();
            let state = self.states[shares.partition_point(|&share| share <= height).min(count - 1)];
            let velocity = |axis: usize| state[2 * axis + 1] + 2.0 / t * (p[axis] - state[2 * axis]);
            next.push([p[0], velocity(0), p[1], velocity(1)]);
        }
        self.states = next;
        Ok(())
    }

    fn printed(&mut self, step: usize) -> Result<(), Failure> {
        let (t, q) = (self.settings.interval, self.settings.process_variance.sqrt());
        let deviation = self.settings.measurement_variance.sqrt();
        let count = self.states.len();
        let mut random = self.stream(step, MESSAGES).fast();
        for axis in self.states.iter_mut().flat_map(|state| state.chunks_exact_mut(2)) {
            let acceleration = q * normal(&mut random);
            axis[0] += t * axis[1] + 0.5 * t * t * acceleration;
            axis[1] += t * acceleration;
        }
        let about = |centre: [f64; 2], random: &mut FastStream| -> Vec<f64> {
            (0..2 * count).map(|k| centre[k % 2] + deviation * normal(random)).collect()
        };
        // The product puts the printed kernels in the place of whatever variance is given here.
        let mut messages = vec![self.prediction(1.0)?];
        if self.method.z_self {
            let own = self.world.fixes[step - 1].to_vec();
            messages.push(kernels(own, self.settings.measurement_variance)?);
        }
        for hearing in self.heard(step) {
            let node = self.world.nodes[hearing.node];
            let points = match hearing.measured {
                Measured::Relative(offset) => about([node[0] + offset[0], node[1] + offset[1]], &mut random),
                Measured::Range(range) => (0..count)
                    .flat_map(|_| {
                        let (distance, angle) =
                            (range + deviation * normal(&mut random), random.random_range(0.0..TAU));
                        [node[0] + distance * angle.cos(), node[1] + distance * angle.sin()]
                    })
                    .collect(),
            };
            messages.push(kernels(points, 1.0)?);
        }
        if messages.len() > 1 {
            let inputs: Vec<&Mixture> = messages.iter().collect();
            let literal = Literal {
                sweeps: self.method.kernel_sweeps(),
                start: self.method.kernel_start(),
                counted_twice: self.method.counted_twice,
            };
            let (points, labels) = literal.chains(&inputs, count, &mut self.stream(step, PRODUCT))?;
            let chosen = labels.chunks_exact(inputs.len()).map(|chain| self.states[chain[0] as usize]);
            let points = points.points().chunks_exact(2);
            self.states = chosen.zip(points).map(|(state, p)| [p[0], state[1], p[1], state[3]]).collect();
        }
        Ok(())
    }

    fn score(&self, step: usize, out: &mut MethodRun) -> Result<(), PositioningError> {
        let points = self.states.iter().flatten().copied().collect();
        let particles = Particles::equally_weighted(&Space::real(4), points)
            .map_err(|error| PositioningError::method(&out.id, error))?;
        let moments = particles.moments();
        let time = step as f64 * self.settings.interval;
        out.push(step as u32, time, 0, &self.world.truth[step], &moments.mean, &moments.covariance)
    }
}

impl Quality {
    fn take(&mut self, effective: f64, product: &sumprod_messages::ProductQuality) {
        self.scans += 1.0;
        self.effective += effective;
        for (sum, value) in
            [(&mut self.divergence, product.divergence), (&mut self.label_change, product.label_change)]
        {
            if let Some(value) = value {
                *sum = (sum.0 + value, sum.1 + 1.0);
            }
        }
    }

    fn report(&self, out: &mut MethodRun) {
        if self.scans > 0.0 {
            out.diagnose("n_eff", self.effective / self.scans);
        }
        for (name, (sum, count)) in
            [("product.divergence", self.divergence), ("product.label_change", self.label_change)]
        {
            if count > 0.0 {
                out.diagnose(name, sum / count);
            }
        }
    }
}

/// Equal kernels of one variance on points of the plane.
fn kernels(centres: Vec<f64>, variance: f64) -> Result<Mixture, MessageError> {
    let weights = vec![0.0; centres.len() / 2];
    Mixture::with_shared_covariance(&Space::real(2), weights, centres, vec![variance, 0.0, 0.0, variance])
}

/// Points evenly on the circle of this radius, the first at the share `phase` of a space.
fn ring(centre: [f64; 2], radius: f64, deviation: f64, phase: f64) -> Vec<f64> {
    let radius = radius.abs();
    let count = ring_kernels(radius, deviation);
    let angles = (0..count as usize).map(|i| TAU * (i as f64 + phase) / count);
    angles.flat_map(|angle| [centre[0] + radius * angle.cos(), centre[1] + radius * angle.sin()]).collect()
}
