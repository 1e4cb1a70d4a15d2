//! Densities of a mixture at many points, with a bound on the error.
//!
//! Points are sorted into groups that lie near each other. For each group a KD tree over the components says which
//! of them matter: a node whose whole share stays below the tolerance is left out, a tight node far smaller than
//! its kernels is replaced by its Taylor expansion to second order, and what remains is summed with one point per
//! vector lane. On a line, many points close together are interpolated from a few. (Gray and Moore 2000, "N-body problems in statistical learning"; Lee, Gray, Moore 2005, "Dual-tree
//! fast Gauss transforms".)

mod bounds;
mod interpolation;
mod sum;

use super::small::{Small, whitener};
use super::tree::{Tree, scale};
use super::{Mixture, size};
use crate::vector::log_sum;
use crate::vector::{greater, widest};
use bounds::Bounds;
use interpolation::Nodes;
use std::f64::consts::{PI, TAU};
use sum::Sum;
use sumprod_graph::{Coordinate, MessageError};

/// Points evaluated side by side.
pub(super) const LANES: usize = 32;

/// Components in a leaf.
const LEAF: usize = 16;

/// Relative accuracy of [`Evaluator::log_densities`].
const FULL: f64 = 1e-16;

/// A mixture prepared for being evaluated at many points.
pub struct Evaluator<'a> {
    mixture: &'a Mixture,
    tree: Tree,
    nodes: Vec<Bounds>,
    /// Numbers per component: log factor, mean, and where it has its own the packed whitener.
    width: usize,
    components: Vec<f64>,
    /// Whitener of a covariance that all share, when means are held whitened; else empty.
    common: Small,
}

/// A group of points that are evaluated side by side.
struct Group {
    /// By coordinate, whitened where the means are.
    points: Vec<[f64; LANES]>,
    /// How many lanes hold points of their own.
    used: usize,
    /// Box in the mixture's coordinates, and in those of the points.
    centre: Small,
    half: Small,
    white_centre: Small,
    white_half: Small,
}

impl Group {
    fn new(points: Vec<[f64; LANES]>, used: usize, low: &[f64], high: &[f64]) -> Self {
        let middle = |low: f64, high: f64| (0.5 * (low + high), 0.5 * (high - low));
        let (centre, half) = low.iter().zip(high).map(|(low, high)| middle(*low, *high)).unzip();
        let (white_centre, white_half) = points
            .iter()
            .map(|column| {
                let ends = column[..used]
                    .iter()
                    .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &x| (low.min(x), high.max(x)));
                middle(ends.0, ends.1)
            })
            .unzip();
        Self { points, used, centre, half, white_centre, white_half }
    }
}

#[derive(Default)]
struct Plan {
    /// Ranges of components.
    direct: Vec<(u32, u32)>,
    expanded: Vec<u32>,
    stack: Vec<u32>,
    lower: f64,
    upper: f64,
}

