//! Densities of a second track about a displaced first one.
//!
//! Student's t is a Gaussian whose precision is scaled by g ~ Gamma(ν/2, ν/2); u = (ν + D)/(ν + δ) is the posterior mean
//! of g, with δ the squared distance in deviations and D the number of coordinates. A Gaussian has u = 1.

use statrs::function::gamma::{digamma, ln_gamma};

use super::error::AssociationError;

/// Fewest and most degrees of freedom that are estimated: below 2 the tails swallow everything, above 100 no data can
/// tell them from a Gaussian's.
const RANGE: [f64; 2] = [2.0, 100.0];

/// Degrees of freedom beyond which nothing but rounding tells the tails from a Gaussian's.
const MOST: f64 = 1e8;

/// Tails of the mixture's components.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Tails {
    /// Gaussian.
    Gaussian,
    /// Student's t with these degrees of freedom ν.
    Student(f64),
    /// Student's t that starts with these degrees of freedom, estimated and clamped to [2, 100].
    Estimated(f64),
}

impl Tails {
    pub(super) fn validate(self) -> Result<(), AssociationError> {
        match self {
            Self::Gaussian => Ok(()),
            Self::Student(nu) | Self::Estimated(nu) if nu > 0.0 && nu <= MOST => Ok(()),
            Self::Student(nu) | Self::Estimated(nu) => {
                let problem =
                    format!("is {nu}; it must be positive, and beyond {MOST:e} the tails are Gaussian");
                Err(AssociationError::parameter("degrees_of_freedom", problem))
            }
        }
    }

    /// The degrees of freedom; `None` for a Gaussian.
    pub(super) fn degrees(self) -> Option<f64> {
        match self {
            Self::Gaussian => None,
            Self::Student(nu) | Self::Estimated(nu) => Some(nu),
        }
    }

    /// The tails with the degrees of freedom of largest expected likelihood, where they are estimated: the root of
    /// −ψ(ν/2) + ln(ν/2) + 1 + s + ψ((ν₀+D)/2) − ln((ν₀+D)/2), s the mean of ln u − u, ν₀ the old ones.
    pub(super) fn reestimated(self, mean_log_scale: f64, width: usize) -> Self {
        let Self::Estimated(old) = self else { return self };
        let half = 0.5 * (old + width as f64);
        let known = 1.0 + mean_log_scale + digamma(half) - half.ln();
        let slope = |nu: f64| (0.5 * nu).ln() - digamma(0.5 * nu) + known;
        let [mut low, mut high] = RANGE;
        if slope(low) <= 0.0 {
            return Self::Estimated(low);
        }
        if slope(high) > 0.0 {
            return Self::Estimated(high);
        }
        while high - low > 1e-9 * low {
            let middle = 0.5 * (low + high);
            *(if slope(middle) > 0.0 { &mut low } else { &mut high }) = middle;
        }
        Self::Estimated(0.5 * (low + high))
    }

    /// The density with this variance of each of D coordinates.
    pub(super) fn density(self, width: usize, variance: f64) -> Density {
        let d = width as f64;
        let spread = -0.5 * d * variance.ln();
        match self.degrees() {
            None => Density {
                constant: spread - 0.5 * d * std::f64::consts::TAU.ln(),
                precision: 1.0 / variance,
                degrees: None,
                exponent: 0.0,
            },
            Some(nu) => Density {
                constant: spread + ln_gamma(0.5 * (nu + d))
                    - ln_gamma(0.5 * nu)
                    - 0.5 * d * (nu * std::f64::consts::PI).ln(),
                precision: 1.0 / variance,
                degrees: Some(nu),
                exponent: 0.5 * (nu + d),
            },
        }
    }
}

/// A density of D coordinates with equal variances.
#[derive(Clone, Copy, Debug)]
pub(super) struct Density {
    constant: f64,
    precision: f64,
    degrees: Option<f64>,
    exponent: f64,
}

impl Density {
    /// Logarithm at a squared distance (m²).
    #[inline]
    pub fn log(&self, squared: f64) -> f64 {
        let delta = squared * self.precision;
        match self.degrees {
            None => self.constant - 0.5 * delta,
            Some(nu) => self.constant - self.exponent * (delta / nu).ln_1p(),
        }
    }

    /// Posterior mean u of the scale.
    #[inline]
    pub fn scale(&self, squared: f64) -> f64 {
        match self.degrees {
            None => 1.0,
            Some(nu) => 2.0 * self.exponent / (nu + squared * self.precision),
        }
    }

    /// −du/dδ, as a share of u.
    #[inline]
    pub fn scale_slope(&self, squared: f64) -> f64 {
        self.degrees.map_or(0.0, |nu| 1.0 / (nu + squared * self.precision))
    }
}
