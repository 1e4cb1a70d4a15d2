//! The joint posterior of a network's positions, on parts of it: its energy, its modes, and how wide they are.
//!
//! The energy of positions x is their negative log posterior,
//!
//! E(x) = ½ Σ (|xᵢ - xⱼ| - zᵢⱼ)² / r + ½ Σ |xᵢ - sᵢ|² / s² - Σ ln(1 - (1 - m) P(|xᵢ - xⱼ| ≤ R)),
//!
//! over the ranges z, the weak starts sᵢ, and the pairs that did not measure each other. A part is a list of agents,
//! ascending; everybody else stays in place.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn, Matrix2, Vector2};

use super::world::{Draw, World};
use crate::cooperation::links::Reach;

/// Newton steps in which a part settles, at most; nearly all take fewer than ten.
const STEPS: usize = 30;
/// Gain of a step (nats) up to which a part has settled.
const SETTLED: f64 = 1e-4;
/// Damping beyond which no step helps.
const STIFFEST: f64 = 1e6;
/// Deviation of a node in parts of a range up to which its direction is known.
const PLACE: f64 = 0.5;
/// Deviation of a node (m) above which its place says nothing about who should have heard it.
const VAGUE: f64 = 3.0;
/// Deviation of a distance (m) by which the step at the reach is rounded: that of the positions.
const EDGE: f64 = 0.5;
/// Distance beyond the reach (m) at which silence is no news.
const BEYOND: f64 = 2.0;
/// Slope of the logistic function nearest to the normal distribution function.
const LOGISTIC: f64 = 1.702;

/// A range to another node.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Link {
    /// The node: agents, then anchors.
    pub(super) node: usize,
    /// The range (m).
    pub(super) measured: f64,
}

/// Probability that a link in reach fails, at least: a lattice's cells and a neighbour's wrong belief are no proof.
const LEAST_LOSS: f64 = 1e-3;

/// Probability that a link in reach fails; none where silence is no evidence.
pub(super) fn missed(world: &World) -> Option<f64> {
    world.silence.then(|| world.link_loss.max(LEAST_LOSS))
}

/// Whom each agent measures.
pub(super) fn links(draw: &Draw) -> Vec<Vec<Link>> {
    let agents = draw.truth.len();
    let mut links = vec![Vec::new(); agents];
    for range in &draw.ranges {
        let ([a, b], measured) = (range.agents, range.measured);
        links[a].push(Link { node: b, measured });
        links[b].push(Link { node: a, measured });
    }
    for range in &draw.anchor_ranges {
        links[range.agent].push(Link { node: agents + range.anchor, measured: range.measured });
    }
    links
}

/// The posterior, and the state it is looked at from.
#[derive(Clone, Debug)]
pub(super) struct Posterior {
    /// Positions of agents, then anchors (m).
    pub(super) places: Vec<[f64; 2]>,
    /// Covariances of the same (m²), zero for whoever counts as a point.
    pub(super) spreads: Vec<Matrix2<f64>>,
    /// Whom each agent measures.
    pub(super) links: Vec<Vec<Link>>,
    /// The weak start of each agent (m), and its variance (m²).
    pub(super) start: Vec<[f64; 2]>,
    pub(super) start_variance: f64,
    /// Variance of a range (m²).
    pub(super) range_variance: f64,
    /// Distance up to which nodes measure each other (m).
    pub(super) radius: f64,
    /// Probability that a link in reach fails; without it silence says nothing.
    pub(super) missed: Option<f64>,
}

/// A part at a mode of its ranges.
#[derive(Clone, Debug)]
pub(super) struct Settled {
    /// Positions of its agents (m).
    pub(super) at: Vec<[f64; 2]>,
    /// Energy of its ranges and starts (nats).
    pub(super) energy: f64,
    information: Cholesky<f64, Dyn>,
}

impl Settled {
    /// ½ ln |information|: the narrower a mode, the less it weighs.
    pub(super) fn half_log_determinant(&self) -> f64 {
        self.information.l_dirty().diagonal().iter().map(|pivot| pivot.ln()).sum()
    }

    /// Covariance of each agent (m²).
    pub(super) fn covariances(&self) -> Vec<Matrix2<f64>> {
        let joint = self.information.inverse();
        (0..self.at.len()).map(|own| joint.fixed_view::<2, 2>(2 * own, 2 * own).into_owned()).collect()
    }
}

impl Posterior {
    /// The posterior of a network whose agents stand at `places`, all of them points.
    pub(super) fn new(world: &World, draw: &Draw, start_variance: f64, mut places: Vec<[f64; 2]>) -> Self {
        places.extend(&draw.anchors);
        Self {
            spreads: vec![Matrix2::zeros(); places.len()],
            places,
            links: links(draw),
            start: draw.start.clone(),
            start_variance,
            range_variance: world.range_variance,
            radius: world.radius,
            missed: missed(world),
        }
    }

    /// Number of agents.
    pub(super) fn agents(&self) -> usize {
        self.links.len()
    }

    /// Whether a node is a point whose place counts.
    pub(super) fn is_point(&self, node: usize) -> bool {
        self.spreads[node][(0, 0)] == 0.0
    }

    /// Variance of the distance to a node outside the part (m²); nothing where even its direction is unknown.
    pub(super) fn variance_along(&self, link: &Link, direction: Vector2<f64>) -> Option<f64> {
        let spread = &self.spreads[link.node];
        let widest = spread[(0, 0)].max(spread[(1, 1)]);
        (widest <= (PLACE * link.measured).powi(2))
            .then(|| self.range_variance + direction.dot(&(spread * direction)))
    }

