//! Metropolis-Hastings chains in standard coordinates, one a particle.
//!
//! A chain's state u stands for a point x. Where the prior's density p is known, x = m + L u with the frame of the
//! prior's cloud, and a chain's target is p(x) ℓ(x). Where it is not, x lies in the kernel around the particle that
//! the chain started from, and the target is N(u; 0, I) ℓ(x): the centre is a part of the state that stays as it is.
//!
//! What a chain proposes from is fitted to the chains of the *other* half of the population, which this half does not
//! touch meanwhile, so that each half's move leaves its target as it is. Source: Goodman, Weare, "Ensemble samplers
//! with affine invariance" (2010).

use std::ops::Range;

use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use sumprod_graph::FastStream;
use sumprod_messages::{Cholesky, Particles};

use crate::Systematic;
use crate::error::OptimizerError;
use crate::frame::{CloudKernel, Frame};
use crate::moves::{Moved, weights_of};
use crate::regularised::{placed, weighed_kernels};
use crate::reselection::Reselection;
use crate::target::Target;
use crate::trigger::effective_sample_size;

enum Chart {
    Density(Frame),
    Kernel(CloudKernel),
}

/// A population of chains after weighing and reselection: a sample of the target already.
pub(crate) struct Chains {
    chart: Chart,
    states: States,
    ancestors: Vec<usize>,
    log_evidence: f64,
    effective_sample_size: f64,
    proposed: u64,
    accepted: u64,
}

/// Where chains stand.
struct States {
    standard: Vec<f64>,
    points: Vec<f64>,
    log_prior: Vec<f64>,
    log_likelihood: Vec<f64>,
}

/// A Gaussian in standard coordinates, fitted to some chains.
pub(crate) struct Fit {
    mean: Vec<f64>,
    factor: Cholesky,
}

impl Chains {
    /// Weighs the prior's particles (after a draw from their kernels where the prior has no density) and reselects.
    pub(crate) fn start(
        target: &mut Target<'_>,
        kernel_scale: f64,
        random: &mut FastStream,
    ) -> Result<Self, OptimizerError> {
        let (prior, d) = (target.prior(), target.dimension());
        let mut standard = vec![0.0; prior.points().len()];
        let (chart, points, log_weights) = if target.prior_density().is_some() {
            let frame = Frame::of(prior)?;
            for (point, u) in prior.points().chunks_exact(d).zip(standard.chunks_exact_mut(d)) {
                frame.standardise(point, u);
            }
            let mut log_weights = vec![0.0; prior.len()];
            target.log_likelihood(prior.points(), &mut log_weights)?;
            for (weight, prior) in log_weights.iter_mut().zip(prior.log_weights()) {
                *weight += prior;
            }
            (Chart::Density(frame), prior.points().to_vec(), log_weights)
        } else {
            standard.iter_mut().for_each(|u| *u = StandardNormal.sample(random));
            let kernel = CloudKernel::of(prior, kernel_scale)?;
            let (points, log_weights) = weighed_kernels(target, &kernel, &standard)?;
            (Chart::Kernel(kernel), points, log_weights)
        };
        let chosen = Chosen::from(&log_weights, random)?;
        let states = States {
            standard: chosen.rows(&standard, d),
            points: chosen.rows(&points, d),
            log_likelihood: chosen
                .ancestors
                .iter()
                .map(|&ancestor| log_weights[ancestor] - prior.log_weights()[ancestor])
                .collect(),
            log_prior: vec![0.0; prior.len()],
        };
        let mut chains = Self {
            chart,
            states,
            ancestors: chosen.ancestors,
            log_evidence: chosen.log_evidence,
            effective_sample_size: chosen.effective_sample_size,
            proposed: 0,
            accepted: 0,
        };
        chains.states.log_prior = chains.log_prior(target, &chains.states.standard, &chains.states.points)?;
        Ok(chains)
    }

    /// Number of chains.
    pub(crate) fn len(&self) -> usize {
        self.ancestors.len()
    }

    /// The two halves; the first is empty of a single chain.
    pub(crate) fn halves(&self) -> [(Range<usize>, Range<usize>); 2] {
        let (middle, end) = (self.len() / 2, self.len());
        [(0..middle, middle..end), (middle..end, 0..middle)]
    }

    /// The Gaussian of the chains in `rows`, drawn towards the standard one in proportion to how few they are.
    pub(crate) fn fit(&self, rows: Range<usize>) -> Result<Fit, OptimizerError> {
        let d = self.dimension();
        let rows = &self.states.standard[rows.start * d..rows.end * d];
        let (n, held) = ((rows.len() / d) as f64, (d + 1) as f64);
        let mut mean = vec![0.0; d];
        for row in rows.chunks_exact(d) {
            mean.iter_mut().zip(row).for_each(|(mean, u)| *mean += u / (n + held));
        }
        let mut covariance = vec![0.0; d * d];
        for row in rows.chunks_exact(d) {
            for i in 0..d {
                for j in 0..=i {
                    covariance[i * d + j] += (row[i] - mean[i]) * (row[j] - mean[j]) / (n + held);
                }
            }
        }
        for i in 0..d {
            covariance[i * d + i] += held / (n + held);
        }
        Ok(Fit { factor: Cholesky::new(&covariance, d, "the covariance of the chains")?, mean })
    }

    /// The state of a chain in standard coordinates.
    pub(crate) fn standard(&self, chain: usize) -> &[f64] {
        let d = self.dimension();
        &self.states.standard[chain * d..(chain + 1) * d]
    }

