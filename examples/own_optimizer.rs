//! An optimizer of one's own: the likelihood let in by stages, against the regularised draw at equal cost.
//!
//! A position known to 10 m is measured by three ranges good to 0.2 m: hardly any particle of the prior explains them.

use rand_distr::{Distribution, StandardNormal};
use sumprod::graph::FastStream;
use sumprod::optimizers::{
    CloudKernel, Move, Moved, OptimizerError, Regularised, Reselection, Systematic, Target, Validity,
};
use sumprod::prelude::*;

/// In each of K stages the particles are drawn from their kernels, weighed by ℓ^(1/K), and reselected; the last
/// stage's weights are kept.
struct Staged(usize);

impl Move for Staged {
    fn advance(&self, target: &mut Target<'_>, random: &mut FastStream) -> Result<Moved, OptimizerError> {
        let (mut particles, d) = (target.prior().clone(), target.dimension());
        for stage in 1.. {
            let kernel = CloudKernel::of(&particles, 1.0)?;
            let mut points = vec![0.0; particles.points().len()];
            for (point, centre) in points.chunks_exact_mut(d).zip(particles.points().chunks_exact(d)) {
                kernel.draw(centre, random, point);
            }
            let mut logs = vec![0.0; particles.len()];
            target.log_likelihood(&points, &mut logs)?;
            for (log, weight) in logs.iter_mut().zip(particles.log_weights()) {
                *log = *log / self.0 as f64 + weight;
            }
            let weighed = Moved::weighed(target, points, logs)?;
            if stage == self.0 {
                // The stages' evidences multiply to none of the whole likelihood; ancestors were lost on the way.
                return Ok(Moved { ancestors: Vec::new(), log_evidence: None, ..weighed });
            }
            let count = particles.len();
            let chosen = Systematic.choose(&weighed.particles.weights(), count, random);
            let points = chosen.iter().flat_map(|&ancestor| weighed.particles.point(ancestor)).copied();
            particles = Particles::equally_weighted(&target.space(), points.collect())?;
        }
        Err(OptimizerError::Empty { what: "the number of stages" })
    }

    fn validity(&self) -> Validity {
        Validity::Smoothed
    }
}

/// Prints how well each optimizer finds the position, at 2,000 likelihoods.
pub fn main() -> Result<(), Box<dyn std::error::Error>> {
    let (anchors, truth) = ([[0.0, 0.0], [100.0, 0.0], [0.0, 100.0]], [43.0_f64, 57.0]);
    let ranges = |x: &[f64]| -> [f64; 3] { anchors.map(|a: [f64; 2]| (x[0] - a[0]).hypot(x[1] - a[1])) };
    let measured = ranges(&truth);
    let likelihood = |x: &[f64]| -> f64 {
        ranges(x).iter().zip(measured).map(|(range, z)| -0.5 * ((range - z) / 0.2).powi(2)).sum()
    };
    let optimizers: [(&str, usize, Box<dyn Move>); 2] =
        [("regularised", 2000, Box::new(Regularised::default())), ("staged", 500, Box::new(Staged(4)))];
    for (name, count, optimizer) in &optimizers {
        let (mut error, mut effective, runs) = (0.0, 0.0, 50);
        for run in 0..runs {
            let space = Space::real(2);
            let mut random = Stream::new(1, run, Purpose::User(0), 0).fast();
            let mut normal = || -> f64 { StandardNormal.sample(&mut random) };
            let points = (0..*count).flat_map(|_| [40.0 + 10.0 * normal(), 60.0 + 10.0 * normal()]);
            let cloud = Particles::equally_weighted(&space, points.collect())?;
            let mut target = Target::new(&cloud, &likelihood)?;
            let moved = optimizer.apply(&mut target, &mut Stream::new(1, run, Purpose::Optimizer, 0))?;
            assert_eq!(target.evaluations(), 2000);
            let mean = moved.particles.mean();
            error += ((mean[0] - truth[0]).powi(2) + (mean[1] - truth[1]).powi(2)) / runs as f64;
            effective += moved.effective_sample_size / runs as f64;
        }
        println!("{name}: {count} particles, error {:.3} m, {effective:.0} effective", error.sqrt());
    }
    Ok(())
}
