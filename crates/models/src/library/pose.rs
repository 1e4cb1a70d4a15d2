//! Relative poses and priors on poses, in the plane or in space, with noise in the Lie algebra, on the right.
//!
//! A pose that is measured as Z is Z Exp(ξ), ξ the noise in the order translation, rotation; the residual is ξ. The density
//! is the noise's of ξ; of the pose it differs by |det ∂ξ/∂X|, in the plane 1 + φ²/12 + O(φ⁴), which is left out.
//!
//! Source: Solà, Deray, Atchuthan, "A micro Lie theory for state estimation in robotics" (2018).

use super::checks::{finite, size};
use crate::pose::{Pose2, Pose3};
use crate::{Chart, Noise, Real, Residual};
use sumprod_graph::MessageError;

/// What is taken as the residual of a pose E that should be the origin.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PoseResidual {
    /// Log E, the velocity that reaches it: GTSAM's choice.
    #[default]
    Log,
    /// E's translation as it stands, and its angle in the plane or twice the quaternion's vector part in space: g2o's
    /// choice.
    Split,
}

/// The pose `a` followed by `b`, which is given in the frame of `a`: [x, y, heading], the heading not wrapped.
pub fn compose<T: Real>(a: &[T; 3], b: &[T; 3]) -> [T; 3] {
    Pose2::read(a).compose(&Pose2::read(b)).stored()
}

/// The pose `b` in the frame of `a`, a⁻¹ b; the heading not wrapped.
pub fn between<T: Real>(a: &[T; 3], b: &[T; 3]) -> [T; 3] {
    Pose2::read(a).between(&Pose2::read(b)).stored()
}

/// The exponential of ξ = (ρ₁, ρ₂, φ): the pose that moving at the constant twist ξ for a unit of time leads to.
pub fn exponential<T: Real>(twist: &[T; 3]) -> [T; 3] {
    Pose2::exp(*twist).stored()
}

/// The logarithm of a pose, ξ = (ρ₁, ρ₂, φ) with φ in (-π, π]. At φ = π the two half turns meet and it jumps.
pub fn logarithm<T: Real>(pose: &[T; 3]) -> [T; 3] {
    Pose2::read(pose).log()
}

/// The arithmetic of a group of poses that factors need; implemented by [`Pose2`] and [`Pose3`].
pub trait PoseGroup: Send + Sync + 'static {
    /// A pose as it is stored.
    type Stored: Copy + AsRef<[f64]> + AsMut<[f64]> + Send + Sync + std::fmt::Debug;

    /// Degrees of freedom.
    const FREEDOMS: usize;
    /// Port dimensions of a factor on one and on two poses.
    const PORTS: &'static [usize];
    /// Degrees of freedom of the same ports.
    const PORT_FREEDOMS: &'static [usize];

    /// Writes the residual of x₀⁻¹ x₁ z⁻¹ from stored poses: that of z⁻¹ x₀⁻¹ x₁.
    fn residual<T: Real>(measured: &[f64], from: &[T], to: &[T], form: PoseResidual, out: &mut [T]);

    /// Writes the residual, its derivative by a step of `to` into the right of `jacobian` (row-major, `columns` wide)
    /// and, of a factor on two poses, by a step of `from` into the left.
    fn closed_form(
        measured: &[f64],
        from: Option<&[f64]>,
        to: &[f64],
        form: PoseResidual,
        residual: &mut [f64],
        jacobian: &mut [f64],
    );
}

/// Writes L into the right and -L A into the left of `jacobian`, both D by D.
fn write_blocks<const D: usize>(local: &[f64], adjoint: Option<&[f64]>, jacobian: &mut [f64]) {
    let Some(adjoint) = adjoint else { return jacobian.copy_from_slice(local) };
    for (row, out) in local.chunks_exact(D).zip(jacobian.chunks_exact_mut(2 * D)) {
        let (left, right) = out.split_at_mut(D);
        right.copy_from_slice(row);
        left.fill(0.0);
        for (entry, a) in row.iter().zip(adjoint.chunks_exact(D)) {
            for (left, a) in left.iter_mut().zip(a) {
                *left -= entry * a;
            }
        }
    }
}

fn constant<T: Real>(measured: &[f64]) -> impl Fn(usize) -> T + '_ {
    |k| T::from(measured[k])
}

impl PoseGroup for Pose2 {
    type Stored = [f64; 3];

    const FREEDOMS: usize = 3;
    const PORTS: &'static [usize] = &[3, 3];
    const PORT_FREEDOMS: &'static [usize] = &[3, 3];

    #[inline]
    fn residual<T: Real>(measured: &[f64], from: &[T], to: &[T], form: PoseResidual, out: &mut [T]) {
        let measured = constant::<T>(measured);
        let measured = Pose2 { x: measured(0), y: measured(1), heading: measured(2) };
        let error = measured.between(&Pose2::read(from).between(&Pose2::read(to)));
        match form {
            PoseResidual::Log => out.copy_from_slice(&error.log()),
            PoseResidual::Split => error.write(out),
        }
    }

