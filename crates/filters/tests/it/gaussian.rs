//! Gaussian filters that must agree: on linear models all of them, and their smoothers with the chain.

use crate::support::{Track, apart};
use sumprod_filters::{Approximation, Correct, Filter, Imm, Kalman, Predict, Smooth, SquareRoot, Step};
use sumprod_messages::Moments;
use sumprod_models::Noise;
use sumprod_models::library::{AnchorRange, ConstantVelocity};

const UNSCENTED: Approximation = Approximation::Unscented { alpha: 0.7, beta: 2.0, kappa: 0.5 };

#[test]
fn all_are_the_kalman_filter_on_linear_models() {
    for held in [true, false] {
        let track = Track::simulated(6, 30, held);
        let mut kalman = Kalman::<4>::new(&track.prior).unwrap();
        let exact = kalman.run(track.steps()).unwrap();
        let check = |found: sumprod_filters::Run<sumprod_filters::GaussianRecord<4>, ConstantVelocity>| {
            for (found, exact) in found.records.iter().zip(&exact.records) {
                assert!(apart(&found.moments(), &exact.moments()) < 1e-10);
            }
            assert!((found.log_evidence - exact.log_evidence).abs() < 1e-9);
        };
        for approximation in [Approximation::Iterated(3), UNSCENTED, Approximation::Cubature] {
            let mut filter = Kalman::<4>::new(&track.prior).unwrap().approximated(approximation);
            check(filter.run(track.steps()).unwrap());
        }
        let mut root = SquareRoot::<4>::new(&track.prior).unwrap();
        check(root.run(track.steps()).unwrap());
        let factor = root.factor();
        assert!((0..4).all(|k| factor[k][k] > 0.0 && factor[k][k + 1..].iter().all(|x| *x == 0.0)));
    }
}

#[test]
fn smoothed_moments_are_the_marginals_of_the_chain() {
    for held in [true, false] {
        let track = Track::simulated(7, 40, held);
        let chain = track.marginals(track.fixes.len());
        let mut kalman = Kalman::<4>::new(&track.prior).unwrap();
        let run = kalman.run(track.steps()).unwrap();
        let mut sigma = Kalman::<4>::new(&track.prior).unwrap().approximated(UNSCENTED);
        let by_sigma = sigma.run(track.steps()).unwrap();
        let mut root = SquareRoot::<4>::new(&track.prior).unwrap();
        let by_root = root.run(track.steps()).unwrap();
        let smoothed =
            [kalman.smooth(&run).unwrap(), sigma.smooth(&by_sigma).unwrap(), root.smooth(&by_root).unwrap()];
        for (found, tolerance) in smoothed.iter().zip([1e-12, 1e-10, 1e-10]) {
            for (k, (found, chain)) in found.iter().zip(&chain).enumerate() {
                assert!(apart(found, chain) < tolerance, "step {k}: {:e}", apart(found, chain));
            }
        }
    }
}

/// A start known exactly makes the first predictions singular: smoothing has no inverse, and needs none.
#[test]
fn a_singular_prediction_is_smoothed() {
    let mut track = Track::simulated(8, 6, true);
    track.prior = Moments::diagonal(&track.prior.mean, &[0.0; 4]);
    let mut filter = Kalman::<4>::new(&track.prior).unwrap();
    let run = filter.run(track.steps()).unwrap();
    let smoothed = filter.smooth(&run).unwrap();
    assert!(apart(&smoothed[0], &track.prior) < 1e-9);
    assert!(smoothed.iter().all(|m| m.mean.iter().all(|x| x.is_finite())));
}

/// Two steps of one time are one state.
#[test]
fn a_step_without_a_motion_is_the_same_state() {
    let track = Track::simulated(9, 8, false);
    let mut steps = track.steps();
    let measurements = steps[3].measurements.clone();
    steps.insert(4, Step { motion: None, measurements });
    let mut filter = Kalman::<4>::new(&track.prior).unwrap();
    let run = filter.run(steps).unwrap();
    let smoothed = filter.smooth(&run).unwrap();
    assert_eq!(smoothed[3], smoothed[4]);
}

