//! Products pair by pair, condensed between multiplications, and corrected by importance weights.
//!
//! Each input is condensed to K Gaussians, two are multiplied in closed form (K² pairs), the result condensed to K
//! again, multiplied by the third, and so on. What that loses is put right by weighing draws from the last mixture by
//! the true product of the inputs. A first pass with a handful of components says where the product lies, so that
//! the second spends its components there, and throws away only what the whole product, not a part of it, makes
//! negligible. Where the weights still vary too much, K grows. Cost O(Σ N log K + L K² + S Σ N), less for the last
//! term where kernels are narrow; no sampling takes part in finding modes, so none is lost to chance.

use super::super::condense::condense;
use super::super::small::log_determinant;
use super::super::{Evaluator, Mixture};
use super::importance::{ACCURACY, weigh};
use super::pairs::multiply;
use super::quality::{ProductQuality, check_agreement, log_products, sort};
use super::{Exact, Product, ProductMethod, absorb, check};
use crate::vector::exponentials;
use std::borrow::Cow;
use sumprod_graph::{FastStream, MessageError, Stream};

/// Components of the first pass.
const COARSE: usize = 8;

/// Pairs whose share of the final product, as the first pass sees it, is smaller than e to minus this are dropped.
const CUT: f64 = 20.0;

/// Components of a product that is kept whole, where nothing was lost on the way to it.
const EXACT: usize = 10_000;

/// Divergence (nats) at which condensing an input stops early.
const TOLERANCE: f64 = 1e-4;

/// How many times more components inputs are condensed to before the first pass tells which of them matter.
const FINER: usize = 6;

/// Share of the proposal that is one wide Gaussian, so that weights stay bounded where the mixture is too narrow.
const DEFENSIVE: f64 = 0.02;

/// The pairwise product.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pairwise {
    /// Components kept between multiplications, at first; by dimension where none: 12, 24 and from three on 64.
    pub components: Option<usize>,
    /// Most components kept, after growing by fours.
    pub most: usize,
    /// Effective share of the points below which more components are tried.
    pub efficiency: f64,
}

impl Default for Pairwise {
    fn default() -> Self {
        Self { components: None, most: 1024, efficiency: 0.5 }
    }
}

/// A mixture near the product.
struct Approximation {
    mixture: Mixture,
    log_normaliser: f64,
    exact: bool,
}

impl ProductMethod for Pairwise {
    fn name(&self) -> &'static str {
        "pairwise"
    }

    fn product(
        &self,
        inputs: &[&Mixture],
        samples: usize,
        stream: &mut Stream,
    ) -> Result<Product, MessageError> {
        check(inputs, samples)?;
        let (mut factors, log_normaliser) = absorb(inputs)?;
        if factors.len() == 1 {
            return Exact::default().product(inputs, samples, stream);
        }
        order(&mut factors);
        let mut random = stream.fast();
        let by_dimension = match factors[0].dimension() {
            1 => 12,
            2 => 24,
            _ => 64,
        };
        let mut components = self.components.unwrap_or(by_dimension).max(COARSE);
        let mut best: Option<(f64, Product)> = None;
        let mut guide: Option<Approximation> = None;
        loop {
            let finer = finer(&factors, FINER * components);
            let guided = match guide.take() {
                Some(guide) => guide,
                None => approximate(&finer, COARSE, None)?,
            };
            let mut found =
                if guided.exact { guided } else { approximate(&finer, components, Some(&guided.mixture))? };
            found.exact &= finer.iter().zip(&factors).all(|(finer, factor)| finer.len() == factor.len());
            if found.exact {
                return exactly(self.name(), &factors, found, log_normaliser, samples, &mut random);
            }
            let proposal = defended(&found.mixture)?;
            let labels = proposal.comb(samples, &mut random);
            let points = proposal.draw(&labels, &mut random);
            let sorted = sort(&factors[0], &points);
            let log_p = log_products(&factors, &points, &sorted, ACCURACY)?;
            let log_q = log_products(&[&proposal], &points, &sorted, ACCURACY)?;
            let mut product =
                weigh(self.name(), &factors, points, &log_p, &log_q, None, log_normaliser, &mut random)?;
            product.near = Some(found.mixture.clone());
            let share = product.quality.effective_sample_size / samples as f64;
            if best.as_ref().is_none_or(|(other, _)| share > *other) {
                best = Some((share, product));
            }
            let largest = factors.iter().map(|factor| factor.len()).max().unwrap_or(0);
            if share >= self.efficiency || components >= self.most.min(largest) {
                break;
            }
            components = (components * 4).min(self.most);
            guide = Some(found);
        }
        best.map(|(_, product)| product)
            .ok_or_else(|| MessageError::Unsupported("a pairwise product found no proposal".into()))
    }
}

