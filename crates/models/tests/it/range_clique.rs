//! Ranges to one landmark as one factor, against integrals on a grid.

use std::f64::consts::TAU;
use sumprod_graph::MessageError;
use sumprod_messages::DynamicGaussian;
use sumprod_models::library::{CliqueRange, RangeClique};

const VARIANCE: f64 = 4.0;

/// A trajectory of four places, of which the landmark at (30, -30) and its mirror at (-30, -30) are as far from the
/// first two.
const PLACES: [f64; 8] = [0.0, 0.0, 0.0, 30.0, 30.0, 30.0, 90.0, 0.0];
const LANDMARK: [f64; 2] = [30.0, -30.0];

fn clique(measured_from: &[usize]) -> RangeClique {
    let positions: Vec<[usize; 2]> = measured_from.iter().map(|&k| [2 * k, 2 * k + 1]).collect();
    let ranges = measured_from.iter().enumerate().map(|(position, &k)| {
        let measured = (LANDMARK[0] - PLACES[2 * k]).hypot(LANDMARK[1] - PLACES[2 * k + 1]);
        CliqueRange { position, measured, variance: VARIANCE }
    });
    RangeClique::new(PLACES.len(), &positions, ranges.collect()).unwrap()
}

/// Places known to `variance` (m²).
fn trajectory(variance: f64) -> DynamicGaussian {
    let mut covariance = vec![0.0; 64];
    (0..8).for_each(|k| covariance[9 * k] = variance);
    DynamicGaussian::from_moments(&PLACES, &covariance).unwrap()
}

/// Log of the integral of the ranges over the plane, the positions given, and the share of x < 0.
fn integral(clique: &RangeClique, positions: &[f64]) -> (f64, f64) {
    let (steps, turns) = (600, 1440);
    let (mut sum, mut left) = (0.0, 0.0);
    for i in 0..steps {
        let radius = 20.0 + 45.0 * (f64::from(i) + 0.5) / f64::from(steps);
        for j in 0..turns {
            let (sine, cosine) = (f64::from(j) * TAU / f64::from(turns)).sin_cos();
            let landmark = [positions[0] + radius * cosine, positions[1] + radius * sine];
            let share = clique.log_density(positions, landmark).exp() * radius;
            sum += share;
            left += if landmark[0] < 0.0 { share } else { 0.0 };
        }
    }
    ((sum * 45.0 / f64::from(steps) * TAU / f64::from(turns)).ln(), left / sum)
}

#[test]
fn evidence_and_modes_agree_with_the_grid() {
    for (measured_from, parts) in [(vec![0], 1), (vec![0, 1], 2), (vec![0, 1, 2], 1)] {
        let clique = clique(&measured_from);
        let (mixture, log_evidence) = clique.mixture(&trajectory(1e-6), 200).unwrap();
        let positions: Vec<f64> =
            measured_from.iter().flat_map(|&k| [PLACES[2 * k], PLACES[2 * k + 1]]).collect();
        let (exact, left) = integral(&clique, &positions);
        // What the Laplace approximation of bent components misses.
        assert!((log_evidence - exact).abs() < 0.06, "{measured_from:?}: {log_evidence} {exact}");
        let d = mixture.dimension();
        let landmark = mixture.marginal(&[d - 2, d - 1]).unwrap();
        let found = landmark.parts(0.5).unwrap();
        assert_eq!(found.iter().max().unwrap() + 1, parts, "{measured_from:?}");
        if measured_from.len() < 3 {
            // Both sides of the line through the places are alike.
            assert!(
                (left - 0.5).abs() < 1e-3 && landmark.moments().mean[0].abs() < 0.01,
                "{measured_from:?}"
            );
        }
    }
}

#[test]
fn fewer_components_are_wider_and_still_right() {
    let (ring, log_evidence) = clique(&[0]).mixture(&trajectory(0.01), 16).unwrap();
    assert_eq!(ring.len(), 16);
    assert!((log_evidence - (TAU * 30.0 * 2.0_f64.sqrt()).ln()).abs() < 0.05, "{log_evidence}");
    let moments = ring.marginal(&[2, 3]).unwrap().moments();
    assert!(moments.mean.iter().all(|mean| mean.abs() < 1e-6));
    // A ring of radius r and noise σ has the variance (r² + σ² + s²) / 2 along each axis, s the tiles' half spacing.
    let half_spacing = TAU * 1800.0_f64.sqrt() / 32.0;
    let expected = 0.5 * (1800.0 + VARIANCE + half_spacing.powi(2));
    assert!((moments.covariance[0] / expected - 1.0).abs() < 1e-3, "{}", moments.covariance[0]);
}

