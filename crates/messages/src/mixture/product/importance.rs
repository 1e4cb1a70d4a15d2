//! Products by importance sampling: draw somewhere, weigh by the product of the inputs' densities.

use super::super::{Evaluator, Mixture};
use super::pairs::multiply;
use super::quality::{ProductQuality, Weighted, check_agreement, log_products, sort};
use super::{Product, ProductMethod, absorb, check};
use crate::vector::log_sum;
use crate::{Particles, Role};
use rand::RngExt;
use std::borrow::Cow;
use sumprod_graph::{FastStream, MessageError, Stream};

/// Relative accuracy of the densities that weights are made of: far below the noise of sampling.
pub(super) const ACCURACY: f64 = 1e-4;

/// Shares of effective points below which a person should know.
const POOR: f64 = 0.05;

/// Draws from the inputs themselves, in equal parts, and weighs by Πₗ pₗ / mean pₗ. Safe against lost modes; starves
/// where the product is much narrower than any input. O(c S L Σ N) for c proposals a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MixtureImportance {
    /// Proposals a sample, over all inputs together.
    pub oversampling: usize,
}

impl Default for MixtureImportance {
    fn default() -> Self {
        Self { oversampling: 5 }
    }
}

impl ProductMethod for MixtureImportance {
    fn name(&self) -> &'static str {
        "mixture-importance"
    }

    fn product(
        &self,
        inputs: &[&Mixture],
        samples: usize,
        stream: &mut Stream,
    ) -> Result<Product, MessageError> {
        let first = check(inputs, samples)?;
        let (factors, log_normaliser) = absorb(inputs)?;
        let mut random = stream.fast();
        let proposals = samples * self.oversampling.max(1);
        let mut points = Vec::with_capacity(proposals * first.dimension());
        for (l, factor) in factors.iter().enumerate() {
            let share = proposals * (l + 1) / factors.len() - proposals * l / factors.len();
            let labels = factor.comb(share, &mut random);
            points.extend(factor.draw(&labels, &mut random));
        }
        let sorted = sort(&factors[0], &points);
        let mut logs = vec![vec![0.0; proposals]; factors.len()];
        for (factor, logs) in factors.iter().zip(&mut logs) {
            Evaluator::new(factor).evaluate(&points, &sorted, ACCURACY, logs)?;
        }
        let log_p: Vec<f64> = (0..proposals).map(|i| logs.iter().map(|log| log[i]).sum()).collect();
        // Parts differ by at most one draw where the proposals do not divide evenly.
        let log_q: Vec<f64> = (0..proposals)
            .map(|i| {
                let at: super::super::small::Small = logs.iter().map(|log| log[i]).collect();
                log_sum(&at) - (factors.len() as f64).ln()
            })
            .collect();
        weigh(self.name(), &factors, points, &log_p, &log_q, Some(samples), log_normaliser, &mut random)
    }
}

/// Draws from the product of Gaussians of the inputs' moments, widened. The cheapest where the product has one mode;
/// wrong where it has several.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GaussianImportance {
    /// Proposals a sample.
    pub oversampling: usize,
    /// Factor on the Gaussian product's covariance.
    pub inflation: f64,
}

impl Default for GaussianImportance {
    fn default() -> Self {
        Self { oversampling: 5, inflation: 2.0 }
    }
}

impl ProductMethod for GaussianImportance {
    fn name(&self) -> &'static str {
        "gaussian-importance"
    }

    fn product(
        &self,
        inputs: &[&Mixture],
        samples: usize,
        stream: &mut Stream,
    ) -> Result<Product, MessageError> {
        let first = check(inputs, samples)?;
        if !(self.inflation > 0.0 && self.inflation.is_finite()) {
            let reason = format!("the inflation of a proposal is {}; it must be positive", self.inflation);
            return Err(MessageError::Unsupported(reason));
        }
        let (factors, log_normaliser) = absorb(inputs)?;
        let gaussian = |mixture: &Mixture, factor: f64| {
            let mut moments = mixture.moments();
            moments.covariance.iter_mut().for_each(|entry| *entry *= factor);
            Mixture::with_shared_covariance(&first.space(), vec![0.0], moments.mean, moments.covariance)
        };
        let mut proposal = gaussian(&factors[0], 1.0)?;
        for factor in &factors[1..] {
            proposal = multiply(&proposal, &gaussian(factor, 1.0)?, f64::INFINITY)?.mixture;
        }
        let proposal = gaussian(&proposal, self.inflation)?;
        let mut random = stream.fast();
        let proposals = samples * self.oversampling.max(1);
        let points = proposal.draw(&vec![0; proposals], &mut random);
        let sorted = sort(&factors[0], &points);
        let log_p = log_products(&factors, &points, &sorted, ACCURACY)?;
        let log_q = log_products(&[&proposal], &points, &sorted, ACCURACY)?;
        let mut product =
            weigh(self.name(), &factors, points, &log_p, &log_q, Some(samples), log_normaliser, &mut random)?;
        product.quality.warnings.push("a Gaussian proposal finds one mode at most".into());
        Ok(product)
    }
}

