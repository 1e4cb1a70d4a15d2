use nalgebra::{DMatrix, Matrix2, Matrix4, Vector2};
use sumprod_fusion::{Criterion, Fusible, intersection};
use sumprod_graph::{Purpose, Space, Stream};
use sumprod_messages::{Categorical, Gaussian, GaussianForm, Mixture, MixtureMessage};

use crate::support::{Random, World, random, uniform};

fn stream() -> Stream {
    Stream::new(1, 0, Purpose::Belief, 0)
}

/// A symmetric positive definite matrix.
fn spread<const D: usize>(random: &mut Random) -> nalgebra::SMatrix<f64, D, D> {
    let root = nalgebra::SMatrix::<f64, D, D>::from_fn(|_, _| uniform(random, -1.0, 1.0));
    root * root.transpose() + nalgebra::SMatrix::identity() * 0.05
}

fn smallest(matrix: &Matrix2<f64>) -> f64 {
    matrix.symmetric_eigenvalues().min()
}

#[test]
fn no_correlation_makes_covariance_intersection_over_confident() {
    for seed in 0..300 {
        let mut random = random(seed);
        // Errors of both with any correlation; each belief claims its own covariance.
        let joint: Matrix4<f64> = spread(&mut random);
        let blocks = [(0, 0), (2, 2), (0, 2)].map(|at| joint.fixed_view::<2, 2>(at.0, at.1).into_owned());
        let [pa, pb, cross] = blocks;
        let zero = Vector2::zeros();
        let a = Gaussian::from_moments(zero, pa).unwrap();
        let b = Gaussian::from_moments(zero, pb).unwrap();
        for criterion in [Criterion::Determinant, Criterion::Trace] {
            let (fused, weight) =
                intersection::covariance(&a, &b, criterion, &GaussianForm::default(), &mut stream()).unwrap();
            let claimed = fused.moments().unwrap().1;
            let (ka, kb) = (claimed * a.information() * weight, claimed * b.information() * (1.0 - weight));
            let mixed = ka * cross * kb.transpose();
            let real = ka * pa * ka.transpose() + kb * pb * kb.transpose() + mixed + mixed.transpose();
            assert!(smallest(&(claimed - real)) > -1e-9, "seed {seed}");
            // No other weight does better.
            for step in 0..=20 {
                let other = f64::from(step) / 20.0;
                let mixed = a.power(other).unwrap().times(&b.power(1.0 - other).unwrap());
                assert!(
                    fused.uncertainty(criterion).unwrap() <= mixed.uncertainty(criterion).unwrap() + 1e-9
                );
            }
        }
    }
}

#[test]
fn the_split_form_lies_between_intersection_and_product() {
    for seed in 0..100 {
        let mut random = random(seed);
        let mut belief = || Gaussian::from_moments(Vector2::zeros(), spread(&mut random)).unwrap();
        let [a, b, private_a, private_b] = std::array::from_fn(|_| belief());
        let form = GaussianForm::default();
        let split = |correlated: Gaussian<2>, independent: Gaussian<2>| intersection::Split {
            correlated,
            independent,
        };
        let (parts, _) = intersection::split(
            &split(a, private_a),
            &split(b, private_b),
            Criterion::Determinant,
            &form,
            &mut stream(),
        )
        .unwrap();
        let fused = parts.correlated.times(&parts.independent).uncertainty(Criterion::Determinant).unwrap();
        let (whole_a, whole_b) = (a.times(&private_a), b.times(&private_b));
        let (plain, _) =
            intersection::covariance(&whole_a, &whole_b, Criterion::Determinant, &form, &mut stream())
                .unwrap();
        assert!(fused <= plain.uncertainty(Criterion::Determinant).unwrap() + 1e-9);
        assert!(fused >= whole_a.times(&whole_b).uncertainty(Criterion::Determinant).unwrap() - 1e-9);
    }
}

