//! Groups of agents in their mirror images: found, and weighed against the network as it stands.
//!
//! A group that hangs on the rest by nodes along a line fits its ranges as well when it is folded over along that
//! line, and belief propagation, which decides agent by agent, may leave all of it on the wrong side. Here every line
//! through two whom an agent measures is tried: the agent goes to its mirror image, and whoever it then fits no longer
//! goes with it. What fits is settled, and compared by the free energy E + ½ ln |information| of the group with its
//! neighbours, silence included. The better image stays; the other is kept with its weight where it is not far worse.

use rayon::prelude::*;
use std::collections::BTreeMap;

use super::posterior::{Posterior, Settled};
use crate::cooperation::links::Reach;
use nalgebra::{Matrix2, Vector2};

/// The most agents that are folded together.
const MOST: usize = 40;
/// The most ends of lines that are tried for an agent, the nearest.
const ENDS: usize = 24;
/// The most agents that are settled together.
const PART: usize = 200;
/// Misfits of a range (m) above which the other end goes along: firm hinges, and hinges that the wrong image has bent.
const SLACKS: [f64; 2] = [2.5, 6.0];
/// Distance from the line (m) within which a mirror image is the place itself.
const ON_LINE: f64 = 0.5;
/// The same for the agent that a fold begins with.
const OFF_LINE: f64 = 1.0;
/// Energy of a misfit (nats) up to which a range counts before the group has settled.
const CAP: f64 = 20.0;
/// Rise of the energy (nats) up to which an image is settled, by its group alone, and then with its neighbours.
const LIMITS: [f64; 2] = [60.0, 30.0];
/// Free energy (nats) up to which the worse image is kept: e⁻⁸ is one in three thousand.
const KEPT: f64 = 8.0;
/// Distance (m) within which two images are one.
const SAME: f64 = 1.0;
/// Passes over all agents; nearly all networks are done after the second.
const PASSES: usize = 6;

/// What the search found.
#[derive(Debug, Default)]
pub(super) struct Folds {
    /// Groups that went over to their mirror image.
    pub(super) undone: usize,
    /// Mirror images that may be the truth.
    pub(super) images: Vec<Image>,
}

/// Another mode of a part of the network.
#[derive(Debug)]
pub(super) struct Image {
    /// Its agents, ascending.
    pub(super) part: Vec<usize>,
    /// How far each is from where it stands (m).
    pub(super) offsets: Vec<[f64; 2]>,
    /// Covariances there (m²).
    pub(super) covariances: Vec<Matrix2<f64>>,
    /// Weight relative to the mode that stands.
    pub(super) weight: f64,
}

/// A line through a point along a unit vector.
#[derive(Clone, Copy)]
struct Line {
    through: Vector2<f64>,
    normal: Vector2<f64>,
}

impl Line {
    /// The line through two points; none where they are one.
    fn new(a: [f64; 2], b: [f64; 2]) -> Option<Self> {
        let (a, b) = (Vector2::from(a), Vector2::from(b));
        let along = b - a;
        let length = along.norm();
        (length > SAME).then(|| Self { through: a, normal: Vector2::new(-along[1], along[0]) / length })
    }

    fn height(&self, point: [f64; 2]) -> f64 {
        (Vector2::from(point) - self.through).dot(&self.normal)
    }

    fn mirror(&self, point: [f64; 2]) -> [f64; 2] {
        (Vector2::from(point) - self.normal * (2.0 * self.height(point))).into()
    }
}

/// A group in its mirror image, before it has settled.
struct Candidate {
    group: Vec<usize>,
    at: Vec<[f64; 2]>,
    /// Rise of the energy (nats).
    rise: f64,
}

