//! The law of moves, for every implementation.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail the test")]

use rand_distr::{Distribution, StandardNormal};
use sumprod_graph::{FastStream, Purpose, Space, Stream};
use sumprod_messages::Particles;
use sumprod_optimizers::{
    BoardSettings, Independence, KnowledgeBoard, LogDensity, Move, Moved, OptimizerError, PriorDensity,
    QuantumImportance, QuantumLiteral, QuantumMetropolis, RandomWalk, Regularised, Rotation, Target,
    Validity, Weigh,
};

/// Standard errors allowed: two-sided error probability 6e-7 of one comparison.
const BOUND: f64 = 5.0;
const REPETITIONS: u64 = 500;
const COUNT: usize = 120;
/// What a Gaussian sum in place of this prior may change an expectation by; the functions have deviations near 1.
const RESOLUTION: f64 = 0.03;

/// Prior x ~ N(m, L L'), measurement z = x₀ + x₁ + v with v ~ N(0, R): the posterior is Gaussian and known.
const MEAN: [f64; 2] = [1.0, -0.5];
const FACTOR: [[f64; 2]; 2] = [[1.0, 0.0], [0.6, 0.8]];
const MEASURED: f64 = 1.9;
const VARIANCE: f64 = 0.3;

/// Every move, by the name that a failure is reported under.
fn moves() -> Vec<(&'static str, Box<dyn Move>)> {
    let board = |settings| Box::new(KnowledgeBoard::new(settings).unwrap());
    let still = QuantumImportance { rotation: Rotation::new(0.0, 9).unwrap(), ..Default::default() };
    vec![
        ("weigh", Box::new(Weigh)),
        ("regularised", Box::new(Regularised::default())),
        ("random walk", Box::new(RandomWalk::new(8, 1.0).unwrap())),
        ("independence", Box::new(Independence::new(8, 1.2).unwrap())),
        ("quantum literal", Box::new(QuantumLiteral::default())),
        ("quantum importance", Box::new(QuantumImportance::default())),
        ("quantum importance without rotation", Box::new(still)),
        ("quantum metropolis", Box::new(QuantumMetropolis::default())),
        ("board", board(BoardSettings::default())),
        ("board-literal", board(BoardSettings::literal())),
    ]
}

fn stream(iteration: u64, entity: u64) -> Stream {
    Stream::new(29, iteration, Purpose::Optimizer, entity)
}

/// A sample of the prior, unequally weighted where `weighted`: drawn from twice the prior's width then.
fn prior(entity: u64, weighted: bool) -> Particles {
    let mut random = stream(0, entity).fast();
    let width = if weighted { 1.4 } else { 1.0 };
    let (mut points, mut logs) = (Vec::new(), Vec::new());
    for _ in 0..COUNT {
        let normal: [f64; 2] = std::array::from_fn(|_| StandardNormal.sample(&mut random));
        let square = normal[0] * normal[0] + normal[1] * normal[1];
        logs.push(0.5 * square * (1.0 - width * width));
        points.extend(place(normal.map(|normal| width * normal)));
    }
    Particles::new(&Space::real(2), points, logs).unwrap()
}

fn log_likelihood(x: &[f64]) -> f64 {
    let residual = MEASURED - x[0] - x[1];
    -0.5 * residual * residual / VARIANCE
}

struct Prior;

impl LogDensity for Prior {
    fn log_values(&self, points: &[f64], values: &mut [f64]) -> Result<(), OptimizerError> {
        let scale = std::f64::consts::TAU * FACTOR[0][0] * FACTOR[1][1];
        for (x, value) in points.chunks_exact(2).zip(values) {
            let first = (x[0] - MEAN[0]) / FACTOR[0][0];
            let second = (x[1] - MEAN[1] - FACTOR[1][0] * first) / FACTOR[1][1];
            *value = -0.5 * (first * first + second * second) - scale.ln();
        }
        Ok(())
    }
}

impl PriorDensity for Prior {
    fn draw(&self, count: usize, random: &mut FastStream) -> Result<Vec<f64>, OptimizerError> {
        Ok((0..count).flat_map(|_| place(std::array::from_fn(|_| StandardNormal.sample(random)))).collect())
    }
}

/// The point of the prior at these standard coordinates.
fn place(standard: [f64; 2]) -> [f64; 2] {
    std::array::from_fn(|row| MEAN[row] + FACTOR[row][0] * standard[0] + FACTOR[row][1] * standard[1])
}

