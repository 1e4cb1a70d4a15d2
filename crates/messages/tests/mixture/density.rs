//! Fast densities against the sum over all components.

use crate::common::{covariance, mixture, normal, stream};
use std::f64::consts::PI;
use sumprod_graph::{Coordinate, Space};
use sumprod_messages::{Evaluator, Mixture};

/// Largest error of the log density at points in and around the mixture.
fn error(mixture: &Mixture, points: &[f64], tolerance: f64) -> f64 {
    let d = mixture.dimension();
    let mut found = vec![0.0; points.len() / d];
    Evaluator::new(mixture).log_densities_within(points, tolerance, &mut found).unwrap();
    let exact = points.chunks(d).map(|point| mixture.log_density(point).unwrap());
    found.iter().zip(exact).map(|(a, b)| (a - b).abs() / b.abs().max(1.0)).fold(0.0, f64::max)
}

fn points(entity: u64, d: usize, count: usize, spread: f64) -> Vec<f64> {
    let mut random = stream(entity).fast();
    (0..count * d).map(|_| spread * normal(&mut random)).collect()
}

#[test]
fn full_accuracy_in_every_dimension() {
    for d in 1..=4 {
        for shared in [true, false] {
            for (count, width) in [(1, 1.0), (7, 0.5), (40, 0.02), (1000, 0.2)] {
                let mixture = mixture(count as u64, d, count, 1.5, width, shared);
                let error = error(&mixture, &points(5, d, 300, 2.0), 0.0);
                assert!(error < 1e-13, "d = {d}, {count} components of width {width}: {error:e}");
            }
        }
    }
}

#[test]
fn the_tolerance_bounds_the_error() {
    for tolerance in [1e-2, 1e-4, 1e-8] {
        for (d, count, width) in [(1, 5000, 0.2), (1, 300, 0.05), (2, 5000, 1.0), (3, 500, 0.3)] {
            let mixture = mixture(9, d, count, 1.0, width, true);
            for spread in [0.3, 1.0, 3.0] {
                let error = error(&mixture, &points(6, d, 1000, spread), tolerance);
                assert!(error < tolerance, "d = {d}, spread {spread}: {error:e} with {tolerance:e}");
            }
        }
    }
}

#[test]
fn points_far_away_have_finite_log_densities() {
    let mixture = mixture(2, 2, 100, 1.0, 1e-3, true);
    let mut far = points(7, 2, 64, 1.0);
    far.extend([1e4, -3e3, 1e6, 1e6]);
    assert!(error(&mixture, &far, 0.0) < 1e-13);
}

#[test]
fn angles_are_read_on_the_nearest_branch() {
    let mut random = stream(8).fast();
    let space = Space::new([Coordinate::Real, Coordinate::Angle]);
    let means: Vec<f64> =
        (0..100).flat_map(|_| [normal(&mut random), PI + 0.5 * normal(&mut random)]).collect();
    for shared in [true, false] {
        let mixture = if shared {
            let kernel = covariance(&mut random, 2, 0.2);
            Mixture::with_shared_covariance(&space, vec![0.0; 100], means.clone(), kernel).unwrap()
        } else {
            let kernels = (0..100).flat_map(|_| covariance(&mut random, 2, 0.2)).collect();
            Mixture::new(&space, vec![0.0; 100], means.clone(), kernels).unwrap()
        };
        let points: Vec<f64> =
            (0..200).flat_map(|i| [0.01 * f64::from(i) - 1.0, 0.31 * f64::from(i)]).collect();
        assert!(error(&mixture, &points, 0.0) < 1e-13);
        // A full turn changes nothing.
        let turned: Vec<f64> =
            points.iter().enumerate().map(|(k, x)| if k % 2 == 1 { x + 2.0 * PI } else { *x }).collect();
        for (a, b) in points.chunks(2).zip(turned.chunks(2)) {
            let (a, b) = (mixture.log_density(a).unwrap(), mixture.log_density(b).unwrap());
            assert!((a - b).abs() < 1e-9 * a.abs().max(1.0));
        }
    }
}

#[test]
fn sizes_must_agree() {
    let mixture = mixture(1, 2, 3, 1.0, 1.0, true);
    assert!(mixture.log_density(&[0.0]).is_err());
    assert!(Evaluator::new(&mixture).log_densities(&[0.0; 5], &mut [0.0; 2]).is_err());
}
