//! Densities of a mixture at many points, with a bound on the error.
//!
//! Points are sorted into groups that lie near each other. For each group a KD tree over the components says which
//! of them matter: a node whose whole share stays below the tolerance is left out, a tight node far smaller than
//! its kernels is replaced by its Taylor expansion to second order, and what remains is summed with one point per
//! vector lane. (Gray and Moore 2000, "N-body problems in statistical learning"; Lee, Gray, Moore 2005, "Dual-tree
//! fast Gauss transforms".)

use super::small::{Small, log_sum, whitener};
use super::tree::{Tree, scale};
use super::vector::{exp, greater, widest};
use super::{Mixture, size};
use std::f64::consts::{PI, TAU};
use sumprod_graph::{Coordinate, MessageError};

/// Points evaluated side by side.
const LANES: usize = 32;

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

/// What is known of a node without looking into it.
struct Bounds {
    centre: Small,
    half: Small,
    variance: Small,
    row_sum: f64,
    /// Largest log of a kernel's height, weight apart.
    peak: f64,
    /// Largest log weight.
    weight: f64,
    expansion: Option<Expansion>,
}

/// Second-order expansion of a node about its mean, in whitened coordinates.
struct Expansion {
    log_factor: f64,
    mean: Small,
    /// Lower triangle of the covariance of the means, off-diagonal entries doubled.
    spread: Small,
    radius: f64,
}

