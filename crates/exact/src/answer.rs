//! An answer of any method, and how far it is from the exact one.

use crate::Values;
use sumprod_models::Manifold;

/// Values of all variables, and their covariances in local coordinates (row-major) where the method has them.
#[derive(Clone, Debug)]
pub struct Answer {
    /// The values.
    pub values: Values,
    /// One covariance per variable, in the graph's order.
    pub covariances: Option<Vec<Vec<f64>>>,
}

/// How far an answer is from the exact one.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Deviation {
    /// The largest difference of a coordinate, in exact standard deviations.
    pub mean_sd: f64,
    /// The largest difference of an entry of a covariance, relative to the largest entry of the exact one.
    pub covariance_relative: Option<f64>,
}

impl Answer {
    /// How far this answer is from an exact one of the same graph; none where that has no covariances.
    pub fn deviation_from(&self, exact: &Self) -> Option<Deviation> {
        let reference = exact.covariances.as_ref()?;
        let mut out = Deviation { mean_sd: 0.0, covariance_relative: self.covariances.as_ref().map(|_| 0.0) };
        for (number, covariance) in reference.iter().enumerate() {
            let space = exact.values.space(number);
            let d = space.degrees_of_freedom();
            let mut step = vec![0.0; d];
            space.local(exact.values.at(number), self.values.at(number), &mut step);
            for (k, x) in step.iter().enumerate() {
                let sd = covariance[k * d + k].sqrt();
                if sd > 0.0 {
                    out.mean_sd = out.mean_sd.max(x.abs() / sd);
                }
            }
            let own = self.covariances.as_ref().and_then(|all| all.get(number));
            if let (Some(own), Some(most)) = (own, &mut out.covariance_relative) {
                let scale = covariance.iter().fold(f64::MIN_POSITIVE, |scale, x| scale.max(x.abs()));
                *most =
                    own.iter().zip(covariance).fold(*most, |most, (a, b)| most.max((a - b).abs() / scale));
            }
        }
        Some(out)
    }
}
