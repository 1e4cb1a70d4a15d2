//! A measurement's residuals and log densities at the particles of a block.

use super::{BLOCK, Cloud, values};
use crate::packed::{Packed, WIDTH, looked};
use crate::{Noise, Residual};
use sumprod_graph::{MessageError, wrap_angle};
use sumprod_messages::vector;

/// Residuals at a block's particles: component by component, [`BLOCK`] values each.
pub type Residuals = Vec<f64>;

/// Writes the residual, of one variable, at a block's first `count` particles; angles wrapped.
fn residuals<R: Residual>(residual: &R, block: &[f64], count: usize, out: &mut Residuals) {
    let m = residual.noise().dimension();
    out.resize(m * BLOCK, 0.0);
    looked();
    vector::widest(Evaluate { residual, block, count, out });
    if looked() {
        let d = block.len() / BLOCK;
        let (mut x, mut value) = (values(d, 0.0), values(m, 0.0));
        for i in 0..count {
            x.iter_mut().enumerate().for_each(|(k, x)| *x = block[k * BLOCK + i]);
            residual.residual(&[&x], &mut value);
            value.iter().enumerate().for_each(|(k, value)| out[k * BLOCK + i] = *value);
        }
    }
    for &angle in residual.angles() {
        out[angle * BLOCK..][..count].iter_mut().for_each(|x| *x = wrap_angle(*x));
    }
}

struct Evaluate<'a, R> {
    residual: &'a R,
    block: &'a [f64],
    count: usize,
    out: &'a mut [f64],
}

impl<R: Residual> pulp::NullaryFnOnce for Evaluate<'_, R> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let d = self.block.len() / BLOCK;
        let m = self.residual.noise().dimension();
        let (mut x, mut value) = (values(d, Packed::from(0.0)), values(m, Packed::from(0.0)));
        for first in (0..self.count).step_by(WIDTH) {
            for (k, x) in x.iter_mut().enumerate() {
                x.0.copy_from_slice(&self.block[k * BLOCK + first..][..WIDTH]);
            }
            self.residual.residual(&[&x], &mut value);
            for (k, value) in value.iter().enumerate() {
                self.out[k * BLOCK + first..][..WIDTH].copy_from_slice(&value.0);
            }
        }
    }
}

/// Adds the noise's log density of each residual to `log_values`; returns the least squared length r'R⁻¹r.
fn add_log_densities(noise: &Noise, residuals: &[f64], log_values: &mut [f64]) -> f64 {
    vector::widest(LogDensities { noise, residuals, log_values })
}

struct LogDensities<'a> {
    noise: &'a Noise,
    residuals: &'a [f64],
    log_values: &'a mut [f64],
}

impl pulp::NullaryFnOnce for LogDensities<'_> {
    type Output = f64;

    #[inline(always)]
    fn call(self) -> f64 {
        let m = self.noise.dimension();
        let mut squared = [0.0; BLOCK];
        let count = self.log_values.len();
        let squared = &mut squared[..count];
        for row in 0..m {
            for column in 0..m {
                let weight = self.noise.information()[row * m + column];
                if weight != 0.0 {
                    let rows = &self.residuals[row * BLOCK..][..count];
                    let columns = &self.residuals[column * BLOCK..][..count];
                    for ((squared, a), b) in squared.iter_mut().zip(rows).zip(columns) {
                        *squared += weight * a * b;
                    }
                }
            }
        }
        let peak = self.noise.log_peak();
        match self.noise.degrees_of_freedom() {
            None => {
                for (log, squared) in self.log_values.iter_mut().zip(&*squared) {
                    *log += peak - 0.5 * squared;
                }
            }
            Some(nu) => {
                let half = 0.5 * (nu + m as f64);
                for (log, squared) in self.log_values.iter_mut().zip(&*squared) {
                    // Of an argument of one or more, so that the absolute error is all there is.
                    *log += peak - half * vector::ln(1.0 + squared / nu);
                }
            }
        }
        // Eight least ones at a time: one would be a chain of comparisons.
        let mut least = [f64::INFINITY; WIDTH];
        let (chunks, rest) = squared.as_chunks::<WIDTH>();
        for chunk in chunks {
            for (least, s) in least.iter_mut().zip(chunk) {
                *least = if *s < *least { *s } else { *least };
            }
        }
        for (least, s) in least.iter_mut().zip(rest) {
            *least = if *s < *least { *s } else { *least };
        }
        least.iter().copied().fold(f64::INFINITY, f64::min)
    }
}