#[test]
fn the_inverse_form_is_not_over_confident_about_common_information() {
    for seed in 0..300 {
        let mut random = random(seed);
        // Both hold independent information and some in common.
        let [private_a, private_b, common] = std::array::from_fn(|_| spread::<2>(&mut random));
        let inverse = |m: &Matrix2<f64>| m.try_inverse().unwrap();
        let (pa, pb) = (inverse(&(private_a + common)), inverse(&(private_b + common)));
        let cross = pa * common * pb;
        let a = Gaussian::from_moments(Vector2::zeros(), pa).unwrap();
        let b = Gaussian::from_moments(Vector2::zeros(), pb).unwrap();
        let (fused, weight) = intersection::inverse(&a, &b, Criterion::Trace).unwrap();
        let claimed = fused.moments().unwrap().1;
        let gamma = inverse(&(pa * weight + pb * (1.0 - weight)));
        let (ka, kb) =
            (claimed * (inverse(&pa) - gamma * weight), claimed * (inverse(&pb) - gamma * (1.0 - weight)));
        let mixed = ka * cross * kb.transpose();
        let real = ka * pa * ka.transpose() + kb * pb * kb.transpose() + mixed + mixed.transpose();
        assert!(smallest(&(claimed - real)) > -1e-9, "seed {seed}");
        // It is no worse than covariance intersection.
        let (plain, _) =
            intersection::covariance(&a, &b, Criterion::Trace, &GaussianForm::default(), &mut stream())
                .unwrap();
        let of = |belief: &Gaussian<2>| belief.uncertainty(Criterion::Trace).unwrap();
        assert!(of(&fused) <= of(&plain) + 1e-9, "seed {seed}");
    }
}

#[test]
fn of_beliefs_of_one_shape_an_intersection_is_the_better() {
    let of = |variance: f64| {
        Gaussian::from_moments(Vector2::new(variance, 0.0), Matrix2::identity() * variance).unwrap()
    };
    let (fused, weight) = intersection::covariance(
        &of(3.0),
        &of(2.0),
        Criterion::Determinant,
        &GaussianForm::default(),
        &mut stream(),
    )
    .unwrap();
    assert_eq!(weight, 0.0);
    assert_eq!(fused, of(2.0));
}

#[test]
fn powers_of_states_and_mixtures() {
    let states = Categorical::from_probabilities(&[0.7, 0.2, 0.1]).unwrap();
    let root = states.power(0.5).unwrap();
    assert!(root.times(&root).distance(&states) < 1e-15);
    let (fused, _) = intersection::covariance(
        &states,
        &Categorical::prior(),
        Criterion::Determinant,
        &Default::default(),
        &mut stream(),
    )
    .unwrap();
    assert!(
        fused.uncertainty(Criterion::Determinant).unwrap()
            <= states.uncertainty(Criterion::Determinant).unwrap() + 1e-12
    );

    let mixture: MixtureMessage =
        Mixture::new(&Space::real(1), vec![0.0, -1.0], vec![-40.0, 40.0], vec![1.0, 4.0]).unwrap().into();
    let root = mixture.power(0.5).unwrap();
    // Far apart, the power of each component is the power of the whole.
    for x in [-41.0, -39.5, 38.0, 42.0] {
        let difference = |m: &MixtureMessage| m.log_value(&[x]).unwrap() - m.log_value(&[-40.0]).unwrap();
        assert!((difference(&root) - 0.5 * difference(&mixture)).abs() < 1e-9);
    }
    assert!(intersection::inverse(&mixture, &root, Criterion::Trace).is_err());
}

#[test]
fn what_cannot_be_intersected_is_an_error() {
    let flat = Gaussian::<2>::default();
    let error = intersection::covariance(
        &flat,
        &flat,
        Criterion::Determinant,
        &GaussianForm::default(),
        &mut stream(),
    );
    assert!(error.is_err());
    assert!(DMatrix::<f64>::identity(1, 1).is_square());
}
