//! The product as the paper of P-MPA prints it, kept to be compared with.
//!
//! Fan, Wang, Zhou (2018), "Cooperative positioning based on message passing", section 2.3.2: every kernel has the
//! variance N^(1/6) (in squared units of the state, whatever the kernels' own covariances; a mixture of one component,
//! which no particles stand for, keeps its own), chains start with independent labels, and the new label
//! is weighted by ω N(x; μ̄, σ̄) N(x; μ_j, σ_j) / N(x; μ̄ⁱ, σ̄ⁱ) with (μ̄, σ̄) the product of all chosen kernels, so that
//! the kernel to be replaced is counted as well.

use super::super::Mixture;
use super::chains::Chains;
use super::gibbs::{Gibbs, warn_of_bias, warn_of_few_sweeps};
use super::{GibbsStart, Product, ProductMethod, check};
use crate::Particles;
use sumprod_graph::{MessageError, Stream};

/// The printed form of the product. It is no consistent estimate of anything: the kernels grow with N.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Literal {
    /// Sweeps a chain; the paper's κ, which it does not state.
    pub sweeps: usize,
    /// Where chains start; the paper's start is independent.
    pub start: GibbsStart,
    /// Whether the conditional counts the present component of the label's own input, as printed; otherwise it is
    /// the leave-one-out conditional.
    pub counted_twice: bool,
}

impl Default for Literal {
    fn default() -> Self {
        Self { sweeps: 3, start: GibbsStart::Independent, counted_twice: true }
    }
}

impl Literal {
    /// One point a chain, and the labels that the chains ended in, chain by chain, one a mixture; nothing is said of
    /// the quality, so that mixtures which hardly meet are multiplied as well.
    ///
    /// # Errors
    ///
    /// Where there are fewer than two inputs or no sample, or the inputs differ in their coordinates.
    pub fn chains(
        &self,
        inputs: &[&Mixture],
        samples: usize,
        stream: &mut Stream,
    ) -> Result<(Particles, Vec<u32>), MessageError> {
        let first = check(inputs, samples)?;
        let printed = printed(inputs)?;
        let mut random = stream.fast();
        let mut state = Chains::new(printed.iter());
        let (labels, _) = self.sampler().run(&mut state, samples, self.counted_twice, &mut random)?;
        let mut points = Vec::with_capacity(samples * first.dimension());
        for chain in labels.chunks_exact(inputs.len()) {
            state.draw(chain, &mut random, &mut points)?;
        }
        Ok((Particles::equally_weighted(&first.space(), points)?, labels))
    }

    fn sampler(&self) -> Gibbs {
        Gibbs { sweeps: self.sweeps, start: self.start }
    }
}

/// The inputs with the printed kernels; a Gaussian is no sample and stays what it is.
fn printed(inputs: &[&Mixture]) -> Result<Vec<Mixture>, MessageError> {
    let printed = inputs.iter().map(|input| {
        if input.len() == 1 {
            return Ok((*input).clone());
        }
        let d = input.dimension();
        let variance = (input.len() as f64).powf(1.0 / 6.0);
        let kernel = (0..d * d).map(|entry| if entry % (d + 1) == 0 { variance } else { 0.0 }).collect();
        let weights = input.log_weights().to_vec();
        Mixture::with_shared_covariance(&input.space(), weights, input.means().to_vec(), kernel)
    });
    printed.collect()
}

impl ProductMethod for Literal {
    fn name(&self) -> &'static str {
        "literal"
    }

    fn product(
        &self,
        inputs: &[&Mixture],
        samples: usize,
        stream: &mut Stream,
    ) -> Result<Product, MessageError> {
        check(inputs, samples)?;
        let printed = printed(inputs)?;
        if let [only] = printed.as_slice() {
            return super::Exact::default().product(&[only], samples, stream);
        }
        let mut random = stream.fast();
        let mut state = Chains::new(printed.iter());
        let (labels, change) = self.sampler().run(&mut state, samples, self.counted_twice, &mut random)?;
        let mut product = state.finish(self.name(), &labels, change, &mut random)?;
        // The quality is measured against the product of the printed kernels; no normaliser of the inputs' own.
        product.log_normaliser = None;
        warn_of_few_sweeps(self.sweeps, &mut product);
        warn_of_bias(&mut product);
        Ok(product)
    }
}
