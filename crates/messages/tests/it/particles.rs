//! Particles: their statistics against direct formulas, their products against exact ones.

use proptest::prelude::*;
use rand_distr::{Distribution, StandardNormal};
use sumprod_graph::{Coordinate, Message, MessageError, Messages, Purpose, Space, Stream, wrap_angle};
use sumprod_messages::{Particles, ParticlesForm, Role};

fn stream(entity: u64) -> Stream {
    Stream::new(11, 0, Purpose::User(1), entity)
}

fn product(messages: &[Particles]) -> Result<Particles, MessageError> {
    let edges: Vec<u32> = (0..messages.len() as u32).collect();
    Particles::product(Messages::new(messages, &edges), &ParticlesForm::default(), &mut stream(0))
}

fn line(points: Vec<f64>, log_weights: Vec<f64>) -> Particles {
    Particles::new(&Space::real(1), points, log_weights).unwrap()
}

/// A sample of `draw` standard normal numbers mapped by `place`.
fn drawn(entity: u64, count: usize, place: impl Fn(usize, f64) -> f64) -> Particles {
    let mut random = stream(entity).fast();
    let points = (0..count).map(|k| place(k, StandardNormal.sample(&mut random))).collect();
    Particles::equally_weighted(&Space::real(1), points).unwrap()
}

fn assert_same(a: &Particles, b: &Particles) {
    assert!(a.same_support(b) && a.role() == b.role());
    for (a, b) in a.log_weights().iter().zip(b.log_weights()) {
        assert!(a == b || (a - b).abs() < 1e-12, "{a} {b}");
    }
}

/// Points and log weights; some weights may be zero, never all.
fn cloud() -> impl Strategy<Value = (Vec<f64>, Vec<f64>)> {
    let weight = prop_oneof![4 => -20.0f64..5.0, 1 => Just(f64::NEG_INFINITY)];
    prop::collection::vec((-10.0f64..10.0, -10.0f64..10.0, weight), 1..40).prop_map(|mut all| {
        all[0].2 = 0.0;
        let points = all.iter().flat_map(|(x, y, _)| [*x, *y]).collect();
        (points, all.iter().map(|(_, _, weight)| *weight).collect())
    })
}

