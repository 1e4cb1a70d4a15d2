//! Constant velocity in any number of axes, state [x, vx, y, vy, ...].

use super::checks::{finite, positive};
use crate::{Motion, ProcessNoise, Real};
use sumprod_graph::MessageError;

/// x' = x + v T, v' = v, with process noise in one of two forms.
#[derive(Clone, Debug)]
pub struct ConstantVelocity {
    axes: usize,
    interval: f64,
    noise: ProcessNoise,
}

impl ConstantVelocity {
    /// White acceleration of power spectral density q (m²/s³) in continuous time: per axis
    /// Q = q [T³/3, T²/2; T²/2, T] (Bar-Shalom, Li and Kirubarajan 2001, section 6.2.2).
    ///
    /// # Errors
    ///
    /// Where `density` or `interval` is not positive and finite.
    pub fn white_acceleration(axes: usize, interval: f64, density: f64) -> Result<Self, MessageError> {
        positive("the density of the acceleration", density)?;
        positive("the interval", interval)?;
        let t = interval;
        // Cholesky factor of [T³/3, T²/2; T²/2, T].
        let lower = [(t.powi(3) / 3.0).sqrt(), 0.0, 0.5 * (3.0 * t).sqrt(), 0.5 * t.sqrt()];
        Self::with_factor(axes, interval, &lower, 2, density)
    }

    /// An acceleration w of variance `variance` (m²/s⁴) held over each interval: x' = F x + G w, per axis
    /// G = [T²/2; T]. Its covariance has rank one per axis (Fan, Wang and Zhou 2018, section 3).
    ///
    /// # Errors
    ///
    /// Where `variance` or `interval` is not positive and finite.
    pub fn held_acceleration(axes: usize, interval: f64, variance: f64) -> Result<Self, MessageError> {
        positive("the variance of the acceleration", variance)?;
        positive("the interval", interval)?;
        Self::with_factor(axes, interval, &[0.5 * interval * interval, interval], 1, variance)
    }

    /// Repeats one axis's noise factor (2 by `sources`) for every axis.
    fn with_factor(
        axes: usize,
        interval: f64,
        factor: &[f64],
        sources: usize,
        variance: f64,
    ) -> Result<Self, MessageError> {
        let width = axes * sources;
        let mut gain = vec![0.0; 2 * axes * width];
        for axis in 0..axes {
            for row in 0..2 {
                for source in 0..sources {
                    gain[(2 * axis + row) * width + axis * sources + source] = factor[row * sources + source];
                }
            }
        }
        let mut covariance = vec![0.0; width * width];
        (0..width).for_each(|k| covariance[k * width + k] = variance);
        let noise = ProcessNoise::driven(&gain, &covariance)?;
        finite("an entry of the process noise", &noise.covariance())?;
        Ok(Self { axes, interval, noise })
    }
}

impl Motion for ConstantVelocity {
    fn dimension(&self) -> usize {
        2 * self.axes
    }

    #[inline(always)]
    fn step<T: Real>(&self, state: &[T], next: &mut [T]) {
        for (from, to) in state.chunks_exact(2).zip(next.chunks_exact_mut(2)) {
            to[0] = from[0] + from[1] * self.interval;
            to[1] = from[1];
        }
    }

    fn noise(&self, _state: &[f64]) -> ProcessNoise {
        self.noise.clone()
    }

    fn constant_noise(&self) -> Option<&ProcessNoise> {
        Some(&self.noise)
    }

    #[inline]
    fn constant_transition(&self, transition: &mut [f64]) -> bool {
        let d = 2 * self.axes;
        transition.fill(0.0);
        for axis in 0..self.axes {
            transition[2 * axis * (d + 1)] = 1.0;
            transition[2 * axis * (d + 1) + 1] = self.interval;
            transition[(2 * axis + 1) * (d + 1)] = 1.0;
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_transition_is_the_steps_derivative() {
        let motion = ConstantVelocity::white_acceleration(3, 0.7, 1.0).unwrap();
        let mut transition = [f64::NAN; 36];
        assert!(motion.constant_transition(&mut transition));
        let (mut unit, mut column) = ([0.0; 6], [0.0; 6]);
        for k in 0..6 {
            unit[k] = 1.0;
            motion.step(&unit, &mut column);
            assert!((0..6).all(|row| transition[row * 6 + k] == column[row]), "{k}");
            unit[k] = 0.0;
        }
    }

    #[test]
    fn noise_that_overflows_is_refused() {
        for result in [
            ConstantVelocity::held_acceleration(2, 1e100, 1e200),
            ConstantVelocity::white_acceleration(2, 1e100, 1e200),
            ConstantVelocity::white_acceleration(2, 1e200, 1.0),
        ] {
            let error = result.err();
            assert!(matches!(error, Some(MessageError::NotFinite { .. })), "{error:?}");
        }
    }
}