/// The posterior's mean and covariance, and the evidence.
fn exact() -> ([f64; 2], [[f64; 2]; 2], f64) {
    let covariance: [[f64; 2]; 2] = std::array::from_fn(|row| {
        std::array::from_fn(|column| (0..2).map(|k| FACTOR[row][k] * FACTOR[column][k]).sum())
    });
    let cross: [f64; 2] = std::array::from_fn(|row| covariance[row][0] + covariance[row][1]);
    let innovation = cross[0] + cross[1] + VARIANCE;
    let residual = MEASURED - MEAN[0] - MEAN[1];
    let mean = std::array::from_fn(|row| MEAN[row] + cross[row] * residual / innovation);
    let left = std::array::from_fn(|row| {
        std::array::from_fn(|column| covariance[row][column] - cross[row] * cross[column] / innovation)
    });
    let evidence = (VARIANCE / innovation).sqrt() * (-0.5 * residual * residual / innovation).exp();
    (mean, left, evidence)
}

type Function = fn(&[f64]) -> f64;

const FUNCTIONS: [(&str, Function); 5] = [
    ("x0", |x| x[0]),
    ("x1", |x| x[1]),
    ("x0²", |x| x[0] * x[0]),
    ("x0 x1", |x| x[0] * x[1]),
    ("x1²", |x| x[1] * x[1]),
];

fn expectations() -> [f64; 5] {
    let (mean, covariance, _) = exact();
    [
        mean[0],
        mean[1],
        covariance[0][0] + mean[0] * mean[0],
        covariance[0][1] + mean[0] * mean[1],
        covariance[1][1] + mean[1] * mean[1],
    ]
}

fn moved(movement: &dyn Move, entity: u64, weighted: bool, known: bool) -> (Moved, u64) {
    let prior = prior(entity, weighted);
    let mut target = Target::new(&prior, &log_likelihood).unwrap();
    if known {
        target = target.with_prior_density(&Prior);
    }
    let moved = movement.apply(&mut target, &mut stream(1, entity)).unwrap();
    (moved, target.evaluations())
}

fn average(particles: &Particles, function: Function) -> f64 {
    let weights = particles.weights();
    weights.iter().enumerate().map(|(index, weight)| weight * function(particles.point(index))).sum()
}

/// Ratio of two means over repetitions, and its standard error by the delta method.
fn ratio(pairs: &[(f64, f64)]) -> (f64, f64) {
    let n = pairs.len() as f64;
    let (top, bottom) = pairs.iter().fold((0.0, 0.0), |sums, pair| (sums.0 + pair.0, sums.1 + pair.1));
    let ratio = top / bottom;
    let squares: f64 = pairs.iter().map(|(top, bottom)| (top - ratio * bottom).powi(2)).sum();
    (ratio, squares.sqrt() * (n / (n - 1.0)).sqrt() / bottom)
}

#[test]
fn expectations_under_the_posterior_are_kept() {
    // 5 functions and the evidence for each move, with equal and unequal weights, and with the prior's density known
    // or not: 24 comparisons a move, error probability 1.5e-5 a move. An expectation is weighed by the evidence
    // estimated beside it, which takes the bias of order 1/N out of a self-normalised average.
    let expectations = expectations();
    let (.., evidence) = exact();
    for (name, movement) in moves() {
        if movement.validity() == Validity::Literal {
            continue;
        }
        for (weighted, known) in [(false, false), (true, false), (false, true), (true, true)] {
            let all: Vec<Moved> = (0..REPETITIONS).map(|k| moved(&*movement, k, weighted, known).0).collect();
            // A weighted prior's own estimates vary less where both are divided by the same sum of weights, which
            // is itself random: the evidence is compared where the weights are equal.
            if !weighted {
                let pairs: Vec<(f64, f64)> =
                    all.iter().filter_map(|moved| moved.log_evidence.map(|log| (log.exp(), 1.0))).collect();
                if !pairs.is_empty() {
                    let (mean, error) = ratio(&pairs);
                    assert!(
                        (mean - evidence).abs() < BOUND * error,
                        "{name}: evidence {mean} ± {error}, exact {evidence}"
                    );
                }
            }
            for ((function, f), exact) in FUNCTIONS.iter().zip(expectations) {
                let pairs: Vec<(f64, f64)> = all
                    .iter()
                    .map(|moved| {
                        let evidence = moved.log_evidence.map_or(1.0, f64::exp);
                        (evidence * average(&moved.particles, *f), evidence)
                    })
                    .collect();
                let (mean, error) = ratio(&pairs);
                let resolved = known || movement.validity() != Validity::GaussianSum;
                let bias = if resolved { 0.0 } else { RESOLUTION };
                assert!(
                    (mean - exact).abs() < BOUND * error + bias,
                    "{name}, weighted {weighted}, prior density {known}: E {function} = {mean} ± {error}, exact {exact}"
                );
            }
        }
    }
}

