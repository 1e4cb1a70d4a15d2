//! Predictions by particles: samples of the prediction, whatever guided them.

use crate::support::{Draw, send, square};
use nalgebra::{DMatrix, DVector};
use sumprod_graph::{MessageError, Space};
use sumprod_messages::{AnyForm, AnyMessage, DynamicGaussian, Particles, ParticlesForm, Proposal};
use sumprod_models::library::ConstantVelocity;
use sumprod_models::{Model, Motion, Transition};

const COUNT: usize = 4000;

fn motion(held: bool) -> ConstantVelocity {
    let interval = 0.8;
    if held {
        ConstantVelocity::held_acceleration(2, interval, 2.0).unwrap()
    } else {
        ConstantVelocity::white_acceleration(2, interval, 2.0).unwrap()
    }
}

/// A weighted sample of a state.
fn state(draw: &mut Draw, count: usize) -> Particles {
    let covariance = draw.covariance(4);
    let lower = covariance.cholesky().unwrap().l();
    let centre = draw.vector(4) * 5.0;
    let points = (0..count).flat_map(|_| (&centre + &lower * draw.vector(4)).as_slice().to_vec()).collect();
    let weights = (0..count).map(|_| draw.uniform(-1.0, 0.0)).collect();
    Particles::new(&Space::real(4), points, weights).unwrap()
}

/// Mean and covariance of the prediction, given the sample.
fn exact(sample: &Particles, motion: &ConstantVelocity) -> (DVector<f64>, DMatrix<f64>) {
    let moments = sample.moments();
    let mut f = DMatrix::identity(4, 4);
    (f[(0, 1)], f[(2, 3)]) = (0.8, 0.8);
    let q = square(&motion.noise(&[0.0; 4]).covariance(), 4);
    let covariance = &f * square(&moments.covariance, 4) * f.transpose() + q;
    (f * DVector::from_vec(moments.mean), covariance)
}

/// A guide about the prediction: both positions, or the whole state.
fn guide(
    mean: &DVector<f64>,
    covariance: &DMatrix<f64>,
    whole: bool,
    width: f64,
    off: f64,
) -> DynamicGaussian {
    let mut information = DMatrix::zeros(4, 4);
    for k in (0..4).step_by(if whole { 1 } else { 2 }) {
        information[(k, k)] = 1.0 / (width * covariance[(k, k)]);
    }
    let centre = mean + covariance.diagonal().map(|variance| off * variance.sqrt());
    crate::support::gaussian(&information, &(&information * centre))
}

fn predict(
    motion: &ConstantVelocity,
    sample: &Particles,
    guide: &DynamicGaussian,
    proposal: Proposal,
    count: usize,
) -> Result<Particles, MessageError> {
    let form = AnyForm::Particles(ParticlesForm { proposal, ..ParticlesForm::new(count) });
    let space = Space::real(4);
    let ports = [
        AnyMessage::from_particles(sample.clone()),
        AnyMessage::from_gaussian(&space, guide.clone()).unwrap(),
    ];
    let message = send(&Model(Transition::new(motion.clone())), 1, &ports, &ports, &form)?;
    Ok(message.particles().unwrap().clone())
}

/// Weighted mean and second moments within 4 standard errors: 14 numbers, each wrong with probability 6.4e-5.
fn assert_sample_of(found: &Particles, mean: &DVector<f64>, covariance: &DMatrix<f64>, what: &str) {
    let weights = found.weights();
    let check = |value: &dyn Fn(&DVector<f64>) -> f64, exact: f64| {
        let values: Vec<f64> = found
            .points()
            .chunks(4)
            .map(|point| value(&(DVector::from_column_slice(point) - mean)))
            .collect();
        let average: f64 = weights.iter().zip(&values).map(|(w, v)| w * v).sum();
        let variance: f64 = weights.iter().zip(&values).map(|(w, v)| (w * (v - exact)).powi(2)).sum();
        let error = variance.sqrt();
        assert!((average - exact).abs() < 4.0 * error, "{what}: {average} ± {error} for {exact}");
    };
    for row in 0..4 {
        check(&|offset| offset[row], 0.0);
        for column in 0..=row {
            check(&|offset| offset[row] * offset[column], covariance[(row, column)]);
        }
    }
}

/// 64 samples of 14 numbers: in all wrong with probability below 0.06, and the seed is fixed.
#[test]
fn every_proposal_gives_a_sample_of_the_prediction() {
    let mut draw = Draw::new(1100);
    for held in [true, false] {
        let motion = motion(held);
        for round in 0..4 {
            let sample = state(&mut draw, COUNT);
            let (mean, covariance) = exact(&sample, &motion);
            for whole in [true, false] {
                // The weights of the optimal proposal have a variance only where the guide is wider than the
                // prediction; the informed one bounds them for any guide.
                let wide = guide(&mean, &covariance, whole, 6.0, 0.3);
                let sharp = guide(&mean, &covariance, whole, 0.1, 0.8);
                for (proposal, guide) in [
                    (Proposal::Prediction, &sharp),
                    (Proposal::Optimal, &wide),
                    (Proposal::Informed, &wide),
                    (Proposal::Informed, &sharp),
                ] {
                    let found = predict(&motion, &sample, guide, proposal, COUNT).unwrap();
                    assert_eq!(found.len(), COUNT);
                    let what = format!("{proposal:?}, held {held}, round {round}, whole {whole}");
                    assert_sample_of(&found, &mean, &covariance, &what);
                }
            }
        }
    }
}

