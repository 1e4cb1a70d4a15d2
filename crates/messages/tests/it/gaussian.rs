//! The laws of Gaussian messages, static and dynamic, and what they refuse.

use nalgebra::{Matrix1, Matrix2, SMatrix, SVector, Vector1, Vector2};
use proptest::prelude::*;
use sumprod_graph::{
    Engine, Factor, FactorGraph, GraphError, Incoming, Message, MessageError, Messages, Options, Port,
    Purpose, Space, Stream,
};
use sumprod_messages::{Cholesky, DynamicGaussian, Gaussian, GaussianForm, Moments, gaussian_divergence};

fn stream() -> Stream {
    Stream::new(0, 0, Purpose::User(0), 0)
}

fn product<M: Message>(messages: &[M]) -> M {
    let edges: Vec<u32> = (0..messages.len() as u32).collect();
    M::product(Messages::new(messages, &edges), &M::Form::default(), &mut stream()).unwrap()
}

/// A message of the given rank at most, from 30 numbers.
fn message<const D: usize>(numbers: &[f64], rank: usize) -> Gaussian<D> {
    let rows =
        SMatrix::<f64, D, D>::from_fn(|row, column| if row < rank { numbers[row * D + column] } else { 0.0 });
    let point = SVector::<f64, D>::from_fn(|row, _| numbers[16 + row]);
    let information = rows.transpose() * rows;
    Gaussian::from_information(information, information * point)
}

fn dynamic<const D: usize>(message: &Gaussian<D>) -> DynamicGaussian {
    DynamicGaussian::from_information(
        message.information().as_slice(),
        message.information_vector().as_slice(),
    )
    .unwrap()
}

/// Largest difference of any number of two messages.
fn apart<const D: usize>(a: &Gaussian<D>, b: &Gaussian<D>) -> f64 {
    let matrices = (a.information() - b.information()).amax();
    matrices.max((a.information_vector() - b.information_vector()).amax())
}

fn laws<const D: usize>(first: &[f64], second: &[f64], ranks: (usize, usize), share: f64) {
    let space = Space::real(D);
    let (a, b) = (message::<D>(first, ranks.0), message::<D>(second, ranks.1));
    let ab = product(&[a, b]);
    assert_eq!(ab, product(&[b, a]));
    assert_eq!(ab, a.times(&b));
    assert_eq!(product(&[a, Gaussian::vacuous(&space)]), a);
    assert_eq!(product(&[Gaussian::vacuous(&space), a]), a);
    assert!(apart(&ab.quotient(&b).unwrap(), &a) < 1e-12);
    assert_eq!((a.change(&a), ab.change(&ab)), (0.0, 0.0));
    assert_eq!(a.change(&b), b.change(&a));
    let mut damped = a;
    assert!(damped.damp(&b, share));
    let halfway = Gaussian::from_information(
        a.information() * (1.0 - share) + b.information() * share,
        a.information_vector() * (1.0 - share) + b.information_vector() * share,
    );
    assert!(apart(&damped, &halfway) < 1e-12);
    assert_eq!(ab.is_proper(), ab.moments().is_ok());

    // The dynamic family does the same.
    let (of_a, of_b) = (dynamic(&a), dynamic(&b));
    let of_ab = product(&[of_a.clone(), of_b.clone()]);
    assert_eq!(of_ab, dynamic(&ab));
    assert_eq!(of_ab, product(&[of_b.clone(), of_a.clone()]));
    assert_eq!(product(&[of_a.clone(), DynamicGaussian::vacuous(&space)]), of_a);
    assert_eq!(of_ab.quotient(&of_b).unwrap(), dynamic(&ab.quotient(&b).unwrap()));
    assert!((of_a.change(&of_b) - a.change(&b)).abs() <= 1e-12 * a.change(&b));
    assert_eq!(of_a.change(&of_a), 0.0);
    let mut also_damped = of_a.clone();
    assert!(also_damped.damp(&of_b, share));
    assert_eq!(also_damped, dynamic(&damped));
    let mut reused = dynamic(&damped);
    assert!(of_ab.quotient_into(&of_b, &mut reused));
    assert_eq!(Some(reused), of_ab.quotient(&of_b));
}

