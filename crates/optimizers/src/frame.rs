//! Standard coordinates of a cloud, and the kernel that smooths it.
//!
//! With mean m and covariance P = L L' of the cloud, x = m + L u. The regularised prior draws
//! x = m + a (cᵢ - m) + h L u, u ~ N(0, I), around a particle cᵢ; a = √(1 - h²) shrinks the centres so that mean and
//! covariance stay those of the cloud, and a Gaussian cloud stays Gaussian.
//!
//! h = (4 / (d + 2))^(1/(d+4)) n^(-1/(d+4)), n the cloud's effective sample size. Source: Silverman, "Density
//! estimation" (1986), section 4.3; the shrinkage: West, "Approximating posterior distributions by mixtures" (1993).

use rand_distr::{Distribution, StandardNormal};
use smallvec::SmallVec;
use sumprod_graph::{Coordinate, FastStream, wrap_angle};
use sumprod_messages::{Cholesky, Particles, floor_diagonal};

use crate::error::OptimizerError;

/// Mean and covariance factor of a cloud.
#[derive(Clone, Debug)]
pub struct Frame {
    coordinates: Vec<Coordinate>,
    mean: Vec<f64>,
    deviations: Vec<f64>,
    factor: Cholesky,
}

impl Frame {
    /// The frame of a cloud; a direction in which the cloud has no extent is given a negligible one.
    ///
    /// # Errors
    ///
    /// Where the covariance is not finite.
    pub fn of(cloud: &Particles) -> Result<Self, OptimizerError> {
        let mut moments = cloud.moments();
        let d = moments.mean.len();
        floor_diagonal(&mut moments.covariance, d);
        Ok(Self {
            coordinates: cloud.coordinates().to_vec(),
            deviations: (0..d).map(|k| moments.covariance_at(k, k).sqrt()).collect(),
            factor: Cholesky::new(&moments.covariance, d, "the particles' covariance")?,
            mean: moments.mean,
        })
    }

    /// Number of coordinates.
    pub fn dimension(&self) -> usize {
        self.mean.len()
    }

    /// Standard deviation of each coordinate.
    pub fn deviations(&self) -> &[f64] {
        &self.deviations
    }

    /// x = m + L u.
    pub fn place(&self, standard: &[f64], point: &mut [f64]) {
        self.factor.multiply_lower(standard, point);
        for (x, mean) in point.iter_mut().zip(&self.mean) {
            *x += mean;
        }
    }

    /// u = L⁻¹ (x - m), angular differences wrapped.
    pub fn standardise(&self, point: &[f64], standard: &mut [f64]) {
        for (k, u) in standard.iter_mut().enumerate() {
            *u = self.offset(k, point[k]);
        }
        self.factor.solve_lower(standard);
    }

    fn offset(&self, coordinate: usize, x: f64) -> f64 {
        let difference = x - self.mean[coordinate];
        match self.coordinates[coordinate] {
            Coordinate::Real => difference,
            Coordinate::Angle => wrap_angle(difference),
        }
    }
}

/// A shrunk Gaussian kernel with the shape of a cloud.
#[derive(Clone, Debug)]
pub struct CloudKernel {
    frame: Frame,
    width: f64,
    shrinkage: f64,
}

impl CloudKernel {
    /// The kernel of the cloud's own width h, times `scale`; at most 1, where nothing of the centres is left.
    ///
    /// # Errors
    ///
    /// As [`Frame::of`].
    pub fn of(cloud: &Particles, scale: f64) -> Result<Self, OptimizerError> {
        let d = cloud.dimension() as f64;
        let n = cloud.effective_sample_size().max(1.0);
        let width = (scale * (4.0 / ((d + 2.0) * n)).powf(1.0 / (d + 4.0))).min(1.0);
        Ok(Self { frame: Frame::of(cloud)?, width, shrinkage: (1.0 - width * width).sqrt() })
    }

    /// The width h.
    pub fn width(&self) -> f64 {
        self.width
    }

    /// A draw from the kernel around a particle.
    pub fn draw(&self, centre: &[f64], random: &mut FastStream, point: &mut [f64]) {
        let standard: SmallVec<[f64; 6]> = centre.iter().map(|_| StandardNormal.sample(random)).collect();
        self.place(centre, &standard, point);
    }

    /// m + a (c - m) + h L u.
    pub fn place(&self, centre: &[f64], standard: &[f64], point: &mut [f64]) {
        self.frame.factor.multiply_lower(standard, point);
        for (k, x) in point.iter_mut().enumerate() {
            *x = self.frame.mean[k] + self.shrinkage * self.frame.offset(k, centre[k]) + self.width * *x;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sumprod_graph::Space;

    fn cloud() -> Particles {
        let points = vec![1.0, 0.0, 3.1, 2.0, 1.0, -3.1, 4.0, 0.5, 3.0, 0.0, 3.0, 2.9];
        Particles::new(&Space::pose2(), points, vec![0.0, -0.5, 0.2, 0.1]).unwrap()
    }

    #[test]
    fn standard_coordinates_lead_back_to_the_point() {
        let (cloud, mut standard, mut back) = (cloud(), [0.0; 3], [0.0; 3]);
        let frame = Frame::of(&cloud).unwrap();
        for index in 0..cloud.len() {
            frame.standardise(cloud.point(index), &mut standard);
            frame.place(&standard, &mut back);
            for (k, (x, y)) in cloud.point(index).iter().zip(back).enumerate() {
                let difference = if k == 2 { wrap_angle(x - y) } else { x - y };
                assert!(difference.abs() < 1e-12);
            }
        }
    }

    #[test]
    fn the_shrunk_kernel_keeps_mean_and_covariance() {
        // E x = m + a Σ wᵢ (cᵢ - m) = m, and its covariance a² P + h² P = P, whatever h is: checked without draws.
        let cloud = Particles::equally_weighted(&Space::real(1), vec![0.0, 1.0, 5.0]).unwrap();
        for scale in [0.0, 0.3, 5.0] {
            let kernel = CloudKernel::of(&cloud, scale).unwrap();
            let (mut x, mut spread) = ([0.0], [0.0]);
            let (mut mean, mut square) = (0.0, 0.0);
            for centre in [0.0, 1.0, 5.0] {
                kernel.place(&[centre], &[0.0], &mut x);
                kernel.place(&[centre], &[1.0], &mut spread);
                mean += x[0] / 3.0;
                square += (x[0] * x[0] + (spread[0] - x[0]).powi(2)) / 3.0;
            }
            let moments = cloud.moments();
            assert!((mean - moments.mean[0]).abs() < 1e-12);
            assert!((square - mean * mean - moments.covariance[0]).abs() < 1e-8);
        }
    }

    #[test]
    fn a_cloud_without_extent_stays_where_it_is() {
        let cloud = Particles::equally_weighted(&Space::real(2), vec![3.0, 4.0]).unwrap();
        let mut point = [0.0; 2];
        CloudKernel::of(&cloud, 1.0).unwrap().place(&[3.0, 4.0], &[1.0, -1.0], &mut point);
        assert!((point[0] - 3.0).abs() < 1e-5 && (point[1] - 4.0).abs() < 1e-5);
    }
}
