//! The Kalman filter and the chain of a graph are one thing.

use crate::support::{Track, apart};
use sumprod_filters::{Approximation, Correct, Filter, Kalman, Predict};
use sumprod_graph::Space;
use sumprod_messages::Moments;
use sumprod_models::Noise;
use sumprod_models::library::{AnchorRange, ConstantVelocity, Prior};

#[test]
fn filtered_moments_are_the_marginals_of_the_chain_so_far() {
    for held in [true, false] {
        let track = Track::simulated(1, 24, held);
        let mut filter = Kalman::<4>::new(&track.prior).unwrap();
        let run = filter.run(track.steps()).unwrap();
        for (k, record) in run.records.iter().enumerate() {
            let chain = track.marginals(k + 1);
            let error = apart(&record.moments(), &chain[k]);
            assert!(error < 1e-12, "step {k}: {error:e}");
        }
    }
}

/// The sum of log-likelihoods against the joint density of all fixes, by the chain rule of one block: the first two
/// fixes of a static state have the density N(z; m, H P H' + R) computed densely here.
#[test]
fn the_log_likelihood_is_the_density_of_the_measurement() {
    let prior = Moments::diagonal(&[1.0, 0.0, 2.0, 0.0], &[4.0, 1.0, 9.0, 1.0]);
    let mut filter = Kalman::<4>::new(&prior).unwrap();
    let correction = filter.correct(&Track::fix(&[2.0, 1.5])).unwrap();
    let density = |error: f64, variance: f64| {
        -0.5 * (error * error / variance + variance.ln() + std::f64::consts::TAU.ln())
    };
    let exact = density(1.0, 4.5) + density(-0.5, 9.5);
    assert!((correction.log_likelihood - exact).abs() < 1e-12);
    assert!((correction.innovation[0] - 1.0).abs() < 1e-15 && (correction.innovation[1] + 0.5).abs() < 1e-15);
    assert!((correction.innovation_covariance[3] - 9.5).abs() < 1e-12);
}

/// At the iterated filter's answer the posterior's gradient vanishes: x = m - P H' R⁻¹ r with P the prior's.
#[test]
fn the_iterated_filter_ends_at_the_mode() {
    let (mean, variances) = ([3.0, 0.0, 4.0, 0.0], [4.0, 1.0, 2.0, 1.0]);
    let prior = Moments::diagonal(&mean, &variances);
    let range = AnchorRange::new(9.0, [0.0, 0.0], 4, [0, 2], Noise::isotropic(1, 0.01).unwrap()).unwrap();
    let filter = |approximation| {
        let mut filter = Kalman::<4>::new(&prior).unwrap().approximated(approximation);
        filter.correct(&range).unwrap();
        *filter.mean()
    };
    let gradient = |x: [f64; 4]| {
        let length = x[0].hypot(x[2]);
        [0, 2].map(|k| (x[k] - mean[k]) / variances[k] + (length - 9.0) / 0.01 * x[k] / length)
    };
    let iterated = gradient(filter(Approximation::Iterated(50)));
    assert!(iterated.iter().all(|g| g.abs() < 1e-6), "{iterated:?}");
    let once = gradient(filter(Approximation::FirstOrder));
    assert!(once.iter().any(|g| g.abs() > 0.1), "{once:?}");
}

/// A direction known exactly has no information form, but moments.
#[test]
fn a_start_known_exactly_is_a_prior() {
    let prior = Moments::diagonal(&[0.0, 1.0, 0.0, 0.0], &[0.0; 4]);
    let mut filter = Kalman::<4>::new(&prior).unwrap();
    filter.predict(&ConstantVelocity::held_acceleration(2, 1.0, 1.0).unwrap()).unwrap();
    filter.correct(&Track::fix(&[2.0, 0.0])).unwrap();
    // Along each axis the state is [1, 0] + [1/2, 1] a: one fix of 1 + a/2 with a ~ N(0, 1).
    let acceleration = 0.5 / (0.25 + 0.5);
    assert!((filter.mean()[0] - (1.0 + 0.5 * acceleration)).abs() < 1e-12);
    assert!((filter.mean()[1] - (1.0 + acceleration)).abs() < 1e-12);
}

/// Heavy-tailed noise weighs as the residual's Gaussian rule does: the filter is the graph's message.
#[test]
fn heavy_tails_are_weighed_as_by_the_rule() {
    use sumprod_graph::schedule::Flooding;
    use sumprod_graph::{Engine, FactorGraph, Options};
    use sumprod_messages::DynamicGaussian;
    use sumprod_models::AddModel;
    let prior = Moments::diagonal(&[30.0, 0.1, 40.0, -0.2], &[4.0, 1.0, 2.0, 1.0]);
    let noise = Noise::isotropic(1, 0.5).unwrap().student_t(4.0).unwrap();
    let range = AnchorRange::new(57.0, [0.0, 0.0], 4, [0, 2], noise).unwrap();
    let mut filter = Kalman::<4>::new(&prior).unwrap();
    filter.correct(&range).unwrap();
    let mut graph = FactorGraph::<DynamicGaussian>::new();
    let space = Space::real(4);
    let state = graph.variable("state", space.clone()).unwrap();
    let start = Prior::new(&space, &prior.mean, Noise::gaussian(&prior.covariance).unwrap()).unwrap();
    graph.add("prior", start, &[state]).unwrap();
    let mut engine = Engine::new(&graph, Options::default()).unwrap();
    engine.run(&mut Flooding).unwrap();
    let before = engine.belief(state).clone();
    graph.set_start(state, before).unwrap();
    graph.add("range", range, &[state]).unwrap();
    let mut engine = Engine::new(&graph, Options { max_iterations: 1, ..Options::default() }).unwrap();
    engine.run(&mut Flooding).unwrap();
    let chain = engine.belief(state).moments().unwrap();
    assert!(apart(&filter.moments(), &chain) < 1e-12, "{:?} {chain:?}", filter.moments());
}
