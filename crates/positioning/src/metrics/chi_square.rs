//! The chi-square law, which the NEES of a consistent estimator follows.

use statrs::distribution::{ChiSquared, ContinuousCDF};

/// Value that a chi-square variable of `dof` degrees of freedom stays below with `probability`.
///
/// `None` unless 0 < probability < 1 and `dof` is positive and finite.
pub fn quantile(probability: f64, dof: f64) -> Option<f64> {
    if !(probability > 0.0 && probability < 1.0) {
        return None;
    }
    law(dof).map(|law| law.inverse_cdf(probability))
}

/// Probability that a chi-square variable of `dof` degrees of freedom is at most `value`; `None` as for
/// [`quantile`].
pub fn cdf(value: f64, dof: f64) -> Option<f64> {
    law(dof).map(|law| law.cdf(value))
}

/// Band that the mean of `count` independent NEES values of `dof` degrees of freedom keeps to with probability 95 %
/// if the estimator is consistent: quantiles 2.5 % and 97.5 % of chi-square(`dof`·`count`), over `count`.
pub fn mean_band95(dof: usize, count: usize) -> Option<[f64; 2]> {
    let total = (dof * count) as f64;
    Some([quantile(0.025, total)? / count as f64, quantile(0.975, total)? / count as f64])
}

fn law(dof: f64) -> Option<ChiSquared> {
    if dof.is_finite() { ChiSquared::new(dof).ok() } else { None }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Published tables, and -2 ln(1 - p) for two degrees of freedom.
    #[test]
    fn quantiles_are_those_of_the_tables() {
        for (probability, dof, expected) in [
            (0.95, 1.0, 3.841_458_820_694_124),
            (0.95, 2.0, -2.0 * 0.05_f64.ln()),
            (0.5, 4.0, 3.356_693_980_033_321),
            (0.975, 200.0, 241.057_895_501_689_6),
            (0.025, 200.0, 162.727_982_500_190_1),
        ] {
            let found = quantile(probability, dof).unwrap();
            assert!((found - expected).abs() < 1e-5 * expected, "{probability} {dof}: {found} {expected}");
        }
    }

    #[test]
    fn quantile_undoes_cdf() {
        for dof in [1.0, 2.0, 3.0, 60.0, 5000.0] {
            for probability in [0.025, 0.5, 0.975] {
                let back = cdf(quantile(probability, dof).unwrap(), dof).unwrap();
                assert!((back - probability).abs() < 1e-6, "{dof} {probability} {back}");
            }
        }
    }

    #[test]
    fn meaningless_arguments_give_none() {
        assert_eq!(quantile(1.0, 2.0), None);
        assert_eq!(quantile(f64::NAN, 2.0), None);
        assert_eq!(quantile(0.5, 0.0), None);
        assert_eq!(cdf(1.0, f64::INFINITY), None);
        assert_eq!(mean_band95(2, 0), None);
    }
}
