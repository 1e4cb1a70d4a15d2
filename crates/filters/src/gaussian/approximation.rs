//! How a Gaussian filter treats what is not linear.

/// How motions and measurements that are not linear are approximated; all are exact for those that are.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Approximation {
    /// First-order expansion at the mean: the Kalman filter of linear models, the extended Kalman filter of others.
    #[default]
    FirstOrder,
    /// First-order expansion at the posterior mode, found by at most so many Gauss-Newton steps: the iterated
    /// extended Kalman filter (Bell and Cathey 1993). Motions as by [`Approximation::FirstOrder`].
    Iterated(u32),
}
