//! Multiscale Gibbs sampling on KD trees.
//!
//! Each input is summarised at every level of a KD tree, a node by one Gaussian with the moments of its components.
//! Going down a level, a point is drawn from the Gaussian product of the chosen nodes and every label is drawn anew
//! at the finer level by its density there; then Gibbs sweeps follow at that level. The coarse levels decide between
//! modes while the nodes are still wide enough for single labels to move (Ihler, Sudderth, Freeman, Willsky 2003,
//! "Efficient multiscale sampling from products of Gaussian mixtures").
//!
//! Their chains start at the roots, and what the coarsest levels get wrong about the masses of modes far apart, no
//! finer level can mend. Here chains start at the finest level whose label choices can be enumerated, once for all
//! chains: their joint law there is exact for the summaries.

use super::super::Mixture;
use super::super::small::{Pair, Small, difference, multiply, whitener};
use super::super::tree::{Merged, Tree, merge};
use super::chains::Chains;
use super::gibbs::warn_of_bias;
use super::{Exact, Product, ProductMethod, absorb, check, comb};
use crate::vector::exponentials;
use rand::RngExt;
use std::borrow::Cow;
use sumprod_graph::{FastStream, MessageError, Stream};

/// Multiscale Gibbs sampling. O(S κ Σ N) for S samples and κ sweeps a level, the levels together having 2 N nodes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MultiscaleGibbs {
    /// Sweeps at each level.
    pub sweeps: usize,
    /// Most label choices to enumerate at the level where chains start; with one they start at the roots.
    pub enumerate: usize,
}

impl Default for MultiscaleGibbs {
    fn default() -> Self {
        Self { sweeps: 1, enumerate: 65_536 }
    }
}

impl ProductMethod for MultiscaleGibbs {
    fn name(&self) -> &'static str {
        "multiscale-gibbs"
    }

    fn product(
        &self,
        inputs: &[&Mixture],
        samples: usize,
        stream: &mut Stream,
    ) -> Result<Product, MessageError> {
        check(inputs, samples)?;
        let (factors, log_normaliser) = absorb(inputs)?;
        if factors.len() == 1 {
            return Exact::default().product(inputs, samples, stream);
        }
        let mut random = stream.fast();
        let mut labels = vec![0; samples * factors.len()];
        let change = self.run(&factors, &mut labels, &mut random)?;
        let finest = Chains::new(factors.iter().map(AsRef::as_ref));
        let mut product = finest.finish(self.name(), &labels, change, &mut random)?;
        product.log_normaliser = product.log_normaliser.map(|log| log + log_normaliser);
        warn_of_bias(&mut product);
        Ok(product)
    }
}

impl MultiscaleGibbs {
    /// The labels of `chains` chains, chain by chain, one label per input.
    ///
    /// # Errors
    ///
    /// Where there are fewer than two inputs, or they differ in their coordinates.
    pub fn labels(
        &self,
        inputs: &[&Mixture],
        chains: usize,
        stream: &mut Stream,
    ) -> Result<Vec<u32>, MessageError> {
        check(inputs, chains)?;
        let mut labels = vec![0; chains * inputs.len()];
        self.run(inputs, &mut labels, &mut stream.fast())?;
        Ok(labels)
    }

    /// Fills in the labels, level by level for all chains; returns the share that the last sweep changed.
    fn run(
        &self,
        inputs: &[impl AsRef<Mixture>],
        labels: &mut [u32],
        random: &mut FastStream,
    ) -> Result<Option<f64>, MessageError> {
        let trees: Vec<Tree> = inputs.iter().map(|input| Tree::of(input.as_ref(), 1)).collect();
        let weights: Vec<Vec<f64>> = inputs.iter().map(|input| input.as_ref().weights()).collect();
        let depth = trees.iter().map(Tree::depth).max().unwrap_or(0);
        let mut points: Vec<f64> = Vec::new();
        let d = inputs.first().map_or(0, |input| input.as_ref().dimension());
        let nodes = |level: usize| trees.iter().map(|tree| tree.level(level).len() as f64).product::<f64>();
        let first =
            (1..=depth).take_while(|&level| nodes(level) <= self.enumerate as f64).last().unwrap_or(0);
        // Two halves of each input are worse than none: their Gaussians' errors multiply.
        let first = if first == 1 && depth > 1 { 0 } else { first };
        let mut changed = 0;
        let mut previous = Vec::new();
        for level in first..=depth {
            let last = level == depth;
            let summaries: Vec<Cow<'_, Mixture>> = (0..inputs.len())
                .map(|l| match inputs[l].as_ref() {
                    input if last => Cow::Borrowed(input),
                    input => Cow::Owned(summary(input, &weights[l], &trees[l], level)),
                })
                .collect();
            let mut state = Chains::new(summaries.iter().map(AsRef::as_ref));
            if level == first {
                joint_labels(&summaries, labels, random)?;
            }
            changed = 0;
            previous.clear();
            previous.append(&mut points);
            for (number, chain) in labels.chunks_exact_mut(inputs.len()).enumerate() {
                if level > first {
                    state.choose_at(&previous[number * d..(number + 1) * d], chain, random)?;
                    for sweep in 0..self.sweeps {
                        let moved = state.sweep(chain, 1.0, false, random)?;
                        changed += if sweep + 1 == self.sweeps { moved } else { 0 };
                    }
                }
                if !last {
                    state.draw(chain, random, &mut points)?;
                }
            }
        }
        if first == depth {
            // Nothing but independent draws of the exact law: no sweep, no mixing.
            return Ok(None);
        }
        Ok((self.sweeps > 0).then(|| changed as f64 / labels.len().max(1) as f64))
    }
}

