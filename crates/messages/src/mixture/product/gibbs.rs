//! Gibbs sampling over labels.
//!
//! One sweep draws each label given all others by P(l_j = i | l_-j) ∝ w_j^i N(μ_j^i; μ*, σ* + σ_j^i), (μ*, σ*) the
//! Gaussian product of the other chosen components. Chains are independent; each ends in one point of the Gaussian
//! product of its labels. Where modes are separated, or kernels narrow against their spacing, single labels cannot
//! move and no number of sweeps helps: the label change in the quality record shows it.

use super::super::Mixture;
use super::chains::Chains;
use super::{Exact, Product, ProductMethod, absorb, check};
use serde::{Deserialize, Serialize};
use sumprod_graph::{FastStream, MessageError, Stream};

/// Where chains of labels start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum GibbsStart {
    /// The first label by its weight, each further one given those before it.
    #[default]
    Sequential,
    /// Every label by its weight alone.
    Independent,
}

/// Plain Gibbs sampling: independent chains of a fixed number of sweeps. O(S κ Σ N) for S samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Gibbs {
    /// Sweeps a chain.
    pub sweeps: usize,
    /// Where chains start.
    pub start: GibbsStart,
}

/// Fewer sweeps than this are warned of.
pub(super) const FEW_SWEEPS: usize = 5;

impl Default for Gibbs {
    fn default() -> Self {
        Self { sweeps: 10, start: GibbsStart::Sequential }
    }
}

impl Gibbs {
    /// The labels of `chains` chains after the sweeps, chain by chain, one label per input: what the sampler's law
    /// is tested on.
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
        let mut state = Chains::new(inputs.iter().copied());
        Ok(self.run(&mut state, chains, false, &mut stream.fast())?.0)
    }

    /// Labels chain by chain, and the share of them that the last sweep changed.
    pub(super) fn run(
        &self,
        state: &mut Chains<'_>,
        chains: usize,
        counted_twice: bool,
        random: &mut FastStream,
    ) -> Result<(Vec<u32>, Option<f64>), MessageError> {
        let mut labels = vec![0; chains * state.len()];
        let mut changed = 0;
        for chain in labels.chunks_exact_mut(state.len()) {
            state.start(self.start, 1.0, chain, random)?;
            for sweep in 0..self.sweeps {
                let moved = state.sweep(chain, 1.0, counted_twice, random)?;
                changed += if sweep + 1 == self.sweeps { moved } else { 0 };
            }
        }
        let change = (self.sweeps > 0).then(|| changed as f64 / labels.len().max(1) as f64);
        Ok((labels, change))
    }
}

impl ProductMethod for Gibbs {
    fn name(&self) -> &'static str {
        "gibbs"
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
        let mut state = Chains::new(factors.iter().map(AsRef::as_ref));
        let (labels, change) = self.run(&mut state, samples, false, &mut random)?;
        let mut product = state.finish(self.name(), &labels, change, &mut random)?;
        product.log_normaliser = product.log_normaliser.map(|log| log + log_normaliser);
        warn_of_few_sweeps(self.sweeps, &mut product);
        warn_of_bias(&mut product);
        Ok(product)
    }
}

pub(super) fn warn_of_few_sweeps(sweeps: usize, product: &mut Product) {
    if sweeps < FEW_SWEEPS {
        let warning = format!("{sweeps} Gibbs sweeps leave a bias; use at least {FEW_SWEEPS}");
        product.quality.warnings.push(warning);
    }
}

/// Divergence (nats), times the number of chains, above which chains are biased: a shift of the mean by four standard
/// errors is one of 8, and chance alone one of a few.
const BIASED: f64 = 20.0;

/// Warns of labels that no longer move, and of points whose density is not the product's.
pub(super) fn warn_of_bias(product: &mut Product) {
    let chains = product.particles.len() as f64;
    let remedy = "use an exact, pairwise or multiscale product";
    let warning = if let Some(change) = product.quality.label_change.filter(|&change| change < 0.05) {
        let percent = 100.0 * change;
        format!(
            "the last sweep changed {percent:.1} % of the labels: the chains are stuck, and masses of modes are \
             those of their start; {remedy}"
        )
    } else if let Some(divergence) = product.quality.divergence.filter(|&value| value * chains > BIASED) {
        format!(
            "the chains' points differ from the product by {divergence:.3} nats, more than by chance: masses of its \
             modes are still those of their start; {remedy}"
        )
    } else {
        return;
    };
    product.quality.warnings.push(warning);
}
