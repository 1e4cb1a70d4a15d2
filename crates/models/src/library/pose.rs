//! Poses in the plane, [x, y, heading], whose noise lives in the Lie algebra of SE(2), on the right.
//!
//! A pose is a rotation R(θ) and a translation t. The exponential of ξ = (ρ, φ) has the heading φ and the translation
//! V(φ) ρ, V(φ) = [sin φ, -(1 - cos φ); 1 - cos φ, sin φ] / φ; the logarithm undoes it, and
//! V(φ)⁻¹ = [a, φ/2; -φ/2, a] with a = (φ/2) cot (φ/2).
//!
//! Source: Solà, Deray, Atchuthan, "A micro Lie theory for state estimation in robotics" (2018), appendix B.

use super::checks::{finite, size};
use crate::{Noise, Real, Residual};
use std::f64::consts::TAU;
use sumprod_graph::{MessageError, wrap_angle};

/// The pose `a` followed by `b`, which is given in the frame of `a`: [x, y, heading], the heading not wrapped.
pub fn compose<T: Real>(a: &[T; 3], b: &[T; 3]) -> [T; 3] {
    let (sine, cosine) = a[2].sin_cos();
    [a[0] + cosine * b[0] - sine * b[1], a[1] + sine * b[0] + cosine * b[1], a[2] + b[2]]
}

/// The pose `b` in the frame of `a`, a⁻¹ b; the heading not wrapped.
pub fn between<T: Real>(a: &[T; 3], b: &[T; 3]) -> [T; 3] {
    let (sine, cosine) = a[2].sin_cos();
    let (x, y) = (b[0] - a[0], b[1] - a[1]);
    [cosine * x + sine * y, cosine * y - sine * x, b[2] - a[2]]
}

/// The exponential of ξ = (ρ₁, ρ₂, φ): the pose that moving at the constant twist ξ for a unit of time leads to.
pub fn exponential<T: Real>(twist: &[T; 3]) -> [T; 3] {
    let angle = twist[2];
    let squared = angle * angle;
    // sin φ / φ and (1 - cos φ) / φ, by their series where the quotients lose digits.
    let (along, across) = if angle.re().abs() < SERIES {
        (
            squared * (squared * (squared / -5040.0 + 120.0_f64.recip()) - 6.0_f64.recip()) + 1.0,
            angle * (squared * (squared / 720.0 - 24.0_f64.recip()) + 0.5),
        )
    } else {
        (angle.sin() / angle, (-angle.cos() + 1.0) / angle)
    };
    [along * twist[0] - across * twist[1], across * twist[0] + along * twist[1], angle]
}

/// The logarithm of a pose, ξ = (ρ₁, ρ₂, φ) with φ in (-π, π]. At φ = π the two half turns meet and it jumps.
pub fn logarithm<T: Real>(pose: &[T; 3]) -> [T; 3] {
    let angle = pose[2] - TAU * ((pose[2].re() - wrap_angle(pose[2].re())) / TAU).round();
    let half = angle * 0.5;
    let squared = angle * angle;
    let a = if angle.re().abs() < SERIES {
        -squared * (squared * (squared / 30240.0 + 720.0_f64.recip()) + 12.0_f64.recip()) + 1.0
    } else {
        // (φ/2) cot (φ/2) in the form that stays finite at φ = π.
        half * angle.sin() / (-angle.cos() + 1.0)
    };
    [a * pose[0] + half * pose[1], a * pose[1] - half * pose[0], angle]
}

/// Angles (rad) below which series serve; their first term left out is below rounding.
const SERIES: f64 = 0.05;

/// A prior on a pose: X = Z Exp(ξ), r = Log(Z⁻¹ X).
///
/// The density is the noise's of ξ; of X it differs by |det ∂ξ/∂X| = 1 + φ²/12 + O(φ⁴), which is left out.
#[derive(Clone, Debug)]
pub struct PosePrior {
    pose: [f64; 3],
    noise: Noise,
}

impl PosePrior {
    /// A prior at `pose` (m, m, rad) with the noise of ξ (m, m, rad).
    ///
    /// # Errors
    ///
    /// Where the pose is not finite, or the noise has not three components.
    pub fn new(pose: [f64; 3], noise: Noise) -> Result<Self, MessageError> {
        finite("the pose of the prior", &pose)?;
        size("the noise of the pose", noise.dimension(), 3)?;
        Ok(Self { pose, noise })
    }
}

impl Residual for PosePrior {
    fn dimensions(&self) -> &[usize] {
        &[3]
    }

