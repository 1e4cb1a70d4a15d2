//! The posterior without any of the solver: trajectories drawn from their prior, and for each the landmarks'
//! integrals on a grid, which given a trajectory are independent.

use rand_distr::{Distribution, StandardNormal};
use std::f64::consts::TAU;
use sumprod_graph::{Purpose, Stream};
use sumprod_messages::Cholesky;
use sumprod_models::Noise;
use sumprod_models::library::pose::{compose, exponential};

use crate::range_slam::file::{RangeGraph, RangeLine};

/// Grid points across a ring, spaced by one standard deviation: the trapezoidal rule is off by 2 exp(-2π²) for a
/// Gaussian of that spacing, and what it leaves out lies beyond six.
const ACROSS: i32 = 6;

/// What is known of one landmark.
#[derive(Clone, Copy, Debug, Default)]
pub struct Landmark {
    pub mean: [f64; 2],
    pub variance: [f64; 2],
    /// Share of the posterior left of the first pose's heading.
    pub left: f64,
}

pub struct Reference {
    pub log_evidence: f64,
    /// Effective number of the trajectories.
    pub effective: f64,
    /// By number; only those seen.
    pub landmarks: Vec<(usize, Landmark)>,
}

fn draw(noise: &Noise, random: &mut impl rand::Rng) -> [f64; 3] {
    let z: [f64; 3] = std::array::from_fn(|_| StandardNormal.sample(random));
    let mut twist = [0.0; 3];
    Cholesky::new(noise.covariance(), 3, "the noise").unwrap().multiply_lower(&z, &mut twist);
    exponential(&twist)
}

/// Sums of the likelihood of ranges to one landmark over the plane: total, x, y, x², y², left; scaled by exp(-largest).
fn integrate(ranges: &[RangeLine], poses: &[[f64; 3]]) -> [f64; 6] {
    let first = ranges.iter().min_by(|a, b| a.measured.total_cmp(&b.measured)).unwrap();
    let (middle, deviation) = (poses[first.pose], first.variance.sqrt());
    let turns = (TAU * (first.measured + 6.0 * deviation) / deviation).ceil() as i32;
    let mut sums = [0.0; 6];
    for i in -ACROSS..=ACROSS {
        let radius = first.measured + f64::from(i) * deviation;
        if radius <= 0.0 {
            continue;
        }
        for j in 0..turns {
            let (sine, cosine) = (TAU * f64::from(j) / f64::from(turns)).sin_cos();
            let (x, y) = (middle[0] + radius * cosine, middle[1] + radius * sine);
            let log: f64 = ranges
                .iter()
                .map(|range| {
                    let distance = (x - poses[range.pose][0]).hypot(y - poses[range.pose][1]);
                    -0.5 * ((distance - range.measured).powi(2) / range.variance
                        + (TAU * range.variance).ln())
                })
                .sum();
            let share = log.exp() * radius * deviation * TAU / f64::from(turns);
            let (sine, cosine) = poses[0][2].sin_cos();
            let left = cosine * (y - poses[0][1]) - sine * (x - poses[0][0]) > 0.0;
            let terms = [1.0, x, y, x * x, y * y, f64::from(u8::from(left))];
            sums.iter_mut().zip(terms).for_each(|(sum, term)| *sum += share * term);
        }
    }
    sums
}

/// The posterior at `step` of a graph with a prior on the first pose and odometry from each to the next, by `count`
/// trajectories.
pub fn reference(graph: &RangeGraph, step: usize, count: u32) -> Reference {
    let seen: Vec<(usize, Vec<RangeLine>)> = (0..graph.landmarks.len())
        .map(|landmark| {
            let mine = graph.ranges.iter().filter(|range| range.landmark == landmark && range.pose <= step);
            (landmark, mine.copied().collect())
        })
        .filter(|(_, ranges): &(usize, Vec<RangeLine>)| !ranges.is_empty())
        .collect();
    let mut random = Stream::new(7, step as u64, Purpose::World, 0).fast();
    let (mut total, mut squares) = (0.0, 0.0);
    let mut sums = vec![[0.0; 6]; seen.len()];
    for _ in 0..count {
        let prior = &graph.priors[0];
        let mut poses = vec![compose(&prior.at, &draw(&prior.noise, &mut random))];
        for line in graph.relative.iter().filter(|line| line.to <= step) {
            assert_eq!((line.from, line.to), (poses.len() - 1, poses.len()), "odometry in order");
            let next = compose(&compose(&poses[line.from], &line.measured), &draw(&line.noise, &mut random));
            poses.push(next);
        }
        let integrals: Vec<[f64; 6]> = seen.iter().map(|(_, ranges)| integrate(ranges, &poses)).collect();
        let weight: f64 = integrals.iter().map(|integral| integral[0]).product();
        total += weight;
        squares += weight * weight;
        for (sums, integral) in sums.iter_mut().zip(&integrals) {
            sums.iter_mut().zip(integral).for_each(|(sum, term)| *sum += weight * term / integral[0]);
        }
    }
    let landmark = |sums: &[f64; 6]| {
        let [_, x, y, xx, yy, left] = sums.map(|sum| sum / total);
        Landmark { mean: [x, y], variance: [xx - x * x, yy - y * y], left }
    };
    Reference {
        log_evidence: (total / f64::from(count)).ln(),
        effective: total * total / squares,
        landmarks: seen.iter().zip(&sums).map(|((number, _), sums)| (*number, landmark(sums))).collect(),
    }
}
