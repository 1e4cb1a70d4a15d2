//! Joint draws of a step's posterior: a trajectory from its belief, each landmark given it from its clique, weighed by
//! the exact factors.
//!
//! With q(x) Πⱼ qⱼ(lⱼ | x) the density drawn from, a draw has the weight
//! w = p(x) Πⱼ Πᵣ N(zᵣ; |lⱼ - p(r)|, σᵣ²) / (q(x) Πⱼ qⱼ(lⱼ | x)): the mean weight estimates the evidence, and draws
//! chosen by weight are draws of the posterior, whatever linearisation and Laplace approximation have left out.

use rand::RngExt;
use rand::seq::SliceRandom;
use rand_distr::{Distribution, StandardNormal};
use std::f64::consts::TAU;
use sumprod_graph::{FastStream, MessageError, Space};
use sumprod_messages::Conditional;
use sumprod_optimizers::{Reselection, Systematic};

use super::solve::Beliefs;
use super::steps::{Exact, Seen};

/// Draws that each one kept is chosen from.
const CANDIDATES: usize = 2;
/// Density between two modes, against that of the lower one, from which they are told as one.
const VALLEY: f64 = 0.5;

/// Joint draws of equal weight.
pub(super) struct Draws {
    /// Coordinates of one draw: the trajectory's and each landmark's two.
    width: usize,
    /// Draw by draw.
    points: Vec<f64>,
    /// Log of the integral of all factors.
    pub(super) log_evidence: f64,
    /// Effective number of the weighted draws that these were chosen from.
    pub(super) effective: f64,
    /// Parts of each landmark's clique, heaviest first, by their shares of the posterior.
    pub(super) parts: Vec<Vec<f64>>,
}

impl Draws {
    /// One coordinate of all draws.
    pub(super) fn coordinate(&self, coordinate: usize) -> impl Iterator<Item = f64> + '_ {
        self.points.iter().skip(coordinate).step_by(self.width).copied()
    }
}

/// Draws `count` times. `weighed` chooses draws by their weights; otherwise the beliefs are taken at their word.
///
/// # Errors
///
/// Where a covariance is not positive definite, or every weight vanishes.
pub(super) fn draw(
    space: &Space,
    beliefs: &Beliefs,
    exact: &Exact,
    seen: &[Seen],
    count: usize,
    weighed: bool,
    random: &mut FastStream,
) -> Result<Draws, MessageError> {
    let proposal = Proposal::new(beliefs, seen)?;
    let candidates = if weighed { CANDIDATES * count } else { count };
    let n = beliefs.trajectory.dimension();
    let width = n + 2 * seen.len();
    let mut strata: Vec<Vec<usize>> = seen.iter().map(|_| (0..candidates).collect()).collect();
    // Each landmark's components are visited evenly, and independently of the other landmarks'.
    strata.iter_mut().for_each(|order| order.shuffle(random));
    let mut points = vec![0.0; candidates * width];
    let mut log_weights = Vec::with_capacity(candidates);
    let mut labels = Vec::with_capacity(candidates * seen.len());
    let Proposal { mut cliques, trajectory } = proposal;
    for (number, point) in points.chunks_exact_mut(width).enumerate() {
        let (poses, landmarks) = point.split_at_mut(n);
        let mut log_weight = -trajectory.draw(poses, random);
        log_weight += exact.log_density(poses);
        for (j, landmark) in landmarks.chunks_exact_mut(2).enumerate() {
            let positions: Vec<f64> = seen[j].clique.positions().iter().map(|&k| poses[k]).collect();
            let uniform = (strata[j][number] as f64 + random.random::<f64>()) / candidates as f64;
            let drawn = cliques[j].draw(&positions, uniform, random, landmark)?;
            labels.push(drawn.component);
            log_weight +=
                seen[j].clique.log_density(&positions, [landmark[0], landmark[1]]) - drawn.log_density;
        }
        space.wrap(poses);
        log_weights.push(log_weight);
    }
    let largest = log_weights.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    if !largest.is_finite() || log_weights.iter().any(|log| log.is_nan()) {
        let remedy = "raise the number of components of form.range";
        return Err(MessageError::NoWeight { what: "the joint draws", largest, remedy });
    }
    let weights: Vec<f64> = log_weights.iter().map(|log| (log - largest).exp()).collect();
    let total: f64 = weights.iter().sum();
    let squares: f64 = weights.iter().map(|weight| weight * weight).sum();
    let shares: Vec<f64> = weights.iter().map(|weight| weight / total).collect();
    let uniform = vec![1.0 / candidates as f64; candidates];
    let believed = if weighed { &shares } else { &uniform };
    let parts = (0..seen.len())
        .map(|j| {
            let component = |number: usize| labels[number * seen.len() + j];
            part_shares(beliefs, j, believed, component)
        })
        .collect::<Result<_, _>>()?;
    let mut chosen: Vec<usize> =
        if weighed { Systematic.choose(&shares, count, random) } else { (0..count).collect() };
    // Whoever reads the first half of the draws should see the whole posterior.
    chosen.shuffle(random);
    let points = chosen.iter().flat_map(|&number| &points[number * width..][..width]).copied().collect();
    let log_evidence = largest + (total / candidates as f64).ln();
    Ok(Draws { width, points, log_evidence, effective: total * total / squares, parts })
}