#[test]
fn the_message_to_the_trajectory_is_the_curvature_of_the_integral() {
    let clique = clique(&[0, 1, 2, 3]);
    let message = clique.to_trajectory(&PLACES).unwrap();
    // Differences of the log integral over the first place's x, the fourth's x and y.
    let value = |shift: &[(usize, f64)]| {
        let mut positions = PLACES;
        shift.iter().for_each(|&(k, by)| positions[k] += by);
        integral(&clique, &positions).0
    };
    let step = 0.5;
    for (a, b) in [(0, 0), (6, 6), (7, 7), (0, 6), (6, 7)] {
        let corner = |x: f64, y: f64| value(&[(a, x * step), (b, y * step)]);
        let second = (corner(1.0, 1.0) - corner(1.0, -1.0) - corner(-1.0, 1.0) + corner(-1.0, -1.0))
            / (4.0 * step * step);
        let found = -message.information_at(a, b);
        assert!((found - second).abs() < 0.01 / VARIANCE, "({a}, {b}): {found} {second}");
    }
    // The measured ranges are the true ones: nothing pulls the places away.
    let pull: Vec<f64> = message.information_vector().to_vec();
    let at_rest: Vec<f64> =
        (0..8).map(|row| (0..8).map(|k| message.information_at(row, k) * PLACES[k]).sum()).collect();
    assert!(pull.iter().zip(&at_rest).all(|(a, b)| (a - b).abs() < 1e-4), "{pull:?} {at_rest:?}");
    // One range, or two, leave the landmark to take up any error.
    for measured_from in [vec![0], vec![0, 1]] {
        let message = self::clique(&measured_from).to_trajectory(&PLACES).unwrap();
        let largest = (0..8).map(|k| message.information_at(k, k)).fold(0.0, f64::max);
        assert!(largest < 1e-3 / VARIANCE, "{measured_from:?}: {largest}");
    }
}

#[test]
fn a_gaussian_takes_the_mode_of_its_start() {
    let clique = clique(&[0, 1]);
    for side in [-1.0, 1.0] {
        let start = [side * 20.0, -40.0];
        let (single, log_evidence) = clique.gaussian(&trajectory(0.01), start).unwrap();
        assert_eq!(single.len(), 1);
        let mean = single.mean_of(0);
        assert!((mean[4] - side * 30.0).abs() < 1e-3 && (mean[5] + 30.0).abs() < 1e-3, "{mean:?}");
        let both = clique.mixture(&trajectory(0.01), 200).unwrap().1;
        let half = both - 2.0_f64.ln();
        assert!((log_evidence - half).abs() < 0.15, "half of it is seen: {log_evidence} {half}");
        let message = clique.gaussian_to_trajectory(&PLACES, start).unwrap();
        assert!((0..8).all(|k| message.information_at(k, k) < 1e-6));
    }
    let (open, _) = self::clique(&[0]).gaussian(&trajectory(0.01), [10.0, 0.0]).unwrap();
    let covariance = open.covariance_of(0);
    assert!(
        (covariance[10] - VARIANCE).abs() < 0.02 && (covariance[15] - 900.0).abs() < 0.02,
        "{covariance:?}"
    );
}

#[test]
fn what_is_no_clique_is_refused() {
    let range = CliqueRange { position: 0, measured: 10.0, variance: 1.0 };
    let refused = |positions: &[[usize; 2]], ranges: Vec<CliqueRange>| {
        RangeClique::new(8, positions, ranges).unwrap_err().to_string()
    };
    assert_eq!(refused(&[[0, 1]], vec![]), "a clique of ranges needs at least one range");
    assert!(refused(&[[0, 8]], vec![range]).contains("coordinate 8"));
    assert!(refused(&[[0, 1]], vec![CliqueRange { position: 1, ..range }]).contains("coordinate 1"));
    assert!(refused(&[[0, 1]], vec![CliqueRange { measured: f64::NAN, ..range }]).contains("NaN"));
    assert!(
        refused(&[[0, 1]], vec![CliqueRange { variance: 0.0, ..range }]).contains("not positive definite")
    );
    let open = DynamicGaussian::flat(8);
    assert!(matches!(clique(&[0]).mixture(&open, 50), Err(MessageError::Improper { .. })));
    assert!(clique(&[0]).to_trajectory(&[0.0]).is_err());
    // Rings that are far too small, too large, or too sharp still give numbers or an error, never none.
    for (measured, variance) in [(0.0, 1.0), (-5.0, 1.0), (1e-300, 1e-300), (1e150, 1.0), (10.0, 1e200)] {
        let ranges = vec![CliqueRange { position: 0, measured, variance }];
        let clique = RangeClique::new(8, &[[0, 1]], ranges).unwrap();
        if let Ok((mixture, log_evidence)) = clique.mixture(&trajectory(0.01), 50) {
            assert!(log_evidence.is_finite() && mixture.means().iter().all(|mean| mean.is_finite()));
        }
    }
}
