//! What is said, and what is not made up, where messages leave directions open.

use crate::support::{Draw, assert_close, gaussian, information_of, moments_of, rows, send, send_gaussian};
use nalgebra::{DMatrix, DVector};
use sumprod_graph::schedule::Flooding;
use sumprod_graph::{Engine, FactorGraph, GraphError, MessageError, Options, Space};
use sumprod_messages::{AnyForm, AnyMessage, DynamicGaussian};
use sumprod_models::library::{AnchorRange, Bearing, LinearGaussian, Prior, Range};
use sumprod_models::{AddModel, Cluster, Model, Noise, Real, Residual, ResidualModel};

fn range(z: f64) -> Range {
    Range::new(z, [2, 2], [[0, 1], [0, 1]], Noise::isotropic(1, 0.04).unwrap()).unwrap()
}

#[test]
fn a_range_to_nowhere_says_nothing() {
    let mut draw = Draw::new(300);
    let model = Model(ResidualModel(range(5.0)));
    for _ in 0..100 {
        let own = moments_of(&(draw.vector(2) * 10.0), &draw.covariance(2));
        let guess = moments_of(&(draw.vector(2) * 10.0), &draw.covariance(2));
        let flat = DynamicGaussian::flat(2);
        for to in 0..2 {
            let mut messages = [own.clone(), own.clone()];
            messages[1 - to] = flat.clone();
            // The other end may have a point to linearise at, and yet have said nothing.
            for other in [&flat, &guess] {
                let mut beliefs = messages.clone();
                beliefs[1 - to] = other.clone();
                let message = send(&model, to, &messages, &beliefs, &Default::default()).unwrap();
                let (information, vector) = information_of(&message);
                // 25 is the range's own information.
                assert!(information.amax() < 25.0 * 1e-13, "{information}");
                assert!(vector.amax() < 25.0 * 1e-11, "{vector}");
            }
        }
    }
}

#[test]
fn a_range_to_a_line_is_known_across_it_alone() {
    // The other end is known in x alone, and lies ahead in x: the sum of both uncertainties along x.
    let model = Model(ResidualModel(range(5.0)));
    let own = moments_of(&DVector::zeros(2), &DMatrix::identity(2, 2));
    let known_x =
        gaussian(&DMatrix::from_row_slice(2, 2, &[4.0, 0.0, 0.0, 0.0]), &DVector::from_vec(vec![24.0, 0.0]));
    let ahead = moments_of(&DVector::from_vec(vec![6.0, 0.0]), &DMatrix::identity(2, 2));
    let message = send(&model, 0, &[own.clone(), known_x], &[own, ahead], &Default::default()).unwrap();
    let (information, vector) = information_of(&message);
    let expected = 1.0 / (0.25 + 0.04);
    assert_close(
        &information,
        &DMatrix::from_row_slice(2, 2, &[expected, 0.0, 0.0, 0.0]),
        1e-12,
        "information",
    );
    assert!((vector[0] - expected).abs() < 1e-10 && vector[1].abs() < 1e-10);
}

fn names_the_remedy(error: &MessageError) -> bool {
    let said = error.to_string();
    said.contains("prior or a start") && said.contains("linearise")
}

#[test]
fn a_ring_without_a_start_names_the_remedy() {
    let mut draw = Draw::new(301);
    for _ in 0..500 {
        let anchor = [draw.normal() * 20.0, draw.normal() * 20.0];
        let ring = AnchorRange::new(5.0, anchor, 2, [0, 1], Noise::isotropic(1, 0.04).unwrap()).unwrap();
        let error = send_gaussian(&Model(ResidualModel(ring)), 0, &[DynamicGaussian::flat(2)]).unwrap_err();
        assert!(names_the_remedy(&error), "{error}");
        let bearing = Bearing::to_anchor(0.3, anchor, Noise::isotropic(1, 0.01).unwrap()).unwrap();
        let error =
            send_gaussian(&Model(ResidualModel(bearing)), 0, &[DynamicGaussian::flat(3)]).unwrap_err();
        assert!(names_the_remedy(&error), "{error}");
        let known = moments_of(&DVector::from_column_slice(&anchor), &draw.covariance(2));
        let error = send_gaussian(&Model(ResidualModel(range(4.0))), 1, &[known, DynamicGaussian::flat(2)])
            .unwrap_err();
        assert!(names_the_remedy(&error), "{error}");
    }
}

