//! A range as a ring of kernels.
//!
//! Around a sender at m with covariance P stand M kernels at equal angles, of standard deviation τ along the ring, no
//! more than their spacing, and across it of the variance that makes their sum's profile N(ρ; z, σ²), σ² = R + u'Pu, to
//! second order in 1/z. With P⊥ the sender's variance along the ring, the sum of straight kernels lies outside their
//! circle by τ²/2z, thins as 1/ρ, and a sender moving along the ring shortens it by P⊥/2z, so that
//!
//! radius    z - τ²/2z - P⊥/2z + σ²/z,
//! variance  (1 / (σ² + P⊥²/2z²) + 1/z²)⁻¹ - τ⁴/2z².
//!
//! Kernels longer than wide need M = 2π √(2z/σ) of them where round ones need 2πz/σ.

use super::senders::Combination;
use super::{Target, Weighed};
use crate::small::{Matrix, Vector, zero_vector, zeros};
use crate::{Ring, RingCentre};
use std::f64::consts::TAU;
use sumprod_graph::{MessageError, Space};
use sumprod_messages::{Mixture, Potential};

/// τ² over 2zσ: how far a kernel's end leaves the ring, in standard deviations across it.
const BEND: f64 = 0.25;

/// Range over standard deviation below which the ring's middle matters, and its profile has no simple correction.
const THICK: f64 = 4.0;

/// Range over a sender's standard deviation below which the sender is cut into narrower ones.
const WIDE: f64 = 4.0;

/// How far a sender that is cut is followed, in standard deviations.
const REACH: f64 = 4.0;

/// Fewest kernels of a ring.
const FEWEST: usize = 12;

/// A ring's centre, for one component of the sender.
struct Hub {
    log_weight: f64,
    centre: [f64; 2],
    /// Row-major.
    covariance: [f64; 4],
}

impl Hub {
    fn spread(&self, east: f64, north: f64) -> f64 {
        let [xx, xy, _, yy] = self.covariance;
        east * east * xx + 2.0 * east * north * xy + north * north * yy
    }

    /// Eigenvalues, the larger first, and the unit vector of the larger.
    fn axes(&self) -> (f64, f64, [f64; 2]) {
        let [xx, xy, _, yy] = self.covariance;
        let (half, difference) = (0.5 * (xx + yy), 0.5 * (xx - yy));
        let root = difference.hypot(xy);
        let angle = 0.5 * xy.atan2(difference);
        (half + root, half - root, [angle.cos(), angle.sin()])
    }

    /// Narrower hubs, of variance at most `most` along either axis, that sum to this one: N(0, λ) is the sum over k of
    /// N(k√v; 0, λ - v) N(k√v, v) √v to within 1e-8.
    fn cut(self, most: f64, out: &mut Vec<Self>) {
        let (large, small, [east, north]) = self.axes();
        // The cut axis comes back with rounding.
        if large <= most * (1.0 + 1e-6) {
            out.push(self);
            return;
        }
        let (rest, step) = (large - most, most.sqrt());
        let side = (REACH * rest.sqrt() / step).ceil() as i64;
        let entry = |along: f64, across: f64| most * along + small * across;
        let mixed = (most - small) * east * north;
        let covariance = [entry(east * east, north * north), mixed, mixed, entry(north * north, east * east)];
        for k in -side..=side {
            let offset = k as f64 * step;
            let share = -0.5 * offset * offset / rest + 0.5 * (most / (TAU * rest)).ln();
            let centre = [self.centre[0] + offset * east, self.centre[1] + offset * north];
            Self { log_weight: self.log_weight + share, centre, covariance }.cut(most, out);
        }
    }
}

fn hubs(ring: &Ring, combinations: &[Combination]) -> Vec<Hub> {
    let hub = |senders: &Combination| match ring.centre {
        RingCentre::Fixed(centre) => {
            Some(Hub { log_weight: senders.log_weight, centre, covariance: [0.0; 4] })
        }
        RingCentre::Port(port, place) => {
            let part = senders.parts.iter().find(|part| part.port == port)?;
            let d = part.mean.len();
            let entry = |row: usize, column: usize| part.covariance[place[row] * d + place[column]];
            let covariance = [entry(0, 0), entry(0, 1), entry(1, 0), entry(1, 1)];
            let centre = place.map(|k| part.mean[k]);
            Some(Hub { log_weight: senders.log_weight, centre, covariance })
        }
    };
    combinations.iter().filter_map(hub).collect()
}