    fn dimension(&self) -> usize {
        match &self.chart {
            Chart::Density(frame) => frame.dimension(),
            Chart::Kernel(_) => self.states.standard.len() / self.len().max(1),
        }
    }

    /// Proposes `standard` to the chains in `rows` and accepts each with probability
    /// min(1, π(u') r), r = q(u | u') / q(u' | u) given by its logarithm. Returns which were accepted.
    pub(crate) fn accept(
        &mut self,
        target: &mut Target<'_>,
        rows: Range<usize>,
        standard: &[f64],
        log_ratios: &[f64],
        random: &mut FastStream,
    ) -> Result<Vec<bool>, OptimizerError> {
        let d = self.dimension();
        let points = match &self.chart {
            Chart::Kernel(kernel) => {
                placed(target, kernel, self.ancestors[rows.clone()].iter().copied(), standard)
            }
            Chart::Density(frame) => {
                let mut points = vec![0.0; standard.len()];
                for (point, u) in points.chunks_exact_mut(d).zip(standard.chunks_exact(d)) {
                    frame.place(u, point);
                }
                target.wrap(&mut points);
                points
            }
        };
        let mut log_likelihood = vec![0.0; rows.len()];
        target.log_likelihood(&points, &mut log_likelihood)?;
        let log_prior = self.log_prior(target, standard, &points)?;
        let mut verdicts = Vec::with_capacity(rows.len());
        for (index, chain) in rows.enumerate() {
            let states = &mut self.states;
            let now = states.log_prior[chain] + states.log_likelihood[chain];
            let then = log_prior[index] + log_likelihood[index];
            let accepted = random.random::<f64>().ln() < then - now + log_ratios[index];
            if accepted {
                let (old, new) = (chain * d..(chain + 1) * d, index * d..(index + 1) * d);
                states.standard[old.clone()].copy_from_slice(&standard[new.clone()]);
                states.points[old].copy_from_slice(&points[new]);
                states.log_prior[chain] = log_prior[index];
                states.log_likelihood[chain] = log_likelihood[index];
                self.accepted += 1;
            }
            self.proposed += 1;
            verdicts.push(accepted);
        }
        Ok(verdicts)
    }

    fn log_prior(
        &self,
        target: &Target<'_>,
        standard: &[f64],
        points: &[f64],
    ) -> Result<Vec<f64>, OptimizerError> {
        let d = self.dimension();
        let mut values = vec![0.0; standard.len() / d];
        if !target.log_prior(points, &mut values)? {
            for (value, u) in values.iter_mut().zip(standard.chunks_exact(d)) {
                *value = -0.5 * u.iter().map(|u| u * u).sum::<f64>();
            }
        }
        Ok(values)
    }

    /// The chains as equally weighted particles.
    pub(crate) fn finish(self, target: &Target<'_>) -> Result<Moved, OptimizerError> {
        let acceptance = (self.proposed > 0).then(|| self.accepted as f64 / self.proposed as f64);
        Ok(Moved {
            particles: Particles::equally_weighted(&target.space(), self.states.points)?,
            ancestors: self.ancestors,
            log_evidence: Some(self.log_evidence),
            acceptance,
            effective_sample_size: self.effective_sample_size,
        })
    }
}

impl Fit {
    /// Draws a point, `width` times as wide.
    pub(crate) fn draw(&self, width: f64, random: &mut FastStream, point: &mut [f64]) {
        self.step(width, random, point);
        point.iter_mut().zip(&self.mean).for_each(|(u, mean)| *u += mean);
    }

    /// Draws a displacement, `width` times as wide.
    pub(crate) fn step(&self, width: f64, random: &mut FastStream, point: &mut [f64]) {
        let normal: Vec<f64> = point.iter().map(|_| StandardNormal.sample(random)).collect();
        self.factor.multiply_lower(&normal, point);
        point.iter_mut().for_each(|u| *u *= width);
    }

    /// Log density up to a constant, `width` times as wide.
    pub(crate) fn log_density(&self, width: f64, point: &[f64]) -> f64 {
        let mut offset: Vec<f64> = point.iter().zip(&self.mean).map(|(u, mean)| (u - mean) / width).collect();
        -0.5 * self.factor.squared_length(&mut offset)
    }
}

/// What systematic reselection by log weights leaves.
struct Chosen {
    ancestors: Vec<usize>,
    log_evidence: f64,
    effective_sample_size: f64,
}

impl Chosen {
    fn from(log_weights: &[f64], random: &mut FastStream) -> Result<Self, OptimizerError> {
        let (mut weights, log_evidence) = weights_of(log_weights)?;
        let total: f64 = weights.iter().sum();
        let effective_sample_size = effective_sample_size(&weights);
        weights.iter_mut().for_each(|weight| *weight /= total);
        let ascending = Systematic.choose(&weights, log_weights.len(), random);
        // Copies of one particle come next to each other: dealt to the halves in turn, they are as many in both.
        let ancestors =
            ascending.iter().step_by(2).chain(ascending.iter().skip(1).step_by(2)).copied().collect();
        Ok(Self { ancestors, log_evidence, effective_sample_size })
    }

    fn rows(&self, values: &[f64], d: usize) -> Vec<f64> {
        self.ancestors
            .iter()
            .flat_map(|&ancestor| &values[ancestor * d..(ancestor + 1) * d])
            .copied()
            .collect()
    }
}