/// Folds groups over until no fold is better, and collects those nearly as good. Costs O(agents · links²) groups, of
/// which less than one an agent is settled.
pub(super) fn search(posterior: &mut Posterior) -> Folds {
    let mut folds = Folds::default();
    for pass in 1..=PASSES {
        let places = posterior.places.clone();
        let near = posterior.reach(&places);
        let mut changed = vec![false; posterior.agents()];
        folds.images.clear();
        let before = folds.undone;
        for candidate in candidates(posterior, &near) {
            let Some((part, now, image, gain)) = weigh(posterior, &near, &candidate, &changed) else {
                continue;
            };
            if gain > 0.0 && pass < PASSES {
                for (&agent, &at) in part.iter().zip(&image.at) {
                    posterior.places[agent] = at;
                    changed[agent] = true;
                }
                folds.undone += 1;
            } else if gain > -KEPT {
                keep(&mut folds.images, &candidate.group, part, &now, &image, gain);
            }
        }
        if folds.undone == before {
            break;
        }
    }
    folds
}

/// Groups whose mirror image may fit, best first.
fn candidates(posterior: &Posterior, near: &Reach<'_>) -> Vec<Candidate> {
    let nodes = posterior.places.len();
    let stands = |agent: usize| posterior.silence(&[agent], &[posterior.places[agent]], near);
    let silence: Vec<f64> = (0..posterior.agents()).into_par_iter().map(stands).collect();
    let by_agent: Vec<Vec<Candidate>> = (0..posterior.agents())
        .into_par_iter()
        .map_init(|| (vec![0_u32; nodes], 0), |marks, agent| from_agent(posterior, &silence, agent, marks))
        .collect();
    // The same group over several lines: the one that fits best.
    let mut best: BTreeMap<Vec<usize>, (f64, Vec<[f64; 2]>)> = BTreeMap::new();
    for candidate in by_agent.into_iter().flatten() {
        let entry = best.entry(candidate.group).or_insert((f64::INFINITY, Vec::new()));
        if candidate.rise < entry.0 {
            *entry = (candidate.rise, candidate.at);
        }
    }
    let mut candidates: Vec<Candidate> = best
        .into_iter()
        .map(|(group, (rise, at))| {
            let stands: Vec<[f64; 2]> = group.iter().map(|&agent| posterior.places[agent]).collect();
            let silence = posterior.silence(&group, &at, near) - posterior.silence(&group, &stands, near);
            Candidate { group, at, rise: rise + silence }
        })
        .filter(|candidate| candidate.rise < LIMITS[0])
        .collect();
    candidates.sort_by(|a, b| a.rise.total_cmp(&b.rise));
    candidates
}

/// The groups that begin with one agent. `silence` is the energy of each agent's silence where it stands, which is as
/// much as an image may gain by it; `marks` holds who has been met, under a number that grows.
fn from_agent(
    posterior: &Posterior,
    silence: &[f64],
    agent: usize,
    marks: &mut (Vec<u32>, u32),
) -> Vec<Candidate> {
    let mut found = Vec::new();
    if !posterior.is_point(agent) {
        return found;
    }
    let mut links = posterior.links[agent].clone();
    links.sort_by(|a, b| a.measured.total_cmp(&b.measured));
    links.truncate(ENDS);
    for (k, first) in links.iter().enumerate() {
        for second in &links[..k] {
            let ends = [first.node, second.node].map(|node| posterior.places[node]);
            let Some(line) = Line::new(ends[0], ends[1]) else { continue };
            if line.height(posterior.places[agent]).abs() < OFF_LINE {
                continue;
            }
            for slack in SLACKS {
                let Some(group) = grow(posterior, agent, line, slack, marks) else { continue };
                let at: Vec<[f64; 2]> =
                    group.iter().map(|&member| line.mirror(posterior.places[member])).collect();
                let rises = group.iter().zip(&at).map(|(&member, &at)| {
                    let misfit = |place| misfit(posterior, &group, member, place);
                    misfit(at) - misfit(posterior.places[member])
                });
                let rise: f64 = rises.sum();
                let relief: f64 = group.iter().map(|&member| silence[member]).sum();
                if rise - relief < LIMITS[0] {
                    found.push(Candidate { group, at, rise });
                }
            }
        }
    }
    found
}

/// Energy (nats) of the ranges from a member of a group to those outside, misfits capped.
fn misfit(posterior: &Posterior, group: &[usize], member: usize, at: [f64; 2]) -> f64 {
    let outside = posterior.links[member].iter().filter(|link| group.binary_search(&link.node).is_err());
    let energy = outside.map(|link| {
        let error = distance(at, posterior.places[link.node]) - link.measured;
        (0.5 * error * error / posterior.range_variance).min(CAP)
    });
    energy.sum()
}

