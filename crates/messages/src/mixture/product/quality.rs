//! What is known of a product's quality, and how it is found out.

use super::super::condense::log_determinants;
use super::super::density::LANES;
use super::super::tree::{Tree, scale};
use super::super::{Evaluator, Mixture};
use crate::vector::log_sum;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;
use sumprod_graph::{MessageError, ProductOutcome};

/// Log of the product's height over the product of the inputs' heights below which the inputs have disjoint
/// supports: where the smallest positive number would be zero.
const DISJOINT: f64 = -700.0;

/// The same, below which they disagree so much that a person should know: ten standard deviations.
const DISAGREE: f64 = -50.0;

/// The names of all methods.
const METHODS: [&str; 11] = [
    "auto",
    "exact",
    "gibbs",
    "annealed-gibbs",
    "multiscale-gibbs",
    "mixture-importance",
    "gaussian-importance",
    "pairwise",
    "pointwise",
    "literal",
    "gaussian",
];

/// Points at which a sampler's divergence is estimated.
pub(super) const PROBES: usize = 256;

/// How a product of mixtures was found, and how good it is.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ProductQuality {
    /// Name of the method that found it.
    pub method: String,
    /// Why that method, where it was chosen automatically.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// Effective sample size of the points, before repeats; their number where they are equally weighted.
    pub effective_sample_size: f64,
    /// Share of the labels that the last sweep changed; near zero where a Gibbs sampler is stuck. Absent where
    /// there was no sweep.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub label_change: Option<f64>,
    /// Estimate (nats) of the divergence between the exact product and the distribution that the points were drawn
    /// from, which unequal weights then correct. Blind to modes that no point has found.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub divergence: Option<f64>,
    /// Number of modes of each input, where they were looked for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub modes_before: Option<Vec<usize>>,
    /// Number of modes of the product, where they were looked for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub modes_after: Option<usize>,
    /// What a person should know.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub warnings: Vec<String>,
}

impl ProductQuality {
    /// What an automatic choice of this kind is called where many are counted.
    fn reasons(&self) -> Option<&'static str> {
        self.reason.as_ref().map(|_| match self.method.as_str() {
            "exact" => "few label choices",
            "pairwise" => "many label choices",
            "multiscale-gibbs" => "many label choices and narrow kernels",
            _ => "the only choice",
        })
    }

    pub(super) fn new(method: &str, effective_sample_size: f64) -> Self {
        Self { method: method.into(), effective_sample_size, ..Self::default() }
    }

    /// Whether points were drawn, and their effective number tells something: not of an exact product.
    pub(crate) fn sampled(&self) -> bool {
        self.divergence != Some(0.0)
    }

    /// What reports of a run hold.
    pub(crate) fn outcome(&self) -> ProductOutcome {
        let method = METHODS.iter().find(|name| **name == self.method).copied().unwrap_or("other");
        ProductOutcome {
            method,
            reason: self.reasons(),
            label_change: self.label_change,
            divergence: self.divergence,
            modes_before: self.modes_before.as_ref().and_then(|modes| modes.iter().max().copied()),
            modes_after: self.modes_after,
        }
    }
}

/// An upper bound of a mixture's log density.
pub(super) fn log_height(mixture: &Mixture) -> f64 {
    let logs = log_determinants(mixture);
    let own = |i: usize| logs[if logs.len() == 1 { 0 } else { i }];
    let heights: Vec<f64> =
        mixture.log_weights().iter().enumerate().map(|(i, log)| log - 0.5 * own(i)).collect();
    log_sum(&heights) - 0.5 * mixture.dimension() as f64 * TAU.ln()
}

/// The order in which `points` are evaluated, near ones together in units of this mixture's kernels.
pub(super) fn sort(mixture: &Mixture, points: &[f64]) -> Tree {
    Tree::new(points, &scale(mixture), LANES)
}

/// Σₗ ln pₗ at `points`, every factor within `tolerance` relatively.
pub(super) fn log_products(
    inputs: &[impl AsRef<Mixture>],
    points: &[f64],
    sorted: &Tree,
    tolerance: f64,
) -> Result<Vec<f64>, MessageError> {
    let d = inputs.first().map_or(1, |input| input.as_ref().dimension());
    let mut sums = vec![0.0; points.len() / d];
    let mut logs = vec![0.0; sums.len()];
    for input in inputs {
        Evaluator::new(input.as_ref()).evaluate(points, sorted, tolerance, &mut logs)?;
        sums.iter_mut().zip(&logs).for_each(|(sum, log)| *sum += log);
    }
    Ok(sums)
}

/// Reports inputs whose supports are disjoint as an error, and inputs that disagree as a warning; `largest` is the
/// log of the product's greatest height that is known.
pub(super) fn check_agreement(
    inputs: &[impl AsRef<Mixture>],
    largest: f64,
    quality: &mut ProductQuality,
) -> Result<(), MessageError> {
    let heights: f64 = inputs.iter().map(|input| log_height(input.as_ref())).sum();
    let largest = largest - heights;
    if largest.is_nan() || largest < DISJOINT {
        return Err(MessageError::NoWeight {
            what: "the product of mixtures with disjoint supports",
            largest,
            remedy: "the inputs contradict each other; look for a wrong measurement, or give them wider kernels",
        });
    }
    if largest < DISAGREE {
        let deviations = (-2.0 * largest).sqrt();
        quality.warnings.push(format!(
            "the inputs disagree: their product lies in their tails, {deviations:.0} standard deviations out in all"
        ));
    }
    Ok(())
}

/// Weights p/q of points drawn from q, normalised in the log domain.
pub(super) struct Weighted {
    pub(super) log_weights: Vec<f64>,
    /// Log of the mean weight: of the integral of p.
    pub(super) log_normaliser: f64,
    pub(super) effective_sample_size: f64,
    /// KL(p ‖ q) as the weights see it, nats.
    pub(super) divergence: f64,
}

impl Weighted {
    /// From ln p and ln q at each point.
    pub(super) fn new(log_p: &[f64], log_q: &[f64]) -> Self {
        let mut log_weights: Vec<f64> = log_p.iter().zip(log_q).map(|(p, q)| p - q).collect();
        let total = log_sum(&log_weights);
        let count = (log_weights.len() as f64).ln();
        let (mut squares, mut divergence) = (0.0, 0.0);
        for log in &mut log_weights {
            *log -= total;
            let weight = log.exp();
            squares += weight * weight;
            if weight > 0.0 {
                divergence += weight * (*log + count);
            }
        }
        Self {
            log_weights,
            log_normaliser: total - count,
            effective_sample_size: if squares > 0.0 { 1.0 / squares } else { 0.0 },
            divergence: divergence.max(0.0),
        }
    }
}