/// Noise of rank two leaves four-dimensional points on planes through the moved particles.
#[test]
fn unsmoothed_draws_stay_where_the_noise_can_bring_them() {
    let mut draw = Draw::new(1101);
    let motion = motion(true);
    let sample = state(&mut draw, 5);
    let (mean, covariance) = exact(&sample, &motion);
    let wide = guide(&mean, &covariance, true, 6.0, 0.0);
    for proposal in [Proposal::Prediction, Proposal::Optimal] {
        let found = predict(&motion, &sample, &wide, proposal, 200).unwrap();
        for point in found.points().chunks(4) {
            let reached = sample.points().chunks(4).any(|from| {
                (0..2).all(|axis| {
                    let (x, v) = (from[2 * axis] + 0.8 * from[2 * axis + 1], from[2 * axis + 1]);
                    let acceleration = (point[2 * axis + 1] - v) / 0.8;
                    (point[2 * axis] - x - 0.32 * acceleration).abs() < 1e-9
                })
            });
            assert!(reached);
        }
    }
}

#[test]
fn the_optimal_proposal_has_equal_weights_once_the_guide_is_multiplied() {
    let mut draw = Draw::new(1102);
    for whole in [true, false] {
        for width in [0.01, 1.0, 100.0] {
            let sample = state(&mut draw, 300);
            let motion = motion(true);
            let (mean, covariance) = exact(&sample, &motion);
            let guide = guide(&mean, &covariance, whole, width, 0.5);
            let found = predict(&motion, &sample, &guide, Proposal::Optimal, 500).unwrap();
            let logs = found.points().chunks(4).zip(found.log_weights());
            let logs: Vec<f64> = logs.map(|(point, log)| log + guide.log_value(point)).collect();
            assert!(logs.iter().all(|log| (log - logs[0]).abs() < 1e-8 * (1.0 + logs[0].abs())));
        }
    }
}

/// Effective sample size after a sharp measurement of the position, ten seeds.
#[test]
fn an_informed_proposal_survives_a_sharp_measurement() {
    let mut draw = Draw::new(1103);
    let survivors = |particles: &Particles, guide: &DynamicGaussian| {
        let logs = particles.points().chunks(4).zip(particles.log_weights());
        let logs: Vec<f64> = logs.map(|(point, log)| log + guide.log_value(point)).collect();
        Particles::new(&Space::real(4), particles.points().to_vec(), logs).unwrap().effective_sample_size()
    };
    for _ in 0..10 {
        let sample = state(&mut draw, 1000);
        let motion = motion(true);
        let (mean, covariance) = exact(&sample, &motion);
        let guide = guide(&mean, &covariance, false, 0.002, 1.0);
        let [prediction, informed, optimal] = [Proposal::Prediction, Proposal::Informed, Proposal::Optimal]
            .map(|proposal| survivors(&predict(&motion, &sample, &guide, proposal, 1000).unwrap(), &guide));
        assert!(prediction < 20.0, "the measurement must be sharp for this test to tell: {prediction}");
        assert!(informed > 10.0 * prediction, "{informed} {prediction}");
        assert!(optimal > 999.0, "{optimal}");
    }
}

#[test]
fn a_flat_guide_is_none() {
    let mut draw = Draw::new(1104);
    let sample = state(&mut draw, 50);
    let motion = motion(true);
    let flat = DynamicGaussian::flat(4);
    let plain = predict(&motion, &sample, &flat, Proposal::Prediction, 60).unwrap();
    for proposal in [Proposal::Informed, Proposal::Optimal] {
        assert_eq!(predict(&motion, &sample, &flat, proposal, 60).unwrap(), plain);
    }
    assert!(plain.log_weights().iter().all(|log| (log + 60.0_f64.ln()).abs() < 1e-12));
}

/// One particle, no spread: the guide still finds its kernel, and a guide beyond reach says so.
#[test]
fn extremes_are_answers_or_errors() {
    let motion = motion(true);
    let one = Particles::equally_weighted(&Space::real(4), vec![1.0, 0.0, 2.0, 0.0]).unwrap();
    let near =
        crate::support::moments_of(&DVector::from_vec(vec![1.0, 0.0, 2.0, 0.0]), &DMatrix::identity(4, 4));
    for proposal in [Proposal::Prediction, Proposal::Informed, Proposal::Optimal] {
        let found = predict(&motion, &one, &near, proposal, 30).unwrap();
        assert!(found.log_weights().iter().all(|log| log.is_finite()));
    }
    let far = DVector::from_element(4, 1e160);
    let far = crate::support::gaussian(&DMatrix::identity(4, 4), &far);
    assert!(predict(&motion, &one, &far, Proposal::Optimal, 30).is_err());

    let none = <Particles as sumprod_graph::Message>::vacuous(&Space::real(4));
    for guide in [near, DynamicGaussian::flat(4)] {
        let error = predict(&motion, &none, &guide, Proposal::Informed, 30).unwrap_err();
        assert!(error.to_string().contains("give it a prior"), "{error}");
    }
    let back = Model(Transition::new(motion));
    let ports = [one.clone(), one];
    let error = send(&back, 0, &ports, &ports, &ParticlesForm::new(3)).unwrap_err();
    assert!(error.to_string().contains("hold this edge as a Gaussian"), "{error}");
}
