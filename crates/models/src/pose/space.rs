//! Poses in space, SE(3), their rotation a unit quaternion.

use super::half_cotangent;
use crate::Real;

/// A pose in space: position (m) and orientation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose3<T = f64> {
    /// x, y, z.
    pub position: [T; 3],
    /// The unit quaternion's vector part and its real part.
    pub rotation: [T; 4],
}

/// The cross product.
#[inline]
fn cross<T: Real>(a: [T; 3], b: [T; 3]) -> [T; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[inline]
fn dot<T: Real>(a: [T; 3], b: [T; 3]) -> T {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// v turned by the unit quaternion q.
#[inline]
fn rotate<T: Real>(q: [T; 4], v: [T; 3]) -> [T; 3] {
    let axis = [q[0], q[1], q[2]];
    let twice = cross(axis, v).map(|x| x * 2.0);
    let again = cross(axis, twice);
    [0, 1, 2].map(|k| v[k] + q[3] * twice[k] + again[k])
}

/// The product of quaternions.
#[inline]
fn multiply<T: Real>(a: [T; 4], b: [T; 4]) -> [T; 4] {
    let (u, v) = ([a[0], a[1], a[2]], [b[0], b[1], b[2]]);
    let across = cross(u, v);
    let [x, y, z] = [0, 1, 2].map(|k| a[3] * v[k] + b[3] * u[k] + across[k]);
    [x, y, z, a[3] * b[3] - dot(u, v)]
}

#[inline]
fn conjugate<T: Real>(q: [T; 4]) -> [T; 4] {
    [-q[0], -q[1], -q[2], q[3]]
}

/// (1 - (θ / 2) cot(θ / 2)) / θ² by θ².
fn cotangent_rest<T: Real>(squared: T) -> T {
    if squared.re() < 1e-4 {
        return squared * (squared / 30240.0 + 1.0 / 720.0) + 1.0 / 12.0;
    }
    (-half_cotangent(squared.sqrt()) + 1.0) / squared
}

impl<T: Real> Pose3<T> {
    /// The pose stored as `[x, y, z, qx, qy, qz, qw]`.
    #[inline]
    pub fn read(stored: &[T]) -> Self {
        Self {
            position: [stored[0], stored[1], stored[2]],
            rotation: [stored[3], stored[4], stored[5], stored[6]],
        }
    }

    /// Writes `[x, y, z, qx, qy, qz, qw]`.
    pub fn write(&self, stored: &mut [T]) {
        stored[..3].copy_from_slice(&self.position);
        stored[3..7].copy_from_slice(&self.rotation);
    }

    /// A point given in this pose's frame, in the frame the pose is given in.
    #[inline]
    pub fn transform(&self, point: [T; 3]) -> [T; 3] {
        let turned = rotate(self.rotation, point);
        [0, 1, 2].map(|k| self.position[k] + turned[k])
    }

    /// A point in this pose's frame.
    #[inline]
    pub fn local(&self, point: [T; 3]) -> [T; 3] {
        rotate(conjugate(self.rotation), [0, 1, 2].map(|k| point[k] - self.position[k]))
    }

    /// This pose, then `step` in its frame.
    #[inline]
    pub fn compose(&self, step: &Self) -> Self {
        Self { position: self.transform(step.position), rotation: multiply(self.rotation, step.rotation) }
    }

    /// `other` as seen from this pose: the inverse of this, composed with it.
    #[inline]
    pub fn between(&self, other: &Self) -> Self {
        Self {
            position: self.local(other.position),
            rotation: multiply(conjugate(self.rotation), other.rotation),
        }
    }

    /// The pose reached from the origin by the constant velocity `[v, ω]` in unit time.
    pub fn exp(velocity: [T; 6]) -> Self {
        let [a, b, c, p, q, r] = velocity;
        let (along, turn) = ([a, b, c], [p, q, r]);
        let squared = dot(turn, turn);
        let (half_sine, cosine) = if squared.re() < 1e-4 {
            let sine = squared * (squared / 3840.0 - 1.0 / 48.0) + 0.5;
            (sine, squared * (squared / 384.0 - 1.0 / 8.0) + 1.0)
        } else {
            let angle = squared.sqrt();
            let (sine, cosine) = (angle * 0.5).sin_cos();
            (sine / angle, cosine)
        };
        let [x, y, z] = turn.map(|w| w * half_sine);
        // (1 - cos θ) / θ² = 2 (sin(θ/2) / θ)², and (θ - sin θ) / θ³.
        let versine = half_sine * half_sine * 2.0;
        let rest = if squared.re() < 1e-4 {
            squared * (squared / 5040.0 - 1.0 / 120.0) + 1.0 / 6.0
        } else {
            (-half_sine * cosine * 2.0 + 1.0) / squared
        };
        let across = cross(turn, along);
        let again = cross(turn, across);
        let position = [0, 1, 2].map(|k| along[k] + versine * across[k] + rest * again[k]);
        Self { position, rotation: [x, y, z, cosine] }
    }

    /// The rotation vector (rad), of less than half a turn.
    fn turn(&self) -> [T; 3] {
        let [x, y, z, w] = self.rotation;
        let sign = if w.re() < 0.0 { -1.0 } else { 1.0 };
        let (axis, w) = ([x, y, z].map(|q| q * sign), w * sign);
        let squared = dot(axis, axis);
        let factor = if squared.re() < 1e-8 {
            (-squared / (w * w) / 3.0 + 1.0) * 2.0 / w
        } else {
            let sine = squared.sqrt();
            sine.atan2(w) * 2.0 / sine
        };
        axis.map(|q| q * factor)
    }

    /// The velocity that reaches this pose in unit time, turning by less than half a turn.
    #[inline]
    pub fn log(&self) -> [T; 6] {
        let turn = self.turn();
        let rest = cotangent_rest(dot(turn, turn));
        let across = cross(turn, self.position);
        let again = cross(turn, across);
        let [a, b, c] = [0, 1, 2].map(|k| self.position[k] - across[k] * 0.5 + rest * again[k]);
        [a, b, c, turn[0], turn[1], turn[2]]
    }
}

type Square = [[f64; 3]; 3];

fn hat(v: [f64; 3]) -> Square {
    [[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]]
}

fn product(a: &Square, b: &Square) -> Square {
    let mut out = [[0.0; 3]; 3];
    for (row, a) in out.iter_mut().zip(a) {
        for (k, b) in b.iter().enumerate() {
            for (out, b) in row.iter_mut().zip(b) {
                *out += a[k] * b;
            }
        }
    }
    out
}

/// Adds `scale` times a matrix.
fn add(out: &mut Square, scale: f64, other: &Square) {
    for (row, other) in out.iter_mut().zip(other) {
        for (out, other) in row.iter_mut().zip(other) {
            *out += scale * other;
        }
    }
}

/// Writes four 3 by 3 blocks as a 6 by 6 matrix, row-major; the lower left is zero.
fn blocks(upper_left: &Square, upper_right: &Square, lower_right: &Square) -> [f64; 36] {
    let mut out = [0.0; 36];
    for k in 0..3 {
        out[6 * k..][..3].copy_from_slice(&upper_left[k]);
        out[6 * k + 3..][..3].copy_from_slice(&upper_right[k]);
        out[6 * (k + 3) + 3..][..3].copy_from_slice(&lower_right[k]);
    }
    out
}

impl Pose3<f64> {
    /// The same pose with a quaternion of unit length.
    pub fn normalised(mut self) -> Self {
        let length = self.rotation.iter().map(|q| q * q).sum::<f64>().sqrt();
        self.rotation.iter_mut().for_each(|q| *q /= length);
        self
    }

    /// The rotation matrix, by rows.
    pub fn matrix(&self) -> [[f64; 3]; 3] {
        let [x, y, z, w] = self.rotation;
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
        ]
    }

    /// The inverse of the right Jacobian at a velocity ξ, row-major: Log(Exp(ξ) Exp(δ)) = ξ + J⁻¹ δ. With J the left
    /// Jacobian of -ω and Q its translation block, J⁻¹ = [J⁻¹, -J⁻¹ Q J⁻¹; 0, J⁻¹].
    pub fn right_jacobian_inverse(velocity: [f64; 6]) -> [f64; 36] {
        let [a, b, c, p, q, r] = velocity.map(|v| -v);
        let turn = [p, q, r];
        let (along, spin) = (hat([a, b, c]), hat(turn));
        let squared = dot(turn, turn);
        let spin_squared = product(&spin, &spin);
        let mut inverse = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        add(&mut inverse, -0.5, &spin);
        add(&mut inverse, cotangent_rest(squared), &spin_squared);

        let [first, second, third] = translation_terms(squared);
        let (spin_along, along_spin) = (product(&spin, &along), product(&along, &spin));
        let spin_along_spin = product(&spin_along, &spin);
        let mut block = [[0.0; 3]; 3];
        add(&mut block, 0.5, &along);
        add(&mut block, first, &spin_along);
        add(&mut block, first, &along_spin);
        add(&mut block, first, &spin_along_spin);
        add(&mut block, second, &product(&spin, &spin_along));
        add(&mut block, second, &product(&along_spin, &spin));
        add(&mut block, -3.0 * second, &spin_along_spin);
        add(&mut block, third, &product(&spin_along_spin, &spin));
        add(&mut block, third, &product(&spin, &spin_along_spin));
        let mut right = [[0.0; 3]; 3];
        add(&mut right, -1.0, &product(&product(&inverse, &block), &inverse));
        blocks(&inverse, &right, &inverse)
    }

    /// The adjoint, row-major: X Exp(δ) X⁻¹ = Exp(Ad δ).
    pub fn adjoint(&self) -> [f64; 36] {
        let rotation = self.matrix();
        blocks(&rotation, &product(&hat(self.position), &rotation), &rotation)
    }
}

/// (θ - sin θ) / θ³, (θ² + 2 cos θ - 2) / (2 θ⁴) and (2 θ - 3 sin θ + θ cos θ) / (2 θ⁵).
fn translation_terms(squared: f64) -> [f64; 3] {
    if squared < 1e-2 {
        let fourth = squared * squared;
        return [
            1.0 / 6.0 - squared / 120.0 + fourth / 5040.0,
            1.0 / 24.0 - squared / 720.0 + fourth / 40320.0,
            1.0 / 120.0 - squared / 2520.0 + fourth / 120_960.0,
        ];
    }
    let angle = squared.sqrt();
    let (sine, cosine) = angle.sin_cos();
    [
        (angle - sine) / (angle * squared),
        (squared + 2.0 * cosine - 2.0) / (2.0 * squared * squared),
        (2.0 * angle - 3.0 * sine + angle * cosine) / (2.0 * squared * squared * angle),
    ]
}
