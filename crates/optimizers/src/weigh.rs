//! The bootstrap: the prior's own points, weighed by the likelihood.
//!
//! Source: Gordon, Salmond, Smith, "Novel approach to nonlinear/non-Gaussian Bayesian state estimation" (1993).

use sumprod_graph::FastStream;

use crate::error::OptimizerError;
use crate::moves::{Move, Moved};
use crate::target::Target;

/// Weighs the prior's points by the likelihood, and moves none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Weigh;

impl Move for Weigh {
    fn advance(&self, target: &mut Target<'_>, _: &mut FastStream) -> Result<Moved, OptimizerError> {
        let prior = target.prior();
        let mut log_weights = vec![0.0; prior.len()];
        target.log_likelihood(prior.points(), &mut log_weights)?;
        for (weight, prior) in log_weights.iter_mut().zip(prior.log_weights()) {
            *weight += prior;
        }
        Moved::weighed(target, prior.points().to_vec(), log_weights)
    }
}