/// Moments of a proper message, both families, and back.
fn moments_agree<const D: usize>(numbers: &[f64]) {
    let rows = SMatrix::<f64, D, D>::from_fn(|row, column| numbers[row * D + column]);
    let covariance = rows * rows.transpose() + SMatrix::identity() * 0.1;
    let mean = SVector::<f64, D>::from_fn(|row, _| numbers[16 + row]);
    let message = Gaussian::from_moments(mean, covariance).unwrap();
    let (own_mean, own_covariance) = message.moments().unwrap();
    // Condition numbers stay below 1e4.
    assert!((own_mean - mean).amax() < 1e-9 && (own_covariance - covariance).amax() < 1e-9);
    assert!((message.mean().unwrap() - mean).amax() < 1e-9);
    let read = message.to_moments().unwrap();
    let of_dynamic = dynamic(&message).moments().unwrap();
    let direct =
        DynamicGaussian::from_moments(mean.as_slice(), covariance.as_slice()).unwrap().moments().unwrap();
    for other in [&of_dynamic, &direct] {
        for k in 0..D {
            assert!((read.mean[k] - other.mean[k]).abs() < 1e-9);
            for l in 0..D {
                assert!((read.covariance_at(k, l) - other.covariance_at(k, l)).abs() < 1e-9);
            }
        }
    }
    let mut into = [0.0; D];
    dynamic(&message).mean_into(&mut into).unwrap();
    assert!(into.iter().zip(&mean).all(|(a, b)| (a - b).abs() < 1e-9));
    // log_value against -½ (x - m)'Λ(x - m), up to the constant ½ m'Λm.
    let x = SVector::<f64, D>::from_fn(|row, _| numbers[20 + row]);
    let quadratic = |y: SVector<f64, D>| -0.5 * (y.transpose() * message.information() * y)[0];
    let expected = quadratic(x - mean) - quadratic(mean);
    let scale = 1.0 + expected.abs() + quadratic(mean).abs();
    assert!((dynamic(&message).log_value(x.as_slice()) - expected).abs() < 1e-10 * scale);
}

fn numbers() -> impl Strategy<Value = Vec<f64>> {
    prop::collection::vec(-2.0f64..2.0, 30)
}

proptest! {
    #[test]
    fn laws_hold(a in numbers(), b in numbers(), ranks in (0usize..5, 0usize..5), share in 0.0f64..1.0) {
        laws::<1>(&a, &b, ranks, share);
        laws::<2>(&a, &b, ranks, share);
        laws::<3>(&a, &b, ranks, share);
        laws::<4>(&a, &b, ranks, share);
    }

    #[test]
    fn moments_and_information_are_one(numbers in numbers()) {
        moments_agree::<1>(&numbers);
        moments_agree::<2>(&numbers);
        moments_agree::<3>(&numbers);
        moments_agree::<4>(&numbers);
    }

    #[test]
    fn a_shift_of_one_deviation_is_a_change_of_order_one(mean in -5.0f64..5.0, deviation in 0.01f64..100.0) {
        let at = |mean: f64| {
            Gaussian::from_moments(Vector1::new(mean), Matrix1::new(deviation * deviation)).unwrap()
        };
        let change = at(mean * deviation + deviation).change(&at(mean * deviation));
        prop_assert!((change - 1.0).abs() < 1e-9, "{}", change);
    }
}

#[test]
fn improper_messages_are_legal_and_name_what_is_missing() {
    // The sum of the coordinates is known, their difference is not.
    let ones = Vector2::new(1.0, 1.0);
    let half = Gaussian::from_information(ones * ones.transpose(), ones);
    assert!(!half.is_proper());
    let check = |error: MessageError| {
        let MessageError::Improper { rank, dimension, ref direction, .. } = error else { panic!("{error}") };
        assert_eq!((rank, dimension), (1, 2));
        assert!(direction.contains("0.707 of coordinate 0") && direction.contains("0.707 of coordinate 1"));
        assert_eq!(direction.matches('-').count(), 1, "opposite signs: {direction}");
        assert!(error.to_string().contains("constrains 1 of 2 directions"), "{error}");
    };
    check(half.moments().unwrap_err());
    check(half.mean().unwrap_err());
    check(dynamic(&half).moments().unwrap_err());
    // A ray whose last pivot is 1e-16 in floating point, not zero.
    let ray = Gaussian::from_information(Matrix2::new(2.0, -1.0, -1.0, 0.5), Vector2::new(2.0, -1.0));
    assert!(!ray.is_proper() && !dynamic(&ray).is_proper());
    assert!(matches!(ray.moments(), Err(MessageError::Improper { rank: 1, dimension: 2, .. })));
    assert!(matches!(
        Gaussian::<2>::default().moments(),
        Err(MessageError::Improper { rank: 0, dimension: 2, .. })
    ));
    let other = Vector2::new(1.0, -1.0);
    let rest = Gaussian::from_information(other * other.transpose(), other * 3.0);
    let (mean, _) = half.times(&rest).moments().unwrap();
    assert!((mean - Vector2::new(2.0, -1.0)).amax() < 1e-12);
}

