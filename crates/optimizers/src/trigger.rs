//! When to reselect: once the effective sample size has fallen.
//!
//! N_eff = (Σ wᵢ)² / Σ wᵢ², between 1 and the number of particles; source: Kong, Liu, Wong, "Sequential imputations
//! and Bayesian missing data problems" (1994).

use crate::error::OptimizerError;

/// Effective sample size (Σ wᵢ)² / Σ wᵢ² of weights of any scale; zero where no weight is positive.
pub fn effective_sample_size(weights: &[f64]) -> f64 {
    let largest = weights.iter().copied().fold(0.0, f64::max);
    if largest == 0.0 {
        return 0.0;
    }
    let (sum, squares) = weights
        .iter()
        .map(|weight| weight / largest)
        .fold((0.0, 0.0), |(sum, squares), w| (sum + w, squares + w * w));
    sum * sum / squares
}

/// Asks for reselection where the effective sample size is at or below a share of the number of particles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trigger {
    share: f64,
}

impl Trigger {
    /// Reselect at every step.
    pub const ALWAYS: Self = Self { share: 1.0 };

    /// Never reselect.
    pub const NEVER: Self = Self { share: 0.0 };

    /// Reselect where N_eff is at or below `share` (0 to 1) of the number of particles.
    ///
    /// # Errors
    ///
    /// Where `share` is not between 0 and 1.
    pub fn below(share: f64) -> Result<Self, OptimizerError> {
        if (0.0..=1.0).contains(&share) {
            return Ok(Self { share });
        }
        Err(OptimizerError::Share { value: share })
    }

    /// Whether particles of this number and effective sample size are to be reselected.
    pub fn fires(self, effective_sample_size: f64, count: usize) -> bool {
        // Equal weights may have an effective sample size above their number by rounding.
        self.share == 1.0 || effective_sample_size <= self.share * count as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_effective_sample_size_counts_equal_weights_and_knows_no_scale() {
        assert_eq!(effective_sample_size(&[0.2; 5]), 5.0);
        assert_eq!(effective_sample_size(&[3.0, 0.0, 0.0]), 1.0);
        assert_eq!(effective_sample_size(&[0.0; 3]), 0.0);
        let weights = [0.1, 0.7, 0.4];
        let exact = 1.2 * 1.2 / (0.01 + 0.49 + 0.16);
        for scale in [1.0, 1e-320, 1e300] {
            let scaled = weights.map(|weight| weight * scale);
            let tolerance = if scale < 1e-300 { 1e-2 } else { 1e-12 };
            assert!((effective_sample_size(&scaled) - exact).abs() < tolerance * exact);
        }
    }

    #[test]
    fn the_trigger_fires_at_its_share() {
        let half = Trigger::below(0.5).unwrap();
        assert!(half.fires(50.0, 100) && half.fires(3.0, 100));
        assert!(!half.fires(50.1, 100));
        assert!(Trigger::ALWAYS.fires(100.0 + 1e-9, 100));
        assert!(!Trigger::below(0.0).unwrap().fires(1.0, 100));
        for share in [-0.1, 1.1, f64::NAN] {
            assert!(Trigger::below(share).unwrap_err().to_string().contains("between 0 and 1"));
        }
    }
}