/// What is known of a state by a measurement: a log likelihood at the particles of a block.
///
/// Every [`Residual`] of one variable is one, and so is a [`Cluster`](crate::Cluster), and a closure in a
/// [`LogLikelihood`].
pub trait Likelihood: Sync {
    /// The state's dimension, where only one will do.
    ///
    /// # Errors
    ///
    /// Where this is no likelihood of a single variable.
    fn dimension(&self) -> Result<Option<usize>, MessageError>;

    /// Number of components of the residual; zero where there is none.
    fn components(&self) -> usize;

    /// Adds the log likelihood at a block's first particles, as many as `log_values` has places, and returns the
    /// least squared length of a residual; infinity where there are no residuals. Where there are, they replace what
    /// `residuals` holds.
    fn add_log(&self, block: &[f64], log_values: &mut [f64], residuals: &mut Residuals) -> f64;
}

impl<R: Residual> Likelihood for R {
    fn dimension(&self) -> Result<Option<usize>, MessageError> {
        match self.dimensions() {
            [dimension] => Ok(Some(*dimension)),
            ports => Err(MessageError::Dimension {
                what: "the list of a measurement's variables",
                found: ports.len(),
                expected: 1,
            }),
        }
    }

    fn components(&self) -> usize {
        self.noise().dimension()
    }

    #[inline]
    fn add_log(&self, block: &[f64], log_values: &mut [f64], out: &mut Residuals) -> f64 {
        residuals(self, block, log_values.len(), out);
        add_log_densities(self.noise(), out, log_values)
    }
}

/// Several at once: their product, in one pass over the particles.
impl<L: Likelihood> Likelihood for Vec<L> {
    fn dimension(&self) -> Result<Option<usize>, MessageError> {
        let mut known = None;
        for own in self {
            known = own.dimension()?.or(known);
        }
        Ok(known)
    }

    fn components(&self) -> usize {
        self.iter().map(Likelihood::components).sum()
    }

    fn add_log(&self, block: &[f64], log_values: &mut [f64], residuals: &mut Residuals) -> f64 {
        let (mut own, mut nearest) = (Residuals::new(), 0.0_f64);
        residuals.clear();
        for likelihood in self {
            // Each must be explained by some particle.
            nearest = nearest.max(likelihood.add_log(block, log_values, &mut own));
            residuals.extend_from_slice(&own);
        }
        nearest
    }
}

/// A log likelihood by a function of the state: `-∞` where the measurement is impossible.
#[derive(Clone, Copy, Debug)]
pub struct LogLikelihood<F>(pub F);

impl<F: Fn(&[f64]) -> f64 + Sync> Likelihood for LogLikelihood<F> {
    fn dimension(&self) -> Result<Option<usize>, MessageError> {
        Ok(None)
    }

    fn components(&self) -> usize {
        0
    }

    fn add_log(&self, block: &[f64], log_values: &mut [f64], _residuals: &mut Residuals) -> f64 {
        each_point(block, log_values, |point| (self.0)(point));
        f64::INFINITY
    }
}

/// Writes the log likelihood at each row of `points` (row-major, as many rows as `log_values` has places), and returns
/// the least squared length of a residual.
pub fn log_values<L: Likelihood + ?Sized>(likelihood: &L, points: &[f64], log_values: &mut [f64]) -> f64 {
    let cloud = Cloud::from_points(points.len() / log_values.len().max(1), points);
    let (mut residuals, mut nearest) = (Residuals::new(), f64::INFINITY);
    log_values.fill(0.0);
    for (block, log_values) in cloud.blocks().zip(log_values.chunks_mut(BLOCK)) {
        nearest = nearest.min(likelihood.add_log(block, log_values, &mut residuals));
    }
    nearest
}

/// Adds a function of the point to each log value.
pub(crate) fn each_point(block: &[f64], log_values: &mut [f64], f: impl Fn(&[f64]) -> f64) {
    let mut point = values(block.len() / BLOCK, 0.0);
    for (i, log_value) in log_values.iter_mut().enumerate() {
        point.iter_mut().enumerate().for_each(|(k, x)| *x = block[k * BLOCK + i]);
        *log_value += f(&point);
    }
}
