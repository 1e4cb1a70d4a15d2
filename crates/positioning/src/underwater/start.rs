//! Where a node is and what its clock does before it moves, from beacons it heard standing.
//!
//! With a = 1 + α/c: the regression (3) of the stamps gives α, differences (7) of mean pseudo-ranges give those of the
//! distances, l_j = d_j - d_1, and the linear equations (4), (5)
//!
//! ```text
//! 2 (p_j - p_1)·(p - p_1) + 2 l_j d_1 = |p_j - p_1|² - l_j²
//! ```
//!
//! position and d_1. The paper's (6) has + l_j² on the right, and its unknown is taken for p; both are corrected here.
//! What these give starts a solve of the graph of all beacons, whose minimum and covariance the filters begin with; so
//! do the middle of the anchors and the mirror images of both, since few anchors leave several minima. Clocks are told
//! relative to a reference, a number of metres near the first pseudo-range, so that an offset of days costs no digits.

use nalgebra::{DMatrix, DVector};
use sumprod_exact::{ExactError, Problem, SolveOptions};
use sumprod_graph::{FactorGraph, MessageError, Space};
use sumprod_messages::{DynamicGaussian, Moments};
use sumprod_models::library::{LinearGaussian, PseudoRange};
use sumprod_models::{AddModel, Noise, NoiseError};

use super::settings::WorldSettings;
use super::world::{Beacon, DIMENSION, Draw};
use crate::PositioningError;
use crate::error::unsolvable;

/// What a node begins with.
#[derive(Clone, Debug, PartialEq)]
pub struct Start {
    /// Mean and covariance of its state when it begins to move, β relative to the reference.
    pub state: Moments,
    /// What is subtracted from every β and pseudo-range (m).
    pub reference: f64,
    /// How fast its clock gains by the first anchor's beacons alone (m/s).
    pub first_rate: f64,
    /// Position by the linear equations, where there are anchors enough for them.
    pub closed_form: Option<[f64; 3]>,
}

/// The beacons of one anchor.
struct Regression {
    place: [f64; 3],
    count: f64,
    /// Mean time before the node moves, and mean pseudo-range relative to the reference.
    age: f64,
    mean: f64,
    /// Slope, and Σ (t - t̄)².
    slope: f64,
    spread: f64,
}

impl Regression {
    fn new(place: [f64; 3], beacons: &[&Beacon], epoch: f64, reference: f64) -> Self {
        let count = beacons.len() as f64;
        let ages = || beacons.iter().map(|beacon| beacon.time - epoch);
        let ranges = || beacons.iter().map(|beacon| beacon.pseudo_range - reference);
        let (age, mean) = (ages().sum::<f64>() / count, ranges().sum::<f64>() / count);
        let spread = ages().map(|own| (own - age).powi(2)).sum::<f64>();
        let slope =
            ages().zip(ranges()).map(|(own, range)| (own - age) * (range - mean)).sum::<f64>() / spread;
        Self { place, count, age, mean, slope, spread }
    }
}

/// Locates and synchronises a standing node.
///
/// # Errors
/// [`PositioningError::Unsolvable`] where its clock cannot be told from its ranges.
pub fn locate(settings: &WorldSettings, draw: &Draw, node: usize) -> Result<Start, PositioningError> {
    let beacons = &draw.nodes[node].beacons;
    let reference = beacons.first().map_or(0.0, |beacon| beacon.pseudo_range.round());
    let regression = |(anchor, &place): (usize, &[f64; 3])| {
        let own: Vec<&Beacon> = beacons.iter().filter(|beacon| beacon.anchor == anchor).collect();
        Regression::new(place, &own, settings.epoch_s, reference)
    };
    let heard: Vec<Regression> = draw.anchors.iter().enumerate().map(regression).collect();
    let rate = heard.iter().map(|own| own.slope).sum::<f64>() / heard.len() as f64;
    let closed_form = linear(settings, &heard, rate);
    let graph =
        graph(settings, &heard, rate).map_err(|problem| PositioningError::setting("world", problem))?;
    let state = solve(&graph, &starts(&heard, closed_form), &heard, rate).map_err(|error| match error {
        ExactError::Unobservable(_) => {
            let (number, count) = (node + 1, heard.len());
            let problem = format!(
                "{count} anchors cannot tell the clock of node {number} from its ranges: it may be elsewhere and its \
                 clock ahead by as much with no pseudo-range changed; a position in space and a clock need 4 anchors \
                 or more, in different directions"
            );
            PositioningError::Unsolvable { problem }
        }
        other => unsolvable(other),
    })?;
    Ok(Start { state, reference, first_rate: heard.first().map_or(0.0, |own| own.slope), closed_form })
}

