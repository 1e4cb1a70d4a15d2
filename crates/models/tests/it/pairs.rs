//! Pair factors of a static dimension against the general linear-Gaussian rule.

use crate::support::{Draw, assert_close, information_of, moments_of, rows, send, send_gaussian};
use nalgebra::{DMatrix, DVector, Matrix3, SMatrix, SVector, Vector3};
use sumprod_graph::schedule::ForwardBackward;
use sumprod_graph::{Engine, Factor, FactorGraph, Options, Space};
use sumprod_messages::{DynamicGaussian, Gaussian};
use sumprod_models::library::{Displacement, LinearGaussian, LinearPair};
use sumprod_models::{Model, Noise, ResidualModel};

fn fixed<const R: usize, const C: usize>(matrix: &DMatrix<f64>) -> SMatrix<f64, R, C> {
    SMatrix::from_column_slice(matrix.as_slice())
}

fn dynamic<const D: usize>(message: &Gaussian<D>) -> (DMatrix<f64>, DVector<f64>) {
    let information = DMatrix::from_column_slice(D, D, message.information().as_slice());
    (information, DVector::from_column_slice(message.information_vector().as_slice()))
}

fn static_of(message: &DynamicGaussian) -> Gaussian<3> {
    let (information, vector) = information_of(message);
    Gaussian::from_information(fixed(&information), SVector::from_column_slice(vector.as_slice()))
}

/// The same message by both, to both ends; and by the general rule in the static family.
fn compare(fast: &dyn Factor<Gaussian<3>>, general: LinearGaussian, messages: &[DynamicGaussian; 2]) {
    let general = Model(ResidualModel(general));
    let inputs = [static_of(&messages[0]), static_of(&messages[1])];
    assert_eq!(fast.dimensions(), [3, 3]);
    for to in 0..2 {
        let (exact, exact_vector) = information_of(&send_gaussian(&general, to, messages).unwrap());
        let own = send(fast, to, &inputs, &inputs, &Default::default()).unwrap();
        let same = send::<Gaussian<3>>(&general, to, &inputs, &inputs, &Default::default()).unwrap();
        for message in [own, same] {
            let (found, vector) = dynamic(&message);
            assert_close(&found, &exact, 1e-10, "information");
            assert!((vector - &exact_vector).amax() < 1e-10 * (1.0 + exact_vector.amax()));
        }
    }
}

#[test]
fn a_linear_pair_equals_the_general_rule() {
    let mut draw = Draw::new(400);
    for _ in 0..100 {
        let messages = [0, 1].map(|_| moments_of(&draw.vector(3), &draw.covariance(3)));
        let (a, b) = (draw.matrix(2, 3), draw.matrix(2, 3));
        let (target, covariance) = (draw.vector(2), draw.covariance(2));
        let general = LinearGaussian::new(
            &[&rows(&a), &rows(&b)],
            target.as_slice(),
            Noise::gaussian(&rows(&covariance)).unwrap(),
        );
        let target = SVector::from_column_slice(target.as_slice());
        let pair = LinearPair::new::<2>(&fixed(&a), &fixed(&b), &target, &fixed(&covariance)).unwrap();
        compare(&pair, general.unwrap(), &messages);
    }
}

#[test]
fn a_displacement_equals_the_general_rule() {
    let mut draw = Draw::new(401);
    let (back, ahead) = (-DMatrix::<f64>::identity(3, 3), DMatrix::<f64>::identity(3, 3));
    for _ in 0..100 {
        let messages = [0, 1].map(|_| moments_of(&draw.vector(3), &draw.covariance(3)));
        let (z, covariance) = (draw.vector(3) * 4.0, draw.covariance(3));
        let general = || {
            let noise = Noise::gaussian(&rows(&covariance)).unwrap();
            LinearGaussian::new(&[&rows(&back), &rows(&ahead)], z.as_slice(), noise).unwrap()
        };
        let shift = SVector::from_column_slice(z.as_slice());
        compare(&Displacement::new(shift, fixed(&covariance)).unwrap(), general(), &messages);
        let information = fixed(&covariance.clone().try_inverse().unwrap());
        compare(&Displacement::from_information(shift, information).unwrap(), general(), &messages);
    }
}

#[test]
fn pairs_pass_improper_messages() {
    let mut draw = Draw::new(402);
    for rank in 0..3 {
        let information = draw.semidefinite(3, rank);
        let vector = &information * draw.vector(3);
        let message = crate::support::gaussian(&information, &vector);
        let (z, covariance) = (draw.vector(3), draw.covariance(3));
        let shift = SVector::from_column_slice(z.as_slice());
        let (back, ahead) = (-DMatrix::<f64>::identity(3, 3), DMatrix::<f64>::identity(3, 3));
        let general = || {
            let noise = Noise::gaussian(&rows(&covariance)).unwrap();
            LinearGaussian::new(&[&rows(&back), &rows(&ahead)], z.as_slice(), noise).unwrap()
        };
        let messages = [message.clone(), message];
        compare(&Displacement::new(shift, fixed(&covariance)).unwrap(), general(), &messages);
        let one = Matrix3::identity();
        let pair = LinearPair::new::<3>(&-one, &one, &shift, &fixed(&covariance)).unwrap();
        compare(&pair, general(), &messages);
    }
}

#[test]
fn a_chain_of_pairs_equals_one_of_displacements() {
    let covariance = Matrix3::new(1.0, 0.2, 0.0, 0.2, 2.0, -0.3, 0.0, -0.3, 0.7);
    let shift = Vector3::new(1.0, -2.0, 0.5);
    let one = Matrix3::identity();
    let pair = LinearPair::new::<3>(&-one, &one, &shift, &covariance).unwrap();
    let step = Displacement::new(shift, covariance).unwrap();
    let run = |factor: &dyn Fn() -> Box<dyn Factor<Gaussian<3>>>| {
        let mut graph = FactorGraph::<Gaussian<3>>::new();
        let x: Vec<_> = (0..10).map(|_| graph.unnamed_variable(Space::real(3))).collect();
        graph.set_prior(x[0], Gaussian::from_moments(Vector3::zeros(), one).unwrap()).unwrap();
        graph.set_prior(x[9], Gaussian::from_moments(Vector3::new(8.0, 0.0, 0.0), one).unwrap()).unwrap();
        for ends in x.windows(2) {
            graph.factor("step", factor(), ends).unwrap();
        }
        let mut engine = Engine::new(&graph, Options::default()).unwrap();
        engine.run(&mut ForwardBackward::new()).unwrap();
        x.iter().map(|&x| engine.belief(x).moments().unwrap()).collect::<Vec<_>>()
    };
    let pairs = run(&|| Box::new(pair.clone()));
    let steps = run(&|| Box::new(step.clone()));
    for ((mean, spread), (other_mean, other)) in pairs.iter().zip(&steps) {
        assert!((mean - other_mean).amax() < 1e-10 && (spread - other).amax() < 1e-10);
    }
}

#[test]
fn an_indefinite_covariance_is_refused() {
    let bad = Matrix3::new(1.0, 2.0, 0.0, 2.0, 1.0, 0.0, 0.0, 0.0, 1.0);
    assert!(Displacement::new(Vector3::zeros(), bad).is_err());
    let one = Matrix3::identity();
    assert!(LinearPair::new::<3>(&one, &one, &Vector3::zeros(), &bad).is_err());
}
