//! Moving particles from a prior to the posterior.
//!
//! **Law.** Let π(x) ∝ p(x) ℓ(x) be the target, and xᵢ with weights wᵢ what a move returns. Then
//!
//! 1. the weights are finite, not negative and sum to one;
//! 2. Σ wᵢ f(xᵢ) tends to E_π f for every f as the prior's sample grows: of a sample of π it keeps the expectation of
//!    f within its standard error;
//! 3. the evidence Ẑ, where there is one, has E Ẑ = ∫ p ℓ, and E[Ẑ Σ wᵢ f(xᵢ)] = ∫ f p ℓ;
//! 4. each point at which ℓ was evaluated is counted by the target;
//! 5. the same stream yields the same bits.
//!
//! A move that breaks law 2 says so by [`Validity::Literal`]; it is here because it was published.
//!
//! | | draws | likelihoods a particle | valid |
//! |---|---|---|---|
//! | [`Weigh`](crate::Weigh) | nothing: the prior's points are weighed | 1 | yes |
//! | [`Regularised`](crate::Regularised) | from the kernel around each particle | 1 | smoothed |
//! | [`RandomWalk`](crate::RandomWalk), [`Independence`](crate::Independence) | Markov chain steps after reselection | 1 + steps | where the prior has a density; else smoothed |
//! | [`QuantumLiteral`](crate::QuantumLiteral) | the best of several strings of bits | 1 + generations | no |
//! | [`QuantumImportance`](crate::QuantumImportance) | strings of bits, weighed by their probability | generations | smoothed |
//! | [`QuantumMetropolis`](crate::QuantumMetropolis) | Markov chain steps that propose strings of bits | 1 + generations | as the Markov chains |
//! | [`KnowledgeBoard`](crate::KnowledgeBoard) | from a proposal that a swarm shapes in T iterations | at most T + 2 | yes |
//! | the same, literal | the swarm's points are weighed | at most T + 1 | no |

use sumprod_graph::{FastStream, Stream};
use sumprod_messages::Particles;

use crate::error::OptimizerError;
use crate::target::Target;
use crate::trigger::effective_sample_size;

/// In what sense a move's particles are a sample of its target.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Validity {
    /// Of the target itself.
    Exact,
    /// Of the target with the prior's density smoothed by a kernel, whose width vanishes as the sample grows.
    Smoothed,
    /// Of the target itself where the prior's density is known, else of the target with the prior replaced by a sum
    /// of Gaussians that has its mean and covariance.
    GaussianSum,
    /// Of no known distribution: what a paper prints.
    Literal,
}

/// What a move returns.
#[derive(Clone, Debug, PartialEq)]
pub struct Moved {
    /// Weighted particles of the posterior.
    pub particles: Particles,
    /// Index of the particle of the prior that each stems from; empty where they were drawn anew.
    pub ancestors: Vec<usize>,
    /// Logarithm of the estimated evidence ∫ p ℓ, where the move estimates it.
    pub log_evidence: Option<f64>,
    /// Share of the proposed points that were accepted, where the move proposes.
    pub acceptance: Option<f64>,
    /// Effective sample size of the weights before anything was reselected within the move.
    pub effective_sample_size: f64,
}

/// A way to come from a sample of the prior to one of the posterior. Implementations write
/// [`advance`](Self::advance); see the [module](self) for the law that it keeps.
pub trait Move: Send + Sync {
    /// Particles of the posterior from those of `target`'s prior; their number is for the move to choose, and is
    /// the prior's in all moves of this crate.
    ///
    /// # Errors
    ///
    /// Where the likelihood is zero at all points, or cannot be evaluated.
    fn advance(&self, target: &mut Target<'_>, random: &mut FastStream) -> Result<Moved, OptimizerError>;

    /// Whether the particles are a sample of the target.
    fn validity(&self) -> Validity {
        Validity::Exact
    }

    /// [`advance`](Self::advance) with the draws of `stream`.
    ///
    /// # Errors
    ///
    /// As [`advance`](Self::advance).
    fn apply(&self, target: &mut Target<'_>, stream: &mut Stream) -> Result<Moved, OptimizerError> {
        self.advance(target, &mut stream.fast())
    }
}

/// Log weights shifted so that the largest is one, turned into weights; and the logarithm of their sum.
///
/// # Errors
///
/// [`OptimizerError::Unexplained`] where all are −∞.
pub fn weights_of(log_weights: &[f64]) -> Result<(Vec<f64>, f64), OptimizerError> {
    let largest = log_weights.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    if !largest.is_finite() {
        return Err(OptimizerError::Unexplained { count: log_weights.len() });
    }
    let weights: Vec<f64> = log_weights.iter().map(|log| (log - largest).exp()).collect();
    let total: f64 = weights.iter().sum();
    Ok((weights, largest + total.ln()))
}

impl Moved {
    /// Weighted points of the posterior that stem from the prior's particles one by one: `log_weights` are those of
    /// the prior (which sum to one) times what each point was weighed by, so that their sum is the evidence.
    ///
    /// # Errors
    ///
    /// Where all weights are zero, or a coordinate is not finite.
    pub fn weighed(
        target: &Target<'_>,
        points: Vec<f64>,
        log_weights: Vec<f64>,
    ) -> Result<Self, OptimizerError> {
        let (weights, log_evidence) = weights_of(&log_weights)?;
        Ok(Self {
            ancestors: (0..log_weights.len()).collect(),
            log_evidence: Some(log_evidence),
            acceptance: None,
            effective_sample_size: effective_sample_size(&weights),
            particles: Particles::new(&target.space(), points, log_weights)?,
        })
    }
}
