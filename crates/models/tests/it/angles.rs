//! Headings and bearings near the half turn.

use crate::support::{Draw, information_of, send, square};
use nalgebra::{DMatrix, DVector};
use std::f64::consts::{PI, TAU};
use sumprod_graph::schedule::Flooding;
use sumprod_graph::{Engine, FactorGraph, Options, Space, wrap_angle};
use sumprod_messages::{AnyForm, AnyMessage, DynamicGaussian, Particles, ParticlesForm, Proposal};
use sumprod_models::library::{Bearing, Prior, RangeBearing, Unicycle};
use sumprod_models::{AddModel, Model, Noise, ResidualModel, Transition};

fn unicycle() -> Unicycle {
    Unicycle::new(2.0, 0.3, [0.01, 0.04, 0.02]).unwrap()
}

/// Poses about (1, 2) with headings on both sides of the half turn.
fn poses(draw: &mut Draw, count: usize) -> Particles {
    let points = (0..count).flat_map(|_| {
        let heading = wrap_angle(PI - 0.05 + 0.2 * draw.normal());
        [1.0 + 0.3 * draw.normal(), 2.0 + 0.3 * draw.normal(), heading]
    });
    Particles::equally_weighted(&Space::pose2(), points.collect()).unwrap()
}

fn diagonal(entries: &[f64]) -> DMatrix<f64> {
    DMatrix::from_diagonal(&DVector::from_column_slice(entries))
}

fn predict(sample: &Particles, guide: &DynamicGaussian, proposal: Proposal) -> Particles {
    let form = AnyForm::Particles(ParticlesForm { proposal, ..ParticlesForm::new(sample.len()) });
    let space = Space::pose2();
    let ports = [
        AnyMessage::from_particles(sample.clone()),
        AnyMessage::from_gaussian(&space, guide.clone()).unwrap(),
    ];
    let message = send(&Model(Transition::new(unicycle())), 1, &ports, &ports, &form).unwrap();
    message.particles().unwrap().clone()
}

/// Mean heading and its spread within 4.5 standard errors (each wrong with probability 7e-6).
#[test]
fn predicted_headings_wrap() {
    let mut draw = Draw::new(1200);
    let sample = poses(&mut draw, 4000);
    let heading = PI - 0.05 + 0.3;
    let at = [1.0 - 2.0, 2.0, heading];
    let guides = [heading, heading - TAU, heading + 3.0 * TAU].map(|heading| {
        crate::support::moments_of(
            &DVector::from_vec(vec![at[0], at[1], heading]),
            &diagonal(&[1.0, 1.0, 0.1]),
        )
    });
    let variance: f64 = 0.04 + 0.02;
    for proposal in [Proposal::Prediction, Proposal::Informed, Proposal::Optimal] {
        let found = predict(&sample, &guides[0], proposal);
        assert!(found.points().chunks(3).all(|point| point[2] > -PI && point[2] <= PI));
        let moments = found.moments();
        let effective = found.effective_sample_size();
        // Both the sample and the draws made of it are random.
        let count = (1.0 / effective + 1.0 / 4000.0_f64).recip();
        let off = wrap_angle(moments.mean[2] - heading);
        assert!(off.abs() < 4.5 * (variance / count).sqrt(), "{proposal:?}: {off}");
        let spread = moments.covariance_at(2, 2);
        assert!((spread - variance).abs() < 4.5 * variance * (2.0 / count).sqrt(), "{proposal:?}: {spread}");
        // A guide on another turn is the same guide.
        for other in &guides[1..] {
            let same = predict(&sample, other, proposal);
            for (a, b) in found.points().chunks(3).zip(same.points().chunks(3)) {
                assert!((a[0] - b[0]).abs() < 1e-6 && (a[1] - b[1]).abs() < 1e-6);
                assert!(wrap_angle(a[2] - b[2]).abs() < 1e-6);
            }
            for (a, b) in found.log_weights().iter().zip(same.log_weights()) {
                assert!((a - b).abs() < 1e-6);
            }
        }
    }
}

/// What a Gaussian rule reads from particles lies in (-π, π], where it linearises may not: the two are one heading.
#[test]
fn particles_and_gaussians_meet_on_one_turn() {
    let mut draw = Draw::new(1201);
    let points = (0..400).flat_map(|_| {
        let heading = wrap_angle(PI + 0.02 + 0.1 * draw.normal());
        [0.3 * draw.normal(), 0.3 * draw.normal(), heading]
    });
    let sample = Particles::equally_weighted(&Space::pose2(), points.collect()).unwrap();
    assert!(sample.mean()[2] < 0.0);
    let message = AnyMessage::from_particles(sample);
    let space = Space::pose2();
    let entries = diagonal(&[1.0, 1.0, 0.1]);
    let belief = |heading: f64| {
        AnyMessage::gaussian(&space, &[0.0, 0.0, heading], &crate::support::rows(&entries)).unwrap()
    };
    let read = |message: AnyMessage| message.moments().unwrap();
    let motion = Model(Transition::new(unicycle()));
    let seen = Model(ResidualModel(Bearing::new(0.4, 3, Noise::isotropic(1, 0.01).unwrap()).unwrap()));
    let [low, high] = [PI + 0.05 - TAU, PI + 0.05].map(|heading| {
        let ports = [message.clone(), belief(0.1)];
        let beliefs = [belief(heading), belief(0.1)];
        let predicted = read(send(&motion, 1, &ports, &beliefs, &AnyForm::gaussian()).unwrap());
        let far = [
            ports[0].clone(),
            AnyMessage::gaussian(&space, &[-9.0, -4.0, 0.1], &crate::support::rows(&entries)).unwrap(),
        ];
        let beliefs = [beliefs[0].clone(), far[1].clone()];
        let message = send(&seen, 1, &far, &beliefs, &AnyForm::gaussian()).unwrap();
        let (gaussian, _) = message.to_gaussian().unwrap();
        (predicted, information_of(&gaussian))
    });
    for k in 0..3 {
        let off =
            if k == 2 { wrap_angle(low.0.mean[k] - high.0.mean[k]) } else { low.0.mean[k] - high.0.mean[k] };
        assert!(off.abs() < 1e-9, "coordinate {k} of the prediction: {off}");
    }
    assert!((square(&low.0.covariance, 3) - square(&high.0.covariance, 3)).amax() < 1e-9);
    assert!((&low.1.0 - &high.1.0).amax() < 1e-9 * low.1.0.amax());
    assert!((&low.1.1 - &high.1.1).amax() < 1e-9 * low.1.1.amax(), "{}{}", low.1.1, high.1.1);
}

