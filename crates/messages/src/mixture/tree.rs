//! KD trees over the means of a mixture: spatial order, levels, and nodes summarised by one Gaussian each.

use super::Mixture;
use super::small::{Small, difference};
use sumprod_graph::{Coordinate, wrap_angle};

/// A node: a range of the tree's order, and its two children side by side; child zero marks a leaf.
#[derive(Clone, Copy, Debug)]
pub(super) struct Node {
    pub(super) begin: u32,
    pub(super) end: u32,
    pub(super) child: u32,
    pub(super) depth: u32,
}

impl Node {
    pub(super) fn range(&self) -> std::ops::Range<usize> {
        self.begin as usize..self.end as usize
    }
}

/// A balanced tree that halves the widest side of each node, widths measured in kernels.
pub(super) struct Tree {
    /// Component numbers, so that every node is a range.
    pub(super) order: Vec<u32>,
    /// Breadth first: parents before their children, and each depth a contiguous stretch.
    pub(super) nodes: Vec<Node>,
}

impl Tree {
    /// Builds the tree of `points` (point by point), leaves of at most `leaf` points; `scale` holds the inverse
    /// unit of each coordinate. O(N log N).
    pub(super) fn new(points: &[f64], scale: &[f64], leaf: usize) -> Self {
        let d = scale.len();
        let count = points.len() / d;
        let mut order: Vec<u32> = (0..count as u32).collect();
        let mut nodes = vec![Node { begin: 0, end: count as u32, child: 0, depth: 0 }];
        let mut next = 0;
        while next < nodes.len() {
            let node = nodes[next];
            let range = node.range();
            if range.len() > leaf.max(1) {
                let middle = range.start + range.len() / 2;
                halve(&mut order[range], points, scale);
                nodes[next].child = nodes.len() as u32;
                let depth = node.depth + 1;
                nodes.push(Node { begin: node.begin, end: middle as u32, child: 0, depth });
                nodes.push(Node { begin: middle as u32, end: node.end, child: 0, depth });
            }
            next += 1;
        }
        Self { order, nodes }
    }

    /// The tree of a mixture's means.
    pub(super) fn of(mixture: &Mixture, leaf: usize) -> Self {
        Self::new(mixture.means(), &scale(mixture), leaf)
    }

    /// Depth of the deepest leaf; the root has depth zero.
    pub(super) fn depth(&self) -> usize {
        self.nodes.last().map_or(0, |node| node.depth as usize)
    }

    /// The nodes that make up level `depth`: those of that depth, and the leaves above it, in the tree's order.
    pub(super) fn level(&self, depth: usize) -> Vec<Node> {
        let depth = depth as u32;
        let kept = |node: &&Node| node.depth == depth || (node.child == 0 && node.depth < depth);
        let mut level: Vec<Node> = self.nodes.iter().filter(kept).copied().collect();
        level.sort_by_key(|node| node.begin);
        level
    }
}

/// Inverse of the root mean kernel variance, by coordinate: what distances between kernels are measured in.
pub(super) fn scale(mixture: &Mixture) -> Small {
    let d = mixture.dimension();
    let matrices = if mixture.shared { 1 } else { mixture.len() };
    (0..d)
        .map(|k| {
            let sum: f64 = (0..matrices).map(|i| mixture.covariance_of(i)[k * d + k]).sum();
            (matrices as f64 / sum).sqrt()
        })
        .collect()
}

/// Splits `part` into a lower and an upper half along its widest side.
fn halve(part: &mut [u32], points: &[f64], scale: &[f64]) {
    let d = scale.len();
    let mut widest = (0, f64::NEG_INFINITY);
    for (k, scale) in scale.iter().enumerate() {
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for &i in part.iter() {
            let x = points[i as usize * d + k];
            low = low.min(x);
            high = high.max(x);
        }
        if (high - low) * scale > widest.1 {
            widest = (k, (high - low) * scale);
        }
    }
    let side = widest.0;
    let middle = part.len() / 2;
    part.select_nth_unstable_by(middle, |&a, &b| {
        points[a as usize * d + side].total_cmp(&points[b as usize * d + side])
    });
}

/// Weight, mean and covariance of a set of components, merged into one Gaussian of the same moments.
pub(super) struct Merged {
    pub(super) log_weight: f64,
    pub(super) mean: Small,
    pub(super) covariance: Small,
}

