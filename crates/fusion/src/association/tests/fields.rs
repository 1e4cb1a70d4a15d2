use nalgebra::{DMatrix, Vector2, Vector4};
use proptest::prelude::*;

use super::super::candidates::squared_distance;
use super::super::{CoherentDrift, Displacement, Pull, Tracks};
use super::{DEGREE, SENSORS, Scene, biased};

proptest! {
    #[test]
    fn the_derivative_by_the_biases_is_that_of_finite_differences(
        x in -80e3_f64..80e3, y in 1e3_f64..90e3,
        ranges in [-2e3_f64..2e3, -2e3..2e3], azimuths in [-0.1_f64..0.1, -0.1..0.1],
    ) {
        let seen = Vector2::new(x, y);
        let biases = Vector4::new(ranges[0], azimuths[0], ranges[1], azimuths[1]);
        let (_, derivative) = SENSORS.transfer(seen, &biases);
        for (k, step) in [1.0, 1e-5, 1.0, 1e-5].into_iter().enumerate() {
            let at = |sign: f64| {
                let mut moved = biases;
                moved[k] += sign * step;
                SENSORS.transfer(seen, &moved).0
            };
            let numeric = (at(1.0) - at(-1.0)) / (2.0 * step);
            let scale = 1.0 + numeric.norm();
            prop_assert!((derivative.column(k) - numeric).norm() < 1e-5 * scale, "{k}: {numeric} {derivative}");
        }
    }

    #[test]
    fn the_transfer_undoes_one_sensor_and_does_the_other(
        x in -80e3_f64..80e3, y in 1e3_f64..90e3, level in 0.0_f64..6.0,
    ) {
        let biases = [300.0 * level, -0.5 * DEGREE * level, -300.0 * level, 0.5 * DEGREE * level];
        let seen = biased([x, y], SENSORS.first, [biases[0], biases[1]]);
        let wanted = biased([x, y], SENSORS.second, [biases[2], biases[3]]);
        let found = SENSORS.transfer(Vector2::from(seen), &Vector4::from(biases)).0;
        prop_assert!((found - Vector2::from(wanted)).norm() < 1e-6);
    }
}

/// One maximisation against the equation of Myronenko and Song with the whole matrix.
#[test]
fn the_low_rank_drift_is_the_dense_one() {
    let scene = Scene::new(7, 60, 5, &[[0.0; 4]]);
    let (tracks, scale, stiffness, length) = (&scene.first, 20e3, 3.0, 1.0);
    let count = tracks.len();
    let pull = Pull {
        weight: (0..count).map(|m| (m % 5) as f64 * 0.3).collect(),
        force: (0..2 * count).map(|i| 700.0 * ((i * i) as f64).sin()).collect(),
    };
    let variance = 150.0_f64.powi(2);
    let mut field = CoherentDrift::new(length, stiffness).unwrap();
    let prior = field.start(tracks, scale, &mut vec![0.0; 2 * count]).unwrap();
    assert!((prior - scale * scale / stiffness).abs() < 1e-6 * prior);
    let mut low = vec![0.0; 2 * count];
    field.improve(&pull, variance, &mut low).unwrap();
    assert!(field.rank() < count && field.lacking() <= 1e-8, "{} {}", field.rank(), field.lacking());

    let places: Vec<&[f64]> = tracks.iter().collect();
    let kernel = DMatrix::from_fn(count, count, |i, j| {
        (-0.5 * squared_distance(places[i], places[j]) / (length * scale).powi(2)).exp()
    });
    let weights = DMatrix::from_diagonal(&pull.weight.clone().into());
    let damping = stiffness * variance / (scale * scale);
    let left = &weights * &kernel + DMatrix::identity(count, count) * damping;
    let right = DMatrix::from_fn(count, 2, |m, i| pull.force[2 * m + i]);
    let coefficients = left.lu().solve(&right).unwrap();
    let dense = &kernel * &coefficients;
    let penalty = 0.5 * stiffness / (scale * scale) * (coefficients.transpose() * &dense).trace();
    // A ten-thousandth of the prior's deviation of 11.5 km is cut off.
    for m in 0..count {
        for i in 0..2 {
            assert!((low[2 * m + i] - dense[(m, i)]).abs() < 2.0, "{} {}", low[2 * m + i], dense[(m, i)]);
        }
    }
    assert!((field.penalty() - penalty).abs() < 1e-3 * penalty, "{} {penalty}", field.penalty());
}

#[test]
fn a_rank_cut_short_is_told_and_stiffer() {
    let scene = Scene::new(8, 60, 0, &[[0.0; 4]]);
    let mut field = CoherentDrift::new(0.3, 3.0).unwrap().with_rank(10).unwrap();
    field.start(&scene.first, 20e3, &mut [0.0; 120]).unwrap();
    assert_eq!(field.rank(), 10);
    assert!(field.lacking() > 0.1);
    assert!(CoherentDrift::new(1.0, 1.0).unwrap().with_rank(0).is_err());
    let none = Tracks::planar(&[]).unwrap();
    field.start(&none, 1.0, &mut []).unwrap();
    assert_eq!(field.rank(), 0);
}