    #[inline]
    fn closed_form(
        measured: &[f64],
        from: Option<&[f64]>,
        to: &[f64],
        form: PoseResidual,
        residual: &mut [f64],
        jacobian: &mut [f64],
    ) {
        let to = Pose2::read(to);
        let relative = from.map(|from| Pose2::read(from).between(&to));
        let error = Pose2::read(measured).between(relative.as_ref().unwrap_or(&to));
        let local = match form {
            PoseResidual::Log => {
                let velocity = error.log();
                residual.copy_from_slice(&velocity);
                Pose2::right_jacobian_inverse(velocity)
            }
            PoseResidual::Split => {
                error.write(residual);
                let (sine, cosine) = error.heading.sin_cos();
                [cosine, -sine, 0.0, sine, cosine, 0.0, 0.0, 0.0, 1.0]
            }
        };
        // Ad of x₁⁻¹ x₀, the inverse of the relative pose.
        let back =
            relative.map(|relative| relative.between(&Pose2 { x: 0.0, y: 0.0, heading: 0.0 }).adjoint());
        write_blocks::<3>(&local, back.as_ref().map(<[f64; 9]>::as_slice), jacobian);
    }
}

/// Twice the vector part of a quaternion on the side of the identity.
fn twice_vector<T: Real>(rotation: [T; 4]) -> [T; 3] {
    let scale = if rotation[3].re() < 0.0 { -2.0 } else { 2.0 };
    [rotation[0] * scale, rotation[1] * scale, rotation[2] * scale]
}

impl PoseGroup for Pose3 {
    type Stored = [f64; 7];

    const FREEDOMS: usize = 6;
    const PORTS: &'static [usize] = &[7, 7];
    const PORT_FREEDOMS: &'static [usize] = &[6, 6];

    #[inline]
    fn residual<T: Real>(measured: &[f64], from: &[T], to: &[T], form: PoseResidual, out: &mut [T]) {
        let measured = constant::<T>(measured);
        let measured = Pose3 {
            position: [measured(0), measured(1), measured(2)],
            rotation: [measured(3), measured(4), measured(5), measured(6)],
        };
        let error = measured.between(&Pose3::read(from).between(&Pose3::read(to)));
        match form {
            PoseResidual::Log => out.copy_from_slice(&error.log()),
            PoseResidual::Split => {
                out[..3].copy_from_slice(&error.position);
                out[3..].copy_from_slice(&twice_vector(error.rotation));
            }
        }
    }

    #[inline]
    fn closed_form(
        measured: &[f64],
        from: Option<&[f64]>,
        to: &[f64],
        form: PoseResidual,
        residual: &mut [f64],
        jacobian: &mut [f64],
    ) {
        let to = Pose3::read(to);
        let relative = from.map(|from| Pose3::read(from).between(&to));
        let error = Pose3::read(measured).between(relative.as_ref().unwrap_or(&to));
        let local = match form {
            PoseResidual::Log => {
                let velocity = error.log();
                residual.copy_from_slice(&velocity);
                Pose3::right_jacobian_inverse(velocity)
            }
            PoseResidual::Split => {
                residual[..3].copy_from_slice(&error.position);
                residual[3..].copy_from_slice(&twice_vector(error.rotation));
                split_derivative(&error)
            }
        };
        let origin = Pose3 { position: [0.0; 3], rotation: [0.0, 0.0, 0.0, 1.0] };
        let back = relative.map(|relative| relative.between(&origin).adjoint());
        write_blocks::<6>(&local, back.as_ref().map(<[f64; 36]>::as_slice), jacobian);
    }
}

/// The derivative of (t, 2 v) of a pose by a step in its own frame: R, and w I + [v].
fn split_derivative(error: &Pose3) -> [f64; 36] {
    let mut out = [0.0; 36];
    for (row, entries) in error.matrix().iter().enumerate() {
        out[6 * row..][..3].copy_from_slice(entries);
    }
    let sign = if error.rotation[3] < 0.0 { -1.0 } else { 1.0 };
    let [x, y, z, w] = error.rotation.map(|q| sign * q);
    out[21..24].copy_from_slice(&[w, -z, y]);
    out[27..30].copy_from_slice(&[z, w, -x]);
    out[33..36].copy_from_slice(&[-y, x, w]);
    out
}

/// Refuses a pose that is none, and brings its quaternion to unit length.
fn checked<G: PoseGroup>(
    what: &'static str,
    noise_of: &'static str,
    mut pose: G::Stored,
    noise: &Noise,
) -> Result<G::Stored, MessageError> {
    finite(what, pose.as_ref())?;
    size(noise_of, noise.dimension(), G::FREEDOMS)?;
    if let [_, _, _, quaternion @ ..] = pose.as_mut()
        && !quaternion.is_empty()
    {
        let length = quaternion.iter().map(|q| q * q).sum::<f64>().sqrt();
        if length < 1e-6 {
            let what = "the quaternion";
            return Err(MessageError::NotPositiveDefinite { what, pivot: 0, value: length });
        }
        quaternion.iter_mut().for_each(|q| *q /= length);
    }
    Ok(pose)
}

