//! Directions of ranges at known positions, from which the bound and the free directions of a network follow.

use nalgebra::DMatrix;

use super::network::DIMENSION;
use super::world::{Slice, State};

/// The gradient of one range with respect to the positions of its ends: a unit vector for the first agent and its
/// negative for the other; `None` where an anchor is the other end. Coincident ends have no direction.
pub(super) fn directions<'a>(
    slice: &'a Slice,
    states: &'a [State],
    anchors: &'a [[f64; 2]],
) -> impl Iterator<Item = (usize, Option<usize>, [f64; 2])> + 'a {
    let position = |agent: usize| [states[agent][0], states[agent][2]];
    let among = slice.ranges.iter().map(move |range| {
        let [a, b] = range.agents;
        (a, Some(b), position(a), position(b))
    });
    let to_anchors = slice
        .anchor_ranges
        .iter()
        .map(move |range| (range.agent, None, position(range.agent), anchors[range.anchor]));
    among.chain(to_anchors).map(|(own, other, a, b)| {
        let (dx, dy) = (a[0] - b[0], a[1] - b[1]);
        let length = dx.hypot(dy).max(f64::MIN_POSITIVE);
        (own, other, [dx / length, dy / length])
    })
}

/// Adds H'H / r to `information` (n by n), H the Jacobian of the ranges at `states`, r their variance (m²).
pub(super) fn add_information(
    information: &mut DMatrix<f64>,
    slice: &Slice,
    states: &[State],
    anchors: &[[f64; 2]],
    variance: f64,
) {
    for (own, other, direction) in directions(slice, states, anchors) {
        let ends = std::iter::once((own, 1.0)).chain(other.map(|other| (other, -1.0)));
        let gradient: Vec<(usize, f64)> = ends
            .flat_map(|(agent, sign)| {
                [0, 1].map(|axis| (DIMENSION * agent + 2 * axis, sign * direction[axis]))
            })
            .collect();
        for &(row, a) in &gradient {
            for &(column, b) in &gradient {
                information[(row, column)] += a * b / variance;
            }
        }
    }
}