#[test]
fn a_prior_on_the_other_side_of_the_half_turn_is_near() {
    let mut graph = FactorGraph::<DynamicGaussian>::new();
    let x = graph.variable("pose", Space::pose2()).unwrap();
    let belief =
        DynamicGaussian::from_moments(&[0.0, 0.0, 3.1], &crate::support::rows(&diagonal(&[1.0, 1.0, 0.01])));
    graph.set_prior(x, belief.unwrap()).unwrap();
    let noise = Noise::diagonal(&[1.0, 1.0, 0.01]).unwrap();
    graph.add("compass", Prior::new(&Space::pose2(), &[0.0, 0.0, -3.1], noise).unwrap(), &[x]).unwrap();
    let mut engine = Engine::new(&graph, Options::default()).unwrap();
    engine.run(&mut Flooding).unwrap();
    let moments = engine.belief(x).moments().unwrap();
    assert!((moments.mean[2] - PI).abs() < 1e-9, "{}", moments.mean[2]);
    assert!((moments.covariance[8] - 0.005).abs() < 1e-12);
}

/// A landmark seen straight behind: the answer is that of the same scene turned to where no angle wraps.
#[test]
fn bearings_near_the_half_turn_equal_the_turned_scene() {
    let answer = |turn: f64, behind: bool| {
        let mut graph = FactorGraph::<DynamicGaussian>::new();
        let x = graph.variable("pose", Space::pose2()).unwrap();
        let heading = turn + if behind { PI } else { 0.0 };
        let start = DynamicGaussian::from_moments(
            &[0.2, -0.1, heading + 0.03],
            &crate::support::rows(&diagonal(&[0.5, 0.5, 0.02])),
        );
        graph.set_prior(x, start.unwrap()).unwrap();
        for (landmark, bearing) in [([5.0, 0.3], 0.05), ([4.0, -0.6], -0.12), ([6.0, 0.0], -0.01)] {
            let bearing = wrap_angle(bearing + if behind { PI } else { 0.0 } - turn);
            let range = f64::hypot(landmark[0], landmark[1]);
            let noise = Noise::diagonal(&[0.04, 0.01]).unwrap();
            let seen = RangeBearing::to_anchor(range, bearing, landmark, noise).unwrap();
            graph.add("landmark", seen, &[x]).unwrap();
        }
        let mut engine = Engine::new(&graph, Options::default()).unwrap();
        engine.run(&mut Flooding).unwrap();
        engine.belief(x).moments().unwrap()
    };
    let plain = answer(0.0, false);
    for (turn, behind) in [(0.0, true), (PI, false), (-PI, false), (TAU, true), (1.0, true)] {
        let moved = answer(turn, behind);
        let shift = turn + if behind { PI } else { 0.0 };
        assert!((moved.mean[0] - plain.mean[0]).abs() < 1e-9 && (moved.mean[1] - plain.mean[1]).abs() < 1e-9);
        assert!(wrap_angle(moved.mean[2] - plain.mean[2] - shift).abs() < 1e-9);
        assert!((square(&moved.covariance, 3) - square(&plain.covariance, 3)).amax() < 1e-9);
    }
}

#[test]
fn pointwise_bearings_do_not_depend_on_the_turn() {
    let noise = Noise::isotropic(1, 0.01).unwrap();
    let bearing = Model(ResidualModel(Bearing::to_anchor(PI - 0.01, [5.0, 0.0], noise).unwrap()));
    // The same four poses, headings on one side and on the other.
    let points = [0.05, -0.05, 0.05 + TAU, -0.05 - TAU].map(|heading| [1.0, 0.0, heading]).concat();
    let carrier = [Particles::equally_weighted(&Space::pose2(), points).unwrap()];
    let message: Particles = send(&bearing, 0, &carrier, &carrier, &ParticlesForm::new(4)).unwrap();
    let logs = message.log_weights();
    // Residuals wrap to -0.05 - π + 0.01 + 2π and 0.05 - π + 0.01.
    assert!((logs[0] - logs[2]).abs() < 1e-6 && (logs[1] - logs[3]).abs() < 1e-6);
    let exact = |residual: f64| -0.5 * wrap_angle(residual).powi(2) / 0.01;
    let difference = exact(-0.05 - PI + 0.01) - exact(0.05 - PI + 0.01);
    assert!((logs[0] - logs[1] - difference).abs() < 1e-8 * difference.abs());
}
