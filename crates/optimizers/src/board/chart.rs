//! Standard coordinates: offsets from the cloud's mean in its standard deviations, coordinate by coordinate.
//!
//! Distances between particles compare there, and so do the pulls of (6) and (7) on positions and on angles. An
//! angle is read on the branch nearest to the cloud's mean.

use sumprod_graph::{Coordinate, wrap_angle};
use sumprod_messages::Particles;

/// Deviations below this share of the mean's size are rounding.
const LEAST_DEVIATION: f64 = 1e-9;

pub(super) struct Chart {
    coordinates: Vec<Coordinate>,
    mean: Vec<f64>,
    deviations: Vec<f64>,
}

impl Chart {
    pub fn of(cloud: &Particles) -> Self {
        let moments = cloud.moments();
        let deviations = (0..moments.mean.len())
            .map(|k| moments.covariance_at(k, k).sqrt().max(LEAST_DEVIATION * moments.mean[k].abs().max(1.0)))
            .collect();
        Self { coordinates: cloud.coordinates().to_vec(), mean: moments.mean, deviations }
    }

    pub fn dimension(&self) -> usize {
        self.mean.len()
    }

    /// Logarithm of the volume of a unit of standard coordinates: what a log density gains by standardising.
    pub fn log_scale(&self) -> f64 {
        self.deviations.iter().map(|deviation| deviation.ln()).sum()
    }

    pub fn standardises(&self, points: &[f64]) -> Vec<f64> {
        let mut standard = points.to_vec();
        for row in standard.chunks_exact_mut(self.dimension()) {
            for (k, u) in row.iter_mut().enumerate() {
                let offset = *u - self.mean[k];
                let offset =
                    if self.coordinates[k] == Coordinate::Angle { wrap_angle(offset) } else { offset };
                *u = offset / self.deviations[k];
            }
        }
        standard
    }

    pub fn places(&self, standard: &[f64]) -> Vec<f64> {
        let mut points = standard.to_vec();
        for row in points.chunks_exact_mut(self.dimension()) {
            for (k, x) in row.iter_mut().enumerate() {
                let place = self.mean[k] + self.deviations[k] * *x;
                *x = if self.coordinates[k] == Coordinate::Angle { wrap_angle(place) } else { place };
            }
        }
        points
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sumprod_graph::Space;

    #[test]
    fn points_come_back_and_angles_lie_near_the_mean() {
        let points = vec![10.0, 1.0, 3.1, 12.0, 1.0, -3.1, 11.0, 1.0, 3.0];
        let cloud = Particles::equally_weighted(&Space::pose2(), points.clone()).unwrap();
        let chart = Chart::of(&cloud);
        let standard = chart.standardises(&points);
        let second_moment = [0, 3, 6].iter().map(|&k| standard[k] * standard[k]).sum::<f64>() / 3.0;
        assert!((second_moment - 1.0).abs() < 1e-12);
        assert!(standard.iter().all(|u| u.abs() < 2.0), "{standard:?}");
        for (back, x) in chart.places(&standard).iter().zip(&points) {
            assert!((back - x).abs() < 1e-12);
        }
    }
}