/// Labels of all chains from their joint law, every choice enumerated. O(Πₗ Nₗ).
fn joint_labels(
    inputs: &[Cow<'_, Mixture>],
    labels: &mut [u32],
    random: &mut FastStream,
) -> Result<(), MessageError> {
    let d = inputs[0].dimension();
    let mut products = vec![Merged {
        log_weight: 0.0,
        mean: Small::from_elem(0.0, d),
        covariance: Small::from_elem(0.0, d * d),
    }];
    for (l, input) in inputs.iter().enumerate() {
        let mut next = Vec::with_capacity(products.len() * input.len());
        for product in &products {
            for i in 0..input.len() {
                let (mean, covariance) = (input.mean_of(i), input.covariance_of(i));
                let own = input.log_weights()[i];
                next.push(if l == 0 {
                    let (mean, covariance) = (Small::from_slice(mean), Small::from_slice(covariance));
                    Merged { log_weight: own, mean, covariance }
                } else {
                    extended(input, product, own, mean, covariance)?
                });
            }
        }
        products = next;
    }
    let logs: Vec<f64> = products.iter().map(|product| product.log_weight).collect();
    let largest = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let mut cumulative = Vec::new();
    exponentials(&logs, largest, &mut cumulative);
    let mut sum = 0.0;
    cumulative.iter_mut().for_each(|share| {
        sum += *share;
        *share = sum;
    });
    let count = inputs.len();
    let chosen = comb(&cumulative, labels.len() / count, random.random());
    for (chain, mut choice) in labels.chunks_exact_mut(count).zip(chosen) {
        for (label, input) in chain.iter_mut().zip(inputs).rev() {
            *label = (choice % input.len()) as u32;
            choice /= input.len();
        }
    }
    Ok(())
}

/// A product of components times one more: N(a; b, A + B) goes into the weight.
fn extended(
    input: &Mixture,
    product: &Merged,
    log_weight: f64,
    mean: &[f64],
    covariance: &[f64],
) -> Result<Merged, MessageError> {
    let d = mean.len();
    let total: Small = product.covariance.iter().zip(covariance).map(|(a, b)| a + b).collect();
    let (Some(pair), Some((matrix, log_determinant))) =
        (Pair::new(&product.covariance, covariance, d), whitener(&total, d))
    else {
        let what = "the sum of two components' covariances";
        return Err(MessageError::NotPositiveDefinite { what, pivot: d - 1, value: total[d * d - 1] });
    };
    let (mut offset, mut white) = (Small::from_elem(0.0, d), Small::from_elem(0.0, d));
    difference(input.coordinates(), mean, &product.mean, &mut offset);
    multiply(&matrix, &offset, &mut white);
    let squared: f64 = white.iter().map(|x| x * x).sum();
    let mut centre = Vec::with_capacity(d);
    pair.push_mean(input.coordinates(), &product.mean, mean, &mut centre);
    Ok(Merged {
        log_weight: product.log_weight + log_weight - 0.5 * (squared + log_determinant),
        mean: Small::from_slice(&centre),
        covariance: pair.covariance,
    })
}

/// One Gaussian per node of a level.
fn summary(mixture: &Mixture, weights: &[f64], tree: &Tree, level: usize) -> Mixture {
    let level = tree.level(level);
    let d = mixture.dimension();
    let mut summary = Mixture {
        coordinates: mixture.coordinates.clone(),
        log_weights: Vec::with_capacity(level.len()),
        means: Vec::with_capacity(level.len() * d),
        covariances: Vec::with_capacity(level.len() * d * d),
        shared: false,
    };
    for node in level {
        let merged = merge(mixture, weights, &tree.order[node.range()]);
        summary.log_weights.push(merged.log_weight);
        summary.means.extend_from_slice(&merged.mean);
        summary.covariances.extend_from_slice(&merged.covariance);
    }
    summary
}
