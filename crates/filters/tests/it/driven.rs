//! The optimizer-driven particle filter against the bootstrap and the Kalman filter.

use crate::support::Track;
use sumprod_filters::{
    Correct, DrivenFilter, Filter, FilterError, Kalman, ParticleFilter, Predict, Recovery, Step,
};
use sumprod_graph::Space;
use sumprod_messages::Moments;
use sumprod_models::Noise;
use sumprod_models::library::AnchorRange;
use sumprod_optimizers::{
    Independence, Move, QuantumImportance, QuantumMetropolis, RandomWalk, Regularised, Trigger, Weigh,
};

type Make = fn() -> Box<dyn Move>;

fn filter(track: &Track, count: usize, seed: u64, movement: Box<dyn Move>) -> DrivenFilter {
    DrivenFilter::new(&Space::real(4), &track.prior, count, seed, movement).unwrap()
}

#[test]
fn with_weighing_alone_it_is_the_bootstrap_filter() {
    let track = Track::simulated(5, 12, true);
    let mut bootstrap = ParticleFilter::new(&Space::real(4), &track.prior, 700, 3).unwrap();
    let mut driven = filter(&track, 700, 3, Box::new(Weigh));
    for step in track.steps() {
        let (a, b) = (bootstrap.run([step.clone()]).unwrap(), driven.run([step]).unwrap());
        assert!((a.log_evidence - b.log_evidence).abs() < 1e-9);
        let (a, b) = (bootstrap.moments(), driven.moments());
        assert!(a.mean.iter().zip(&b.mean).all(|(a, b)| (a - b).abs() < 1e-9));
        assert!(a.covariance.iter().zip(&b.covariance).all(|(a, b)| (a - b).abs() < 1e-9));
    }
    let corrections = track.fixes.iter().map(Vec::len).sum::<usize>() as u64;
    assert_eq!(driven.evaluations(), 700 * corrections);
}

/// The moments of 3,000 particles after ten steps have standard errors near 0.03 deviations, correlated over the
/// steps; the bounds are 0.2 and, for the deviations, 15 %.
#[test]
fn every_valid_move_has_the_kalman_filters_moments_and_evidence() {
    let moves: [(&str, Make); 5] = [
        ("regularised", || Box::new(Regularised::default())),
        ("random walk", || Box::new(RandomWalk::new(2, 1.0).unwrap())),
        ("independence", || Box::new(Independence::new(2, 1.2).unwrap())),
        ("quantum importance", || Box::new(QuantumImportance::default())),
        ("quantum metropolis", || Box::new(QuantumMetropolis { generations: 2, ..Default::default() })),
    ];
    let track = Track::simulated(6, 10, true);
    let exact = Kalman::<4>::new(&track.prior).unwrap().run(track.steps()).unwrap();
    let last = exact.records.last().unwrap().moments();
    for (name, make) in moves {
        let mut filter = filter(&track, 3000, 1, make());
        let run = filter.run(track.steps()).unwrap();
        assert!((run.log_evidence - exact.log_evidence).abs() < 0.6, "{name}: {}", run.log_evidence);
        let found = filter.moments();
        for k in 0..4 {
            let deviation = last.covariance_at(k, k).sqrt();
            assert!((found.mean[k] - last.mean[k]).abs() < 0.2 * deviation, "{name}, coordinate {k}");
            let ratio = found.covariance_at(k, k).sqrt() / deviation;
            assert!((ratio - 1.0).abs() < 0.15, "{name}, coordinate {k}: {ratio}");
        }
    }
}

#[test]
fn a_known_density_makes_markov_chains_exact() {
    // Noise of full rank: chains run on the mixture's own density, and few particles already follow the Kalman filter.
    let track = Track::simulated(7, 8, false);
    let exact = Kalman::<4>::new(&track.prior).unwrap().run(track.steps()).unwrap();
    let last = exact.records.last().unwrap().moments();
    let mut filter = filter(&track, 400, 2, Box::new(RandomWalk::new(3, 1.0).unwrap())).knowing_density();
    filter.run(track.steps()).unwrap();
    let found = filter.moments();
    for k in 0..4 {
        assert!((found.mean[k] - last.mean[k]).abs() < 0.5 * last.covariance_at(k, k).sqrt());
    }
}

