//! Ranges: between two points, to an anchor, and with a sensor's scale and offset as a variable.
//!
//! Variables may be larger than a position (a state, a pose): a range reads the coordinates it is told to.

use crate::{Noise, PortSampler, Real, Residual};
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use std::f64::consts::TAU;
use sumprod_graph::{FastStream, Port};

/// Shortest distance whose direction is taken as known (m): below it a range has no gradient.
pub(super) const TOUCHING: f64 = 1e-9;

/// The length of the vector (x, y), for residuals of points in the plane: its derivatives are finite everywhere.
pub fn distance<T: Real>(x: T, y: T) -> T {
    let squared = x * x + y * y;
    // At coincident points the derivative of the root does not exist; the direction is left open.
    if squared.re() < TOUCHING * TOUCHING { squared } else { squared.sqrt() }
}

/// The measured distance z between two positions: r = |p₁ - p₀| - z.
#[derive(Clone, Debug)]
pub struct Range {
    measured: f64,
    dimensions: [usize; 2],
    positions: [[usize; 2]; 2],
    noise: Noise,
}

impl Range {
    /// A range (m) between two variables of these dimensions, whose positions are at these coordinates.
    pub fn new(measured: f64, dimensions: [usize; 2], positions: [[usize; 2]; 2], noise: Noise) -> Self {
        Self { measured, dimensions, positions, noise }
    }
}

impl Residual for Range {
    fn dimensions(&self) -> &[usize] {
        &self.dimensions
    }

    fn noise(&self) -> &Noise {
        &self.noise
    }

    #[inline]
    fn residual<T: Real>(&self, x: &[&[T]], out: &mut [T]) {
        let [a, b] = self.positions;
        out[0] = distance(x[1][b[0]] - x[0][a[0]], x[1][b[1]] - x[0][a[1]]) - self.measured;
    }
}

/// The measured distance z to an anchor at a known position: r = |p - a| - z.
#[derive(Clone, Debug)]
pub struct AnchorRange {
    measured: f64,
    anchor: [f64; 2],
    dimensions: [usize; 1],
    position: [usize; 2],
    noise: Noise,
}

impl AnchorRange {
    /// A range (m) from a variable of this dimension, its position at these coordinates, to an anchor (m).
    pub fn new(
        measured: f64,
        anchor: [f64; 2],
        dimension: usize,
        position: [usize; 2],
        noise: Noise,
    ) -> Self {
        Self { measured, anchor, dimensions: [dimension], position, noise }
    }
}

impl Residual for AnchorRange {
    fn dimensions(&self) -> &[usize] {
        &self.dimensions
    }

    fn noise(&self) -> &Noise {
        &self.noise
    }

    #[inline]
    fn residual<T: Real>(&self, x: &[&[T]], out: &mut [T]) {
        let [east, north] = self.position;
        out[0] = distance(x[0][east] - self.anchor[0], x[0][north] - self.anchor[1]) - self.measured;
    }

    fn sampler(&self, _port: Port) -> Option<&dyn PortSampler> {
        // A ring determines a position alone.
        (self.dimensions[0] == 2).then_some(self)
    }
}

impl PortSampler for AnchorRange {
    /// A point of the ring: uniform angle, radius z + v. The plane density of such points falls as one over the
    /// radius, which matters only where the noise is not small against the range.
    fn sample(&self, _others: &[&[f64]], out: &mut [f64], random: &mut FastStream) {
        let angle = TAU * random.random::<f64>();
        let error: f64 = StandardNormal.sample(random);
        let radius = (self.measured + self.noise.covariance()[0].sqrt() * error).abs();
        out[self.position[0]] = self.anchor[0] + radius * angle.cos();
        out[self.position[1]] = self.anchor[1] + radius * angle.sin();
    }
}

/// A range to an anchor by a sensor with scale and offset: r = (1 + s) |p - a| + c - z, where port 0 holds the
/// position and port 1 the calibration [s, c] (dimensionless, m).
#[derive(Clone, Debug)]
pub struct CalibratedRange {
    measured: f64,
    anchor: [f64; 2],
    dimensions: [usize; 2],
    position: [usize; 2],
    noise: Noise,
}

impl CalibratedRange {
    /// A range (m) from a variable of this dimension, its position at these coordinates, to an anchor (m).
    pub fn new(
        measured: f64,
        anchor: [f64; 2],
        dimension: usize,
        position: [usize; 2],
        noise: Noise,
    ) -> Self {
        Self { measured, anchor, dimensions: [dimension, 2], position, noise }
    }
}

impl Residual for CalibratedRange {
    fn dimensions(&self) -> &[usize] {
        &self.dimensions
    }

    fn noise(&self) -> &Noise {
        &self.noise
    }

    #[inline]
    fn residual<T: Real>(&self, x: &[&[T]], out: &mut [T]) {
        let [east, north] = self.position;
        let true_range = distance(x[0][east] - self.anchor[0], x[0][north] - self.anchor[1]);
        out[0] = true_range * (x[1][0] + 1.0) + x[1][1] - self.measured;
    }
}