proptest! {
    #[test]
    fn statistics_are_the_formulas((points, logs) in cloud(), probability in 0.01f64..0.99) {
        let set = Particles::new(&Space::real(2), points.clone(), logs.clone()).unwrap();
        let total: f64 = logs.iter().map(|log| log.exp()).sum();
        let weights: Vec<f64> = logs.iter().map(|log| log.exp() / total).collect();
        for (own, expected) in set.weights().iter().zip(&weights) {
            prop_assert!((own - expected).abs() < 1e-12);
        }
        prop_assert!((set.log_weights().iter().map(|log| log.exp()).sum::<f64>() - 1.0).abs() < 1e-12);
        let squares: f64 = weights.iter().map(|weight| weight * weight).sum();
        prop_assert!((set.effective_sample_size() * squares - 1.0).abs() < 1e-9);
        prop_assert_eq!(set.quality().effective_sample_size, Some(set.effective_sample_size()));
        let average = |f: &dyn Fn(&[f64]) -> f64| -> f64 {
            weights.iter().zip(points.chunks(2)).map(|(weight, point)| weight * f(point)).sum()
        };
        let mean = [average(&|p| p[0]), average(&|p| p[1])];
        let moments = set.moments();
        for row in 0..2 {
            prop_assert!((moments.mean[row] - mean[row]).abs() < 1e-10);
            for column in 0..2 {
                let expected = average(&|p| (p[row] - mean[row]) * (p[column] - mean[column]));
                prop_assert!((moments.covariance_at(row, column) - expected).abs() < 1e-9);
            }
        }
        // The quantile is a point, and the weight on either side of it is right.
        let quantile = set.quantile(1, probability).unwrap();
        let below = average(&|p| f64::from(u8::from(p[1] < quantile)));
        let reached = average(&|p| f64::from(u8::from(p[1] <= quantile)));
        prop_assert!(below < probability + 1e-12 && reached > probability - 1e-12);
        prop_assert_eq!(set.quantile(2, probability), None);
    }

    #[test]
    fn circular_means_turn_with_their_points(
        (points, logs) in cloud(), turn in -20.0f64..20.0,
    ) {
        // Angles within a quarter turn of their centre, so that the mean is the centre's neighbour.
        let space = Space::new([Coordinate::Angle, Coordinate::Real]);
        let quarter = |(k, x): (usize, &f64)| if k.is_multiple_of(2) { x / 10.0 } else { *x };
        let near: Vec<f64> = points.iter().enumerate().map(quarter).collect();
        let turned = |k: usize, x: &f64| if k.is_multiple_of(2) { x + turn } else { *x };
        let moved: Vec<f64> = near.iter().enumerate().map(|(k, x)| turned(k, x)).collect();
        let a = Particles::new(&space, near, logs.clone()).unwrap();
        let b = Particles::new(&space, moved, logs).unwrap();
        let (before, after) = (a.moments(), b.moments());
        prop_assert!(wrap_angle(after.mean[0] - before.mean[0] - turn).abs() < 1e-9);
        prop_assert!(after.mean[0].abs() <= std::f64::consts::PI);
        for (p, q) in before.covariance.iter().zip(&after.covariance) {
            prop_assert!((p - q).abs() < 1e-8);
        }
        let (p, q) = (a.quantile(0, 0.3).unwrap(), b.quantile(0, 0.3).unwrap());
        prop_assert!(wrap_angle(q - p - turn).abs() < 1e-9);
    }

    #[test]
    fn laws_hold_on_one_support((points, logs) in cloud(), seed in any::<u64>(), share in 0.0f64..1.0) {
        let sample = Particles::new(&Space::real(2), points, logs).unwrap();
        let value = |k: usize, salt: u64| 3.0 * crate::linear::noise(seed ^ salt, k as u64);
        let likelihood = |salt| {
            Particles::likelihood(&sample, (0..sample.len()).map(|k| value(k, salt)).collect()).unwrap()
        };
        let (a, b) = (likelihood(1), likelihood(2));
        let all = product(&[sample.clone(), a.clone(), b.clone()]).unwrap();
        prop_assert_eq!(all.role(), Role::Sample);
        for order in [[1, 0, 2], [2, 1, 0], [1, 2, 0]] {
            let messages = [sample.clone(), a.clone(), b.clone()];
            assert_same(&product(&order.map(|k: usize| messages[k].clone())).unwrap(), &all);
        }
        // Against the definition.
        let weights = sample.weights().into_iter().enumerate();
        let raw: Vec<f64> = weights.map(|(k, weight)| weight * (value(k, 1) + value(k, 2)).exp()).collect();
        let total: f64 = raw.iter().sum();
        for (own, raw) in all.weights().iter().zip(&raw) {
            prop_assert!((own - raw / total).abs() < 1e-12);
        }
        let vacuous = Particles::vacuous(&Space::real(2));
        assert_same(&product(&[sample.clone(), vacuous.clone()]).unwrap(), &sample);
        assert_same(&product(&[vacuous.clone(), sample.clone()]).unwrap(), &sample);
        assert_same(&all.quotient(&b).unwrap(), &product(&[sample.clone(), a.clone()]).unwrap());
        assert_same(&all.quotient(&vacuous).unwrap(), &all);
        prop_assert_eq!(all.change(&all), 0.0);
        prop_assert_eq!(a.change(&a), 0.0);
        let change = all.change(&sample);
        prop_assert!((0.0..=1.0 + 1e-12).contains(&change), "total variation {}", change);
        prop_assert!((change - sample.change(&all)).abs() < 1e-12);
        let mut damped = a.clone();
        prop_assert!(damped.damp(&b, share));
        for k in 0..sample.len() {
            let expected = (1.0 - share) * value(k, 1) + share * value(k, 2);
            prop_assert!((damped.log_weights()[k] - expected).abs() < 1e-12);
        }
    }
}