/// A group of points that are evaluated side by side.
struct Group {
    /// By coordinate, whitened where the means are.
    points: Vec<[f64; LANES]>,
    /// In the mixture's coordinates.
    centre: Small,
    half: Small,
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
            let (matrix, log_determinant) = own.unwrap_or_else(|| (Small::from_elem(0.0, d * d), f64::INFINITY));
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
        let common = if whitened { shared.map(|(matrix, _)| matrix).unwrap_or_default() } else { Small::new() };
        let mut evaluator = Self { mixture, tree, nodes: Vec::new(), width, components, common };
        evaluator.nodes =
            evaluator.tree.nodes.iter().map(|node| evaluator.bounds(node.range(), &heights)).collect();
        evaluator
    }

    fn bounds(&self, range: std::ops::Range<usize>, heights: &[f64]) -> Bounds {
        let mixture = self.mixture;
        let d = mixture.dimension();
        let mut low = Small::from_elem(f64::INFINITY, d);
        let mut high = Small::from_elem(f64::NEG_INFINITY, d);
        let mut variance = Small::from_elem(0.0, d);
        let mut row_sum: f64 = 0.0;
        let (mut peak, mut weight) = (f64::NEG_INFINITY, f64::NEG_INFINITY);
        for position in range.clone() {
            let i = self.tree.order[position] as usize;
            for (k, &x) in mixture.mean_of(i).iter().enumerate() {
                low[k] = low[k].min(x);
                high[k] = high[k].max(x);
            }
            peak = peak.max(heights[position]);
            weight = weight.max(mixture.log_weights()[i]);
            if !mixture.shared || position == range.start {
                let matrix = mixture.covariance_of(i);
                for k in 0..d {
                    variance[k] = variance[k].max(matrix[k * d + k]);
                    row_sum = row_sum.max(matrix[k * d..][..d].iter().map(|entry| entry.abs()).sum());
                }
            }
        }
        let centre: Small = low.iter().zip(&high).map(|(a, b)| 0.5 * (a + b)).collect();
        let half: Small = low.iter().zip(&high).map(|(a, b)| 0.5 * (b - a)).collect();
        let expansion = (range.len() > 4 && !self.common.is_empty())
            .then(|| self.expansion(range, heights[0]))
            .filter(|expansion| expansion.radius < 1.0);
        Bounds { centre, half, variance, row_sum, peak, weight, expansion }
    }

    fn expansion(&self, range: std::ops::Range<usize>, height: f64) -> Expansion {
        let d = self.mixture.dimension();
        let rows = || self.components[range.start * self.width..range.end * self.width].chunks_exact(self.width);
        let logs: Vec<f64> = rows().map(|row| row[0] - height).collect();
        let log_weight = log_sum(&logs);
        let shares: Vec<f64> = logs.iter().map(|log| (log - log_weight).exp()).collect();
        let mut mean = Small::from_elem(0.0, d);
        for (row, share) in rows().zip(&shares) {
            mean.iter_mut().zip(&row[1..]).for_each(|(m, x)| *m += share * x);
        }
        let mut spread = Small::from_elem(0.0, d * (d + 1) / 2);
        let mut radius: f64 = 0.0;
        for (row, share) in rows().zip(&shares) {
            let offset: Small = row[1..].iter().zip(&mean).map(|(x, m)| x - m).collect();
            radius = radius.max(offset.iter().map(|x| x * x).sum());
            for r in 0..d {
                for c in 0..=r {
                    let factor = if r == c { *share } else { 2.0 * share };
                    spread[r * (r + 1) / 2 + c] += factor * offset[r] * offset[c];
                }
            }
        }
        Expansion { log_factor: log_weight + height, mean, spread, radius: radius.sqrt() }
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
        let d = self.mixture.dimension();
        size("the points", points.len(), out.len() * d)?;
        if out.is_empty() {
            return Ok(());
        }
        let order = Tree::new(points, &scale(self.mixture), LANES);
        let mut plan = Plan::default();
        let mut sums = [0.0; LANES];
        for node in order.nodes.iter().filter(|node| node.child == 0) {
            let members = &order.order[node.range()];
            let group = self.group(points, members);
            self.plan(&group, tolerance.max(FULL), &mut plan);
            let shift = plan.lower.max(plan.upper - 600.0);
            if shift - plan.lower > 600.0 {
                for (lane, &i) in members.iter().enumerate() {
                    out[i as usize] = self.one(&group, lane, &plan);
                }
                continue;
            }
            widest(Sum { evaluator: self, group: &group, plan: &plan, shift, sums: &mut sums });
            for (sum, &i) in sums.iter().zip(members) {
                out[i as usize] = shift + sum.ln();
            }
        }
        Ok(())
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
        let centre = low.iter().zip(&high).map(|(a, b)| 0.5 * (a + b)).collect();
        let half = low.iter().zip(&high).map(|(a, b)| 0.5 * (b - a)).collect();
        Group { points: columns, centre, half }
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
            let expandable = tolerance > 100.0 * FULL && bounds.expansion.is_some();
            if expandable && self.expands(group, bounds, reach - plan.lower, 0.5 * tolerance) {
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
    fn expands(&self, group: &Group, bounds: &Bounds, reach: f64, tolerance: f64) -> bool {
        let Some(expansion) = &bounds.expansion else { return false };
        let r = expansion.radius;
        let mut farthest: f64 = 0.0;
        for lane in 0..LANES {
            let squared: f64 =
                group.points.iter().zip(&expansion.mean).map(|(column, m)| (column[lane] - m).powi(2)).sum();
            farthest = farthest.max(squared);
        }
        let y = farthest.sqrt();
        let beta = y * r + 0.5 * r * r;
        let error = beta.powi(3) * beta.exp() / 6.0 + 0.5 * y * r.powi(3) + r.powi(4) / 8.0;
        error * reach.min(0.0).exp() < tolerance && error < 0.1
    }

    /// A lower bound of the log density over the group's box, from the components of the nearest leaf.
    fn lower(&self, group: &Group) -> f64 {
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
            number = if distance(&self.nodes[child]) <= distance(&self.nodes[child + 1]) { child } else { child + 1 };
        }
        let range = self.tree.nodes[number].range();
        let logs: smallvec::SmallVec<[f64; LEAF]> = self.components
            [range.start * self.width..range.end * self.width]
            .chunks_exact(self.width)
            .map(|component| {
                let mut farthest: f64 = 0.0;
                for lane in 0..LANES {
                    farthest = farthest.max(self.squared(component, group, lane));
                }
                component[0] - 0.5 * farthest
            })
            .collect();
        log_sum(&logs)
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
                    offset = super::vector::wrap(offset);
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
            if let Some(expansion) = &self.nodes[number as usize].expansion {
                let offset: Small =
                    expansion.mean.iter().zip(&group.points).map(|(m, column)| column[lane] - m).collect();
                let squared: f64 = offset.iter().map(|x| x * x).sum();
                logs.push(expansion.log_factor - 0.5 * squared + expansion.factor(&offset).ln());
            }
        }
        log_sum(&logs)
    }
}

impl Expansion {
    /// 1 + ½ (y'Sy - tr S).
    fn factor(&self, offset: &[f64]) -> f64 {
        let mut sum = 0.0;
        for row in 0..offset.len() {
            for column in 0..=row {
                let entry = self.spread[row * (row + 1) / 2 + column];
                sum += entry * (offset[row] * offset[column] - f64::from(u8::from(row == column)));
            }
        }
        1.0 + 0.5 * sum
    }
}

/// The sums of one group.
struct Sum<'a> {
    evaluator: &'a Evaluator<'a>,
    group: &'a Group,
    plan: &'a Plan,
    shift: f64,
    sums: &'a mut [f64; LANES],
}

