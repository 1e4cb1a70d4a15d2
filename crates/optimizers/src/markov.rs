//! Markov chain moves: after weighing and reselection, copies part by Metropolis-Hastings steps.
//!
//! Source: Gilks, Berzuini, "Following a moving target" (2001); Chopin, "A sequential particle filter method for
//! static models" (2002). Whether the chains run on the prior's density or in the particles' kernels depends on what
//! the target knows.

use sumprod_graph::FastStream;

use crate::chains::Chains;
use crate::error::OptimizerError;
use crate::moves::{Move, Moved, Validity};
use crate::target::Target;

/// Random-walk Metropolis: steps shaped by the population's covariance, 2.38/√d times its width at scale 1.
///
/// The factor: Gelman, Roberts, Gilks, "Efficient Metropolis jumping rules" (1996).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RandomWalk {
    steps: usize,
    scale: f64,
}

/// Independence Metropolis-Hastings: proposals from a Gaussian fitted to the population.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Independence {
    steps: usize,
    width: f64,
}

impl RandomWalk {
    /// `steps` steps of every chain, `scale` times as long as the rule has them.
    ///
    /// # Errors
    ///
    /// Where `scale` is not positive and finite.
    pub fn new(steps: usize, scale: f64) -> Result<Self, OptimizerError> {
        Ok(Self { steps, scale: positive("the scale of the steps", scale)? })
    }
}

impl Independence {
    /// `steps` steps of every chain, from a Gaussian `width` times as wide as the fitted one; somewhat more than 1
    /// keeps the tails within reach.
    ///
    /// # Errors
    ///
    /// Where `width` is not positive and finite.
    pub fn new(steps: usize, width: f64) -> Result<Self, OptimizerError> {
        Ok(Self { steps, width: positive("the width of the proposal", width)? })
    }
}

impl Move for RandomWalk {
    fn advance(&self, target: &mut Target<'_>, random: &mut FastStream) -> Result<Moved, OptimizerError> {
        let d = target.dimension();
        let length = self.scale * 2.38 / (d as f64).sqrt();
        let mut chains = Chains::start(target, 1.0, random)?;
        for _ in 0..self.steps {
            for (half, others) in chains.halves() {
                let fit = chains.fit(others)?;
                let mut proposals = vec![0.0; half.len() * d];
                for (chain, proposal) in half.clone().zip(proposals.chunks_exact_mut(d)) {
                    fit.step(length, random, proposal);
                    proposal.iter_mut().zip(chains.standard(chain)).for_each(|(new, old)| *new += old);
                }
                let ratios = vec![0.0; half.len()];
                chains.accept(target, half, &proposals, &ratios, random)?;
            }
        }
        chains.finish(target)
    }

    fn validity(&self) -> Validity {
        Validity::Smoothed
    }
}

impl Move for Independence {
    fn advance(&self, target: &mut Target<'_>, random: &mut FastStream) -> Result<Moved, OptimizerError> {
        let d = target.dimension();
        let mut chains = Chains::start(target, 1.0, random)?;
        for _ in 0..self.steps {
            for (half, others) in chains.halves() {
                let fit = chains.fit(others)?;
                let mut proposals = vec![0.0; half.len() * d];
                let mut ratios = Vec::with_capacity(half.len());
                for (chain, proposal) in half.clone().zip(proposals.chunks_exact_mut(d)) {
                    fit.draw(self.width, random, proposal);
                    let old = fit.log_density(self.width, chains.standard(chain));
                    ratios.push(old - fit.log_density(self.width, proposal));
                }
                chains.accept(target, half, &proposals, &ratios, random)?;
            }
        }
        chains.finish(target)
    }

    fn validity(&self) -> Validity {
        Validity::Smoothed
    }
}

fn positive(what: &'static str, value: f64) -> Result<f64, OptimizerError> {
    if value.is_finite() && value > 0.0 {
        return Ok(value);
    }
    Err(OptimizerError::Parameter { what, value, must: "it must be positive and finite" })
}
