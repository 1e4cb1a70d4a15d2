//! The exact product, by enumeration of all label choices.

use super::super::Mixture;
use super::pairs::multiply;
use super::quality::{ProductQuality, check_agreement};
use super::{Product, ProductMethod, absorb, check, choices};
use std::borrow::Cow;
use sumprod_graph::{MessageError, Stream};

/// Pairs this many nats below the largest are left out of the last multiplication: all of them together weigh less
/// than the rounding of the total, whatever their number that fits in memory.
const CUT: f64 = 50.0;

/// Pairs up to this many are all kept: looking for the small ones costs more.
const FEW: usize = 100_000;

/// Enumerates every label choice. Mixtures of one component are multiplied in first, so that one mixture times any
/// number of Gaussians is its closed form, O(N).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Exact {
    /// Most label choices to enumerate.
    pub limit: usize,
}

impl Default for Exact {
    fn default() -> Self {
        Self { limit: 4_000_000 }
    }
}

impl Exact {
    /// The product as a mixture of all label choices, and its log normaliser. O(N^L).
    ///
    /// # Errors
    ///
    /// As [`ProductMethod::product`].
    pub fn mixture(&self, inputs: &[&Mixture]) -> Result<(Mixture, f64), MessageError> {
        check(inputs, 1)?;
        let (mixture, log_normaliser) = self.enumerate(inputs)?;
        Ok((mixture.into_owned(), log_normaliser))
    }

    fn enumerate<'a>(&self, inputs: &[&'a Mixture]) -> Result<(Cow<'a, Mixture>, f64), MessageError> {
        let (mut factors, mut log_normaliser) = absorb(inputs)?;
        let count = choices(&factors);
        if count > self.limit as f64 {
            let sizes: Vec<String> = factors.iter().map(|factor| factor.len().to_string()).collect();
            return Err(MessageError::Unsupported(format!(
                "the exact product of mixtures of {} components has {count:.3e} components, more than the limit of \
                 {}; choose another product method, or reduce the inputs",
                sizes.join(", "),
                self.limit
            )));
        }
        factors.sort_by_key(|factor| factor.len());
        let mut rest = factors.into_iter();
        let Some(mut product) = rest.next() else {
            return Err(MessageError::Unsupported("a product of mixtures needs at least one mixture".into()));
        };
        while let Some(factor) = rest.next() {
            let few = product.len() * factor.len() <= FEW;
            let cut = if rest.len() > 0 || few { f64::INFINITY } else { CUT };
            let next = multiply(&product, &factor, cut)?;
            log_normaliser += next.log_normaliser;
            product = Cow::Owned(next.mixture);
        }
        Ok((product, log_normaliser))
    }
}

impl ProductMethod for Exact {
    fn name(&self) -> &'static str {
        "exact"
    }

    fn product(
        &self,
        inputs: &[&Mixture],
        samples: usize,
        stream: &mut Stream,
    ) -> Result<Product, MessageError> {
        check(inputs, samples)?;
        let (mixture, log_normaliser) = self.enumerate(inputs)?;
        let mut quality = ProductQuality::new(self.name(), samples as f64);
        quality.divergence = Some(0.0);
        let summit = mixture.mean_of(mixture.heaviest());
        let largest = inputs.iter().map(|input| input.log_density(summit)).sum::<Result<f64, _>>()?;
        check_agreement(inputs, largest, &mut quality)?;
        Ok(Product {
            particles: mixture.sample_systematic(samples, stream)?,
            mixture: Some(mixture.into_owned()),
            near: None,
            log_normaliser: Some(log_normaliser),
            quality,
        })
    }
}