impl<'a> Evaluator<'a> {
    /// Prepares `mixture`. O(N log N).
    pub fn new(mixture: &'a Mixture) -> Self {
        let d = mixture.dimension();
        let tree = Tree::of(mixture, LEAF);
        let angles = mixture.coordinates().contains(&Coordinate::Angle);
        let shared = mixture.shared_covariance().and_then(|matrix| whitener(matrix, d));
        let log_scale = -0.5 * d as f64 * TAU.ln();
        let triangle = d * (d + 1) / 2;
        let whitened = shared.is_some() && !angles;
        let width = if whitened { 1 + d } else { 1 + d + triangle };
        let mut components = Vec::with_capacity(width * mixture.len());
        let mut heights = Vec::with_capacity(mixture.len());
        for &i in &tree.order {
            let i = i as usize;
            let own = shared.clone().or_else(|| whitener(mixture.covariance_of(i), d));
            let (matrix, log_determinant) =
                own.unwrap_or_else(|| (Small::from_elem(0.0, d * d), f64::INFINITY));
            let height = log_scale - 0.5 * log_determinant;
            heights.push(height);
            components.push(mixture.log_weights()[i] + height);
            let mean = mixture.mean_of(i);
            if whitened {
                for row in 0..d {
                    components.push((0..=row).map(|k| matrix[row * d + k] * mean[k]).sum());
                }
            } else {
                components.extend_from_slice(mean);
                for row in 0..d {
                    components.extend_from_slice(&matrix[row * d..=row * d + row]);
                }
            }
        }
        let common =
            if whitened { shared.map(|(matrix, _)| matrix).unwrap_or_default() } else { Small::new() };
        let mut evaluator = Self { mixture, tree, nodes: Vec::new(), width, components, common };
        // Children come after their parents, so that backwards each node finds its children's bounds.
        let mut nodes: Vec<Bounds> = Vec::with_capacity(evaluator.tree.nodes.len());
        let last = evaluator.tree.nodes.len() - 1;
        for node in evaluator.tree.nodes.iter().rev() {
            nodes.push(match node.child as usize {
                0 => evaluator.leaf_bounds(node.range(), &heights),
                child => nodes[last - child].joined(&nodes[last - child - 1]),
            });
        }
        nodes.reverse();
        evaluator.nodes = nodes;
        evaluator
    }

    /// Log densities at `points` (point by point), to a relative error of about 1e-14.
    ///
    /// # Errors
    ///
    /// Where the points' size does not fit `out`.
    pub fn log_densities(&self, points: &[f64], out: &mut [f64]) -> Result<(), MessageError> {
        self.log_densities_within(points, FULL, out)
    }

    /// Log densities at `points`, every density within `tolerance` of the exact one, relatively. O(M log N) for
    /// tolerances and kernels that let whole nodes be expanded or left out, at worst O(M N).
    ///
    /// # Errors
    ///
    /// Where the points' size does not fit `out`.
    pub fn log_densities_within(
        &self,
        points: &[f64],
        tolerance: f64,
        out: &mut [f64],
    ) -> Result<(), MessageError> {
        size("the points", points.len(), out.len() * self.mixture.dimension())?;
        if out.is_empty() {
            return Ok(());
        }
        self.evaluate(points, &Tree::new(points, &scale(self.mixture), LANES), tolerance, out)
    }

    /// As [`Evaluator::log_densities_within`] for points that a tree with leaves of at most [`LANES`] has sorted.
    pub(super) fn evaluate(
        &self,
        points: &[f64],
        order: &Tree,
        tolerance: f64,
        out: &mut [f64],
    ) -> Result<(), MessageError> {
        size("the points", points.len(), out.len() * self.mixture.dimension())?;
        let tolerance = tolerance.max(FULL);
        let mut plan = Plan::default();
        let mut stack = vec![0];
        while let Some(number) = stack.pop() {
            let node = &order.nodes[number];
            let members = &order.order[node.range()];
            if let Some(nodes) = Nodes::new(self, points, members, tolerance) {
                let (shift, sums) = self.sums(&nodes.group, 0.5 * tolerance, &mut plan);
                if let Some(sums) = sums {
                    for &i in members {
                        out[i as usize] = shift + nodes.at(&sums, points[i as usize]).ln();
                    }
                    continue;
                }
            }
            if node.child != 0 {
                stack.extend([node.child as usize, node.child as usize + 1]);
                continue;
            }
            let group = self.group(points, members);
            match self.sums(&group, tolerance, &mut plan) {
                (shift, Some(sums)) => {
                    for (sum, &i) in sums.iter().zip(members) {
                        out[i as usize] = shift + sum.ln();
                    }
                }
                (_, None) => {
                    for (lane, &i) in members.iter().enumerate() {
                        out[i as usize] = self.one(&group, lane, &plan);
                    }
                }
            }
        }
        Ok(())
    }

