//! One estimate reduced to the numbers that the figures are made of.

use std::collections::BTreeMap;

use super::chi_square;
use crate::results::{Estimate, MethodRun, StateLayout};

/// Pivots of a covariance scaled to unit variances below this make it singular: 12 digits, where rounding of a
/// rank-deficient covariance leaves about 15.
const SINGULAR_PIVOT: f64 = 1e-12;

/// Degrees of freedom of the NEES blocks.
#[derive(Clone, Copy, Debug)]
pub(super) struct Dimensions {
    pub position: usize,
    pub velocity: usize,
    pub clock: usize,
    pub state: usize,
    pub scored: usize,
    /// Number of angles, which share no unit with the rest of the state.
    pub angular: usize,
}

impl Dimensions {
    pub fn of(layout: &StateLayout) -> Self {
        Self {
            position: layout.position.len(),
            velocity: layout.velocity.len(),
            clock: layout.clock.len(),
            state: layout.dimension(),
            scored: layout.scored().len(),
            angular: layout.angular.len(),
        }
    }
}

/// What the figures need of one estimate.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sample {
    /// Which of the runs, by place.
    pub run: usize,
    pub node: u32,
    pub step: u32,
    pub time: f64,
    /// Squared length of the position error (m²).
    pub position_squared: Option<f64>,
    /// Squared length of the state's error, of a state that has no position.
    pub state_squared: Option<f64>,
    /// Squared length of the velocity error (m²/s²).
    pub velocity_squared: Option<f64>,
    /// Squared errors of a clock's offset (s²) and skew (ppm²).
    pub clock_squared: Option<[f64; 2]>,
    /// NEES of the blocks; `None` where the covariance is singular or the block empty.
    pub position_nees: Option<f64>,
    pub velocity_nees: Option<f64>,
    pub clock_nees: Option<f64>,
    pub state_nees: Option<f64>,
    /// Whether the 95 % region of the position (of the whole state, where it has none) holds the truth, as 0 or 1;
    /// where there are intervals the share of them that do.
    pub covered: f64,
    /// Mean width of the 95 % intervals, where there are some.
    pub width: Option<f64>,
    /// Signs of the position error along the first three axes.
    pub signs: [f64; 3],
}

/// The samples of one run, in the order of its estimates.
pub(super) fn samples(run: usize, method: &MethodRun) -> impl Iterator<Item = Sample> {
    let layout = &method.layout;
    let whole: Vec<usize> = (0..layout.dimension()).collect();
    let scored = layout.scored();
    let limit = chi_square::quantile(0.95, scored.len() as f64).unwrap_or(0.0);
    let mut work = Vec::new();
    method.estimates().map(move |estimate| {
        let errors = |axes: &[usize]| -> Option<f64> {
            let squares = axes.iter().map(|&i| estimate.error_at(i, layout).powi(2));
            (!axes.is_empty()).then(|| squares.sum())
        };
        let position_squared = errors(&layout.position);
        let position_nees = nees(&estimate, layout, &layout.position, &mut work);
        let state_squared = if layout.position.is_empty() { errors(&whole) } else { None };
        let state_nees = nees(&estimate, layout, &whole, &mut work);
        let (covered, width) = if estimate.intervals.is_empty() {
            let (nees, squared) = match layout.position.is_empty() {
                true => (state_nees, state_squared),
                false => (position_nees, position_squared),
            };
            // A degenerate region holds the truth if it is the truth itself, and nothing else.
            let inside = nees.map_or(squared == Some(0.0), |nees| nees <= limit);
            (f64::from(u8::from(inside)), None)
        } else {
            let (covered, width) = intervals(&estimate, &scored);
            (covered, Some(width))
        };
        let mut signs = [0.0; 3];
        for (sign, &i) in signs.iter_mut().zip(&layout.position) {
            let error = estimate.error_at(i, layout);
            *sign = if error == 0.0 { 0.0 } else { error.signum() };
        }
        Sample {
            run,
            node: estimate.node,
            step: estimate.step,
            time: estimate.time,
            position_squared,
            velocity_squared: errors(&layout.velocity),
            clock_squared: match layout.clock[..] {
                [offset, skew] => Some([offset, skew].map(|k| estimate.error_at(k, layout).powi(2))),
                _ => None,
            },
            position_nees,
            velocity_nees: nees(&estimate, layout, &layout.velocity, &mut work),
            clock_nees: nees(&estimate, layout, &layout.clock, &mut work),
            state_nees,
            state_squared,
            covered,
            width,
            signs,
        }
    })
}

/// Share of the scored components inside their intervals, and the intervals' mean width.
fn intervals(estimate: &Estimate<'_>, scored: &[usize]) -> (f64, f64) {
    let (mut inside, mut width) = (0.0, 0.0);
    for ([low, high], &i) in estimate.intervals.iter().zip(scored) {
        inside += f64::from(u8::from((*low..=*high).contains(&estimate.truth[i])));
        width += high - low;
    }
    (inside / scored.len() as f64, width / scored.len() as f64)
}

/// eᵀP⁻¹e over some components, by a Cholesky factorisation of the covariance scaled to unit variances; `None` if
/// that is singular. O(k³) for k components.
fn nees(
    estimate: &Estimate<'_>,
    layout: &StateLayout,
    components: &[usize],
    work: &mut Vec<f64>,
) -> Option<f64> {
    let k = components.len();
    if k == 0 {
        return None;
    }
    work.clear();
    work.resize(k * k, 0.0);
    let mut solved = 0.0;
    let mut whitened = [0.0; 16];
    let mut spill = Vec::new();
    let whitened = if k <= whitened.len() {
        &mut whitened[..k]
    } else {
        spill.resize(k, 0.0);
        &mut spill[..]
    };
    for i in 0..k {
        let deviation = estimate.covariance_at(components[i], components[i]).sqrt();
        if deviation <= 0.0 {
            return None;
        }
        let mut residual = estimate.error_at(components[i], layout) / deviation;
        for j in 0..=i {
            let other = estimate.covariance_at(components[j], components[j]).sqrt();
            let mut sum = estimate.covariance_at(components[i], components[j]) / (deviation * other);
            for l in 0..j {
                sum -= work[i * k + l] * work[j * k + l];
            }
            if j < i {
                work[i * k + j] = sum / work[j * k + j];
                residual -= work[i * k + j] * whitened[j];
            } else if sum > SINGULAR_PIVOT {
                work[i * k + i] = sum.sqrt();
            } else {
                return None;
            }
        }
        whitened[i] = residual / work[i * k + i];
        solved += whitened[i] * whitened[i];
    }
    solved.is_finite().then_some(solved)
}

/// |mean over steps of the sign of the error|, averaged over axes, nodes and runs.
pub(super) fn one_sidedness(samples: &[Sample], axes: usize) -> Option<f64> {
    let axes = axes.min(3);
    let mut sums: BTreeMap<(usize, u32), ([f64; 3], usize)> = BTreeMap::new();
    for sample in samples {
        let (signs, count) = sums.entry((sample.run, sample.node)).or_default();
        for (sum, sign) in signs.iter_mut().zip(sample.signs) {
            *sum += sign;
        }
        *count += 1;
    }
    // A single step is one-sided by definition.
    if axes == 0 || sums.values().any(|&(_, count)| count < 2) || sums.is_empty() {
        return None;
    }
    let total: f64 = sums
        .values()
        .flat_map(|(signs, count)| signs[..axes].iter().map(|sum| (sum / *count as f64).abs()))
        .sum();
    Some(total / (axes * sums.len()) as f64)
}