/// The share of each part of a landmark's mixture, heaviest first; parts below a thousandth are left out.
fn part_shares(
    beliefs: &Beliefs,
    landmark: usize,
    shares: &[f64],
    component: impl Fn(usize) -> usize,
) -> Result<Vec<f64>, MessageError> {
    let clique = &beliefs.cliques[landmark];
    let d = clique.dimension();
    let parts = clique.marginal(&[d - 2, d - 1])?.parts(VALLEY)?;
    let mut sums = vec![0.0; parts.iter().max().map_or(0, |most| most + 1)];
    for (number, share) in shares.iter().enumerate() {
        sums[parts[component(number)]] += share;
    }
    sums.retain(|&share| share >= 1e-3);
    sums.sort_by(|a, b| b.total_cmp(a));
    Ok(sums)
}

/// What is drawn from.
struct Proposal {
    trajectory: Trajectory,
    cliques: Vec<Conditional>,
}

impl Proposal {
    fn new(beliefs: &Beliefs, seen: &[Seen]) -> Result<Self, MessageError> {
        let given = |j: usize| seen[j].clique.positions().len();
        let conditionals = beliefs.cliques.iter().enumerate();
        let cliques: Result<_, _> = conditionals.map(|(j, clique)| clique.given_first(given(j))).collect();
        Ok(Self { trajectory: Trajectory::new(beliefs)?, cliques: cliques? })
    }
}

/// A Gaussian over the trajectory, its angles not wrapped.
struct Trajectory {
    mean: Vec<f64>,
    factor: sumprod_messages::Cholesky,
    log_peak: f64,
}

impl Trajectory {
    fn new(beliefs: &Beliefs) -> Result<Self, MessageError> {
        let d = beliefs.trajectory.dimension();
        let mut mean = vec![0.0; d];
        beliefs.trajectory.mean_into(&mut mean)?;
        let factor = beliefs.trajectory.factor()?;
        let log_peak = 0.5 * (factor.log_determinant() - d as f64 * TAU.ln());
        Ok(Self { mean, factor, log_peak })
    }

    /// Draws into `out` and returns the log density. With information L L', a draw is mean + L⁻ᵀ z.
    fn draw(&self, out: &mut [f64], random: &mut FastStream) -> f64 {
        let mut squared = 0.0;
        for value in out.iter_mut() {
            *value = StandardNormal.sample(random);
            squared += *value * *value;
        }
        self.factor.solve_upper(out);
        out.iter_mut().zip(&self.mean).for_each(|(x, mean)| *x += mean);
        self.log_peak - 0.5 * squared
    }
}