    /// Densities at a group's points, each times e to minus the shift; none where no one shift suits them all.
    fn sums(&self, group: &Group, tolerance: f64, plan: &mut Plan) -> (f64, Option<[f64; LANES]>) {
        self.plan(group, tolerance, plan);
        let shift = plan.lower.max(plan.upper - 600.0);
        if shift - plan.lower > 600.0 {
            return (shift, None);
        }
        let mut sums = [0.0; LANES];
        widest(Sum { evaluator: self, group, plan, shift, sums: &mut sums });
        (shift, Some(sums))
    }

    fn group(&self, points: &[f64], members: &[u32]) -> Group {
        let d = self.mixture.dimension();
        let mut low = Small::from_elem(f64::INFINITY, d);
        let mut high = Small::from_elem(f64::NEG_INFINITY, d);
        let mut columns = vec![[0.0; LANES]; d];
        for lane in 0..LANES {
            let i = members[lane.min(members.len() - 1)] as usize;
            let point = &points[i * d..][..d];
            for k in 0..d {
                low[k] = low[k].min(point[k]);
                high[k] = high[k].max(point[k]);
                columns[k][lane] = if self.common.is_empty() {
                    point[k]
                } else {
                    (0..=k).map(|c| self.common[k * d + c] * point[c]).sum()
                };
            }
        }
        Group::new(columns, members.len(), &low, &high)
    }

    fn plan(&self, group: &Group, tolerance: f64, plan: &mut Plan) {
        plan.direct.clear();
        plan.expanded.clear();
        plan.upper = f64::NEG_INFINITY;
        plan.lower = self.lower(group);
        let cut = plan.lower + (0.5 * tolerance).ln();
        plan.stack.clear();
        plan.stack.push(0);
        while let Some(number) = plan.stack.pop() {
            let (node, bounds) = (&self.tree.nodes[number as usize], &self.nodes[number as usize]);
            let reach = bounds.peak - 0.5 * self.nearest(group, bounds);
            if reach < cut {
                continue;
            }
            let expandable = tolerance > 100.0 * FULL;
            if expandable && self.expands(group, number as usize, reach - plan.lower, 0.5 * tolerance) {
                plan.expanded.push(number);
                plan.upper = plan.upper.max(reach);
            } else if node.child == 0 {
                plan.upper = plan.upper.max(reach + bounds.weight);
                match plan.direct.last_mut() {
                    Some(last) if last.1 == node.begin => last.1 = node.end,
                    _ => plan.direct.push((node.begin, node.end)),
                }
            } else {
                // The right child below the left one, so that ranges come in order.
                plan.stack.push(node.child + 1);
                plan.stack.push(node.child);
            }
        }
    }

    /// Least squared Mahalanobis distance between the group's box and the node's, from below.
    fn nearest(&self, group: &Group, bounds: &Bounds) -> f64 {
        let (mut squared, mut farthest) = (0.0, 0.0);
        for k in 0..self.mixture.dimension() {
            let mut offset = (group.centre[k] - bounds.centre[k]).abs();
            if self.mixture.coordinates()[k] == Coordinate::Angle && offset > PI {
                offset = (offset - TAU * (offset / TAU).round()).abs();
            }
            let distance = (offset - bounds.half[k] - group.half[k]).max(0.0);
            squared += distance * distance;
            farthest = greater(distance * distance / bounds.variance[k], farthest);
        }
        greater(farthest, squared / bounds.row_sum)
    }

    /// Whether the expansion's error stays below `tolerance`, relative to the density wherever it is least. With y
    /// the point seen from the node's mean and r the node's radius, both whitened, the exponent moves by at most
    /// β = |y| r + r²/2 and the series left out is at most β³ e^β / 6 + |y| r³ / 2 + r⁴ / 8.
    fn expands(&self, group: &Group, number: usize, reach: f64, tolerance: f64) -> bool {
        let Some(expansion) = self.expansion(number) else { return false };
        let r = expansion.radius;
        let mut farthest: f64 = 0.0;
        for lane in 0..group.used {
            let squared: f64 =
                group.points.iter().zip(&expansion.mean).map(|(column, m)| (column[lane] - m).powi(2)).sum();
            farthest = farthest.max(squared);
        }
        let y = farthest.sqrt();
        let beta = y * r + 0.5 * r * r;
        let error = beta.powi(3) * beta.exp() / 6.0 + 0.5 * y * r.powi(3) + r.powi(4) / 8.0;
        error * reach.min(0.0).exp() < tolerance && error < 0.1
    }

