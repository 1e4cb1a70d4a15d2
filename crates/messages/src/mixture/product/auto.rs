//! Choosing a product method by size and separation.

use super::super::Mixture;
use super::{
    AnnealedGibbs, Exact, GaussianImportance, Gibbs, Literal, MixtureImportance, MultiscaleGibbs, Pairwise,
    Product, ProductMethod, absorb, check, choices,
};
use serde::{Deserialize, Serialize};
use sumprod_graph::{MessageError, Stream};

/// Chooses a method: the closed form where one mixture remains after all Gaussians are multiplied in; enumeration
/// where the label choices are few; else the pairwise product, whose own weights say whether it worked; and
/// multiscale Gibbs sampling where they say that it did not. The quality record holds the choice and its reason.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Auto {
    /// Most label choices to enumerate.
    pub enumerate: usize,
    /// Effective share of the points below which a pairwise product is not taken.
    pub efficiency: f64,
}

impl Default for Auto {
    fn default() -> Self {
        Self { enumerate: 100_000, efficiency: 0.05 }
    }
}

impl ProductMethod for Auto {
    fn name(&self) -> &'static str {
        "auto"
    }

    fn product(
        &self,
        inputs: &[&Mixture],
        samples: usize,
        stream: &mut Stream,
    ) -> Result<Product, MessageError> {
        check(inputs, samples)?;
        let (factors, log_normaliser) = absorb(inputs)?;
        let factors: Vec<&Mixture> = factors.iter().map(AsRef::as_ref).collect();
        let count = choices(&factors);
        let (mut product, reason) = if factors.len() == 1 {
            (Exact::default().product(&factors, samples, stream)?, "one mixture times Gaussians".to_owned())
        } else if count <= self.enumerate as f64 {
            let exact = Exact { limit: self.enumerate }.product(&factors, samples, stream)?;
            (exact, format!("{count} label choices, few enough to enumerate"))
        } else {
            self.large(&factors, count, samples, stream)?
        };
        product.log_normaliser = product.log_normaliser.map(|log| log + log_normaliser);
        product.quality.reason = Some(reason);
        Ok(product)
    }
}

impl Auto {
    fn large(
        &self,
        factors: &[&Mixture],
        count: f64,
        samples: usize,
        stream: &mut Stream,
    ) -> Result<(Product, String), MessageError> {
        let pairwise = Pairwise::default().product(factors, samples, stream)?;
        let share = pairwise.quality.effective_sample_size / samples as f64;
        let percent = 100.0 * share;
        if share >= self.efficiency {
            return Ok((
                pairwise,
                format!("{count:.1e} label choices; {percent:.0} % of the points are effective"),
            ));
        }
        let multiscale = MultiscaleGibbs::default().product(factors, samples, stream)?;
        let reason = format!(
            "{count:.1e} label choices, and kernels so narrow against their spacing that only {percent:.1} % of a \
             pairwise product's points are effective"
        );
        Ok((multiscale, reason))
    }
}

/// A product method by its name, with its default settings: what a form on an edge holds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ProductChoice {
    /// [`Auto`].
    #[default]
    Auto,
    /// [`Exact`].
    Exact,
    /// [`Gibbs`].
    Gibbs,
    /// [`AnnealedGibbs`].
    AnnealedGibbs,
    /// [`MultiscaleGibbs`].
    MultiscaleGibbs,
    /// [`MixtureImportance`].
    MixtureImportance,
    /// [`GaussianImportance`].
    GaussianImportance,
    /// [`Pairwise`].
    Pairwise,
    /// [`Literal`].
    Literal,
}

impl ProductChoice {
    /// The method with its default settings.
    pub fn method(self) -> Box<dyn ProductMethod> {
        match self {
            Self::Auto => Box::new(Auto::default()),
            Self::Exact => Box::new(Exact::default()),
            Self::Gibbs => Box::new(Gibbs::default()),
            Self::AnnealedGibbs => Box::new(AnnealedGibbs::default()),
            Self::MultiscaleGibbs => Box::new(MultiscaleGibbs::default()),
            Self::MixtureImportance => Box::new(MixtureImportance::default()),
            Self::GaussianImportance => Box::new(GaussianImportance::default()),
            Self::Pairwise => Box::new(Pairwise::default()),
            Self::Literal => Box::new(Literal::default()),
        }
    }
}