/// Weighs given points, a sample that is one more factor of the product: the receiver's prediction, usually. The
/// number of samples asked for is that of the points, whatever the caller says. O(M Σ N).
#[derive(Clone, Debug, PartialEq)]
pub struct Pointwise {
    /// The sample that carries the product.
    pub carrier: Particles,
}

impl ProductMethod for Pointwise {
    fn name(&self) -> &'static str {
        "pointwise"
    }

    fn product(
        &self,
        inputs: &[&Mixture],
        samples: usize,
        _stream: &mut Stream,
    ) -> Result<Product, MessageError> {
        let first = check(inputs, samples)?;
        if self.carrier.is_empty() || self.carrier.role() == Role::Likelihood {
            let reason = "a pointwise product needs a sample to carry it, and this holds no distribution";
            return Err(MessageError::Unsupported(reason.into()));
        }
        if self.carrier.coordinates() != first.coordinates() {
            let (found, expected) = (self.carrier.dimension(), first.dimension());
            return Err(MessageError::Dimension { what: "the carrier of the product", found, expected });
        }
        let points = self.carrier.points();
        let log_p = log_products(inputs, points, &sort(first, points), ACCURACY)?;
        let weights = self.carrier.log_weights();
        let inverse: Vec<f64> = weights.iter().map(|log| -log).collect();
        let weighted = Weighted::new(&log_p, &inverse);
        let mut quality = ProductQuality::new(self.name(), weighted.effective_sample_size);
        quality.divergence = Some(weighted.divergence);
        let carried = log_p.iter().zip(weights).filter(|(_, weight)| weight.is_finite());
        let largest = carried.fold(f64::NEG_INFINITY, |best, (log, _)| best.max(*log));
        check_agreement(inputs, largest, &mut quality)?;
        warn_of_starvation(&mut quality, weights.len());
        let space = first.space();
        // The carrier's weights sum to one, so the total and not the mean is the normaliser.
        let log_normaliser = Some(weighted.log_normaliser + (weights.len() as f64).ln());
        let particles = Particles::new(&space, self.carrier.points().to_vec(), weighted.log_weights)?;
        Ok(Product { particles, mixture: None, near: None, log_normaliser, quality })
    }
}

/// The product from points drawn from q: weighted as they are, or `samples` of them by a comb over the weights.
#[allow(clippy::too_many_arguments, reason = "what a sampler knows when it has drawn, used once each")]
pub(super) fn weigh(
    method: &str,
    factors: &[Cow<'_, Mixture>],
    points: Vec<f64>,
    log_p: &[f64],
    log_q: &[f64],
    samples: Option<usize>,
    log_normaliser: f64,
    random: &mut FastStream,
) -> Result<Product, MessageError> {
    let weighted = Weighted::new(log_p, log_q);
    let mut quality = ProductQuality::new(method, weighted.effective_sample_size);
    quality.divergence = Some(weighted.divergence);
    check_agreement(factors, log_p.iter().copied().fold(f64::NEG_INFINITY, f64::max), &mut quality)?;
    warn_of_starvation(&mut quality, log_p.len());
    let space = factors[0].space();
    let d = factors[0].dimension();
    let particles = match samples {
        None => Particles::new(&space, points, weighted.log_weights)?,
        Some(samples) => {
            let mut sum = 0.0;
            let cumulative: Vec<f64> = weighted
                .log_weights
                .iter()
                .map(|log| {
                    sum += log.exp();
                    sum
                })
                .collect();
            let chosen = super::comb(&cumulative, samples, random.random());
            let points = chosen.iter().flat_map(|&i| &points[i * d..(i + 1) * d]).copied().collect();
            Particles::equally_weighted(&space, points)?
        }
    };
    let log_normaliser = Some(weighted.log_normaliser + log_normaliser);
    Ok(Product { particles, mixture: None, near: None, log_normaliser, quality })
}

fn warn_of_starvation(quality: &mut ProductQuality, points: usize) {
    let effective = quality.effective_sample_size;
    if effective < POOR * points as f64 {
        quality.warnings.push(format!(
            "only {effective:.0} of {points} weighted points are effective; use a pairwise or multiscale product"
        ));
    }
}