#[test]
fn reselection_waits_for_its_trigger_and_origins_are_followed() {
    let track = Track::simulated(8, 3, true);
    let never = Trigger::below(0.0).unwrap();
    let mut filter = filter(&track, 50, 4, Box::new(Weigh)).reselecting_when(never);
    filter.run(track.steps()).unwrap();
    filter.settle().unwrap();
    assert_eq!(filter.unique_ancestors(), Some(50));
    assert!(filter.particles().effective_sample_size() < 50.0);
    let mut filter = filter_always(&track);
    filter.run(track.steps()).unwrap();
    let before = filter.particles().effective_sample_size();
    filter.settle().unwrap();
    assert!((filter.particles().effective_sample_size() - 50.0).abs() < 1e-9);
    let unique = filter.unique_ancestors().unwrap();
    assert!(unique < 50 && unique as f64 >= 0.5 * before, "{unique} of {before}");
}

fn filter_always(track: &Track) -> DrivenFilter {
    filter(track, 50, 4, Box::new(Weigh))
}

#[test]
fn a_measurement_that_nothing_explains_is_told_and_recovered_from() {
    let prior = Moments::diagonal(&[0.0, 1.0, 0.0, 1.0], &[1.0, 1.0, 1.0, 1.0]);
    let made = || {
        let movement = Box::new(Regularised::default());
        DrivenFilter::new(&Space::real(4), &prior, 200, 1, movement).unwrap().gated_at(10.0).unwrap()
    };
    let range = AnchorRange::new(900.0, [100.0, 0.0], 4, [0, 2], Noise::isotropic(1, 1.0).unwrap()).unwrap();
    let error = made().correct(&range).unwrap_err();
    assert!(matches!(error, FilterError::Unexplained { step: 0, count: 200, .. }), "{error}");
    let mut keeping = made().recovering_by(Recovery::KeepPrediction);
    let before = keeping.moments();
    assert!(keeping.correct(&range).unwrap().recovered);
    assert_eq!(keeping.moments(), before);
    assert_eq!(keeping.told().nearest, f64::INFINITY);
    let wide = Moments::diagonal(&[0.0; 4], &[1e6, 1.0, 1e6, 1.0]);
    let mut redrawing = made().recovering_by(Recovery::Redraw(wide));
    let correction = redrawing.correct(&range).unwrap();
    assert!(correction.recovered && correction.log_likelihood.is_finite());
    assert!(redrawing.told().nearest < 10.0);
    assert_eq!(redrawing.unique_ancestors(), None);
    let distance = |point: &[f64]| (point[0] - 100.0).hypot(point[2]);
    let near: f64 = redrawing
        .particles()
        .weights()
        .iter()
        .enumerate()
        .map(|(index, weight)| weight * distance(redrawing.particles().point(index)))
        .sum();
    assert!((near - 900.0).abs() < 3.0, "{near}");
}

#[test]
fn wrong_settings_are_refused() {
    let prior = Moments::diagonal(&[0.0], &[1.0]);
    let made = |count| DrivenFilter::new(&Space::real(1), &prior, count, 1, Box::new(Weigh));
    assert!(made(0).err().unwrap().to_string().contains("the number of particles is 0"));
    assert!(made(1).unwrap().gated_at(f64::NAN).err().unwrap().to_string().contains("must be positive"));
    let track = Track::simulated(9, 1, true);
    let mut alone = filter(&track, 1, 1, Box::new(QuantumMetropolis::default()));
    let steps: Vec<Step<_, _>> = track.steps().into_iter().collect();
    alone.run(steps).unwrap();
    assert_eq!(alone.particles().len(), 1);
    let error = made(3).unwrap().predict(&track.motion).unwrap_err().to_string();
    assert!(error.contains("the motion"), "{error}");
}
