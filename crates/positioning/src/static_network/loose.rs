//! Agents that their ranges leave on an arc, or on a whole ring: their posterior in polar coordinates.

use nalgebra::{Matrix2, Vector2};

use super::posterior::{Link, Posterior};
use crate::cooperation::links::Reach;

/// Standard deviations of the shortest range to either side, and points to each.
const WIDTH: f64 = 4.0;
const POINTS_A_DEVIATION: f64 = 2.0;
/// The fewest and the most directions.
const DIRECTIONS: [usize; 2] = [48, 360];

/// The agents whose ranges to others than such agents leave a deviation above `most` (m) along some direction,
/// linearised where they stand.
pub(super) fn loose(posterior: &Posterior, most: f64) -> Vec<bool> {
    let mut loose = vec![false; posterior.agents()];
    // Whoever leans on a loose agent may be loose in turn.
    let mut due: Vec<usize> = (0..loose.len()).collect();
    while let Some(agent) = due.pop() {
        if loose[agent] || deviation(posterior, &loose, agent) <= most {
            continue;
        }
        loose[agent] = true;
        due.extend(posterior.links[agent].iter().map(|link| link.node).filter(|&node| node < loose.len()));
    }
    loose
}

/// Deviation (m) along the worst direction that ranges to agents that are not loose, and to anchors, leave.
fn deviation(posterior: &Posterior, loose: &[bool], agent: usize) -> f64 {
    let mut information: Matrix2<f64> = Matrix2::zeros();
    let place = Vector2::from(posterior.places[agent]);
    for link in &posterior.links[agent] {
        if loose.get(link.node).is_some_and(|&loose| loose) {
            continue;
        }
        let offset = place - Vector2::from(posterior.places[link.node]);
        let square = offset.norm_squared();
        if square > 0.0 {
            information += offset * offset.transpose() / (square * posterior.range_variance);
        }
    }
    let half_difference = 0.5 * (information[(0, 0)] - information[(1, 1)]);
    let worst = 0.5 * information.trace() - half_difference.hypot(information[(0, 1)]);
    if worst > 0.0 { worst.sqrt().recip() } else { f64::INFINITY }
}

/// Mean and covariance (m, m²) of an agent's posterior given everybody else's, on a grid around the end of its
/// shortest range; none where it has no range to anyone whose place is known.
pub(super) fn moments(
    posterior: &Posterior,
    near: &Reach<'_>,
    agent: usize,
) -> Option<(Vector2<f64>, Matrix2<f64>)> {
    let usable = |link: &&Link| posterior.variance_along(link, Vector2::x()).is_some();
    let links = posterior.links[agent].iter().filter(usable);
    let shortest = links.min_by(|a, b| a.measured.total_cmp(&b.measured))?;
    let centre = Vector2::from(posterior.places[shortest.node]);
    let deviation = (posterior.range_variance + posterior.spreads[shortest.node].diagonal().max()).sqrt();
    let step = deviation / POINTS_A_DEVIATION;
    let rings = (WIDTH * POINTS_A_DEVIATION) as i32;
    let around = std::f64::consts::TAU * shortest.measured.abs() / step;
    let directions = (around as usize).clamp(DIRECTIONS[0], DIRECTIONS[1]);
    let mut points = Vec::new();
    for direction in 0..directions {
        let (sine, cosine) = (std::f64::consts::TAU * direction as f64 / directions as f64).sin_cos();
        for ring in -rings..=rings {
            let radius = shortest.measured + f64::from(ring) * step;
            if radius > 0.0 {
                let place = centre + Vector2::new(cosine, sine) * radius;
                let at = [[place[0], place[1]]];
                let energy =
                    posterior.energy(&[agent], &at) + posterior.silence(&[agent], &at, near) - radius.ln();
                points.push((place, energy));
            }
        }
    }
    let least = points.iter().map(|point| point.1).fold(f64::INFINITY, f64::min);
    let (mut total, mut mean, mut square) = (0.0, Vector2::zeros(), Matrix2::zeros());
    for (place, energy) in &points {
        let weight = (least - energy).exp();
        let offset = place - centre;
        total += weight;
        mean += offset * weight;
        square += offset * offset.transpose() * weight;
    }
    if !(total > 0.0 && total.is_finite()) {
        return None;
    }
    mean /= total;
    let covariance = square / total - mean * mean.transpose() + Matrix2::identity() * (step * step / 12.0);
    Some((centre + mean, covariance))
}