/// The group that must go along with an agent over a line, ascending; none where that is too many, or where an anchor
/// that must stay speaks against it.
fn grow(
    posterior: &Posterior,
    agent: usize,
    line: Line,
    slack: f64,
    (marks, number): &mut (Vec<u32>, u32),
) -> Option<Vec<usize>> {
    *number += 1;
    let mut group = vec![agent];
    marks[agent] = *number;
    let mut next = 0;
    while let Some(&member) = group.get(next) {
        let at = line.mirror(posterior.places[member]);
        for link in &posterior.links[member] {
            if marks[link.node] == *number || !(posterior.is_point(link.node)) {
                continue;
            }
            let place = posterior.places[link.node];
            let error = (distance(at, place) - link.measured).abs();
            if link.node >= posterior.agents() {
                if error > 2.0 * slack {
                    return None;
                }
            } else if error > slack && line.height(place).abs() > ON_LINE {
                marks[link.node] = *number;
                group.push(link.node);
                if group.len() > MOST {
                    return None;
                }
            }
        }
        next += 1;
    }
    group.sort_unstable();
    Some(group)
}

/// The group with its neighbours as they stand and in its image, both settled, and how much better the image is
/// (nats); none where it is far worse, or no other, or where the neighbourhood has just changed.
fn weigh(
    posterior: &Posterior,
    near: &Reach<'_>,
    candidate: &Candidate,
    changed: &[bool],
) -> Option<(Vec<usize>, Settled, Settled, f64)> {
    let group = &candidate.group;
    if group.iter().any(|&agent| changed[agent]) {
        return None;
    }
    let alone = posterior.settle(group, &candidate.at)?;
    let stands: Vec<[f64; 2]> = group.iter().map(|&agent| posterior.places[agent]).collect();
    let total = |at: &[[f64; 2]]| posterior.energy(group, at) + posterior.silence(group, at, near);
    if total(&alone.at) - total(&stands) > LIMITS[1] {
        return None;
    }
    let neighbours = group.iter().flat_map(|&agent| &posterior.links[agent]).map(|link| link.node);
    let mut part: Vec<usize> =
        neighbours.filter(|&node| node < posterior.agents() && posterior.is_point(node)).collect();
    part.extend(group);
    part.sort_unstable();
    part.dedup();
    if part.len() > PART {
        return None;
    }
    let from: Vec<[f64; 2]> = part.iter().map(|&agent| posterior.places[agent]).collect();
    let folded: Vec<[f64; 2]> = part
        .iter()
        .zip(&from)
        .map(|(agent, &stands)| group.binary_search(agent).map_or(stands, |member| alone.at[member]))
        .collect();
    let (now, image) = (posterior.settle(&part, &from)?, posterior.settle(&part, &folded)?);
    let moved = now.at.iter().zip(&image.at).any(|(&a, &b)| distance(a, b) > SAME);
    let free = |settled: &Settled| {
        settled.energy + posterior.silence(&part, &settled.at, near) + settled.half_log_determinant()
    };
    let gain = free(&now) - free(&image);
    moved.then_some((part, now, image, gain))
}

/// Keeps an image, unless one that is kept has the group in the same place.
fn keep(
    images: &mut Vec<Image>,
    group: &[usize],
    part: Vec<usize>,
    now: &Settled,
    image: &Settled,
    gain: f64,
) {
    let offsets: Vec<[f64; 2]> =
        image.at.iter().zip(&now.at).map(|(a, b)| [a[0] - b[0], a[1] - b[1]]).collect();
    let offset = |part: &[usize], offsets: &[[f64; 2]], agent: &usize| {
        part.binary_search(agent).ok().map(|own| offsets[own])
    };
    let known = images.iter().any(|other| {
        group.iter().all(|agent| {
            let pair = offset(&other.part, &other.offsets, agent).zip(offset(&part, &offsets, agent));
            pair.is_some_and(|(a, b)| distance(a, b) < SAME)
        })
    });
    if !known {
        images.push(Image { part, offsets, covariances: image.covariances(), weight: gain.exp() });
    }
}

fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}
