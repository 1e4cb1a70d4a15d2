//! The law of reselection, for every resampler.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail the test")]

use sumprod_graph::{Purpose, Space, Stream};
use sumprod_messages::Particles;
use sumprod_optimizers::{Reselection, Scheme};

/// Uneven weights with a zero, a dominant one, and whole expected counts.
const WEIGHTS: [f64; 9] = [0.5, 3.0, 0.0, 0.25, 7.3, 1.0, 0.01, 2.94, 5.0];
const REPETITIONS: u64 = 20_000;
/// Standard errors allowed: two-sided error probability 6e-7 of one comparison.
const BOUND: f64 = 5.0;

fn stream(entity: u64) -> Stream {
    Stream::new(11, 0, Purpose::Optimizer, entity)
}

fn counts(scheme: Scheme, weights: &[f64], count: usize, entity: u64) -> Vec<usize> {
    let mut counts = vec![0; weights.len()];
    for ancestor in scheme.ancestors(weights, count, &mut stream(entity)).unwrap() {
        counts[ancestor] += 1;
    }
    counts
}

#[test]
fn expected_copies_are_proportional_to_the_weights() {
    // 5 schemes, 3 counts, 9 weights: 135 comparisons, error probability 8e-5 in all.
    let total: f64 = WEIGHTS.iter().sum();
    for scheme in Scheme::ALL {
        for count in [4, 20, 37] {
            let mut sums = [(0.0, 0.0); WEIGHTS.len()];
            for entity in 0..REPETITIONS {
                let counts = counts(scheme, &WEIGHTS, count, entity);
                assert_eq!(counts.iter().sum::<usize>(), count);
                for ((sum, squares), &copies) in sums.iter_mut().zip(&counts) {
                    *sum += copies as f64;
                    *squares += (copies * copies) as f64;
                }
            }
            for ((sum, squares), weight) in sums.iter().zip(WEIGHTS) {
                let n = REPETITIONS as f64;
                let (mean, expected) = (sum / n, count as f64 * weight / total);
                let error = ((squares / n - mean * mean).max(0.0) / n).sqrt();
                assert!(
                    (mean - expected).abs() <= BOUND * error + 1e-9,
                    "{scheme:?}, {count} of weight {weight}: {mean} instead of {expected} ± {error}"
                );
            }
        }
    }
}

#[test]
fn copies_stay_within_the_stated_distance_of_their_expectation() {
    let total: f64 = WEIGHTS.iter().sum();
    for scheme in Scheme::ALL {
        for (entity, count) in (0..2000).zip([1, 3, 20, 64].into_iter().cycle()) {
            for (copies, weight) in counts(scheme, &WEIGHTS, count, entity).into_iter().zip(WEIGHTS) {
                let (copies, expected) = (copies as f64, count as f64 * weight / total);
                let holds = match scheme {
                    Scheme::Systematic | Scheme::Ssp => (copies - expected).abs() < 1.0 + 1e-9,
                    Scheme::Stratified => (copies - expected).abs() < 2.0,
                    Scheme::Residual => copies >= (expected - 1e-9).floor(),
                    Scheme::Multinomial => copies <= count as f64,
                };
                assert!(holds, "{scheme:?}: {copies} copies, {expected} expected");
                assert!(weight > 0.0 || copies == 0.0, "{scheme:?} chose a weight of zero");
            }
        }
    }
}

#[test]
fn a_test_function_keeps_its_expectation_and_no_scheme_varies_more_than_multinomial() {
    // f(x) = x² on a line of points: 5 comparisons, error probability 3e-6 in all.
    let points: Vec<f64> = (0..WEIGHTS.len()).map(|k| k as f64 - 3.0).collect();
    let logs: Vec<f64> = WEIGHTS.iter().map(|weight| weight.ln()).collect();
    let particles = Particles::new(&Space::real(1), points, logs).unwrap();
    let second = |particles: &Particles| -> f64 {
        particles.weights().iter().zip(particles.points()).map(|(weight, x)| weight * x * x).sum()
    };
    let exact = second(&particles);
    let mut variances = Vec::new();
    for scheme in Scheme::ALL {
        let (mut sum, mut squares) = (0.0, 0.0);
        for entity in 0..REPETITIONS {
            let chosen = scheme.reselect(&particles, 20, &mut stream(entity)).unwrap();
            let weights = chosen.weights();
            assert!(weights.iter().all(|weight| (weight - 0.05).abs() < 1e-14));
            let error = second(&chosen) - exact;
            sum += error;
            squares += error * error;
        }
        let n = REPETITIONS as f64;
        let variance = squares / n;
        assert!(sum.abs() / n < BOUND * (variance / n).sqrt(), "{scheme:?}: {}", sum / n);
        variances.push(variance);
    }
    // The others vary less by a factor of two and more; 20,000 repetitions know a variance to 1 %.
    assert!(variances[1..].iter().all(|variance| *variance < 0.8 * variances[0]), "{variances:?}");
}

#[test]
fn the_scale_of_the_weights_does_not_matter() {
    for scheme in Scheme::ALL {
        for entity in 0..200 {
            let reference = scheme.ancestors(&WEIGHTS, 50, &mut stream(entity)).unwrap();
            for scale in [2.0_f64.powi(-60), 4.0, 1e-7, 3e11] {
                let scaled = WEIGHTS.map(|weight| weight * scale);
                assert_eq!(scheme.ancestors(&scaled, 50, &mut stream(entity)).unwrap(), reference);
            }
        }
    }
}

#[test]
fn the_same_stream_chooses_the_same_in_ascending_order() {
    for scheme in Scheme::ALL {
        let first = scheme.ancestors(&WEIGHTS, 500, &mut stream(3)).unwrap();
        assert_eq!(first, scheme.ancestors(&WEIGHTS, 500, &mut stream(3)).unwrap());
        assert_ne!(first, scheme.ancestors(&WEIGHTS, 500, &mut stream(4)).unwrap());
        assert!(first.is_sorted());
    }
}

#[test]
fn equal_weights_are_each_kept_once_by_the_regular_schemes() {
    for scheme in [Scheme::Residual, Scheme::Stratified, Scheme::Systematic, Scheme::Ssp] {
        for (entity, n) in (0..).zip([1, 7, 49, 1000]) {
            let ancestors = scheme.ancestors(&vec![0.1; n], n, &mut stream(entity)).unwrap();
            assert_eq!(ancestors, (0..n).collect::<Vec<_>>(), "{scheme:?}, {n}");
        }
    }
}
