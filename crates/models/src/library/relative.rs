//! Relative positions: between two variables, and to an anchor whose own position may be uncertain.

use crate::{Noise, Real, Residual};

/// A measured offset p₁ - p₀ in the world's frame: r = p₁ - p₀ - z.
#[derive(Clone, Debug)]
pub struct RelativePosition {
    measured: Vec<f64>,
    dimensions: [usize; 2],
    positions: [Vec<usize>; 2],
    noise: Noise,
}

impl RelativePosition {
    /// An offset (m) between two variables of these dimensions, whose positions are at these coordinates.
    pub fn new(measured: &[f64], dimensions: [usize; 2], positions: [&[usize]; 2], noise: Noise) -> Self {
        Self { measured: measured.to_vec(), dimensions, positions: positions.map(<[usize]>::to_vec), noise }
    }
}

impl Residual for RelativePosition {
    fn dimensions(&self) -> &[usize] {
        &self.dimensions
    }

    fn noise(&self) -> &Noise {
        &self.noise
    }

    fn residual<T: Real>(&self, x: &[&[T]], out: &mut [T]) {
        let [from, to] = &self.positions;
        for (k, out) in out.iter_mut().enumerate() {
            *out = x[1][to[k]] - x[0][from[k]] - self.measured[k];
        }
    }
}

/// A measured offset p - a from an anchor at a known position: r = p - a - z. With a = 0 it is a position fix.
#[derive(Clone, Debug)]
pub struct AnchorOffset {
    target: Vec<f64>,
    dimensions: [usize; 1],
    position: Vec<usize>,
    noise: Noise,
}

impl AnchorOffset {
    /// An offset (m) of a variable of this dimension, its position at these coordinates, from an anchor (m). An
    /// anchor's own uncertainty adds to the noise.
    pub fn new(measured: &[f64], anchor: &[f64], dimension: usize, position: &[usize], noise: Noise) -> Self {
        let target = measured.iter().zip(anchor).map(|(z, a)| a + z).collect();
        Self { target, dimensions: [dimension], position: position.to_vec(), noise }
    }
}

impl Residual for AnchorOffset {
    fn dimensions(&self) -> &[usize] {
        &self.dimensions
    }

    fn noise(&self) -> &Noise {
        &self.noise
    }

    fn residual<T: Real>(&self, x: &[&[T]], out: &mut [T]) {
        for ((out, &coordinate), target) in out.iter_mut().zip(&self.position).zip(&self.target) {
            *out = x[0][coordinate] - *target;
        }
    }
}
