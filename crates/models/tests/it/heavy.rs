//! Student-t noise: the weight by its formula (ν + d) / (ν + E r'R⁻¹r), the expectation over the beliefs, and an outlier that loses its say.

use crate::support::{Draw, assert_close, information_of, moments_of, rows, send_gaussian};
use nalgebra::{DMatrix, DVector};
use sumprod_graph::schedule::Flooding;
use sumprod_graph::{Engine, FactorGraph, Options, Space};
use sumprod_messages::DynamicGaussian;
use sumprod_models::library::{AnchorOffset, LinearGaussian};
use sumprod_models::{AddModel, Block, Cluster, Model, Noise, ResidualModel};

#[test]
fn the_weight_is_that_of_the_expected_squared_residual() {
    let mut draw = Draw::new(700);
    for round in 0..50 {
        let nu = 1.0 + round as f64 / 5.0;
        let (a, b) = (draw.matrix(2, 3), draw.matrix(2, 2));
        let (target, covariance) = (draw.vector(2) * 4.0, draw.covariance(2));
        let (x, p) = (draw.vector(3), draw.covariance(3));
        let (y, q) = (draw.vector(2), draw.covariance(2));
        let noise = Noise::gaussian(&rows(&covariance)).unwrap().student_t(nu).unwrap();
        let factor = LinearGaussian::new(&[&rows(&a), &rows(&b)], target.as_slice(), noise.clone()).unwrap();
        let messages = [moments_of(&x, &p), moments_of(&y, &q)];
        let message = send_gaussian(&Model(ResidualModel(factor.clone())), 0, &messages).unwrap();

        let residual = &a * &x + &b * &y - &target;
        let spread = &a * &p * a.transpose() + &b * &q * b.transpose();
        let inverse = covariance.clone().try_inverse().unwrap();
        let squared = (residual.transpose() * &inverse * &residual)[0] + (&inverse * spread).trace();
        let weight = (nu + 2.0) / (nu + squared);
        assert!((noise.weight(squared) - weight).abs() < 1e-14);
        let information = (&covariance / weight + &b * &q * b.transpose()).try_inverse().unwrap();
        let (found, vector) = information_of(&message);
        assert_close(&found, &(a.transpose() * &information * &a), 1e-10, "information");
        let exact = a.transpose() * information * (&target - &b * &y);
        assert!((vector - &exact).amax() < 1e-10 * (1.0 + exact.amax()));

        // The same residual inside a cluster, whose joint belief is the product of the two.
        let mut cluster = Cluster::new(5);
        cluster.add(factor, &[Block::new(2, 3), Block::new(0, 2)]).unwrap();
        let mut mean = DVector::zeros(5);
        mean.rows_mut(0, 2).copy_from(&y);
        mean.rows_mut(2, 3).copy_from(&x);
        let mut joint = DMatrix::zeros(5, 5);
        joint.view_mut((0, 0), (2, 2)).copy_from(&q);
        joint.view_mut((2, 2), (3, 3)).copy_from(&p);
        let message = send_gaussian(&Model(cluster), 0, &[moments_of(&mean, &joint)]).unwrap();
        let mut wide = DMatrix::zeros(2, 5);
        wide.columns_mut(0, 2).copy_from(&b);
        wide.columns_mut(2, 3).copy_from(&a);
        let exact = wide.transpose() * covariance.try_inverse().unwrap() * &wide * weight;
        assert_close(&information_of(&message).0, &exact, 1e-10, "information of the cluster");
    }
}

/// Ten fixes, one of them far off: the estimate with heavy tails stays with the others.
#[test]
fn an_outlier_loses_its_weight() {
    let mut draw = Draw::new(701);
    let fixes: Vec<[f64; 2]> = (0..10).map(|_| [5.0 + draw.normal(), -2.0 + draw.normal()]).collect();
    let run = |heavy: bool, outlier: Option<f64>| {
        let mut graph = FactorGraph::<DynamicGaussian>::new();
        let x = graph.unnamed_variable(Space::real(2));
        let prior = DynamicGaussian::from_moments(&[0.0, 0.0], &[1e4, 0.0, 0.0, 1e4]).unwrap();
        graph.set_prior(x, prior).unwrap();
        let noise = Noise::isotropic(2, 1.0).unwrap();
        let noise = if heavy { noise.student_t(4.0).unwrap() } else { noise };
        for fix in fixes.iter().copied().chain(outlier.map(|far| [far, far])) {
            let fix = AnchorOffset::new(&fix, &[0.0, 0.0], 2, &[0, 1], noise.clone()).unwrap();
            graph.add("fix", fix, &[x]).unwrap();
        }
        let mut engine = Engine::new(&graph, Options::default()).unwrap();
        assert!(engine.run(&mut Flooding).unwrap().converged());
        engine.belief(x).moments().unwrap().mean
    };
    let clean = run(true, None);
    let shift = |mean: &[f64], from: &[f64]| (mean[0] - from[0]).hypot(mean[1] - from[1]);
    let gaussian = shift(&run(false, Some(300.0)), &run(false, None));
    let heavy = shift(&run(true, Some(300.0)), &clean);
    assert!(gaussian > 30.0, "{gaussian}");
    assert!(heavy < 0.05, "{heavy}");
    // The farther, the less it counts.
    assert!(shift(&run(true, Some(3000.0)), &clean) < heavy);
}