    /// Every range of the part once: its agent's place in the part, that of the other if it has one, the direction
    /// from the other to the agent, the error (m) and its variance (m²).
    fn each_range(
        &self,
        part: &[usize],
        at: &[[f64; 2]],
        mut visit: impl FnMut(usize, Option<usize>, Vector2<f64>, f64, f64),
    ) {
        for (own, &agent) in part.iter().enumerate() {
            for link in &self.links[agent] {
                let other = part.binary_search(&link.node).ok();
                if other.is_some() && link.node < agent {
                    continue;
                }
                let place = other.map_or(self.places[link.node], |other| at[other]);
                let offset = Vector2::from(at[own]) - Vector2::from(place);
                let length = offset.norm().max(1e-9);
                let direction = offset / length;
                let variance = match other {
                    Some(_) => Some(self.range_variance),
                    None => self.variance_along(link, direction),
                };
                if let Some(variance) = variance {
                    visit(own, other, direction, length - link.measured, variance);
                }
            }
        }
    }

    /// Energy (nats) of the part's ranges and starts.
    pub(super) fn energy(&self, part: &[usize], at: &[[f64; 2]]) -> f64 {
        let mut sum = 0.0;
        for (&agent, place) in part.iter().zip(at) {
            sum += (Vector2::from(*place) - Vector2::from(self.start[agent])).norm_squared()
                / self.start_variance;
        }
        self.each_range(part, at, |_, _, _, error, variance| sum += error * error / variance);
        0.5 * sum
    }

    /// Gauss-Newton information and minus the energy's gradient.
    fn normal_equations(&self, part: &[usize], at: &[[f64; 2]]) -> (DMatrix<f64>, DVector<f64>) {
        let size = 2 * part.len();
        let (mut information, mut force) = (DMatrix::zeros(size, size), DVector::zeros(size));
        for (own, &agent) in part.iter().enumerate() {
            for axis in 0..2 {
                information[(2 * own + axis, 2 * own + axis)] = 1.0 / self.start_variance;
                force[2 * own + axis] = (self.start[agent][axis] - at[own][axis]) / self.start_variance;
            }
        }
        self.each_range(part, at, |own, other, direction, error, variance| {
            let block = direction * direction.transpose() / variance;
            let pull = direction * (error / variance);
            let mut add = |row: usize, column: usize, sign: f64| {
                let mut view = information.fixed_view_mut::<2, 2>(2 * row, 2 * column);
                view += block * sign;
            };
            add(own, own, 1.0);
            let mut own_force = force.fixed_rows_mut::<2>(2 * own);
            own_force -= pull;
            if let Some(other) = other {
                add(other, other, 1.0);
                add(own, other, -1.0);
                add(other, own, -1.0);
                let mut other_force = force.fixed_rows_mut::<2>(2 * other);
                other_force += pull;
            }
        });
        (information, force)
    }

    /// The mode of the part's ranges that damped Newton steps reach from `from`; none where arithmetic fails. Costs
    /// O(agents³) a step.
    pub(super) fn settle(&self, part: &[usize], from: &[[f64; 2]]) -> Option<Settled> {
        let mut at = from.to_vec();
        let mut energy = self.energy(part, &at);
        let (mut information, mut force) = self.normal_equations(part, &at);
        let mut damping = 1e-4;
        for _ in 0..STEPS {
            let mut damped = information.clone();
            (0..damped.nrows()).for_each(|k| damped[(k, k)] *= 1.0 + damping);
            let step = Cholesky::new(damped)?.solve(&force);
            let next: Vec<[f64; 2]> = at
                .iter()
                .zip(step.as_slice().chunks_exact(2))
                .map(|(x, d)| [x[0] + d[0], x[1] + d[1]])
                .collect();
            let found = self.energy(part, &next);
            if found > energy || !found.is_finite() {
                damping *= 10.0;
                if damping > STIFFEST {
                    break;
                }
                continue;
            }
            let gain = energy - found;
            (at, energy) = (next, found);
            damping = f64::max(0.1 * damping, 1e-9);
            (information, force) = self.normal_equations(part, &at);
            if gain < SETTLED {
                break;
            }
        }
        Some(Settled { at, energy, information: Cholesky::new(information)? })
    }

    /// The grid that [`Posterior::silence`] asks for who is near.
    pub(super) fn reach<'p>(&self, places: &'p [[f64; 2]]) -> Reach<'p> {
        Reach::new(places, Some(self.radius + BEYOND))
    }

    fn is_linked(&self, agent: usize, node: usize) -> bool {
        self.links[agent].iter().any(|link| link.node == node)
    }

    /// Energy (nats) of two that did not measure each other.
    fn unheard(&self, missed: f64, a: [f64; 2], b: [f64; 2]) -> f64 {
        let distance = (a[0] - b[0]).hypot(a[1] - b[1]);
        let within = 1.0 / (1.0 + (-LOGISTIC * (self.radius - distance) / EDGE).exp());
        -(1.0 - (1.0 - missed) * within).ln()
    }

    /// Energy (nats) of the silence between the part's agents and everybody, those left out who are in no one place.
    pub(super) fn silence(&self, part: &[usize], at: &[[f64; 2]], near: &Reach<'_>) -> f64 {
        let Some(missed) = self.missed else { return 0.0 };
        let mut sum = 0.0;
        for (own, &agent) in part.iter().enumerate() {
            for (node, _) in near.within(at[own]) {
                let vague = self.spreads[node].diagonal().max() > VAGUE * VAGUE;
                if vague || part.binary_search(&node).is_ok() || self.is_linked(agent, node) {
                    continue;
                }
                sum += self.unheard(missed, at[own], self.places[node]);
            }
            for (other, &node) in part.iter().enumerate().skip(own + 1) {
                if !self.is_linked(agent, node) {
                    sum += self.unheard(missed, at[own], at[other]);
                }
            }
        }
        sum
    }
}
