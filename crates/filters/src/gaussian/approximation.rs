//! How a Gaussian filter treats what is not linear.

use sumprod_models::moments::SigmaPoints;

/// How motions and measurements that are not linear are approximated; all are exact for those that are.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Approximation {
    /// First-order expansion at the mean: the Kalman filter of linear models, the extended Kalman filter of others.
    #[default]
    FirstOrder,
    /// First-order expansion at the posterior mode, found by at most so many Gauss-Newton steps: the iterated
    /// extended Kalman filter (Bell and Cathey 1993). Motions as by [`Approximation::FirstOrder`].
    Iterated(u32),
    /// The scaled unscented transform with these α, β, κ: 2D + 1 points (Julier and Uhlmann 2004). Without a reason
    /// for others take (1, 0, 3 - D), or (1, 2, 0).
    Unscented {
        /// Scale of the points' distance.
        alpha: f64,
        /// Part of the mean's point in covariances; 2 for a Gaussian and small α.
        beta: f64,
        /// Second scale: α² (D + κ) is the squared distance of the points, in variances.
        kappa: f64,
    },
    /// The cubature rule: 2D points of equal weight (Arasaratnam and Haykin 2009).
    Cubature,
}

impl Approximation {
    /// The sigma points, where there are any.
    pub(crate) fn points(self, dimension: usize) -> Option<SigmaPoints> {
        match self {
            Self::FirstOrder | Self::Iterated(_) => None,
            Self::Unscented { alpha, beta, kappa } => {
                Some(SigmaPoints::unscented(dimension, alpha, beta, kappa))
            }
            Self::Cubature => Some(SigmaPoints::cubature(dimension)),
        }
    }
}
