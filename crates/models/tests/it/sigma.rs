//! Sigma points: exact where a line is, and better than one derivative where the range curves.

use crate::support::{Draw, assert_close, information_of, moments_of, rows, send};
use nalgebra::{DMatrix, DVector};
use sumprod_graph::schedule::Flooding;
use sumprod_graph::{Engine, FactorGraph, Options, Space};
use sumprod_messages::{DynamicGaussian, GaussianForm, Linearisation};
use sumprod_models::library::{AnchorRange, LinearGaussian, Prior};
use sumprod_models::{AddModel, Model, Noise, ResidualModel};

fn form(linearisation: Linearisation) -> GaussianForm {
    GaussianForm { linearisation }
}

#[test]
fn linear_residuals_are_exact() {
    let mut draw = Draw::new(600);
    for _ in 0..50 {
        let (a, b) = (draw.matrix(2, 3), draw.matrix(2, 2));
        let (target, covariance) = (draw.vector(2), draw.covariance(2));
        let noise = Noise::gaussian(&rows(&covariance)).unwrap();
        let factor = LinearGaussian::new(&[&rows(&a), &rows(&b)], target.as_slice(), noise).unwrap();
        let model = Model(ResidualModel(factor));
        let mut proper = |d| moments_of(&(draw.vector(d) * 5.0), &draw.covariance(d));
        let (messages, beliefs) = ([proper(3), proper(2)], [proper(3), proper(2)]);
        for to in 0..2 {
            let by = |linearisation| {
                let message: DynamicGaussian =
                    send(&model, to, &messages, &beliefs, &form(linearisation)).unwrap();
                information_of(&message)
            };
            let (jacobian, sigma) = (by(Linearisation::Jacobian), by(Linearisation::SigmaPoints));
            assert_close(&sigma.0, &jacobian.0, 1e-10, "information");
            assert!((&sigma.1 - &jacobian.1).amax() < 1e-10 * (1.0 + jacobian.1.amax()));
        }
    }
}

/// A vague prior across a tight ring: mean and covariance by a grid, and by either rule.
#[test]
fn a_curved_range_is_nearer_the_grid() {
    let (prior_mean, prior_variance, z, variance) = ([10.0, 0.5], [1.0, 9.0], 10.0, 0.04);
    let (mut total, mut first, mut second) = (0.0, DVector::zeros(2), DMatrix::zeros(2, 2));
    let step = 0.02;
    for i in 0..400 {
        for j in 0..1000 {
            let x = DVector::from_vec(vec![5.0 + step * (i as f64 + 0.5), -10.0 + step * (j as f64 + 0.5)]);
            let across: f64 = (0..2).map(|k| (x[k] - prior_mean[k]).powi(2) / prior_variance[k]).sum();
            let weight = (-0.5 * across - 0.5 * (x.norm() - z).powi(2) / variance).exp();
            total += weight;
            second += weight * &x * x.transpose();
            first += weight * x;
        }
    }
    let mean = first / total;
    let covariance = second / total - &mean * mean.transpose();

    let errors = [Linearisation::Jacobian, Linearisation::SigmaPoints].map(|linearisation| {
        let mut graph = FactorGraph::<DynamicGaussian>::new();
        let x = graph.unnamed_variable(Space::real(2));
        let prior =
            Prior::new(&Space::real(2), &prior_mean, Noise::diagonal(&prior_variance).unwrap()).unwrap();
        graph.add("prior", prior, &[x]).unwrap();
        graph
            .set_start(x, DynamicGaussian::from_moments(&prior_mean, &[1.0, 0.0, 0.0, 9.0]).unwrap())
            .unwrap();
        let ring =
            AnchorRange::new(z, [0.0, 0.0], 2, [0, 1], Noise::isotropic(1, variance).unwrap()).unwrap();
        let factor = graph.add("ring", ring, &[x]).unwrap();
        graph.set_edge_form(factor, 0, form(linearisation)).unwrap();
        let mut engine = Engine::new(&graph, Options::default()).unwrap();
        assert!(engine.run(&mut Flooding).unwrap().converged());
        let found = engine.belief(x).moments().unwrap();
        let off = (DVector::from_vec(found.mean) - &mean).norm();
        (off, (found.covariance[0] / covariance[(0, 0)]).ln().abs())
    });
    let [(jacobian, jacobian_spread), (sigma, sigma_spread)] = errors;
    assert!(jacobian > 0.2, "the range must curve for this test to tell: {jacobian}");
    assert!(sigma < 0.5 * jacobian, "mean off by {sigma} with sigma points, {jacobian} without");
    assert!(sigma_spread < 0.5 * jacobian_spread, "{sigma_spread} {jacobian_spread}");
}

/// Without a belief to regress over, the expansion at the message's own mean stands in.
#[test]
fn sigma_points_need_no_start_where_the_residual_is_linear() {
    let prior = Prior::new(&Space::real(2), &[3.0, -1.0], Noise::isotropic(2, 2.0).unwrap()).unwrap();
    let flat = [DynamicGaussian::flat(2)];
    let message =
        send(&Model(ResidualModel(prior)), 0, &flat, &flat, &form(Linearisation::SigmaPoints)).unwrap();
    let moments = message.moments().unwrap();
    assert!((moments.mean[0] - 3.0).abs() < 1e-12 && (moments.covariance[0] - 2.0).abs() < 1e-12);
}
