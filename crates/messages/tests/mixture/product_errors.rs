//! Bad input, each with its own sentence.

use crate::common::{mixture, stream};
use sumprod_graph::{Coordinate, MessageError, Space};
use sumprod_messages::{Exact, Mixture, Particles, Pointwise, ProductChoice, ProductMethod, modes};

const METHODS: [ProductChoice; 9] = [
    ProductChoice::Auto,
    ProductChoice::Exact,
    ProductChoice::Gibbs,
    ProductChoice::AnnealedGibbs,
    ProductChoice::MultiscaleGibbs,
    ProductChoice::MixtureImportance,
    ProductChoice::GaussianImportance,
    ProductChoice::Pairwise,
    ProductChoice::Literal,
];

fn text<T>(result: Result<T, MessageError>) -> String {
    match result {
        Ok(_) => panic!("this should have failed"),
        Err(error) => error.to_string(),
    }
}

#[test]
fn mixtures_that_are_none() {
    let line = Space::real(1);
    let build = |logs: &[f64], means: &[f64], kernels: &[f64]| {
        Mixture::new(&line, logs.to_vec(), means.to_vec(), kernels.to_vec())
    };
    assert_eq!(text(build(&[], &[], &[])), "a mixture needs at least one component");
    let nothing = [f64::NEG_INFINITY; 2];
    assert!(text(build(&nothing, &[0.0, 1.0], &[1.0, 1.0])).contains("every weight is zero"));
    assert_eq!(text(build(&[f64::NAN], &[0.0], &[1.0])), "a log weight of a mixture is NaN");
    assert_eq!(text(build(&[f64::INFINITY], &[0.0], &[1.0])), "a log weight of a mixture is inf");
    assert_eq!(text(build(&[0.0], &[f64::NAN], &[1.0])), "a mean of a mixture is NaN");
    for kernel in [0.0, -1.0] {
        assert!(text(build(&[0.0], &[0.0], &[kernel])).contains("not positive definite: pivot 0"));
    }
    assert!(text(build(&[0.0], &[0.0, 1.0], &[1.0])).contains("has dimension 2, expected 1"));
    let flat = Mixture::new(&Space::real(2), vec![0.0], vec![0.0; 2], vec![1.0; 4]);
    assert!(text(flat).contains("not positive definite: pivot 1"));
    assert!(text(Mixture::new(&Space::finite(3), vec![0.0], vec![0.0], vec![1.0])).contains("continuous"));
}

#[test]
fn components_of_weight_zero_are_left_out() {
    let logs = vec![0.0, f64::NEG_INFINITY, 0.0];
    let mixture = Mixture::new(&Space::real(1), logs, vec![1.0, 2.0, 3.0], vec![1.0, 2.0, 3.0]).unwrap();
    assert_eq!(mixture.len(), 2);
    assert_eq!((mixture.mean_of(1), mixture.covariance_of(1)), (&[3.0][..], &[3.0][..]));
}

#[test]
fn products_of_nothing_and_of_different_spaces() {
    let (line, plane) = (mixture(1, 1, 3, 1.0, 1.0, true), mixture(2, 2, 3, 1.0, 1.0, true));
    let space = Space::new([Coordinate::Angle]);
    let circle = Mixture::with_shared_covariance(&space, vec![0.0; 2], vec![0.0, 1.0], vec![0.1]).unwrap();
    for choice in METHODS {
        let method = choice.method();
        assert!(text(method.product(&[], 10, &mut stream(0))).contains("at least one mixture"));
        assert!(text(method.product(&[&line], 0, &mut stream(0))).contains("0 samples"));
        assert!(
            text(method.product(&[&line, &plane], 10, &mut stream(0))).contains("dimension 2, expected 1")
        );
        assert!(text(method.product(&[&line, &circle], 10, &mut stream(0))).contains("angles"));
    }
    assert!(
        text(Exact { limit: 5 }.product(&[&line, &line], 10, &mut stream(0))).contains("more than the limit")
    );
}

#[test]
fn disjoint_supports_are_reported_as_such() {
    let build = |centre: f64| {
        let means = (0..30).map(|i| centre + 0.01 * f64::from(i)).collect();
        Mixture::with_shared_covariance(&Space::real(1), vec![0.0; 30], means, vec![1e-4]).unwrap()
    };
    let (here, there) = (build(0.0), build(100.0));
    for choice in METHODS.into_iter().filter(|choice| *choice != ProductChoice::Literal) {
        let error = text(choice.method().product(&[&here, &there], 100, &mut stream(1)));
        assert!(error.contains("disjoint supports"), "{choice:?}: {error}");
    }
    let carrier = here.sample(50, &mut stream(2)).unwrap();
    let error = text(Pointwise { carrier }.product(&[&there], 50, &mut stream(3)));
    assert!(error.contains("disjoint supports"), "{error}");
}

#[test]
fn inputs_that_disagree_are_warned_of() {
    let build = |centre| {
        Mixture::with_shared_covariance(&Space::real(1), vec![0.0; 2], vec![centre, centre + 1.0], vec![1.0])
    };
    let (here, there) = (build(0.0).unwrap(), build(25.0).unwrap());
    let product = ProductChoice::Auto.method().product(&[&here, &there], 100, &mut stream(4)).unwrap();
    assert!(product.quality.warnings[0].contains("disagree"), "{:?}", product.quality);
}

#[test]
fn few_sweeps_and_stuck_chains_are_warned_of() {
    let inputs = [mixture(3, 1, 10, 3.0, 1.0, true), mixture(4, 1, 10, 3.0, 1.0, true)];
    let references: Vec<&Mixture> = inputs.iter().collect();
    let few = sumprod_messages::Gibbs { sweeps: 2, ..Default::default() };
    let product = few.product(&references, 100, &mut stream(5)).unwrap();
    assert!(product.quality.warnings.iter().any(|warning| warning.contains("2 Gibbs sweeps")));
    let narrow = [mixture(3, 1, 10, 30.0, 1e-2, true), mixture(3, 1, 10, 30.0, 1e-2, true)];
    let references: Vec<&Mixture> = narrow.iter().collect();
    let product = ProductChoice::Gibbs.method().product(&references, 100, &mut stream(6)).unwrap();
    assert!(product.quality.label_change.unwrap() < 0.01);
    assert!(product.quality.warnings.iter().any(|warning| warning.contains("stuck")));
}

#[test]
fn modes_need_inputs_and_points() {
    let line = mixture(1, 1, 3, 1.0, 1.0, true);
    let points = Particles::equally_weighted(&Space::real(2), vec![0.0; 4]).unwrap();
    assert!(text(modes(&[&line], &points)).contains("dimension 2, expected 1"));
    assert!(text(modes(&[], &points)).contains("at least one mixture"));
}
