//! One target that moves at nearly constant velocity: its trajectory, and the bound of whoever follows it.
//!
//! X_k = F X_{k-1} + G u_k, u ~ N(0, Q I₂), state [x, vx, y, vy], per axis F = [1 T; 0 1] and G = [T²/2; T].

use nalgebra::{Matrix4, Vector4};
use rand_distr::{Distribution, StandardNormal};
use sumprod_graph::FastStream;

/// The states from time zero on, `steps` + 1 of them: `interval` T (s), `variance` Q of the acceleration (m²/s⁴).
pub(crate) fn trajectory(
    start: [f64; 4],
    interval: f64,
    variance: f64,
    steps: u32,
    random: &mut FastStream,
) -> Vec<[f64; 4]> {
    let (t, spread) = (interval, variance.sqrt());
    let mut state = start;
    let mut truth = vec![state];
    for _ in 0..steps {
        for axis in state.chunks_exact_mut(2) {
            let acceleration = spread * normal(random);
            axis[0] += t * axis[1] + 0.5 * t * t * acceleration;
            axis[1] += t * acceleration;
        }
        truth.push(state);
    }
    truth
}

/// A standard normal draw.
pub(crate) fn normal(random: &mut FastStream) -> f64 {
    StandardNormal.sample(random)
}

/// The posterior Cramér–Rao bound of the state, step by step.
///
/// P ← F P F' + G Q G', then P⁻¹ ← P⁻¹ + Σ h h'/R over the gradients h of all measurements at the true state: the
/// covariance of the extended Kalman filter at the truth. Written in covariances, so that the process noise may be
/// singular. Source: Tichavský, Muravchik, Nehorai, "Posterior Cramér-Rao bounds for discrete-time nonlinear
/// filtering" (1998).
pub(crate) struct Recursion {
    f: Matrix4<f64>,
    noise: Matrix4<f64>,
    covariance: Matrix4<f64>,
}

impl Recursion {
    /// Starts from independent components of these variances.
    pub(crate) fn new(start_variances: [f64; 4], interval: f64, variance: f64) -> Self {
        let t = interval;
        let (mut f, mut noise) = (Matrix4::identity(), Matrix4::zeros());
        for axis in [0, 2] {
            f[(axis, axis + 1)] = t;
            let g = [0.5 * t * t, t];
            for row in 0..2 {
                for column in 0..2 {
                    noise[(axis + row, axis + column)] = variance * g[row] * g[column];
                }
            }
        }
        Self { f, noise, covariance: Matrix4::from_diagonal(&Vector4::from(start_variances)) }
    }

    /// One step of the motion.
    pub(crate) fn predict(&mut self) {
        self.covariance = self.f * self.covariance * self.f.transpose() + self.noise;
    }

    /// One measured number of this gradient and noise variance.
    pub(crate) fn measure(&mut self, gradient: &Vector4<f64>, variance: f64) {
        let gain = self.covariance * gradient;
        let total = gradient.dot(&gain) + variance;
        self.covariance -= gain * gain.transpose() / total;
    }

    /// A measured distance from `state` to `place`; at the place itself it has no gradient and says nothing to first
    /// order.
    pub(crate) fn range(&mut self, state: &[f64; 4], place: [f64; 2], variance: f64) {
        if let Some(gradient) = range_gradient(state, place) {
            self.measure(&gradient, variance);
        }
    }

    /// Trace of the position block (m²).
    pub(crate) fn position_variance(&self) -> f64 {
        self.covariance[(0, 0)] + self.covariance[(2, 2)]
    }
}

/// Gradient of the distance to a place, where it has one.
pub(crate) fn range_gradient(state: &[f64; 4], place: [f64; 2]) -> Option<Vector4<f64>> {
    let (dx, dy) = (state[0] - place[0], state[2] - place[1]);
    let distance = dx.hypot(dy);
    (distance > 0.0).then(|| Vector4::new(dx / distance, 0.0, dy / distance, 0.0))
}