    fn noise(&self) -> &Noise {
        &self.noise
    }

    fn residual<T: Real>(&self, x: &[&[T]], out: &mut [T]) {
        let found = [x[0][0], x[0][1], x[0][2]];
        out.copy_from_slice(&logarithm(&between(&self.pose.map(T::from), &found)));
    }

    fn angles(&self) -> &[usize] {
        &[2]
    }
}

/// A measured pose of one body in the frame of another, odometry for instance: X₁ = X₀ Z Exp(ξ), r = Log(Z⁻¹ X₀⁻¹ X₁).
///
/// The density is the noise's of ξ, as of [`PosePrior`].
#[derive(Clone, Debug)]
pub struct RelativePose {
    measured: [f64; 3],
    noise: Noise,
}

impl RelativePose {
    /// A relative pose (m, m, rad) with the noise of ξ (m, m, rad).
    ///
    /// # Errors
    ///
    /// Where the measurement is not finite, or the noise has not three components.
    pub fn new(measured: [f64; 3], noise: Noise) -> Result<Self, MessageError> {
        finite("the measured relative pose", &measured)?;
        size("the noise of the relative pose", noise.dimension(), 3)?;
        Ok(Self { measured, noise })
    }
}

impl Residual for RelativePose {
    fn dimensions(&self) -> &[usize] {
        &[3, 3]
    }

    fn noise(&self) -> &Noise {
        &self.noise
    }

    fn residual<T: Real>(&self, x: &[&[T]], out: &mut [T]) {
        let pose = |port: usize| [x[port][0], x[port][1], x[port][2]];
        let found = between(&pose(0), &pose(1));
        out.copy_from_slice(&logarithm(&between(&self.measured.map(T::from), &found)));
    }

    fn angles(&self) -> &[usize] {
        &[2]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(a: [f64; 3], b: [f64; 3]) -> bool {
        a.iter().zip(&b).all(|(a, b)| (a - b).abs() < 1e-13 * (1.0 + b.abs()))
    }

    #[test]
    fn the_logarithm_undoes_the_exponential_on_both_sides_of_the_series() {
        for angle in [0.0, 1e-9, -0.0499, 0.0501, -1.0, 3.1] {
            let twist = [1.5, -0.7, angle];
            assert!(close(logarithm(&exponential(&twist)), twist), "{angle}");
        }
        // A quarter turn to the left at speed one: radius 2/π.
        let quarter = std::f64::consts::FRAC_PI_2;
        assert!(close(exponential(&[1.0, 0.0, quarter]), [1.0 / quarter, 1.0 / quarter, quarter]));
        assert!(close(logarithm(&[1.0, 2.0, TAU + 0.3]), logarithm(&[1.0, 2.0, 0.3])));
    }

    #[test]
    fn going_there_and_back_is_standing_still() {
        let (a, b) = ([1.0, -2.0, 0.4], [-3.0, 0.5, 2.0]);
        assert!(close(compose(&a, &between(&a, &b)), b));
        assert!(close(between(&a, &compose(&a, &b)), b));
    }

    #[test]
    fn a_residual_is_the_noise_that_made_the_pose() {
        let noise = Noise::diagonal(&[0.04, 0.0016, 0.0004]).unwrap();
        let (from, measured, twist) = ([2.0, 1.0, 3.0], [0.0, -30.0, -1.5], [0.3, -0.1, 0.04]);
        let to = compose(&compose(&from, &measured), &exponential(&twist));
        let mut out = [0.0; 3];
        let relative = RelativePose::new(measured, noise.clone()).unwrap();
        relative.residual(&[&from[..], &to[..]], &mut out);
        assert!(close(out, twist));
        PosePrior::new(compose(&from, &measured), noise).unwrap().residual(&[&to[..]], &mut out);
        assert!(close(out, twist));
    }

    #[test]
    fn poses_that_are_none_are_refused() {
        let noise = |components| Noise::isotropic(components, 1.0).unwrap();
        for bad in [f64::NAN, f64::INFINITY] {
            assert!(PosePrior::new([0.0, bad, 0.0], noise(3)).is_err());
            assert!(RelativePose::new([0.0, 0.0, bad], noise(3)).is_err());
        }
        let error = RelativePose::new([0.0; 3], noise(2)).unwrap_err();
        assert_eq!(error.to_string(), "the noise of the relative pose has dimension 2, expected 3");
        assert!(PosePrior::new([0.0; 3], noise(1)).is_err());
    }
}
