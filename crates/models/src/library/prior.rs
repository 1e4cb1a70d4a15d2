//! A prior on a variable.

use crate::{Noise, Real, Residual};
use sumprod_graph::Space;

/// x ~ N(mean, R), or Student-t, angles wrapped: r(x) = x - mean.
#[derive(Clone, Debug)]
pub struct Prior {
    mean: Vec<f64>,
    angles: Vec<usize>,
    noise: Noise,
    dimensions: [usize; 1],
}

impl Prior {
    /// A prior on a variable of this space.
    pub fn new(space: &Space, mean: &[f64], noise: Noise) -> Self {
        let angles = (0..mean.len()).filter(|&index| space.is_angle(index)).collect();
        Self { mean: mean.to_vec(), angles, noise, dimensions: [mean.len()] }
    }
}

impl Residual for Prior {
    fn dimensions(&self) -> &[usize] {
        &self.dimensions
    }

    fn noise(&self) -> &Noise {
        &self.noise
    }

    fn residual<T: Real>(&self, x: &[&[T]], out: &mut [T]) {
        for ((out, x), mean) in out.iter_mut().zip(x[0]).zip(&self.mean) {
            *out = *x - *mean;
        }
    }

    fn angles(&self) -> &[usize] {
        &self.angles
    }
}
