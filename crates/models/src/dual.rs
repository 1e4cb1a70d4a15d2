//! Derivatives by dual numbers.

use num_dual::{DualNum, DualSVec64};

/// A number that residuals and motions are written for: `f64` when evaluated, a dual number when differentiated.
///
/// Arithmetic with `f64` on the right works, and the functions of `f64` (`sqrt`, `sin`, `atan2`, ...) are there.
pub trait Real: DualNum<Primitive = f64> + Copy {}

impl<T: DualNum<Primitive = f64> + Copy> Real for T {}

/// Directions differentiated in one evaluation.
pub(crate) const LANES: usize = 4;

/// A dual number of [`LANES`] directions.
pub(crate) type Lanes = DualSVec64<LANES>;

/// The value and the derivative of `f` at `x` (length n): writes f (length m) and the m by n row-major Jacobian.
///
/// `f` is evaluated once per four inputs.
#[inline]
pub(crate) fn differentiate(
    x: &[f64],
    value: &mut [f64],
    jacobian: &mut [f64],
    mut f: impl FnMut(&[Lanes], &mut [Lanes]),
) {
    use smallvec::SmallVec;
    let (n, m) = (x.len(), value.len());
    let mut inputs: SmallVec<[Lanes; 12]> = x.iter().map(|&x| Lanes::from_re(x)).collect();
    let mut outputs: SmallVec<[Lanes; 6]> = SmallVec::from_elem(Lanes::from_re(0.0), m);
    for first in (0..n.max(1)).step_by(LANES) {
        let lanes = first..(first + LANES).min(n);
        for (lane, index) in lanes.clone().enumerate() {
            inputs[index] = Lanes::from_re(x[index]).derivative(lane);
        }
        f(&inputs, &mut outputs);
        for (row, output) in outputs.iter().enumerate() {
            value[row] = output.re;
            for (lane, column) in lanes.clone().enumerate() {
                jacobian[row * n + column] = output.eps.0.map_or(0.0, |eps| eps[lane]);
            }
        }
        for index in lanes {
            inputs[index] = Lanes::from_re(x[index]);
        }
    }
}