#[test]
fn an_empty_set_says_nothing_and_breaks_nothing() {
    let empty = Particles::vacuous(&Space::real(3));
    assert!(empty.is_empty() && !empty.is_proper());
    assert_eq!((empty.dimension(), empty.effective_sample_size(), empty.distinct_fraction()), (3, 0.0, 0.0));
    assert_eq!(empty.mean(), [0.0; 3]);
    assert!((0..4).all(|coordinate| empty.quantile(coordinate, 0.5).is_none()));
    assert_eq!(empty.quality().effective_sample_size, None);
    assert_eq!(empty.change(&empty), 0.0);
    assert!(product(&[empty.clone(), empty.clone()]).unwrap().is_empty());
}

#[test]
fn bad_input_is_refused() {
    let new = |points: &[f64], logs: &[f64]| Particles::new(&Space::real(1), points.to_vec(), logs.to_vec());
    assert!(matches!(new(&[1.0, 2.0], &[0.0]), Err(MessageError::Dimension { found: 2, expected: 1, .. })));
    assert!(matches!(new(&[f64::NAN], &[0.0]), Err(MessageError::NotFinite { .. })));
    assert!(matches!(new(&[1.0], &[f64::NAN]), Err(MessageError::NotFinite { .. })));
    assert!(matches!(new(&[1.0], &[f64::INFINITY]), Err(MessageError::NoWeight { .. })));
    assert!(matches!(new(&[1.0], &[f64::NEG_INFINITY]), Err(MessageError::NoWeight { .. })));
    assert!(matches!(new(&[], &[]), Err(MessageError::NoWeight { .. })));
    assert!(Particles::new(&Space::finite(2), vec![], vec![]).is_err());
    assert!(Particles::new(&Space::real(0), vec![], vec![0.0]).is_err());
    let set = new(&[1.0, 2.0], &[0.0, 0.0]).unwrap();
    assert!(matches!(Particles::likelihood(&set, vec![0.0]), Err(MessageError::Dimension { .. })));
    for bad in [f64::NAN, f64::INFINITY] {
        assert!(matches!(Particles::likelihood(&set, vec![0.0, bad]), Err(MessageError::NotFinite { .. })));
        let mut reused = set.clone();
        let filled = reused.become_likelihood(&set, |values| {
            values[1] = bad;
            Ok(())
        });
        assert!(matches!(filled, Err(MessageError::NotFinite { .. })));
    }
    let form = ParticlesForm::new(0);
    assert!(Particles::check_form(&form, &Space::real(1)).unwrap_err().contains("number of particles is 0"));
    let form = ParticlesForm { senders: Some(0), ..ParticlesForm::new(5) };
    assert!(Particles::check_form(&form, &Space::real(1)).unwrap_err().contains("senders"));
    assert!(Particles::check_form(&ParticlesForm::default(), &Space::finite(3)).is_err());
    assert!(Particles::check_form(&ParticlesForm::default(), &Space::real(0)).is_err());
    assert!(Particles::check_form(&ParticlesForm::default(), &Space::pose2()).is_ok());
}

#[test]
fn a_refilled_set_leaves_others_alone() {
    let mut set = line(vec![1.0, 2.0], vec![0.0, 0.0]);
    let other = set.clone();
    set.become_sample(&[Coordinate::Real; 2], 3, |points, logs| {
        points.copy_from_slice(&[0.0, 1.0, 2.0, 3.0, 4.0, 5.0]);
        logs[2] = f64::NEG_INFINITY;
        Ok(())
    })
    .unwrap();
    assert_eq!((set.len(), set.dimension(), set.point(1)), (3, 2, &[2.0, 3.0][..]));
    assert!((set.effective_sample_size() - 2.0).abs() < 1e-12);
    assert_eq!((other.len(), other.points()), (2, &[1.0, 2.0][..]));
    assert!((line(vec![1.0, 1.0, 2.0, 3.0], vec![0.0; 4]).distinct_fraction() - 0.75).abs() < 1e-12);
}