impl pulp::NullaryFnOnce for Sum<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let angles = self.evaluator.mixture.coordinates().contains(&Coordinate::Angle);
        let whitened = !self.evaluator.common.is_empty();
        match (self.evaluator.mixture.dimension(), whitened, angles) {
            (1, true, _) => self.run::<1, true, false>(),
            (2, true, _) => self.run::<2, true, false>(),
            (3, true, _) => self.run::<3, true, false>(),
            (1, false, false) => self.run::<1, false, false>(),
            (2, false, false) => self.run::<2, false, false>(),
            (3, false, false) => self.run::<3, false, false>(),
            (1, false, true) => self.run::<1, false, true>(),
            (2, false, true) => self.run::<2, false, true>(),
            (3, false, true) => self.run::<3, false, true>(),
            _ => self.run_any_dimension(),
        }
    }
}

impl Sum<'_> {
    #[inline(always)]
    fn run<const D: usize, const WHITE: bool, const ANGLES: bool>(self) {
        let Some(columns) = self.group.points.first_chunk::<D>() else { return };
        let mut turns = [0.0; D];
        let mut inverse = [0.0; D];
        for (k, kind) in self.evaluator.mixture.coordinates().iter().enumerate().take(D) {
            if *kind == Coordinate::Angle {
                (turns[k], inverse[k]) = (TAU, 1.0 / TAU);
            }
        }
        let mut sums = [0.0; LANES];
        let width = self.evaluator.width;
        for &(begin, end) in &self.plan.direct {
            let range = begin as usize * width..end as usize * width;
            for component in self.evaluator.components[range].chunks_exact(width) {
                let constant = component[0] - self.shift;
                let mut mean = [0.0; D];
                let mut matrix = [[0.0; D]; D];
                for row in 0..D {
                    mean[row] = component[1 + row];
                    if !WHITE {
                        for column in 0..=row {
                            matrix[row][column] = component[1 + D + row * (row + 1) / 2 + column];
                        }
                    }
                }
                for lane in 0..LANES {
                    let mut offset = [0.0; D];
                    let mut squared = 0.0;
                    for k in 0..D {
                        offset[k] = columns[k][lane] - mean[k];
                        if ANGLES {
                            let turn = super::vector::round(offset[k] * inverse[k]);
                            offset[k] -= turns[k] * turn;
                        }
                        let mut white = offset[k];
                        if !WHITE {
                            white = 0.0;
                            for column in 0..=k {
                                white += matrix[k][column] * offset[column];
                            }
                        }
                        squared += white * white;
                    }
                    sums[lane] += exp(constant - 0.5 * squared);
                }
            }
        }
        for &number in &self.plan.expanded {
            let Some(expansion) = &self.evaluator.nodes[number as usize].expansion else { continue };
            let constant = expansion.log_factor - self.shift;
            let mut mean = [0.0; D];
            mean.copy_from_slice(&expansion.mean[..D]);
            let mut spread = [[0.0; D]; D];
            let mut trace = 0.0;
            for row in 0..D {
                for column in 0..=row {
                    spread[row][column] = expansion.spread[row * (row + 1) / 2 + column];
                }
                trace += spread[row][row];
            }
            for lane in 0..LANES {
                let mut offset = [0.0; D];
                let (mut squared, mut form) = (0.0, 0.0);
                for k in 0..D {
                    offset[k] = columns[k][lane] - mean[k];
                    squared += offset[k] * offset[k];
                    for column in 0..=k {
                        form += spread[k][column] * offset[k] * offset[column];
                    }
                }
                sums[lane] += exp(constant - 0.5 * squared) * (1.0 + 0.5 * (form - trace));
            }
        }
        *self.sums = sums;
    }

    #[inline(always)]
    fn run_any_dimension(self) {
        let mut sums = [0.0; LANES];
        let width = self.evaluator.width;
        for &(begin, end) in &self.plan.direct {
            let range = begin as usize * width..end as usize * width;
            for component in self.evaluator.components[range].chunks_exact(width) {
                for (lane, sum) in sums.iter_mut().enumerate() {
                    let squared = self.evaluator.squared(component, self.group, lane);
                    *sum += exp(component[0] - self.shift - 0.5 * squared);
                }
            }
        }
        for &number in &self.plan.expanded {
            let Some(expansion) = &self.evaluator.nodes[number as usize].expansion else { continue };
            for (lane, sum) in sums.iter_mut().enumerate() {
                let offset: Small =
                    expansion.mean.iter().zip(&self.group.points).map(|(m, column)| column[lane] - m).collect();
                let squared: f64 = offset.iter().map(|x| x * x).sum();
                *sum += exp(expansion.log_factor - self.shift - 0.5 * squared) * expansion.factor(&offset);
            }
        }
        *self.sums = sums;
    }
}
