//! Throughput of filters: particle-steps a second on the peers' workload W4 and on a bearing-and-range problem, and
//! the time of one step of Gaussian filters. Times of one core are processor time (median), which a busy machine does not stretch.
//!
//! W4: constant velocity in the plane, four range sensors, reselection at every step, the mean read at each. Problem
//! A: a bearing (0.2°) and a range (1 m) from the origin, reselection where the effective sample size halves.
//!
//! `cargo bench --bench filters [PARTICLES]`

#[path = "common.rs"]
mod common;

use common::Timing;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;
use std::hint::black_box;
use sumprod::filters::{Approximation, Correct, Kalman, ParticleFilter, Predict};
use sumprod::optimizers::Trigger;
use sumprod::prelude::*;

type Outcome<T> = Result<T, Box<dyn std::error::Error>>;

/// What a sensor at a known place reads: a range, or bearing and range.
struct Reading {
    place: [f64; 2],
    measured: [f64; 2],
    with_bearing: bool,
    noise: Noise,
}

impl Residual for Reading {
    fn dimensions(&self) -> &[usize] {
        &[4]
    }

    fn noise(&self) -> &Noise {
        &self.noise
    }

    fn angles(&self) -> &[usize] {
        if self.with_bearing { &[1] } else { &[] }
    }

    #[inline(always)]
    fn residual<T: Real>(&self, x: &[&[T]], out: &mut [T]) {
        let (east, north) = (x[0][0] - self.place[0], x[0][2] - self.place[1]);
        out[0] = distance(east, north) - self.measured[0];
        if self.with_bearing {
            out[1] = north.atan2(east) - self.measured[1];
        }
    }
}

/// A track and what was read of it.
struct Problem {
    name: &'static str,
    prior: Moments,
    motion: ConstantVelocity,
    trigger: Trigger,
    truth: Vec<[f64; 2]>,
    readings: Vec<Vec<Reading>>,
}

fn problem(with_bearing: bool, steps: usize) -> Outcome<Problem> {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(3);
    let mut normal = move || -> f64 { StandardNormal.sample(&mut random) };
    let (interval, density) = if with_bearing { (1.0, 0.1) } else { (0.5, 0.09) };
    let motion = ConstantVelocity::white_acceleration(2, interval, density)?;
    let start = if with_bearing { [100.0, 1.5, 50.0, 1.0] } else { [0.0, 1.5, 0.0, 1.0] };
    let prior = Moments::diagonal(&start, &[9.0, 0.25, 9.0, 0.25]);
    let sensors: &[[f64; 2]] = if with_bearing {
        &[[0.0, 0.0]]
    } else {
        &[[-50.0, -50.0], [50.0, -50.0], [50.0, 50.0], [-50.0, 50.0]]
    };
    let bearing_variance = 0.2f64.to_radians().powi(2);
    let noise =
        if with_bearing { Noise::diagonal(&[1.0, bearing_variance])? } else { Noise::isotropic(1, 1.0)? };
    let (mut state, mut next) = (start, [0.0; 4]);
    let (mut truth, mut readings) = (Vec::new(), Vec::new());
    let process = motion.noise(&state);
    for step in 0..steps {
        if step > 0 {
            motion.step(&state, &mut next);
            for source in 0..process.sources() {
                let z = normal();
                (0..4).for_each(|row| next[row] += process.factor()[row * process.sources() + source] * z);
            }
            state = next;
        }
        truth.push([state[0], state[2]]);
        let read = |place: &[f64; 2]| {
            let (east, north) = (state[0] - place[0], state[2] - place[1]);
            let measured =
                [east.hypot(north) + normal(), north.atan2(east) + bearing_variance.sqrt() * normal()];
            Reading { place: *place, measured, with_bearing, noise: noise.clone() }
        };
        readings.push(sensors.iter().map(read).collect());
    }
    let (name, trigger) = if with_bearing { ("A ", Trigger::below(0.5)?) } else { ("W4", Trigger::ALWAYS) };
    Ok(Problem { name, prior, motion, trigger, truth, readings })
}

