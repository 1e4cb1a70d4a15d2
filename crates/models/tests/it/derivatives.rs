//! Derivatives by dual numbers against finite differences.

use crate::support::{Draw, assert_close, rows, square};
use nalgebra::DMatrix;
use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use sumprod_graph::Space;
use sumprod_messages::Moments;
use sumprod_models::library::{
    AnchorOffset, AnchorRange, Bearing, CalibratedRange, LinearGaussian, PosePrior, Prior, Range,
    RangeBearing, RelativePose, RelativePosition, Unicycle,
};
use sumprod_models::{Blocks, Motion, Noise, Real, Residual, Transition, check_residual};

const TOLERANCE: f64 = 1e-6;

fn noise(dimension: usize) -> Noise {
    Noise::isotropic(dimension, 0.3).unwrap()
}

fn coordinates(count: usize) -> impl Strategy<Value = Vec<f64>> {
    prop::collection::vec(-50.0f64..50.0, count)
}

/// Whether a range or bearing is far from the point where it has no derivative.
fn apart(x: [f64; 2], y: [f64; 2]) -> bool {
    (x[0] - y[0]).hypot(x[1] - y[1]) > 1.0
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 100, rng_seed: RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::default()
    })]

    #[test]
    fn ranges(x in coordinates(4), y in coordinates(3), anchor in coordinates(2), z in 0.0f64..60.0) {
        let anchor = [anchor[0], anchor[1]];
        prop_assume!(apart([x[0], x[2]], [y[1], y[0]]) && apart([x[0], x[2]], anchor));
        let pair = Range::new(z, [4, 3], [[0, 2], [1, 0]], noise(1)).unwrap();
        prop_assert_eq!(check_residual(&pair, &[&x, &y], TOLERANCE), Ok(()));
        let ring = AnchorRange::new(z, anchor, 4, [0, 2], noise(1)).unwrap();
        prop_assert_eq!(check_residual(&ring, &[&x], TOLERANCE), Ok(()));
        let sensor = CalibratedRange::new(z, anchor, 4, [0, 2], noise(1)).unwrap();
        prop_assert_eq!(check_residual(&sensor, &[&x, &[0.05, -0.4]], TOLERANCE), Ok(()));
        let mut residual = [0.0];
        sensor.residual(&[&x[..], &[0.05, -0.4]], &mut residual);
        let distance = (x[0] - anchor[0]).hypot(x[2] - anchor[1]);
        prop_assert!((residual[0] - (1.05 * distance - 0.4 - z)).abs() < 1e-12 * (1.0 + distance));
    }

    #[test]
    fn poses(a in coordinates(3), b in coordinates(3), z in coordinates(3), near in 0.0f64..0.06) {
        let measured = [z[0], z[1], 0.05 * z[2]];
        let relative = RelativePose::new(measured, noise(3)).unwrap();
        // Headings whose difference is anything but half a turn, where the logarithm jumps; and nearly equal ones.
        for turn in [0.05 * b[2], near] {
            let heading = a[2] + measured[2] + turn;
            let to = [b[0], b[1], heading];
            prop_assert_eq!(check_residual(&relative, &[&a, &to], TOLERANCE), Ok(()));
            let prior = PosePrior::new([a[0], a[1], a[2]], noise(3)).unwrap();
            prop_assert_eq!(check_residual(&prior, &[&[b[0], b[1], a[2] + turn]], TOLERANCE), Ok(()));
        }
    }

    #[test]
    fn bearings(pose in coordinates(3), other in coordinates(3), anchor in coordinates(2), z in -3.2f64..3.2) {
        let (from, anchor) = ([pose[0], pose[1]], [anchor[0], anchor[1]]);
        prop_assume!(apart(from, [other[0], other[1]]) && apart(from, anchor));
        for target in [2, 3] {
            let to = &other[..target];
            let bearing = Bearing::new(z, target, noise(1)).unwrap();
            prop_assert_eq!(check_residual(&bearing, &[&pose, to], TOLERANCE), Ok(()));
            let both = RangeBearing::new(9.0, z, target, noise(2)).unwrap();
            prop_assert_eq!(check_residual(&both, &[&pose, to], TOLERANCE), Ok(()));
        }
        let bearing = Bearing::to_anchor(z, anchor, noise(1)).unwrap();
        prop_assert_eq!(check_residual(&bearing, &[&pose], TOLERANCE), Ok(()));
        let both = RangeBearing::to_anchor(9.0, z, anchor, noise(2)).unwrap();
        prop_assert_eq!(check_residual(&both, &[&pose], TOLERANCE), Ok(()));
    }

    #[test]
    fn linear_residuals(x in coordinates(4), y in coordinates(3), z in coordinates(2), entries in coordinates(14)) {
        let offset = RelativePosition::new(&z, [4, 3], [&[0, 2], &[2, 0]], noise(2)).unwrap();
        prop_assert_eq!(check_residual(&offset, &[&x, &y], TOLERANCE), Ok(()));
        let fix = AnchorOffset::new(&z, &[3.0, -4.0], 4, &[2, 0], noise(2)).unwrap();
        prop_assert_eq!(check_residual(&fix, &[&x], TOLERANCE), Ok(()));
        let linear = LinearGaussian::new(&[&entries[..8], &entries[8..]], &z, noise(2)).unwrap();
        prop_assert_eq!(check_residual(&linear, &[&x, &y], TOLERANCE), Ok(()));
        let prior = Prior::new(&Space::pose2(), &[z[0], z[1], 3.0], noise(3)).unwrap();
        prop_assert_eq!(check_residual(&prior, &[&y], TOLERANCE), Ok(()));
        let mut residual = [0.0; 2];
        fix.residual(&[&x[..]], &mut residual);
        prop_assert!((residual[0] - (x[2] - 3.0 - z[0])).abs() < 1e-12);
        prop_assert!((residual[1] - (x[0] + 4.0 - z[1])).abs() < 1e-12);
    }

    /// The Jacobian shows in F P F', which the prediction adds to the noise.
    #[test]
    fn motions(pose in coordinates(3), distance in -5.0f64..5.0, turn in -2.0f64..2.0, seed in any::<u64>()) {
        let motion = Unicycle::new(distance, turn, [0.1, 0.02, 0.03]).unwrap();
        let motion = Blocks(vec![motion.clone(), motion]);
        let state = [&pose[..], &[1.0, -2.0, 0.7]].concat();
        let mut jacobian = DMatrix::<f64>::zeros(6, 6);
        let step = 1e-5;
        for column in 0..6 {
            let (mut above, mut below) = (state.clone(), state.clone());
            above[column] += step;
            below[column] -= step;
            let (mut ahead, mut behind) = ([0.0; 6], [0.0; 6]);
            motion.step(&above, &mut ahead);
            motion.step(&below, &mut behind);
            for row in 0..6 {
                jacobian[(row, column)] = (ahead[row] - behind[row]) / (2.0 * step);
            }
        }
        let covariance = Draw::new(seed).covariance(6);
        let noise = square(&motion.noise(&state).covariance(), 6);
        let exact = &jacobian * &covariance * jacobian.transpose() + noise;
        let mut next = [0.0; 6];
        motion.step(&state, &mut next);
        let transition = Transition::new(motion);
        let predicted =
            transition.predict_moments(&Moments { mean: state, covariance: rows(&covariance) }).unwrap();
        prop_assert_eq!(&predicted.mean[..], &next[..]);
        assert_close(&square(&predicted.covariance, 6), &exact, 1e-6, "the predicted covariance");
    }
}

