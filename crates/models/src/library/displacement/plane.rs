//! Both messages of a displacement in the plane at once, side by side in the two halves of a vector register: the
//! inner loop of large grids of points.

use nalgebra::{SMatrix, SVector};
use sumprod_graph::{MessageError, Port};
use sumprod_messages::Gaussian;

/// One number for each of the two messages.
type Both = [f64; 2];

/// Λ(0,0), Λ(1,0), Λ(1,1), η(0), η(1) of a message.
type Numbers = [f64; 5];

#[inline(always)]
fn each(a: Both, b: Both, f: impl Fn(f64, f64) -> f64) -> Both {
    [f(a[0], b[0]), f(a[1], b[1])]
}

#[inline(always)]
fn plus(a: Both, b: Both) -> Both {
    each(a, b, |a, b| a + b)
}

#[inline(always)]
fn minus(a: Both, b: Both) -> Both {
    each(a, b, |a, b| a - b)
}

#[inline(always)]
fn times(a: Both, b: Both) -> Both {
    each(a, b, |a, b| a * b)
}

/// The numbers of a message of two coordinates.
#[inline(always)]
pub(super) fn read<const D: usize>(message: &Gaussian<D>) -> Numbers {
    let (information, vector) = (message.information(), message.information_vector());
    [information[(0, 0)], information[(1, 0)], information[(1, 1)], vector[0], vector[1]]
}

/// One of two messages from its numbers.
#[inline(always)]
pub(super) fn write<const D: usize>(sent: [Both; 5], which: usize) -> Gaussian<D> {
    let [a, b, d, x, y] = sent.map(|both| both[which]);
    let (entries, vector) = ([a, b, b, d], [x, y]);
    Gaussian::from_information(
        SMatrix::from_fn(|row, column| entries[row + 2 * column]),
        SVector::from_fn(|row, _| vector[row]),
    )
}

/// Both messages: Λ' = J (J + Λ)⁻¹ Λ = (|J| Λ + |Λ| J) / |J + Λ|, an identity of two rows, and η' = p + J (J + Λ)⁻¹ (η - p),
/// where p is J z towards port 1 and -J z towards port 0. `inputs` holds what each message is made from.
#[inline(always)]
pub(super) fn both_ways(
    own: [f64; 3],
    pull: [f64; 2],
    inputs: [Numbers; 2],
) -> Result<[Both; 5], (Port, MessageError)> {
    let [j00, j01, j11] = own.map(|entry| [entry; 2]);
    let own_determinant = [own[0] * own[2] - own[1] * own[1]; 2];
    let (p0, p1) = ([-pull[0], pull[0]], [-pull[1], pull[1]]);
    let input = |k: usize| [inputs[0][k], inputs[1][k]];
    let (l00, l01, l11, e0, e1) = (input(0), input(1), input(2), input(3), input(4));
    let (a, b, d) = (plus(j00, l00), plus(j01, l01), plus(j11, l11));
    let determinant = minus(times(a, d), times(b, b));
    let definite = |port: usize| a[port] > 0.0 && determinant[port] > 0.0;
    if !(definite(0) && definite(1)) {
        let port = usize::from(definite(0));
        return Err((port, indefinite(a[port], determinant[port])));
    }
    let scale = each([1.0; 2], determinant, |one, value| one / value);
    let other_determinant = minus(times(l00, l11), times(l01, l01));
    let information =
        |j: Both, l: Both| times(scale, plus(times(own_determinant, l), times(other_determinant, j)));
    let (r0, r1) = (minus(e0, p0), minus(e1, p1));
    let (w0, w1) = (minus(times(d, r0), times(b, r1)), minus(times(a, r1), times(b, r0)));
    Ok([
        information(j00, l00),
        information(j01, l01),
        information(j11, l11),
        plus(p0, times(scale, plus(times(j00, w0), times(j01, w1)))),
        plus(p1, times(scale, plus(times(j01, w0), times(j11, w1)))),
    ])
}

/// Why a sum of two rows is not positive definite, by its first entry and its determinant.
#[cold]
pub(super) fn indefinite(first: f64, determinant: f64) -> MessageError {
    let what = "the sum over a port";
    // A NaN is no positive pivot either.
    let (pivot, value) = if first > 0.0 { (1, determinant / first) } else { (0, first) };
    MessageError::NotPositiveDefinite { what, pivot, value }
}
