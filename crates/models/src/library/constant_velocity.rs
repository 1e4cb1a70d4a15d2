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

    /// White acceleration of a density (m²/s³) of its own along each axis: a vehicle that accelerates differently up and
    /// down, or a clock's offset and rate beside a position and velocity.
    ///
    /// # Errors
    ///
    /// Where the interval or a density is not positive and finite.
    pub fn white_accelerations(interval: f64, densities: &[f64]) -> Result<Self, MessageError> {
        let mut motion = Self::white_acceleration(densities.len(), interval, 1.0)?;
        let width = motion.noise.sources();
        let mut factor = motion.noise.factor().to_vec();
        for (rows, &density) in factor.chunks_exact_mut(2 * width).zip(densities) {
            positive("the density of the acceleration", density)?;
            rows.iter_mut().for_each(|entry| *entry *= density.sqrt());
        }
        let ones: Vec<f64> =
            (0..width * width).map(|k| f64::from(u8::from(k.is_multiple_of(width + 1)))).collect();
        motion.noise = ProcessNoise::driven(&factor, &ones)?;
        finite("an entry of the process noise", &motion.noise.covariance())?;
        Ok(motion)
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
    fn each_axis_has_the_noise_of_its_own_density() {
        let both = ConstantVelocity::white_accelerations(0.7, &[0.3, 4.0]).unwrap();
        let covariance = both.noise(&[0.0; 4]).covariance();
        for (axis, density) in [0.3, 4.0].into_iter().enumerate() {
            let alone = ConstantVelocity::white_acceleration(1, 0.7, density).unwrap();
            let alone = alone.noise(&[0.0; 2]).covariance();
            for (row, column) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
                let entry = covariance[(2 * axis + row) * 4 + 2 * axis + column];
                assert!((entry - alone[2 * row + column]).abs() < 1e-14);
                assert_eq!(covariance[(2 * axis + row) * 4 + (2 - 2 * axis) + column], 0.0);
            }
        }
        assert!(ConstantVelocity::white_accelerations(0.7, &[0.3, 0.0]).is_err());
        assert!(ConstantVelocity::white_accelerations(0.7, &[]).is_err());
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