/// x y - z, with the derivative by the second port's second coordinate left out.
struct Forgetful {
    noise: Noise,
}

impl Residual for Forgetful {
    fn dimensions(&self) -> &[usize] {
        &[1, 2]
    }

    fn noise(&self) -> &Noise {
        &self.noise
    }

    fn residual<T: Real>(&self, x: &[&[T]], out: &mut [T]) {
        out[0] = x[0][0];
        out[1] = x[0][0] * x[1][0] + T::from(2.0 * x[1][1].re());
    }
}

#[test]
fn a_wrong_derivative_is_named() {
    let error =
        check_residual(&Forgetful { noise: noise(2) }, &[&[3.0], &[1.0, 5.0]], TOLERANCE).unwrap_err();
    assert_eq!((error.component, error.port, error.coordinate), (1, 1, 1));
    assert_eq!(error.derivative, 0.0);
    assert!((error.difference - 2.0).abs() < 1e-8);
    let said = error.to_string();
    assert!(said.contains("component 1") && said.contains("coordinate 1 of port 1"), "{said}");
}

struct Root {
    noise: Noise,
}

impl Residual for Root {
    fn dimensions(&self) -> &[usize] {
        &[1]
    }

    fn noise(&self) -> &Noise {
        &self.noise
    }

    fn residual<T: Real>(&self, x: &[&[T]], out: &mut [T]) {
        out[0] = x[0][0].sqrt();
    }
}

#[test]
fn a_derivative_that_is_not_finite_is_refused() {
    let root = Root { noise: noise(1) };
    assert_eq!(check_residual(&root, &[&[4.0]], TOLERANCE), Ok(()));
    assert!(check_residual(&root, &[&[0.0]], TOLERANCE).is_err());
    assert!(check_residual(&root, &[&[-1.0]], TOLERANCE).is_err());
}

#[test]
fn an_angle_that_crosses_the_half_turn_is_no_jump() {
    // Straight behind: atan2 jumps by a full turn between the two sides of the difference.
    let bearing = Bearing::to_anchor(0.2, [-10.0, 0.0], noise(1)).unwrap();
    assert_eq!(check_residual(&bearing, &[&[0.0, 0.0, 0.1]], TOLERANCE), Ok(()));
}

#[test]
fn ranges_and_bearings_at_a_touching_point_are_finite() {
    let model = sumprod_models::Model(sumprod_models::ResidualModel(
        AnchorRange::new(1.0, [2.0, 3.0], 2, [0, 1], noise(1)).unwrap(),
    ));
    let there = sumprod_messages::DynamicGaussian::from_moments(&[2.0, 3.0], &[1.0, 0.0, 0.0, 1.0]).unwrap();
    let message = crate::support::send_gaussian(&model, 0, std::slice::from_ref(&there)).unwrap();
    assert!(message.is_flat(), "a range to where one stands has no direction");

    let model = sumprod_models::Model(sumprod_models::ResidualModel(
        RangeBearing::to_anchor(1.0, 0.4, [2.0, 3.0], noise(2)).unwrap(),
    ));
    let covariance = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    let there = sumprod_messages::DynamicGaussian::from_moments(&[2.0, 3.0, 0.1], &covariance).unwrap();
    let message = crate::support::send_gaussian(&model, 0, &[there]).unwrap();
    let (information, vector) = crate::support::information_of(&message);
    assert!(information.iter().chain(vector.iter()).all(|x| x.is_finite()), "{information}{vector}");
}