/// The most informative inputs first, so that later ones are met by few components.
fn order(factors: &mut [Cow<'_, Mixture>]) {
    let d = factors[0].dimension();
    factors.sort_by_cached_key(|factor| {
        let volume = log_determinant(&factor.moments().covariance, d).unwrap_or(f64::INFINITY);
        // Total order of floats as integers.
        let bits = volume.to_bits() as i64;
        bits ^ (((bits >> 63) as u64) >> 1) as i64
    });
}

/// The inputs condensed to more components than will be kept: what both passes look at, so that the largest inputs
/// are gone through once.
fn finer<'a>(factors: &'a [Cow<'_, Mixture>], components: usize) -> Vec<Cow<'a, Mixture>> {
    let condensed = |factor: &'a Cow<'_, Mixture>| {
        if factor.len() > components {
            Cow::Owned(condense(factor, components, 0.1 * TOLERANCE, None).mixture)
        } else {
            Cow::Borrowed(factor.as_ref())
        }
    };
    factors.iter().map(condensed).collect()
}

fn approximate(
    factors: &[Cow<'_, Mixture>],
    components: usize,
    guide: Option<&Mixture>,
) -> Result<Approximation, MessageError> {
    let guide = guide.map(Evaluator::new);
    let mut exact = true;
    let mut log_normaliser = 0.0;
    let mut product: Option<Mixture> = None;
    for (number, factor) in factors.iter().enumerate() {
        let condensed;
        let mut next: &Mixture = factor;
        if factor.len() > components {
            let masses = guide.as_ref().map(|guide| masses(factor, guide)).transpose()?;
            let masses = masses.as_ref().map(|(masses, _)| masses.as_slice());
            condensed = condense(factor, components, TOLERANCE, masses);
            exact = false;
            next = &condensed.mixture;
        }
        let Some(previous) = &product else {
            product = Some(next.clone());
            continue;
        };
        let pairs = multiply(previous, next, f64::INFINITY)?;
        log_normaliser += pairs.log_normaliser;
        let mut pairs = pairs.mixture;
        let last = number + 1 == factors.len();
        let room = match last {
            true if exact => EXACT,
            true => 2 * components,
            false => components,
        };
        if pairs.len() > room {
            let mut weighed = None;
            if let Some(guide) = &guide {
                let (masses, floor) = masses(&pairs, guide)?;
                let kept: Vec<usize> = (0..pairs.len()).filter(|&i| masses[i] > floor).collect();
                pairs = pairs.select(&kept);
                weighed = Some(kept.iter().map(|&i| masses[i]).collect::<Vec<f64>>());
            }
            pairs = condense(&pairs, room, 0.1 * TOLERANCE, weighed.as_deref()).mixture;
            exact = false;
        }
        let total = pairs.normalise("the product of mixtures")?;
        log_normaliser += total;
        product = Some(pairs);
    }
    match product {
        Some(mixture) => Ok(Approximation { mixture, log_normaliser, exact }),
        None => Err(MessageError::Unsupported("a product of mixtures needs at least one mixture".into())),
    }
}

/// By component: its mass in the final product as the guide sees it, relative to the largest; and the mass below
/// which a component does not matter.
fn masses(mixture: &Mixture, guide: &Evaluator<'_>) -> Result<(Vec<f64>, f64), MessageError> {
    let mut logs = vec![0.0; mixture.len()];
    guide.log_densities_within(&mixture.means, 1e-2, &mut logs)?;
    if !mixture.shared {
        let d = mixture.dimension();
        for (i, log) in logs.iter_mut().enumerate() {
            *log += 0.5 * log_determinant(mixture.covariance_of(i), d).unwrap_or(0.0);
        }
    }
    let largest = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let mut masses = Vec::new();
    exponentials(&logs, largest, &mut masses);
    Ok((masses, (-CUT).exp()))
}

/// The mixture with a small share of one wide Gaussian.
fn defended(mixture: &Mixture) -> Result<Mixture, MessageError> {
    let moments = mixture.moments();
    let mut log_weights: Vec<f64> =
        mixture.log_weights.iter().map(|log| log + (1.0 - DEFENSIVE).ln()).collect();
    log_weights.push(DEFENSIVE.ln());
    let mut means = mixture.means.clone();
    means.extend(moments.mean);
    let mut covariances =
        if mixture.shared { mixture.covariances.repeat(mixture.len()) } else { mixture.covariances.clone() };
    covariances.extend(moments.covariance.iter().map(|entry| 2.0 * entry));
    Ok(Mixture::assemble(&mixture.coordinates, log_weights, means, covariances, false)?.0)
}

/// The product where nothing had to be condensed.
fn exactly(
    method: &str,
    factors: &[Cow<'_, Mixture>],
    found: Approximation,
    log_normaliser: f64,
    samples: usize,
    random: &mut FastStream,
) -> Result<Product, MessageError> {
    let mixture = found.mixture;
    let summit = mixture.mean_of(mixture.heaviest());
    let largest = factors.iter().map(|factor| factor.log_density(summit)).sum::<Result<f64, _>>()?;
    let mut quality = ProductQuality::new(method, samples as f64);
    quality.divergence = Some(0.0);
    check_agreement(factors, largest, &mut quality)?;
    let labels = mixture.comb(samples, random);
    let particles = crate::Particles::equally_weighted(&mixture.space(), mixture.draw(&labels, random))?;
    let log_normaliser = Some(found.log_normaliser + log_normaliser);
    Ok(Product { particles, mixture: Some(mixture), near: None, log_normaliser, quality })
}