#[test]
fn weights_are_normalised_ancestors_exist_and_evaluations_are_counted() {
    for (name, movement) in moves() {
        for weighted in [false, true] {
            let (moved, evaluations) = moved(&*movement, 3, weighted, true);
            let weights = moved.particles.weights();
            assert!((weights.iter().sum::<f64>() - 1.0).abs() < 1e-12, "{name}");
            assert_eq!(weights.len(), COUNT, "{name}");
            assert!(moved.ancestors.is_empty() || moved.ancestors.len() == COUNT, "{name}");
            assert!(moved.ancestors.iter().all(|&ancestor| ancestor < COUNT), "{name}");
            assert!((1.0..=10.0 * COUNT as f64).contains(&moved.effective_sample_size), "{name}");
            assert!(moved.acceptance.is_none_or(|share| (0.0..=1.0).contains(&share)), "{name}");
            assert!(evaluations >= COUNT as u64, "{name}");
        }
    }
}

#[test]
fn the_same_stream_yields_the_same_bits() {
    for (name, movement) in moves() {
        let first = moved(&*movement, 5, false, false);
        assert_eq!(first, moved(&*movement, 5, false, false), "{name}");
        assert_ne!(first, moved(&*movement, 6, false, false), "{name}");
    }
}

#[test]
fn one_particle_and_a_likelihood_of_zero_are_no_accident() {
    let alone = Particles::equally_weighted(&Space::real(2), vec![0.5, 1.0]).unwrap();
    let zero = |_: &[f64]| f64::NEG_INFINITY;
    let wrong = |x: &[f64]| if x[0] < 0.0 { f64::NAN } else { 0.0 };
    for (name, movement) in moves() {
        for known in [false, true] {
            let mut target = Target::new(&alone, &log_likelihood).unwrap();
            if known {
                target = target.with_prior_density(&Prior);
            }
            let moved = movement.apply(&mut target, &mut stream(2, 0)).unwrap();
            assert!(moved.particles.points().iter().all(|x| x.is_finite()), "{name}, {known}");
        }
        let prior = prior(0, false);
        let mut target = Target::new(&prior, &zero).unwrap();
        let error = movement.apply(&mut target, &mut stream(2, 1)).unwrap_err().to_string();
        assert!(error.starts_with("none of the "), "{name}: {error}");
        let mut target = Target::new(&prior, &wrong).unwrap();
        let error = movement.apply(&mut target, &mut stream(2, 2)).unwrap_err().to_string();
        assert!(error.contains("is NaN"), "{name}: {error}");
    }
}

#[test]
fn the_literal_form_breaks_the_law_and_says_so() {
    // The best of six draws by likelihood lies nearer the measurement than the posterior does: the variance along the
    // measured direction x₀ + x₁ comes out less than half as wide.
    let (_, covariance, _) = exact();
    let along = covariance[0][0] + 2.0 * covariance[0][1] + covariance[1][1];
    let movement = QuantumLiteral::default();
    assert_eq!(movement.validity(), Validity::Literal);
    let found: Vec<f64> = (0..100)
        .map(|k| {
            let (moved, _) = moved(&movement, k, false, false);
            let mean = average(&moved.particles, |x| x[0] + x[1]);
            average(&moved.particles, |x| (x[0] + x[1]).powi(2)) - mean * mean
        })
        .collect();
    let mean = found.iter().sum::<f64>() / 100.0;
    assert!(mean < 0.5 * along, "{mean} of {along}");
}

#[test]
fn rotation_costs_effective_samples() {
    // Of pools of 600, 100 each: 187 ± 1.5 without rotation, 180 ± 1.5 with that of the top bit, 99 ± 4 of all bits.
    let mean = |angle: f64, places: usize| -> f64 {
        let rotation = Rotation::new(angle, places).unwrap();
        let movement = QuantumImportance { rotation, ..Default::default() };
        (0..100).map(|k| moved(&movement, k, false, false).0.effective_sample_size).sum::<f64>() / 100.0
    };
    let turn = 0.05 * std::f64::consts::PI;
    let (none, top, all) = (mean(0.0, 9), mean(turn, 1), mean(turn, 9));
    assert!(all < 0.9 * none && all < top, "none {none}, top bit {top}, all bits {all}");
}