/// A belief that knows one direction is still no point to linearise at.
#[test]
fn half_a_belief_is_no_start() {
    let mut draw = Draw::new(302);
    for _ in 0..200 {
        let information = draw.semidefinite(2, 1);
        let belief = gaussian(&information, &(&information * draw.vector(2)));
        let anchor = [draw.normal() * 20.0, draw.normal() * 20.0];
        let ring = AnchorRange::new(5.0, anchor, 2, [0, 1], Noise::isotropic(1, 0.04).unwrap()).unwrap();
        let error = send_gaussian(&Model(ResidualModel(ring)), 0, &[belief]).unwrap_err();
        assert!(names_the_remedy(&error), "{error}");
    }
}

#[test]
fn the_engine_adds_the_names() {
    let mut graph = FactorGraph::<AnyMessage>::new();
    let boat = graph.variable("boat", Space::real(2)).unwrap();
    let ring = AnchorRange::new(5.0, [3.0, 4.0], 2, [0, 1], Noise::isotropic(1, 0.04).unwrap()).unwrap();
    graph.add("range to the pier", ring, &[boat]).unwrap();
    let error = Engine::new(&graph, Options::default()).unwrap().run(&mut Flooding).unwrap_err();
    assert!(matches!(&error, GraphError::Rule { variable, port: 0, .. } if variable == "boat"));
    let said = error.to_string();
    assert!(said.contains("range to the pier") && said.contains("prior or a start"), "{said}");

    let mut cluster = Cluster::new(4);
    cluster.add(range(3.0), &[sumprod_models::Block::new(0, 2), sumprod_models::Block::new(2, 2)]).unwrap();
    let error = send_gaussian(&Model(cluster), 0, &[DynamicGaussian::flat(4)]).unwrap_err();
    assert!(error.to_string().contains("prior or a start"), "{error}");
}

#[test]
fn particles_without_a_carrier_name_the_remedy() {
    let space = Space::real(2);
    let flat = AnyMessage::from_gaussian(&space, DynamicGaussian::flat(2)).unwrap();
    let known = AnyMessage::gaussian(&space, &[1.0, 2.0], &[1.0, 0.0, 0.0, 1.0]).unwrap();
    let form = AnyForm::particles(50);
    let model = Model(ResidualModel(range(3.0)));
    let error = send(&model, 0, &[flat.clone(), known.clone()], &[flat.clone(), known.clone()], &form);
    assert!(error.unwrap_err().to_string().contains("give the variable a prior"));
    let error = send(&model, 0, &[known.clone(), flat.clone()], &[known, flat], &form);
    assert!(error.unwrap_err().to_string().contains("give it a prior"));
}

/// A residual that is linear needs no start: its message to a flat variable is exact.
#[test]
fn linear_factors_need_no_start() {
    let mut draw = Draw::new(303);
    for _ in 0..50 {
        let (a, b) = (draw.matrix(2, 3), draw.matrix(2, 2));
        let (target, covariance) = (draw.vector(2), draw.covariance(2));
        let noise = Noise::gaussian(&rows(&covariance)).unwrap();
        let factor = LinearGaussian::new(&[&rows(&a), &rows(&b)], target.as_slice(), noise).unwrap();
        let (mean, spread) = (draw.vector(2), draw.covariance(2));
        let messages = [DynamicGaussian::flat(3), moments_of(&mean, &spread)];
        let message = send_gaussian(&Model(ResidualModel(factor)), 0, &messages).unwrap();
        let weight = (covariance + &b * spread * b.transpose()).try_inverse().unwrap();
        let (information, vector) = information_of(&message);
        assert_close(&information, &(a.transpose() * &weight * &a), 1e-12, "information");
        let exact = a.transpose() * weight * (target - b * mean);
        assert!((vector - &exact).amax() < 1e-10 * (1.0 + exact.amax()));
    }
    let prior = Prior::new(&Space::pose2(), &[1.0, 2.0, 3.0], Noise::isotropic(3, 0.5).unwrap()).unwrap();
    let message = send_gaussian(&Model(ResidualModel(prior)), 0, &[DynamicGaussian::flat(3)]).unwrap();
    let moments = message.moments().unwrap();
    assert!(moments.mean.iter().zip([1.0, 2.0, 3.0]).all(|(a, b)| (a - b).abs() < 1e-12));
}