impl Problem {
    /// Runs a filter and returns the root mean square error of the position.
    fn error<F: Predict<ConstantVelocity>>(
        &self,
        filter: &mut F,
        correct: impl Fn(&mut F, &Vec<Reading>) -> Outcome<()>,
        mean: impl Fn(&F) -> [f64; 2],
    ) -> Outcome<f64> {
        let mut squares = 0.0;
        for (step, (truth, readings)) in self.truth.iter().zip(&self.readings).enumerate() {
            if step > 0 {
                filter.predict(&self.motion)?;
            }
            correct(filter, readings)?;
            let mean = mean(filter);
            squares += (mean[0] - truth[0]).powi(2) + (mean[1] - truth[1]).powi(2);
        }
        Ok((squares / self.truth.len() as f64).sqrt())
    }

    fn particles(&self, count: usize) -> Outcome<f64> {
        let filter = ParticleFilter::new(&Space::real(4), &self.prior, count, 1)?;
        // All readings of a step at once.
        let correct = |filter: &mut ParticleFilter, readings: &Vec<Reading>| {
            filter.correct(readings)?;
            Ok(())
        };
        self.error(&mut filter.reselecting_when(self.trigger), correct, |filter| {
            let mean = filter.mean();
            [mean[0], mean[2]]
        })
    }

    fn kalman(&self, approximation: Approximation) -> Outcome<f64> {
        let mut filter = Kalman::<4>::new(&self.prior)?.approximated(approximation);
        let correct = |filter: &mut Kalman<4>, readings: &Vec<Reading>| {
            readings.iter().try_for_each(|reading| filter.correct(reading).map(drop))?;
            Ok(())
        };
        self.error(&mut filter, correct, |filter| [filter.mean()[0], filter.mean()[2]])
    }
}

fn main() -> Outcome<()> {
    for count in common::sizes(&[1_000, 10_000, 100_000, 1_000_000]) {
        let steps = if count < 1_000_000 { 100 } else { 30 };
        for with_bearing in [false, true] {
            let problem = problem(with_bearing, steps)?;
            let repeats = 7;
            let run = || problem.particles(count).map(drop).map_err(|error| error.to_string());
            let pool = |threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build();
            let one = pool(1)?.install(|| Timing::of_thread(repeats, run))?;
            let two =
                pool(2)?.install(|| Timing::of((4_000_000 / count / steps).clamp(repeats, 200), run))?;
            let rate = |seconds: f64| (count * steps) as f64 / seconds / 1e6;
            println!(
                "{}, {count} particles: {:.1} M particle-steps a second of one core, {:.1} of two by the clock; RMSE {:.3} m (EKF {:.3} m)",
                problem.name,
                rate(one.median()),
                rate(two.least()),
                problem.particles(count)?,
                problem.kalman(Approximation::FirstOrder)?,
            );
        }
    }
    gaussian_steps()
}

/// A step of four coordinates: one prediction, one correction by a position fix.
fn gaussian_steps() -> Outcome<()> {
    let motion = ConstantVelocity::white_acceleration(2, 0.5, 0.1)?;
    let prior = Moments::diagonal(&[0.0, 1.0, 0.0, 1.0], &[9.0, 1.0, 9.0, 1.0]);
    let fix = AnchorOffset::new(&[0.3, -0.2], &[0.0, 0.0], 4, &[0, 2], Noise::isotropic(2, 0.25)?)?;
    let unscented = Approximation::Unscented { alpha: 1.0, beta: 0.0, kappa: -1.0 };
    let ways = [
        ("Kalman", Approximation::FirstOrder),
        ("unscented", unscented),
        ("cubature", Approximation::Cubature),
    ];
    for (name, approximation) in ways {
        let mut filter = Kalman::<4>::new(&prior)?.approximated(approximation);
        let steps = 100_000;
        let timing = Timing::of_thread(7, || -> Result<(), sumprod::filters::FilterError> {
            for _ in 0..steps {
                filter.predict(black_box(&motion))?;
                black_box(filter.correct(black_box(&fix))?);
            }
            Ok(())
        })?;
        println!(
            "{name} step of 4 coordinates, fix of 2: {:.3} us",
            timing.median() / f64::from(steps) * 1e6
        );
    }
    Ok(())
}