#[test]
fn moments_that_are_no_distribution_are_refused() {
    let zero = Vector2::zeros();
    let indefinite = Matrix2::new(1.0, 2.0, 2.0, 1.0);
    for bad in [indefinite, Matrix2::new(1.0, 1.0, 1.0, 1.0), -Matrix2::identity(), Matrix2::zeros()] {
        let refused = |error| assert!(matches!(error, MessageError::NotPositiveDefinite { .. }), "{error}");
        refused(Gaussian::from_moments(zero, bad).unwrap_err());
        refused(DynamicGaussian::from_moments(&[0.0; 2], bad.as_slice()).unwrap_err());
    }
    for bad in [f64::NAN, f64::INFINITY] {
        let mean = Vector2::new(0.0, bad);
        let error = Gaussian::from_moments(mean, Matrix2::identity()).unwrap_err();
        assert!(matches!(error, MessageError::NotFinite { what: "an entry of the mean", .. }), "{error}");
        let error = DynamicGaussian::from_moments(&[0.0, bad], &[1.0, 0.0, 0.0, 1.0]).unwrap_err();
        assert!(matches!(error, MessageError::NotFinite { .. }), "{error}");
        for covariance in [Matrix2::new(bad, 0.0, 0.0, 1.0), Matrix2::new(1.0, bad, bad, 1.0)] {
            assert!(Gaussian::from_moments(zero, covariance).is_err());
            assert!(DynamicGaussian::from_moments(&[0.0; 2], covariance.as_slice()).is_err());
        }
        assert!(DynamicGaussian::from_information(&[bad], &[0.0]).is_err());
    }
    let sizes = |error| assert!(matches!(error, MessageError::Dimension { .. }), "{error}");
    sizes(DynamicGaussian::from_moments(&[0.0; 2], &[1.0; 3]).unwrap_err());
    sizes(DynamicGaussian::from_information(&[1.0; 3], &[0.0; 2]).unwrap_err());
    sizes(Cholesky::new(&[1.0; 3], 2, "the covariance").unwrap_err());
}

#[test]
fn sizes_and_spaces_must_match() {
    let form = GaussianForm::default();
    assert!(Gaussian::<2>::check_form(&form, &Space::real(2)).is_ok());
    assert!(Gaussian::<2>::check_form(&form, &Space::real(3)).unwrap_err().contains("dimension 3"));
    assert!(DynamicGaussian::check_form(&form, &Space::finite(4)).unwrap_err().contains("4 states"));
    let pair = [DynamicGaussian::flat(2), DynamicGaussian::flat(3)];
    let result = DynamicGaussian::product(Messages::new(&pair, &[0, 1]), &form, &mut stream());
    assert!(matches!(result, Err(MessageError::Dimension { found: 3, expected: 2, .. })));
}

#[test]
fn the_divergence_of_gaussians_is_the_textbook_s() {
    let moments = |mean: f64, variance: f64| Moments { mean: vec![mean], covariance: vec![variance] };
    let divergence = gaussian_divergence(&moments(1.0, 2.0), &moments(3.0, 5.0)).unwrap();
    let expected = 0.5 * (2.0 / 5.0 + 4.0 / 5.0 - 1.0 + (5.0f64 / 2.0).ln());
    assert!((divergence - expected).abs() < 1e-14);
    assert!(gaussian_divergence(&moments(1.0, 2.0), &moments(1.0, 2.0)).unwrap().abs() < 1e-14);
    let wide = Moments { mean: vec![0.0; 2], covariance: vec![1.0, 0.0, 0.0, 1.0] };
    assert!(matches!(gaussian_divergence(&moments(0.0, 1.0), &wide), Err(MessageError::Dimension { .. })));
}

/// Sends a number that is none, in the information or in the vector alone.
struct Spoiled {
    in_vector: bool,
    value: f64,
}

impl Factor<Gaussian<2>> for Spoiled {
    fn dimensions(&self) -> &[usize] {
        &[2]
    }

    fn message(
        &self,
        _to: Port,
        _incoming: &Incoming<'_, Gaussian<2>>,
        _form: &GaussianForm,
        _stream: &mut Stream,
    ) -> Result<Gaussian<2>, MessageError> {
        let (mut information, mut vector) = (Matrix2::new(1.0, 0.0, 0.0, 0.0), Vector2::zeros());
        // The second coordinate has no information: its row must be looked at all the same.
        if self.in_vector {
            vector[1] = self.value
        } else {
            information[(1, 0)] = self.value
        }
        Ok(Gaussian::from_information(information, vector))
    }
}

#[test]
fn no_number_that_is_none_passes_unseen() {
    for in_vector in [true, false] {
        for value in [f64::NAN, f64::INFINITY] {
            let mut graph: FactorGraph<Gaussian<2>, Spoiled> = FactorGraph::new();
            let x = graph.variable("robot", Space::real(2)).unwrap();
            graph.factor("sensor", Spoiled { in_vector, value }, &[x]).unwrap();
            let mut engine = Engine::new(&graph, Options::default()).unwrap();
            let error = engine.run(&mut sumprod_graph::schedule::Flooding).unwrap_err();
            assert!(
                matches!(&error, GraphError::Rule { factor, port: 0, variable, .. }
                if factor == "sensor #0" && variable == "robot"),
                "{error}"
            );
        }
    }
    // A vector that is not a number where the information is unchanged.
    let good = Gaussian::from_information(Matrix2::identity(), Vector2::zeros());
    let bad = Gaussian::from_information(Matrix2::identity(), Vector2::new(f64::NAN, 0.0));
    assert!(bad.change(&good).is_nan());
}
