//! One target, ranges from three posts, and the same verbs for three filters and a smoother.
//!
//! Some steps have no measurement, one post fails halfway, and the filters are told of neither: a step holds whatever
//! was measured.

use rand_distr::{Distribution, StandardNormal};
use sumprod::filters::{Approximation, Step};
use sumprod::prelude::*;

const POSTS: [[f64; 2]; 3] = [[0.0, 0.0], [120.0, 0.0], [60.0, 100.0]];

/// Prints the root mean square error of each filter's position, and its log-evidence.
pub fn main() -> Result<(), Box<dyn std::error::Error>> {
    let motion = ConstantVelocity::white_acceleration(2, 1.0, 0.05)?;
    let prior = Moments::diagonal(&[20.0, 1.0, 10.0, 1.0], &[25.0, 0.25, 25.0, 0.25]);
    let mut random = Stream::new(7, 0, Purpose::World, 0).fast();
    let mut normal = move || -> f64 { StandardNormal.sample(&mut random) };

    let (mut state, mut next) = ([22.0, 1.2, 8.0, 0.8], [0.0; 4]);
    let process = motion.noise(&state);
    let (mut truth, mut steps) = (Vec::new(), Vec::new());
    for k in 0..60 {
        if k > 0 {
            motion.step(&state, &mut next);
            for source in 0..process.sources() {
                let z = normal();
                (0..4).for_each(|row| next[row] += process.factor()[row * process.sources() + source] * z);
            }
            state = next;
        }
        let heard = if k % 7 == 6 {
            0
        } else if k < 30 {
            3
        } else {
            2
        };
        let mut measurements = Vec::new();
        for post in &POSTS[..heard] {
            let range = (state[0] - post[0]).hypot(state[2] - post[1]) + normal();
            measurements.push(AnchorRange::new(range, *post, 4, [0, 2], Noise::isotropic(1, 1.0)?)?);
        }
        steps.push(Step { motion: (k > 0).then(|| motion.clone()), measurements });
        truth.push([state[0], state[2]]);
    }
    let error = |estimates: &[Moments]| {
        let squares = truth.iter().zip(estimates).map(|(truth, estimate)| {
            (estimate.mean[0] - truth[0]).powi(2) + (estimate.mean[2] - truth[1]).powi(2)
        });
        (squares.sum::<f64>() / truth.len() as f64).sqrt()
    };

    let mut kalman = Kalman::<4>::new(&prior)?.approximated(Approximation::Iterated(5));
    let run = kalman.run(steps.clone())?;
    let filtered: Vec<Moments> = run.records.iter().map(|record| record.moments()).collect();
    let smoothed = kalman.smooth(&run)?;
    println!("iterated Kalman: {:.3} m, log-evidence {:.2}", error(&filtered), run.log_evidence);
    println!("its smoother:    {:.3} m", error(&smoothed));

    let mut particles = ParticleFilter::new(&Space::real(4), &prior, 5000, 1)?;
    let run = particles.run(steps)?;
    let by_particles: Vec<Moments> = run.records.iter().map(Particles::moments).collect();
    println!("particles:       {:.3} m, log-evidence {:.2}", error(&by_particles), run.log_evidence);
    (error(&smoothed) < error(&by_particles)).then_some(()).ok_or("smoothing has not helped".into())
}