/// Σ of scaled coordinates of very different units, so that a threshold on absolute size would drop the small.
#[test]
fn summing_out_respects_the_units() {
    let mut draw = Draw::new(304);
    for _ in 0..50 {
        // Port 1 holds a length in metres and a clock rate near 1e-9, of which only the length was told.
        let units = DMatrix::from_diagonal(&DVector::from_vec(vec![1.0, 1e9]));
        let (a, b) = (draw.matrix(3, 2), draw.matrix(3, 2) * units);
        let (target, covariance) = (draw.vector(3), draw.covariance(3));
        let noise = Noise::gaussian(&rows(&covariance)).unwrap();
        let factor = LinearGaussian::new(&[&rows(&a), &rows(&b)], target.as_slice(), noise).unwrap();
        let told = DMatrix::from_row_slice(2, 2, &[0.7, 0.0, 0.0, 0.0]);
        let messages = [DynamicGaussian::flat(2), gaussian(&told, &DVector::from_vec(vec![0.4, 0.0]))];
        let message = send_gaussian(&Model(ResidualModel(factor)), 0, &messages).unwrap();
        // In units of its own the same sum by hand.
        let b = &b * DMatrix::from_diagonal(&DVector::from_vec(vec![1.0, 1e-9]));
        let weight = covariance.try_inverse().unwrap();
        let inner = (b.transpose() * &weight * &b + &told).try_inverse().unwrap();
        let gain = a.transpose() * &weight * &b * inner;
        let exact = a.transpose() * &weight * &a - &gain * b.transpose() * &weight * &a;
        let other = b.transpose() * &weight * &target + DVector::from_vec(vec![0.4, 0.0]);
        let exact_vector = a.transpose() * &weight * &target - gain * other;
        let (information, vector) = information_of(&message);
        assert_close(&information, &exact, 1e-9, "information");
        assert!((vector - &exact_vector).amax() < 1e-9 * (1.0 + exact_vector.amax()));
    }
}

/// x y - z between two scalars.
struct Product {
    noise: Noise,
}

impl Residual for Product {
    fn dimensions(&self) -> &[usize] {
        &[1, 1]
    }

    fn noise(&self) -> &Noise {
        &self.noise
    }

    fn residual<T: Real>(&self, x: &[&[T]], out: &mut [T]) {
        out[0] = x[0][0] * x[1][0] - 6.0;
    }
}

/// Given its sender this residual is linear in the receiver, and the message's own mean is the point.
#[test]
fn a_message_that_determines_its_receiver_finds_its_own_point() {
    let product = Model(ResidualModel(Product { noise: Noise::isotropic(1, 1e-4).unwrap() }));
    let known = DynamicGaussian::from_moments(&[2.0], &[1e-6]).unwrap();
    let message = send_gaussian(&product, 0, &[DynamicGaussian::flat(1), known]).unwrap();
    let moments = message.moments().unwrap();
    assert!((moments.mean[0] - 3.0).abs() < 1e-9);
    // σ² / y² + x² σ_y² / y².
    assert!((moments.covariance[0] - (1e-4 + 9.0 * 1e-6) / 4.0).abs() < 1e-12);
}
