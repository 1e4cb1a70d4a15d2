//! Robust kernels: how much a large residual costs, and the weight it keeps.

use serde::{Deserialize, Serialize};
use sumprod_models::Expansion;

/// A robust kernel ρ of the squared whitened residual s: the loss is ρ(s) / 2 and the weight ρ'(s) (iteratively
/// reweighted least squares). Widths are in standard deviations.
///
/// | kernel | ρ(s) | weight |
/// |---|---|---|
/// | none | s | 1 |
/// | Huber k | s up to k², then 2 k √s - k² | k / √s |
/// | Cauchy c | c² ln(1 + s / c²) | 1 / (1 + s / c²) |
/// | Geman-McClure c | s / (1 + s / c²) | 1 / (1 + s / c²)² |
/// | Tukey c | c² (1 - (1 - s / c²)³) / 3 up to c², then c² / 3 | (1 - s / c²)², then 0 |
///
/// Source: Barron (2019), "A general and adaptive robust loss function"; Holland and Welsch (1977).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kernel {
    /// Least squares.
    #[default]
    None,
    /// Linear beyond k.
    Huber(f64),
    /// Logarithmic.
    Cauchy(f64),
    /// Bounded.
    GemanMcclure(f64),
    /// Constant beyond c.
    Tukey(f64),
}

impl Kernel {
    /// ρ(s) and ρ'(s).
    pub fn loss_and_weight(self, squared: f64) -> (f64, f64) {
        match self {
            Self::None => (squared, 1.0),
            Self::Huber(k) if squared <= k * k => (squared, 1.0),
            Self::Huber(k) => (2.0 * k * squared.sqrt() - k * k, k / squared.sqrt()),
            Self::Cauchy(c) => {
                let ratio = squared / (c * c);
                (c * c * ratio.ln_1p(), 1.0 / (1.0 + ratio))
            }
            Self::GemanMcclure(c) => {
                let shrink = 1.0 / (1.0 + squared / (c * c));
                (squared * shrink, shrink * shrink)
            }
            Self::Tukey(c) if squared <= c * c => {
                let rest = 1.0 - squared / (c * c);
                (c * c * (1.0 - rest * rest * rest) / 3.0, rest * rest)
            }
            Self::Tukey(c) => (c * c / 3.0, 0.0),
        }
    }

    /// Reweights an expansion.
    pub(crate) fn apply(self, out: &mut Expansion) {
        let squared: f64 = out.residual.iter().map(|r| r * r).sum();
        let (loss, weight) = self.loss_and_weight(squared);
        out.loss = 0.5 * loss;
        let root = weight.sqrt();
        out.residual.iter_mut().for_each(|r| *r *= root);
        if out.derivative {
            out.jacobian.iter_mut().for_each(|entry| *entry *= root);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_are_the_losses_derivatives() {
        let kernels =
            [Kernel::Huber(1.3), Kernel::Cauchy(2.0), Kernel::GemanMcclure(1.5), Kernel::Tukey(4.6)];
        for kernel in kernels {
            for squared in [1e-3, 0.7, 1.6, 3.0, 20.0, 30.0] {
                let h = 1e-6 * squared;
                let (above, below) =
                    (kernel.loss_and_weight(squared + h).0, kernel.loss_and_weight(squared - h).0);
                let (loss, weight) = kernel.loss_and_weight(squared);
                assert!((weight - (above - below) / (2.0 * h)).abs() < 1e-7, "{kernel:?} at {squared}");
                assert!(loss <= squared * (1.0 + 1e-12) && (0.0..=1.0).contains(&weight));
            }
        }
    }
}