/// A measured pose of one body in the frame of another, odometry for instance: X₁ = X₀ Z Exp(ξ), r = Log(Z⁻¹ X₀⁻¹ X₁).
#[derive(Clone, Debug)]
pub struct BetweenPoses<G: PoseGroup> {
    measured: G::Stored,
    form: PoseResidual,
    noise: Noise,
}

/// A relative pose in the plane, [x, y, heading] (m, m, rad).
pub type RelativePose = BetweenPoses<Pose2>;
/// A relative pose in space, [x, y, z, qx, qy, qz, qw] (m and a quaternion).
pub type RelativePose3 = BetweenPoses<Pose3>;

impl<G: PoseGroup> BetweenPoses<G> {
    /// A relative pose as it is stored, with the noise of ξ.
    ///
    /// # Errors
    ///
    /// Where a number is not finite, the noise has not as many components as the group, or the quaternion vanishes.
    pub fn new(measured: G::Stored, noise: Noise) -> Result<Self, MessageError> {
        let what = "the measured relative pose";
        let measured = checked::<G>(what, "the noise of the relative pose", measured, &noise)?;
        Ok(Self { measured, form: PoseResidual::default(), noise })
    }

    /// The same with another residual.
    pub fn with_form(mut self, form: PoseResidual) -> Self {
        self.form = form;
        self
    }
}

impl<G: PoseGroup> Residual for BetweenPoses<G> {
    fn dimensions(&self) -> &[usize] {
        G::PORTS
    }

    fn degrees_of_freedom(&self) -> &[usize] {
        G::PORT_FREEDOMS
    }

    fn noise(&self) -> &Noise {
        &self.noise
    }

    fn residual<T: Real>(&self, x: &[&[T]], out: &mut [T]) {
        G::residual(self.measured.as_ref(), x[0], x[1], self.form, out);
    }

    fn closed_form(&self, x: &[&[f64]], residual: &mut [f64], jacobian: &mut [f64]) -> Option<Chart> {
        let jacobian = &mut jacobian[..2 * G::FREEDOMS * G::FREEDOMS];
        G::closed_form(self.measured.as_ref(), Some(x[0]), x[1], self.form, residual, jacobian);
        Some(Chart::Local)
    }

    fn angles(&self) -> &[usize] {
        if G::FREEDOMS == 3 { &[2] } else { &[] }
    }
}

/// A prior on a pose: X = Z Exp(ξ), r = Log(Z⁻¹ X).
#[derive(Clone, Debug)]
pub struct PriorPose<G: PoseGroup> {
    mean: G::Stored,
    noise: Noise,
}

/// A prior on a pose in the plane.
pub type PosePrior = PriorPose<Pose2>;
/// A prior on a pose in space.
pub type PosePrior3 = PriorPose<Pose3>;

impl<G: PoseGroup> PriorPose<G> {
    /// A prior at a pose as it is stored, with the noise of ξ.
    ///
    /// # Errors
    ///
    /// As [`BetweenPoses::new`].
    pub fn new(mean: G::Stored, noise: Noise) -> Result<Self, MessageError> {
        let mean = checked::<G>("the pose of the prior", "the noise of the pose", mean, &noise)?;
        Ok(Self { mean, noise })
    }
}

impl<G: PoseGroup> Residual for PriorPose<G> {
    fn dimensions(&self) -> &[usize] {
        &G::PORTS[..1]
    }

    fn degrees_of_freedom(&self) -> &[usize] {
        &G::PORT_FREEDOMS[..1]
    }

    fn noise(&self) -> &Noise {
        &self.noise
    }

    fn residual<T: Real>(&self, x: &[&[T]], out: &mut [T]) {
        let mut origin = [T::from(0.0); 7];
        origin[6] = T::from(1.0);
        let origin = if G::FREEDOMS == 6 { &origin[..] } else { &origin[..3] };
        G::residual(self.mean.as_ref(), origin, x[0], PoseResidual::Log, out);
    }

    fn closed_form(&self, x: &[&[f64]], residual: &mut [f64], jacobian: &mut [f64]) -> Option<Chart> {
        let jacobian = &mut jacobian[..G::FREEDOMS * G::FREEDOMS];
        G::closed_form(self.mean.as_ref(), None, x[0], PoseResidual::Log, residual, jacobian);
        Some(Chart::Local)
    }

    fn angles(&self) -> &[usize] {
        if G::FREEDOMS == 3 { &[2] } else { &[] }
    }

    fn known_place(&self) -> Option<&[f64]> {
        Some(&self.mean.as_ref()[..if G::FREEDOMS == 3 { 2 } else { 3 }])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

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
