//! The four problems, and how an optimizer is scored on them.

use sumprod::filters::{Correct, DrivenFilter, Filter, FilterError, Predict};
use sumprod::graph::FastStream;
use sumprod::models::library::CoordinatedTurn;
use sumprod::optimizers::Move;
use sumprod::positioning::kcpf::growth::{GrowthMeasurement, GrowthMotion};
use sumprod::positioning::kcpf::turn::RadarMeasurement;
use sumprod::positioning::wsn::ranges::Ranges;
use sumprod::positioning::wsn::world::{Start, World, WorldSettings};
use sumprod::prelude::*;

use rand_distr::{Distribution, StandardNormal};

use super::Failure;

/// Tracks run `run` with `count` particles moved by an optimizer, and adds the result to the tally.
type Track = fn(run: u64, count: usize, optimizer: Box<dyn Move>, tally: &mut Tally) -> Result<(), Failure>;

/// A problem and how it is tracked.
pub struct Problem {
    pub name: &'static str,
    pub track: Track,
}

pub const PROBLEMS: &[Problem] = &[
    Problem { name: "WSN, 4 sensors", track: |run, n, by, out| wsn(run, 0.36).track(run, n, by, out) },
    Problem { name: "growth", track: |run, n, by, out| growth(run, 1.0)?.track(run, n, by, out) },
    Problem { name: "turn", track: |run, n, by, out| turn(run)?.track(run, n, by, out) },
    Problem { name: "growth, sharp", track: |run, n, by, out| growth(run, 0.01)?.track(run, n, by, out) },
];

/// One run of a problem: the truth and what is measured of it at every step.
struct Run<M, R> {
    prior: Moments,
    /// Whether the process noise has a density.
    density: bool,
    /// Coordinates that are scored.
    scored: Vec<usize>,
    steps: Vec<(M, R, Vec<f64>)>,
}

impl<M: Motion, R: Residual> Run<M, R> {
    fn track(self, run: u64, count: usize, by: Box<dyn Move>, tally: &mut Tally) -> Result<(), Failure> {
        let space = Space::real(self.prior.dimension());
        let mut filter = DrivenFilter::new(&space, &self.prior, count, run, by)?;
        if self.density {
            filter = filter.knowing_density();
        }
        let mut squares = 0.0;
        for (motion, measurement, truth) in &self.steps {
            filter.predict(motion)?;
            match filter.correct(measurement) {
                // Nothing explains the measurement: the prediction stands, and the table says how often.
                Err(FilterError::Unexplained { .. } | FilterError::Optimizer { .. }) => tally.failed += 1,
                corrected => drop(corrected?),
            }
            let mean = filter.moments().mean;
            for &k in &self.scored {
                squares += (mean[k] - truth[k]).powi(2);
                let [low, high] = [0.025, 0.975].map(|tail| filter.particles().quantile(k, tail));
                let inside =
                    low.is_some_and(|low| low <= truth[k]) && high.is_some_and(|high| truth[k] <= high);
                tally.covered += u64::from(inside);
                tally.scored += 1;
            }
        }
        tally.steps += self.steps.len() as u64;
        tally.evaluations += filter.evaluations();
        tally.squares.push(squares / self.steps.len() as f64);
        Ok(())
    }
}

/// What an optimizer got on a problem.
#[derive(Default)]
pub struct Tally {
    /// Mean squared error of each run.
    squares: Vec<f64>,
    covered: u64,
    scored: u64,
    steps: u64,
    evaluations: u64,
    /// Corrections that failed.
    pub failed: u64,
}

impl Tally {
    /// Root of the mean squared error, and its standard error over the runs by the delta method.
    pub fn rmse(&self) -> (f64, f64) {
        let n = self.squares.len() as f64;
        let mean = self.squares.iter().sum::<f64>() / n;
        let variance = self.squares.iter().map(|square| (square - mean).powi(2)).sum::<f64>() / (n - 1.0);
        (mean.sqrt(), (variance / n).sqrt() / (2.0 * mean.sqrt()))
    }

