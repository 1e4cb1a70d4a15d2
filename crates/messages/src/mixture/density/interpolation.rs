//! Many points on a stretch of a line, from the density at a few Chebyshev nodes.
//!
//! With n nodes on an interval of half-width b (in kernel widths) the error is at most b^n max |p⁽ⁿ⁾| / (2^(n-1) n!). A
//! derivative of a kernel is a Hermite function, and |Heₙ(y)| e^(-y²/4) ≤ 1.09 √n! for every y (Cramér's inequality), so
//! that |p⁽ⁿ⁾| ≤ 1.09 √n! times the height that all kernels would have in one place.

use super::{Evaluator, Group, LANES};
use std::f64::consts::PI;

/// Chebyshev nodes of an interval.
pub(super) const NODES: usize = 16;

/// Fewer points than this are evaluated one by one.
const WORTHWHILE: usize = 20;

/// √16!
const ROOT_OF_FACTORIAL: f64 = 4_574_143.623;

/// (-1)^k sin((2k + 1) π / 32): the nodes' barycentric weights.
const WEIGHTS: [f64; NODES] = [
    0.0980171403295606,
    -0.29028467725446233,
    0.47139673682599764,
    -0.6343932841636455,
    0.773010453362737,
    -0.8819212643483549,
    0.9569403357322089,
    -0.9951847266721968,
    0.9951847266721969,
    -0.9569403357322089,
    0.881921264348355,
    -0.7730104533627371,
    0.6343932841636455,
    -0.47139673682599786,
    0.2902846772544624,
    -0.09801714032956083,
];

/// The nodes of one interval.
pub(super) struct Nodes {
    pub(super) group: Group,
    scale: f64,
}

impl Nodes {
    /// The nodes for the points numbered `members`; none where their error may exceed half of `tolerance`, relative
    /// to the density wherever it is least, or where evaluating them one by one is cheaper.
    pub(super) fn new(
        evaluator: &Evaluator<'_>,
        points: &[f64],
        members: &[u32],
        tolerance: f64,
    ) -> Option<Self> {
        if evaluator.mixture.dimension() != 1 || evaluator.common.is_empty() || members.len() < WORTHWHILE {
            return None;
        }
        let (low, high) = members.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &i| {
            (low.min(points[i as usize]), high.max(points[i as usize]))
        });
        let scale = evaluator.common[0];
        let (centre, half) = (0.5 * (low + high), 0.5 * (high - low));
        let width = half * scale;
        // No density makes an interval of eight kernel widths accurate enough.
        if !(width > 0.0 && width < 4.0) {
            return None;
        }
        let mut column = [0.0; LANES];
        for (lane, x) in column.iter_mut().enumerate() {
            *x = scale * (centre + half * node(lane.min(NODES - 1)));
        }
        let mut group = Group::new(vec![column], NODES, &[low], &[high]);
        // The outermost nodes lie a little inside the interval's ends.
        group.white_half[0] = width;
        let least = evaluator.lower(&group);
        let height = evaluator.nodes[0].peak;
        let order = NODES as i32;
        let error = 1.09 * width.powi(order) / (ROOT_OF_FACTORIAL * 2.0f64.powi(order - 1));
        (error.ln() + height - least < (0.5 * tolerance).ln()).then_some(Self { group, scale })
    }

    /// The interpolated value at `x`, by the barycentric formula (Berrut and Trefethen 2004, "Barycentric Lagrange
    /// interpolation", equation 5.3).
    pub(super) fn at(&self, values: &[f64; LANES], x: f64) -> f64 {
        let x = self.scale * x;
        let (mut above, mut below) = (0.0, 0.0);
        for (k, (value, place)) in values.iter().zip(&self.group.points[0]).take(NODES).enumerate() {
            let distance = x - place;
            if distance == 0.0 {
                return *value;
            }
            let weight = WEIGHTS[k] / distance;
            above += weight * value;
            below += weight;
        }
        above / below
    }
}

fn node(k: usize) -> f64 {
    ((2 * k + 1) as f64 * PI / (2 * NODES) as f64).cos()
}