/// The linear equations, by least squares.
fn linear(settings: &WorldSettings, heard: &[Regression], rate: f64) -> Option<[f64; 3]> {
    let (first, others) = heard.split_first()?;
    if others.len() < 4 {
        return None;
    }
    let gain = 1.0 + rate / settings.sound_speed;
    let mut matrix = DMatrix::zeros(others.len(), 4);
    let mut right = DVector::zeros(others.len());
    for (row, other) in others.iter().enumerate() {
        let apart = (other.mean - first.mean - rate * (other.age - first.age)) / gain;
        let mut squared = -apart * apart;
        for k in 0..3 {
            let side = other.place[k] - first.place[k];
            matrix[(row, k)] = 2.0 * side;
            squared += side * side;
        }
        matrix[(row, 3)] = 2.0 * apart;
        right[row] = squared;
    }
    let found = matrix.svd(true, true).solve(&right, f64::EPSILON).ok()?;
    let place = [0, 1, 2].map(|k| first.place[k] + found[k]);
    place.iter().all(|value| value.is_finite()).then_some(place)
}

/// Positions from which the graph is solved.
fn starts(heard: &[Regression], closed_form: Option<[f64; 3]>) -> Vec<[f64; 3]> {
    let count = heard.len() as f64;
    let middle = [0, 1, 2].map(|k| heard.iter().map(|own| own.place[k]).sum::<f64>() / count);
    let mut spread = nalgebra::Matrix3::<f64>::zeros();
    for own in heard {
        let side = nalgebra::Vector3::from_fn(|k, _| own.place[k] - middle[k]);
        spread += side * side.transpose();
    }
    let eigen = spread.symmetric_eigen();
    let (flattest, _) = eigen.eigenvalues.argmin();
    let normal = eigen.eigenvectors.column(flattest);
    // Nothing moves a point of the anchors' plane off it, so the middle is tried on both sides.
    let step = (eigen.eigenvalues.max() / count).sqrt();
    let off = |from: [f64; 3], distance: f64| [0, 1, 2].map(|k| from[k] + distance * normal[k]);
    let mut starts = vec![off(middle, 0.5 * step), off(middle, -0.5 * step)];
    if let Some(place) = closed_form {
        let height: f64 = (0..3).map(|k| (place[k] - middle[k]) * normal[k]).sum();
        starts.extend([place, off(place, -2.0 * height)]);
    }
    starts
}

/// The state as a variable, with the mean pseudo-range of each anchor, the regression's rate, and the velocity's prior.
fn graph(
    settings: &WorldSettings,
    heard: &[Regression],
    rate: f64,
) -> Result<FactorGraph<DynamicGaussian>, String> {
    let variance = |value: f64| Noise::isotropic(1, value).map_err(|error: NoiseError| error.to_string());
    let refuse = |error: MessageError| error.to_string();
    let mut graph = FactorGraph::new();
    let state = graph.variable("state", Space::real(DIMENSION)).map_err(|error| error.to_string())?;
    for own in heard {
        let noise = variance(settings.range_variance / own.count)?;
        let range = PseudoRange::new(own.mean, own.place, settings.sound_speed, noise).map_err(refuse)?;
        let range = range.aged(own.age).map_err(refuse)?.still();
        graph.add("beacon", range, &[state]).map_err(|error| error.to_string())?;
    }
    let count = heard.len() as f64;
    let spread = heard.iter().map(|own| 1.0 / own.spread).sum::<f64>() / (count * count);
    let rows = [(7, rate, settings.range_variance * spread)]
        .into_iter()
        .chain([1, 3, 5].map(|k| (k, 0.0, settings.velocity_variance)));
    for (coordinate, mean, spread) in rows {
        let mut row = [0.0; DIMENSION];
        row[coordinate] = 1.0;
        let factor = LinearGaussian::new(&[&row], &[mean], variance(spread)?).map_err(refuse)?;
        graph.add("known before", factor, &[state]).map_err(|error| error.to_string())?;
    }
    Ok(graph)
}

/// The lowest minimum of those that the starts lead to.
fn solve(
    graph: &FactorGraph<DynamicGaussian>,
    starts: &[[f64; 3]],
    heard: &[Regression],
    rate: f64,
) -> Result<Moments, ExactError> {
    let problem = Problem::new(graph)?;
    let mut best: Option<(f64, Moments)> = None;
    let mut failed = None;
    for place in starts {
        let mut values = problem.start();
        let first = heard.first().map_or(0.0, |own| {
            own.mean - (0..3).map(|k| (place[k] - own.place[k]).powi(2)).sum::<f64>().sqrt() - rate * own.age
        });
        let state = [place[0], 0.0, place[1], 0.0, place[2], 0.0, first, rate];
        for &variable in problem.variables() {
            values.set(variable, &state)?;
        }
        match problem.solve(values, &SolveOptions::default()) {
            Ok(mut solution) => {
                let cost = solution.report().cost;
                if best.as_ref().is_none_or(|(least, _)| cost < *least) {
                    best = Some((cost, solution.joint(problem.variables())?));
                }
            }
            Err(error) => failed = Some(error),
        }
    }
    match (best, failed) {
        (Some((_, state)), _) => Ok(state),
        (None, Some(error)) => Err(error),
        (None, None) => Err(ExactError::Request("there is no place to start from".into())),
    }
}
