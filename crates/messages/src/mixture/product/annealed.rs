//! Gibbs sampling over labels with kernels that start wide and cool.

use super::super::Mixture;
use super::chains::Chains;
use super::gibbs::{warn_of_bias, warn_of_few_sweeps};
use super::{Exact, GibbsStart, Product, ProductMethod, absorb, check};
use sumprod_graph::{MessageError, Stream};

/// Gibbs sampling in which all covariances are multiplied by a factor that falls geometrically from `heat` to one
/// over the first three quarters of the sweeps. Halves the error of plain Gibbs sampling at equal cost where modes
/// are separated, and does not remove it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AnnealedGibbs {
    /// Sweeps a chain.
    pub sweeps: usize,
    /// First factor on the covariances, at least one.
    pub heat: f64,
    /// Where chains start.
    pub start: GibbsStart,
}

impl Default for AnnealedGibbs {
    fn default() -> Self {
        Self { sweeps: 10, heat: 30.0, start: GibbsStart::Sequential }
    }
}

impl ProductMethod for AnnealedGibbs {
    fn name(&self) -> &'static str {
        "annealed-gibbs"
    }

    fn product(
        &self,
        inputs: &[&Mixture],
        samples: usize,
        stream: &mut Stream,
    ) -> Result<Product, MessageError> {
        check(inputs, samples)?;
        if !(self.heat >= 1.0 && self.heat.is_finite()) {
            let reason = format!("the heat of an annealed product is {}; it must be at least 1", self.heat);
            return Err(MessageError::Unsupported(reason));
        }
        let (factors, log_normaliser) = absorb(inputs)?;
        if factors.len() == 1 {
            return Exact::default().product(inputs, samples, stream);
        }
        let mut random = stream.fast();
        let mut state = Chains::new(factors.iter().map(AsRef::as_ref));
        let mut labels = vec![0; samples * state.len()];
        let cooling = (0.75 * self.sweeps as f64).ceil().max(1.0);
        let mut changed = 0;
        for chain in labels.chunks_exact_mut(state.len()) {
            state.start(self.start, self.heat, chain, &mut random)?;
            for sweep in 0..self.sweeps {
                let heat = self.heat.powf((1.0 - sweep as f64 / cooling).max(0.0));
                let moved = state.sweep(chain, heat, false, &mut random)?;
                changed += if sweep + 1 == self.sweeps { moved } else { 0 };
            }
        }
        let change = (self.sweeps > 0).then(|| changed as f64 / labels.len() as f64);
        let mut product = state.finish(self.name(), &labels, change, &mut random)?;
        product.log_normaliser = product.log_normaliser.map(|log| log + log_normaliser);
        warn_of_few_sweeps(self.sweeps, &mut product);
        warn_of_bias(&mut product);
        Ok(product)
    }
}