/// One range at a time of a distant anchor is nearly linear: sigma points and expansion agree; of a near one, the
/// regression's error widens the posterior.
#[test]
fn sigma_points_see_the_curvature() {
    let prior = Moments::diagonal(&[3.0, 0.0, 0.0, 0.0], &[1.0, 1.0, 4.0, 1.0]);
    let corrected = |anchor: f64, approximation| {
        let noise = Noise::isotropic(1, 0.01).unwrap();
        let range = AnchorRange::new(anchor + 3.0, [-anchor, 0.0], 4, [0, 2], noise).unwrap();
        let mut filter = Kalman::<4>::new(&prior).unwrap().approximated(approximation);
        filter.correct(&range).unwrap();
        filter.moments()
    };
    for approximation in [UNSCENTED, Approximation::Cubature] {
        let far = apart(&corrected(1e5, approximation), &corrected(1e5, Approximation::FirstOrder));
        assert!(far < 1e-3, "{far}");
        let near = corrected(0.5, approximation).covariance_at(0, 0);
        assert!(near > 3.0 * corrected(0.5, Approximation::FirstOrder).covariance_at(0, 0), "{near}");
    }
}

#[test]
fn a_bank_of_one_is_its_filter_and_of_equals_too() {
    let track = Track::simulated(10, 20, false);
    let mut kalman = Kalman::<4>::new(&track.prior).unwrap();
    let exact = kalman.run(track.steps()).unwrap();
    for modes in [1, 2] {
        let (probabilities, changes): (&[f64], &[f64]) =
            if modes == 1 { (&[1.0], &[1.0]) } else { (&[0.3, 0.7], &[0.9, 0.1, 0.2, 0.8]) };
        let mut bank = Imm::<4>::new(&track.prior, probabilities, changes).unwrap();
        let steps = track.steps().into_iter().map(|step| Step {
            motion: step.motion.map(|motion| vec![motion; modes]),
            measurements: step.measurements,
        });
        let run = bank.run(steps).unwrap();
        assert!((run.log_evidence - exact.log_evidence).abs() < 1e-10);
        assert!(apart(&bank.moments(), &kalman.moments()) < 1e-12);
    }
}

/// Fixes of a target at rest, then of one that manoeuvres: the probability follows.
#[test]
fn a_bank_finds_the_motion() {
    let prior = Moments::diagonal(&[0.0; 4], &[1.0, 0.01, 1.0, 0.01]);
    let motion = |density: f64| ConstantVelocity::white_acceleration(2, 1.0, density).unwrap();
    let motions = [motion(1e-6), motion(4.0)];
    let mut bank = Imm::<4>::new(&prior, &[0.5, 0.5], &[0.95, 0.05, 0.05, 0.95]).unwrap();
    for step in 0..40 {
        let place = if step < 20 { 0.0 } else { 2.0 * f64::from(step - 20).powi(2) };
        bank.predict(&motions[..]).unwrap();
        bank.correct(&Track::fix(&[place, 0.0])).unwrap();
        if step == 19 {
            assert!(bank.probabilities()[0] > 0.8, "{:?}", bank.probabilities());
        }
    }
    assert!(bank.probabilities()[1] > 0.95, "{:?}", bank.probabilities());
    assert!((bank.probabilities().iter().sum::<f64>() - 1.0).abs() < 1e-12);
    assert!((bank.moments().mean[0] - 2.0 * 19.0f64.powi(2)).abs() < 2.0);
    assert!(bank.predict(&motions[..1]).is_err());
    assert!(Imm::<4>::new(&prior, &[0.5, 0.6], &[1.0, 0.0, 0.0, 1.0]).is_err());
    assert!(Imm::<4>::new(&prior, &[1.0], &[1.0, 0.0]).is_err());
}