#[test]
fn messages_that_contradict_each_other_say_so() {
    let none = f64::NEG_INFINITY;
    let sample = line(vec![0.0, 1.0], vec![0.0, none]);
    let likelihood = Particles::likelihood(&sample, vec![none, 0.0]).unwrap();
    let error = product(&[sample.clone(), likelihood.clone()]).unwrap_err();
    assert!(matches!(error, MessageError::NoWeight { .. }), "{error}");
    assert!(error.to_string().contains("every weight is zero"), "{error}");
    // What cannot be divided is not divided.
    assert!(sample.quotient(&Particles::likelihood(&sample, vec![0.0, none]).unwrap()).is_none());
    assert!(sample.quotient(&sample).is_none());
    // A likelihood that is zero everywhere is far from any other, and no NaN.
    let nowhere = Particles::likelihood(&sample, vec![none, none]).unwrap();
    assert_eq!((nowhere.change(&likelihood), nowhere.change(&nowhere)), (1.0, 0.0));
    // Supports so far apart that no kernel reaches.
    let (near, far) = (line(vec![0.0, 1.0], vec![0.0; 2]), line(vec![1e200, 1.1e200], vec![0.0; 2]));
    let error = product(&[far, near]).unwrap_err();
    assert!(matches!(error, MessageError::NoWeight { .. }), "{error}");
}

#[test]
fn kernels_multiply_samples_on_different_points() {
    // N(0, 1) times a skewed mixture 0.7 N(0.5, 1) + 0.3 N(2, 0.49), on a grid of 1e-3.
    let normal =
        |x: f64, mean: f64, deviation: f64| (-0.5 * ((x - mean) / deviation).powi(2)).exp() / deviation;
    let (mut mass, mut first, mut second) = (0.0, 0.0, 0.0);
    for k in -8000..8000 {
        let x = f64::from(k) * 1e-3;
        let density = normal(x, 0.0, 1.0) * (0.7 * normal(x, 0.5, 1.0) + 0.3 * normal(x, 2.0, 0.7));
        (mass, first, second) = (mass + density, first + density * x, second + density * x * x);
    }
    let mean = first / mass;
    let variance = second / mass - mean * mean;
    let count = 2000;
    let a = drawn(1, count, |_, z| z);
    let b = drawn(2, count, |k, z| if k % 10 < 7 { 0.5 + z } else { 2.0 + 0.7 * z });
    // Kernels widen a sample's covariance by h² = 5 % at this count; with that bias, four Monte Carlo standard
    // errors (4 x 0.75 / sqrt(1000) = 0.09) fail once in 16,000 seeds.
    for messages in [[a.clone(), b.clone()], [b, a]] {
        let moments = product(&messages).unwrap().moments();
        assert!((moments.mean[0] - mean).abs() < 0.12, "{} instead of {mean}", moments.mean[0]);
        assert!((moments.covariance[0] / variance - 1.0).abs() < 0.2, "{} {variance}", moments.covariance[0]);
    }
}

#[test]
fn a_likelihood_on_other_points_is_regressed() {
    // N(0, 1) times N(1; x, 0.25): N(0.8, 0.2).
    let sample = drawn(3, 2000, |_, z| z);
    let grid = line((0..400).map(|k| -4.0 + 0.02 * f64::from(k)).collect(), vec![0.0; 400]);
    let values = grid.points().iter().map(|x| -0.5 * (x - 1.0f64).powi(2) / 0.25).collect();
    let likelihood = Particles::likelihood(&grid, values).unwrap();
    let product = product(&[likelihood, sample]).unwrap();
    assert_eq!((product.role(), product.len()), (Role::Sample, 2000));
    let moments = product.moments();
    // Regression widens the likelihood by its kernel, h² = 3 % of 0.25; four standard errors are 0.06.
    assert!((moments.mean[0] - 0.8).abs() < 0.08, "{}", moments.mean[0]);
    assert!((moments.covariance[0] / 0.2 - 1.0).abs() < 0.2, "{}", moments.covariance[0]);
}