    /// Share of runs whose error is smaller than in `other`, ties by halves.
    pub fn wins_over(&self, other: &Self) -> f64 {
        let pairs = self.squares.iter().zip(&other.squares);
        let won: f64 = pairs
            .map(|(mine, theirs)| match mine.total_cmp(theirs) {
                std::cmp::Ordering::Less => 1.0,
                std::cmp::Ordering::Equal => 0.5,
                std::cmp::Ordering::Greater => 0.0,
            })
            .sum();
        won / self.squares.len() as f64
    }

    /// Share of coordinates inside the central 95 % interval of the particles.
    pub fn coverage(&self) -> f64 {
        self.covered as f64 / self.scored as f64
    }

    pub fn evaluations_a_step(&self) -> f64 {
        self.evaluations as f64 / self.steps as f64
    }
}

fn wsn(run: u64, measurement_variance: f64) -> Run<ConstantVelocity, Ranges> {
    let settings = WorldSettings { start: Start::Bayes, measurement_variance, ..WorldSettings::default() };
    let world = World::simulate(&settings, 1, run as u32);
    let steps = world.scans.iter().zip(&world.truth[1..]).filter_map(|(scan, truth)| {
        let motion = ConstantVelocity::held_acceleration(2, settings.interval, settings.process_variance);
        let ranges = Ranges::new(&world.sensors, &scan.readings, measurement_variance);
        Some((motion.ok()?, ranges.ok()?, truth.to_vec()))
    });
    Run {
        prior: Moments::diagonal(&settings.prior_mean, &settings.prior_variance),
        density: false,
        scored: vec![0, 2],
        steps: steps.collect(),
    }
}

fn random(problem: u64, run: u64) -> FastStream {
    Stream::new(1, run, Purpose::World, problem).fast()
}

fn normal(random: &mut FastStream) -> f64 {
    StandardNormal.sample(random)
}

/// The growth model, whose posterior often has two modes; sharp where the measurement's variance is small.
fn growth(run: u64, variance: f64) -> Result<Run<GrowthMotion, GrowthMeasurement>, Failure> {
    let mut random = random(1, run);
    let mut x = [5.0_f64.sqrt() * normal(&mut random)];
    let mut steps = Vec::new();
    for number in 1..=50 {
        let motion = GrowthMotion::new(number, 10.0)?;
        let mut next = [0.0];
        motion.step(&x, &mut next);
        x = [next[0] + 10.0_f64.sqrt() * normal(&mut random)];
        let measured = 0.05 * x[0] * x[0] + variance.sqrt() * normal(&mut random);
        steps.push((motion, GrowthMeasurement::new(measured, variance)?, x.to_vec()));
    }
    Ok(Run { prior: Moments::diagonal(&[0.0], &[5.0]), density: true, scored: vec![0], steps })
}

/// An aircraft's turn of 19 s between two straight flights of 20 s, seen by a radar at the origin.
fn turn(run: u64) -> Result<Run<CoordinatedTurn, RadarMeasurement>, Failure> {
    let mut random = random(2, run);
    let (speed, variances) = (300.0_f64, [2500.0_f64, 1e-4]);
    let start = [4e4_f64, 900.0, 4e4, 900.0, 4e-4];
    let mut state: [f64; 5] = [-2000.0, 0.0, 12_000.0, speed, 0.0];
    let mean: Vec<f64> =
        state.iter().zip(start).map(|(x, variance)| x + variance.sqrt() * normal(&mut random)).collect();
    let motion = CoordinatedTurn::new(1.0, 4.0, 9e-4)?;
    let mut steps = Vec::new();
    for number in 1..=59 {
        state[4] = if (21..=39).contains(&number) { -50.0 / speed } else { 0.0 };
        let before = state;
        motion.step(&before, &mut state);
        let measured = [
            state[0].hypot(state[2]) + variances[0].sqrt() * normal(&mut random),
            state[2].atan2(state[0]) + variances[1].sqrt() * normal(&mut random),
        ];
        steps.push((motion.clone(), RadarMeasurement::new(measured, variances)?, state.to_vec()));
    }
    Ok(Run { prior: Moments::diagonal(&mean, &start), density: false, scored: vec![0, 2], steps })
}
