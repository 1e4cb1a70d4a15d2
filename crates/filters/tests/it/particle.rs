//! The particle filter against the Kalman filter on a linear model, and its promises.

use crate::support::{Track, apart};
use sumprod_filters::{Filter, Kalman, ParticleFilter, Step};
use sumprod_graph::Space;
use sumprod_optimizers::{Scheme, Trigger};

fn filter(track: &Track, count: usize, seed: u64) -> ParticleFilter {
    ParticleFilter::new(&Space::real(4), &track.prior, count, seed).unwrap()
}

/// Log of the mean of exp(log-evidence) over 60 runs against the exact one: the estimate is unbiased, and within 4.5
/// of its own standard errors (t with 59 degrees of freedom: wrong with probability below 4e-5 each).
#[test]
fn the_evidence_is_the_kalman_filters_missing_fixes_included() {
    for held in [true, false] {
        let track = Track::simulated(2, 20, held);
        let exact = Kalman::<4>::new(&track.prior).unwrap().run(track.steps()).unwrap().log_evidence;
        let always: fn(ParticleFilter) -> ParticleFilter = |filter| filter;
        let rarely: fn(ParticleFilter) -> ParticleFilter =
            |filter| filter.reselecting_when(Trigger::below(0.5).unwrap());
        let by_name: fn(ParticleFilter) -> ParticleFilter = |filter| filter.reselecting_by(Scheme::Ssp);
        for variant in [always, rarely, by_name] {
            let ratios: Vec<f64> = (0..60)
                .map(|seed| {
                    let run = variant(filter(&track, 2000, seed)).run(track.steps()).unwrap();
                    (run.log_evidence - exact).exp()
                })
                .collect();
            let n = ratios.len() as f64;
            let mean = ratios.iter().sum::<f64>() / n;
            let variance = ratios.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (n - 1.0);
            let error = (variance / n).sqrt();
            assert!((mean - 1.0).abs() < 4.5 * error, "{mean} ± {error}");
            assert!(error < 0.2, "{error}");
        }
    }
}

/// 40,000 particles: a standard error of 0.005 to 0.01 standard deviations of the posterior; the bound is 0.1.
#[test]
fn many_particles_have_the_kalman_filters_moments() {
    let track = Track::simulated(3, 15, true);
    let exact = Kalman::<4>::new(&track.prior).unwrap().run(track.steps()).unwrap();
    let mut filter = filter(&track, 40_000, 5);
    for (step, record) in track.steps().into_iter().zip(&exact.records) {
        filter.run([step]).unwrap();
        let (found, exact) = (filter.moments(), record.moments());
        for k in 0..4 {
            let deviation = exact.covariance_at(k, k).sqrt();
            assert!((found.mean[k] - exact.mean[k]).abs() < 0.1 * deviation);
            assert!((found.covariance_at(k, k).sqrt() / deviation - 1.0).abs() < 0.1);
        }
        assert_eq!(filter.mean(), found.mean);
    }
}

#[test]
fn the_bits_do_not_depend_on_the_number_of_threads() {
    let track = Track::simulated(4, 6, false);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut filter = filter(&track, 20_000, 9);
            let run = filter.run(track.steps()).unwrap();
            (run.log_evidence.to_bits(), run.records)
        })
    };
    let one = run(1);
    assert!(run(2) == one && run(3) == one);
}

#[test]
fn one_particle_is_a_filter() {
    let track = Track::simulated(5, 6, false);
    let mut filter = filter(&track, 1, 1).gated_at(1e6).unwrap();
    let run = filter.run(track.steps()).unwrap();
    assert!(run.log_evidence.is_finite());
    assert_eq!(filter.effective_sample_size(), 1.0);
    let steps: Vec<Step<_, sumprod_models::library::AnchorOffset>> = Vec::new();
    assert_eq!(filter.run::<sumprod_models::library::ConstantVelocity, _>(steps).unwrap().log_evidence, 0.0);
    assert!(apart(&filter.moments(), &filter.moments()) == 0.0);
}