/// The ring's kernels, with their masses where there is a belief to guide (on the ring's coordinates); none where a ring
/// is no good picture of the range.
pub(super) fn kernels(
    target: &Target<'_>,
    ring: &Ring,
    combinations: &[Combination],
    guide: Option<&Mixture>,
    phase: f64,
) -> Result<Option<Weighed>, MessageError> {
    let noise = target.model.noise().covariance()[0];
    let radius = ring.radius.abs();
    let mut narrow = Vec::new();
    for hub in hubs(ring, combinations) {
        hub.cut((radius / WIDE).powi(2), &mut narrow);
    }
    if narrow.iter().any(|hub| radius * radius < THICK * THICK * (noise + hub.axes().0)) {
        return Ok(None);
    }
    let d = target.dimension();
    let mut potential = Potential::new(target.coordinates);
    let mut log_masses = Vec::new();
    let [x, y] = ring.position;
    for hub in &narrow {
        let deviation = (noise + hub.axes().1.max(0.0)).sqrt();
        let longest = (2.0 * BEND * radius * deviation).sqrt();
        let count = ((TAU * radius / longest).ceil() as usize).max(FEWEST);
        let spacing = TAU * radius / count as f64;
        for k in 0..count {
            let angle = TAU * (k as f64 + phase) / count as f64;
            let (sine, cosine) = angle.sin_cos();
            let (across, along) = (noise + hub.spread(cosine, sine), hub.spread(-sine, cosine));
            let bend = spacing * spacing / (2.0 * radius);
            let drift = along / (2.0 * radius);
            let place = radius - bend - drift + across / radius;
            let blurred = across + 2.0 * drift * drift;
            let variance = 1.0 / (1.0 / blurred + 1.0 / (radius * radius)) - 2.0 * bend * bend;
            let (outer, inner) = (1.0 / variance, 1.0 / (spacing * spacing));
            let (mut centre, mut information) = (zero_vector(d), zeros(d * d));
            centre[x] = hub.centre[0] + place * cosine;
            centre[y] = hub.centre[1] + place * sine;
            information[x * d + x] = outer * cosine * cosine + inner * sine * sine;
            information[y * d + y] = outer * sine * sine + inner * cosine * cosine;
            information[x * d + y] = (outer - inner) * cosine * sine;
            information[y * d + x] = information[x * d + y];
            let log_value = hub.log_weight - 0.5 * variance.ln();
            push(&mut potential, log_value, &centre, &information);
            if let Some(guide) = guide {
                let kernel = [variance, spacing * spacing];
                log_masses.push(log_value + overlap(guide, [centre[x], centre[y]], [cosine, sine], kernel));
            }
        }
    }
    let log_masses = guide.is_some().then_some(log_masses);
    Ok(Some(Weighed { potential, log_masses }))
}

fn push(potential: &mut Potential, log_value: f64, centre: &Vector, information: &Matrix) {
    potential.push(log_value, centre, &zero_vector(centre.len()), information);
}

/// Log of the integral of a planar mixture times a kernel of these variances across and along the ring.
fn overlap(guide: &Mixture, centre: [f64; 2], [cosine, sine]: [f64; 2], [across, along]: [f64; 2]) -> f64 {
    let kernel = [
        across * cosine * cosine + along * sine * sine,
        (across - along) * cosine * sine,
        across * sine * sine + along * cosine * cosine,
    ];
    let mut total = f64::NEG_INFINITY;
    for (i, log_weight) in guide.log_weights().iter().enumerate() {
        let own = guide.covariance_of(i);
        let (xx, xy, yy) = (own[0] + kernel[0], own[1] + kernel[1], own[3] + kernel[2]);
        let (u, v) = (centre[0] - guide.mean_of(i)[0], centre[1] - guide.mean_of(i)[1]);
        let determinant = xx * yy - xy * xy;
        let squared = (yy * u * u - 2.0 * xy * u * v + xx * v * v) / determinant;
        let log = log_weight - 0.5 * (squared + determinant.ln());
        let (large, small) = if log > total { (log, total) } else { (total, log) };
        total = large + (small - large).exp().ln_1p();
    }
    total
}

/// A belief that covers the disc of a short range: where a receiver of no belief is looked for.
pub(super) fn surroundings(
    target: &Target<'_>,
    ring: &Ring,
    combinations: &[Combination],
) -> Result<Mixture, MessageError> {
    let d = target.dimension();
    let noise = target.model.noise().covariance()[0];
    let reach = |hub: &Hub| (ring.radius.powi(2) + 4.0 * (noise + hub.axes().0)).sqrt();
    let (mut log_weights, mut means, mut covariances) = (Vec::new(), Vec::new(), Vec::new());
    for hub in hubs(ring, combinations) {
        let spread = reach(&hub);
        let (mut mean, mut covariance) = (vec![0.0; d], vec![0.0; d * d]);
        for k in 0..d {
            covariance[k * d + k] = 1.0;
        }
        for (k, &place) in ring.position.iter().enumerate() {
            mean[place] = hub.centre[k];
            covariance[place * d + place] = spread * spread;
        }
        log_weights.push(hub.log_weight);
        means.extend(mean);
        covariances.extend(covariance);
    }
    Mixture::new(&Space::new(target.coordinates), log_weights, means, covariances)
}