    /// A lower bound of the log density at every point of the group, from the components of the nearest leaf.
    fn lower(&self, group: &Group) -> f64 {
        let range = self.tree.nodes[self.leaf(group)].range();
        let logs: smallvec::SmallVec<[f64; LEAF]> = self.components
            [range.start * self.width..range.end * self.width]
            .chunks_exact(self.width)
            .map(|component| {
                let mut farthest: f64 = 0.0;
                if !self.common.is_empty() {
                    for (k, centre) in group.white_centre.iter().enumerate() {
                        let distance = (centre - component[1 + k]).abs() + group.white_half[k];
                        farthest += distance * distance;
                    }
                    return component[0] - 0.5 * farthest;
                }
                for lane in 0..group.used {
                    farthest = farthest.max(self.squared(component, group, lane));
                }
                component[0] - 0.5 * farthest
            })
            .collect();
        log_sum(&logs)
    }

    /// The leaf nearest to the group's centre, descending by boxes.
    fn leaf(&self, group: &Group) -> usize {
        let d = self.mixture.dimension();
        let mut number = 0;
        while self.tree.nodes[number].child != 0 {
            let child = self.tree.nodes[number].child as usize;
            let distance = |bounds: &Bounds| -> f64 {
                (0..d)
                    .map(|k| {
                        let mut offset = (group.centre[k] - bounds.centre[k]).abs();
                        if self.mixture.coordinates()[k] == Coordinate::Angle && offset > PI {
                            offset = (offset - TAU * (offset / TAU).round()).abs();
                        }
                        ((offset - bounds.half[k]).max(0.0) + 1e-3 * offset).powi(2) / bounds.variance[k]
                    })
                    .sum()
            };
            number = if distance(&self.nodes[child]) <= distance(&self.nodes[child + 1]) {
                child
            } else {
                child + 1
            };
        }
        number
    }

    /// Squared Mahalanobis distance of one point and one component.
    #[inline]
    fn squared(&self, component: &[f64], group: &Group, lane: usize) -> f64 {
        let d = self.mixture.dimension();
        if !self.common.is_empty() {
            return (0..d).map(|k| (group.points[k][lane] - component[1 + k]).powi(2)).sum();
        }
        let mut squared = 0.0;
        let mut entry = 1 + d;
        for row in 0..d {
            let mut white = 0.0;
            for k in 0..=row {
                let mut offset = group.points[k][lane] - component[1 + k];
                if self.mixture.coordinates()[k] == Coordinate::Angle {
                    offset = crate::vector::wrap(offset);
                }
                white += component[entry] * offset;
                entry += 1;
            }
            squared += white * white;
        }
        squared
    }

    /// One point with its own shift, where a group spans too many orders of magnitude.
    fn one(&self, group: &Group, lane: usize, plan: &Plan) -> f64 {
        let mut logs = Vec::new();
        for &(begin, end) in &plan.direct {
            let range = begin as usize * self.width..end as usize * self.width;
            for component in self.components[range].chunks_exact(self.width) {
                logs.push(component[0] - 0.5 * self.squared(component, group, lane));
            }
        }
        for &number in &plan.expanded {
            if let Some(expansion) = self.expansion(number as usize) {
                let offset: Small =
                    expansion.mean.iter().zip(&group.points).map(|(m, column)| column[lane] - m).collect();
                let squared: f64 = offset.iter().map(|x| x * x).sum();
                logs.push(expansion.log_factor - 0.5 * squared + expansion.factor(&offset).ln());
            }
        }
        log_sum(&logs)
    }
}