/// Merges the components numbered `part`, angles about the first of them; `weights` are the mixture's, or others of
/// any total. O(n d²).
pub(super) fn merge(mixture: &Mixture, weights: &[f64], part: &[u32]) -> Merged {
    let first = part[0] as usize;
    if part.len() == 1 {
        return Merged {
            log_weight: weights[first].max(f64::MIN_POSITIVE).ln(),
            mean: Small::from_slice(mixture.mean_of(first)),
            covariance: Small::from_slice(mixture.covariance_of(first)),
        };
    }
    let real = !mixture.coordinates.contains(&Coordinate::Angle);
    let (sum, shift, second) = match (mixture.dimension(), real) {
        (1, true) => sums::<1>(mixture, weights, part),
        (2, true) => sums::<2>(mixture, weights, part),
        (3, true) => sums::<3>(mixture, weights, part),
        _ => sums_of_any_dimension(mixture, weights, part),
    };
    finish(mixture, first, sum, shift, second)
}

/// Sums of weights, of weighted offsets from the first component, and of weighted second moments about it (lower
/// triangle), the kernels' own covariances included where each has its own.
fn sums<const D: usize>(mixture: &Mixture, weights: &[f64], part: &[u32]) -> (f64, Small, Small) {
    let mut reference = [0.0; D];
    reference.copy_from_slice(&mixture.mean_of(part[0] as usize)[..D]);
    let mut sum = 0.0;
    let mut shift = [0.0; D];
    let mut second = [[0.0; D]; D];
    for &i in part {
        let i = i as usize;
        // Weights may underflow; a group's total must not.
        let weight = weights[i].max(f64::MIN_POSITIVE);
        let Some(mean) = mixture.means[i * D..].first_chunk::<D>() else { continue };
        sum += weight;
        let mut offset = [0.0; D];
        for row in 0..D {
            offset[row] = mean[row] - reference[row];
            let weighted = weight * offset[row];
            shift[row] += weighted;
            for column in 0..=row {
                second[row][column] += weighted * offset[column];
            }
        }
        if !mixture.shared {
            let own = &mixture.covariances[i * D * D..][..D * D];
            for row in 0..D {
                for column in 0..=row {
                    second[row][column] += weight * own[row * D + column];
                }
            }
        }
    }
    (sum, Small::from_slice(&shift), second.iter().flatten().copied().collect())
}

fn sums_of_any_dimension(mixture: &Mixture, weights: &[f64], part: &[u32]) -> (f64, Small, Small) {
    let d = mixture.dimension();
    let reference = mixture.mean_of(part[0] as usize);
    let mut sum = 0.0;
    let mut shift = Small::from_elem(0.0, d);
    let mut second = Small::from_elem(0.0, d * d);
    let mut offset = Small::from_elem(0.0, d);
    for &i in part {
        let i = i as usize;
        let weight = weights[i].max(f64::MIN_POSITIVE);
        sum += weight;
        difference(&mixture.coordinates, mixture.mean_of(i), reference, &mut offset);
        for row in 0..d {
            let weighted = weight * offset[row];
            shift[row] += weighted;
            for column in 0..=row {
                second[row * d + column] += weighted * offset[column];
            }
        }
        if !mixture.shared {
            second.iter_mut().zip(mixture.covariance_of(i)).for_each(|(sum, entry)| *sum += weight * entry);
        }
    }
    (sum, shift, second)
}

fn finish(mixture: &Mixture, first: usize, sum: f64, mut shift: Small, mut second: Small) -> Merged {
    let d = mixture.dimension();
    let shared = mixture.shared_covariance();
    shift.iter_mut().for_each(|value| *value /= sum);
    for row in 0..d {
        for column in 0..=row {
            let kernel = shared.map_or(0.0, |matrix| matrix[row * d + column]);
            let value = second[row * d + column] / sum - shift[row] * shift[column] + kernel;
            second[row * d + column] = value;
            second[column * d + row] = value;
        }
    }
    for (k, kind) in mixture.coordinates.iter().enumerate() {
        shift[k] += mixture.mean_of(first)[k];
        if *kind == Coordinate::Angle {
            shift[k] = wrap_angle(shift[k]);
        }
    }
    Merged { log_weight: sum.ln(), mean: shift, covariance: second }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_level_holds_every_point_once() {
        let points: Vec<f64> = (0..37).map(|i| f64::from(i * 29 % 37)).collect();
        let tree = Tree::new(&points, &[1.0], 1);
        assert_eq!(tree.depth(), 6);
        for depth in 0..=tree.depth() {
            let level = tree.level(depth);
            assert!(level.windows(2).all(|pair| pair[0].end == pair[1].begin));
            assert_eq!((level[0].begin, level[level.len() - 1].end), (0, 37));
            // Each node lies wholly below the next.
            for pair in level.windows(2) {
                let of = |node: &Node| tree.order[node.range()].iter().map(|&i| points[i as usize]);
                let highest = of(&pair[0]).fold(f64::MIN, f64::max);
                assert!(of(&pair[1]).all(|x| x > highest));
            }
        }
        assert_eq!(tree.level(tree.depth()).len(), 37);
    }
}
