//! The posterior Cramér–Rao bound of a run, at its own trajectory and nodes.
//!
//! P ← F P F' + G Q G', then P⁻¹ ← P⁻¹ + Σ h h'/R over the gradients h of all measurements at the true state. For
//! relative measurements, which are linear, no unbiased or Bayesian estimate does better on average; for ranges it is
//! the covariance of the extended Kalman filter at the truth. Written in covariances, so that the process noise may be
//! singular. Source: Tichavský, Muravchik, Nehorai, "Posterior Cramér-Rao bounds for discrete-time nonlinear
//! filtering" (1998).

use nalgebra::{Matrix4, Vector4};

use super::world::{Measured, World, WorldSettings};

/// Trace of the bound's position block (m²) at every scan, with the neighbours' data or without.
pub fn position_variances(settings: &WorldSettings, world: &World, neighbours: bool) -> Vec<f64> {
    let t = settings.interval;
    let (mut f, mut noise) = (Matrix4::identity(), Matrix4::zeros());
    for axis in [0, 2] {
        f[(axis, axis + 1)] = t;
        let g = [0.5 * t * t, t];
        for row in 0..2 {
            for column in 0..2 {
                noise[(axis + row, axis + column)] = settings.process_variance * g[row] * g[column];
            }
        }
    }
    let mut covariance = Matrix4::from_diagonal_element(settings.start_variance);
    let scans = world.truth[1..].iter().zip(&world.hearings);
    scans
        .map(|(state, heard)| {
            covariance = f * covariance * f.transpose() + noise;
            let axes = [Vector4::x(), Vector4::z()];
            let mut hear = |gradient: &Vector4<f64>| {
                let gain = covariance * gradient;
                let total = gradient.dot(&gain) + settings.measurement_variance;
                covariance -= gain * gain.transpose() / total;
            };
            axes.iter().for_each(&mut hear);
            for hearing in heard.iter().filter(|_| neighbours) {
                match hearing.measured {
                    Measured::Relative(_) => axes.iter().for_each(&mut hear),
                    Measured::Range(_) => {
                        let node = world.nodes[hearing.node];
                        let (dx, dy) = (state[0] - node[0], state[2] - node[1]);
                        let distance = dx.hypot(dy);
                        // At a node itself the distance has no gradient and says nothing to first order.
                        if distance > 0.0 {
                            hear(&Vector4::new(dx / distance, 0.0, dy / distance, 0.0));
                        }
                    }
                }
            }
            covariance[(0, 0)] + covariance[(2, 2)]
        })
        .collect()
}
