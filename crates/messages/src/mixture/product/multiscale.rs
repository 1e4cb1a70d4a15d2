//! Multiscale Gibbs sampling on KD trees.
//!
//! Each input is summarised at every level of a KD tree, a node by one Gaussian with the moments of its components.
//! Chains start at the roots. Going down a level, a point is drawn from the Gaussian product of the chosen nodes and
//! every label is drawn anew at the finer level by its density there; then Gibbs sweeps follow at that level. The
//! coarse levels decide between modes while the nodes are still wide enough for single labels to move (Ihler,
//! Sudderth, Freeman, Willsky 2003, "Efficient multiscale sampling from products of Gaussian mixtures").

use super::super::Mixture;
use super::super::tree::{Tree, merge};
use super::chains::Chains;
use super::gibbs::warn_of_stuck_labels;
use super::{Exact, GibbsStart, Product, ProductMethod, absorb, check};
use sumprod_graph::{MessageError, Stream};

/// Multiscale Gibbs sampling. O(S κ Σ N) for S samples and κ sweeps a level, the levels together having 2 N nodes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MultiscaleGibbs {
    /// Sweeps at each level.
    pub sweeps: usize,
}

impl Default for MultiscaleGibbs {
    fn default() -> Self {
        Self { sweeps: 1 }
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
        warn_of_stuck_labels(&mut product);
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
        random: &mut sumprod_graph::FastStream,
    ) -> Result<Option<f64>, MessageError> {
        let trees: Vec<Tree> = inputs.iter().map(|input| Tree::of(input.as_ref(), 1)).collect();
        let weights: Vec<Vec<f64>> = inputs.iter().map(|input| input.as_ref().weights()).collect();
        let depth = trees.iter().map(Tree::depth).max().unwrap_or(0);
        let mut points: Vec<f64> = Vec::new();
        let d = inputs.first().map_or(0, |input| input.as_ref().dimension());
        let mut changed = 0;
        let mut previous = Vec::new();
        for level in 0..=depth {
            let last = level == depth;
            let summaries: Vec<Mixture> = if last {
                Vec::new()
            } else {
                (0..inputs.len()).map(|l| summary(inputs[l].as_ref(), &weights[l], &trees[l], level)).collect()
            };
            let mut state = if last {
                Chains::new(inputs.iter().map(AsRef::as_ref))
            } else {
                Chains::new(summaries.iter())
            };
            changed = 0;
            previous.clear();
            previous.append(&mut points);
            for (number, chain) in labels.chunks_exact_mut(inputs.len()).enumerate() {
                if level == 0 {
                    state.start(GibbsStart::Independent, 1.0, chain, random)?;
                } else {
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
        Ok((self.sweeps > 0).then(|| changed as f64 / labels.len().max(1) as f64))
    }
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
