//! Poses: the laws of their groups, and the derivatives of the factors between them.

use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use sumprod_graph::Space;
use sumprod_models::library::{
    PointInFrame, PosePrior, PosePrior3, PoseResidual, Range, RelativePose, RelativePose3,
};
use sumprod_models::pose::{Pose2, Pose3};
use sumprod_models::{Manifold, Noise, check_expansion, check_residual};

fn step(freedoms: usize, turn: f64) -> impl Strategy<Value = Vec<f64>> {
    let translation = if freedoms == 3 { 2 } else { 3 };
    (
        prop::collection::vec(-3.0f64..3.0, translation),
        prop::collection::vec(-turn..turn, freedoms - translation),
    )
        .prop_map(|(translation, rotation)| [translation, rotation].concat())
}

/// A pose reached from the origin by a step.
fn pose(space: &Space, step: &[f64]) -> Vec<f64> {
    let mut value = vec![0.0; space.dimension()];
    space.origin(&mut value);
    space.retract(&mut value, step);
    value
}

fn array<const N: usize>(numbers: &[f64]) -> [f64; N] {
    numbers.try_into().unwrap()
}

fn noise(components: usize) -> Noise {
    let mut covariance = vec![0.02; components * components];
    for k in 0..components {
        covariance[k * components + k] = 0.3 + 0.1 * k as f64;
    }
    Noise::gaussian(&covariance).unwrap()
}

fn close(a: &[f64], b: &[f64], tolerance: f64) -> bool {
    a.iter().zip(b).all(|(a, b)| (a - b).abs() <= tolerance)
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 200, rng_seed: RngSeed::Fixed(7), failure_persistence: None, ..ProptestConfig::default()
    })]

    #[test]
    fn steps_are_given_back(plane in (step(3, 3.1), step(3, 3.1)), solid in (step(6, 1.7), step(6, 1.7))) {
        for (space, (there, step)) in [(Space::Se2, plane), (Space::Se3, solid)] {
            let start = pose(&space, &there);
            let mut moved = start.clone();
            space.retract(&mut moved, &step);
            let mut back = vec![0.0; space.degrees_of_freedom()];
            space.local(&start, &moved, &mut back);
            prop_assert!(close(&back, &step, 1e-9), "{:?} {:?}", back, step);
            let mut again = start.clone();
            space.retract(&mut again, &back);
            prop_assert!(close(&again, &moved, 1e-12));
            let mut still = start.clone();
            space.retract(&mut still, &vec![0.0; space.degrees_of_freedom()]);
            prop_assert!(close(&still, &start, 1e-15));
        }
    }

    #[test]
    fn groups_associate_and_invert(a in step(6, 1.7), b in step(6, 1.7), c in step(6, 1.7), point in step(6, 1.0)) {
        let [a, b, c] = [a, b, c].map(|s| Pose3::exp([s[0], s[1], s[2], s[3], s[4], s[5]]));
        let point = [point[0], point[1], point[2]];
        let (left, right) = (a.compose(&b).compose(&c), a.compose(&b.compose(&c)));
        prop_assert!(close(&left.position, &right.position, 1e-12));
        prop_assert!(close(&left.transform(point), &a.transform(b.transform(c.transform(point))), 1e-12));
        prop_assert!(close(&a.between(&a.compose(&b)).position, &b.position, 1e-12));
        prop_assert!(close(&a.local(a.transform(point)), &point, 1e-12));
        let (a, b) = (Pose2::exp([a.position[0], a.position[1], 2.0]), Pose2::exp([point[0], point[1], -2.5]));
        let back = a.between(&a.compose(&b));
        prop_assert!(close(&[back.x, back.y, back.heading], &[b.x, b.y, b.heading], 1e-12));
    }

    #[test]
    fn relative_poses(a in step(3, 3.1), b in step(3, 3.1), z in step(3, 3.1), small in -1e-4f64..1e-4) {
        let [a, b, z] = [a, b, z].map(|s| pose(&Space::Se2, &s));
        for form in [PoseResidual::Log, PoseResidual::Split] {
            let factor = RelativePose::new(array(&z), noise(3)).unwrap().with_form(form);
            let (turned, spaces) = (a[2] + z[2] - b[2], [Space::Se2, Space::Se2]);
            // Half a turn away the residual jumps.
            if (turned - std::f64::consts::PI).rem_euclid(std::f64::consts::TAU) > 0.05
                && (std::f64::consts::PI - turned).rem_euclid(std::f64::consts::TAU) > 0.05
            {
                prop_assert_eq!(check_expansion(&factor, &spaces, &[&a, &b], 1e-5), Ok(()));
                prop_assert_eq!(check_residual(&factor, &[&a, &b], 1e-5), Ok(()));
            }
            let mut near = a.clone();
            Space::Se2.retract(&mut near, &[z[0] + small, z[1], z[2]]);
            let mut exact = a.clone();
            let mut whole = [0.0; 3];
            Space::Se2.local(&pose(&Space::Se2, &[0.0; 3]), &z, &mut whole);
            Space::Se2.retract(&mut exact, &whole);
            prop_assert_eq!(check_expansion(&factor, &spaces, &[&a, &exact], 1e-5), Ok(()));
        }
        let prior = PosePrior::new(array(&z), noise(3)).unwrap();
        let mut near = z.clone();
        Space::Se2.retract(&mut near, &[0.4, -small, 1.0]);
        prop_assert_eq!(check_expansion(&prior, &[Space::Se2], &[&near], 1e-5), Ok(()));
    }

    #[test]
    fn relative_poses_in_space(a in step(6, 1.5), z in step(6, 1.0), error in step(6, 1.2), scale in -6i32..1) {
        let [a, z] = [a, z].map(|s| pose(&Space::Se3, &s));
        let error: Vec<f64> = error.iter().map(|e| e * 10f64.powi(scale)).collect();
        let mut b = Pose3::read(&a).compose(&Pose3::read(&z)).normalised();
        b = b.compose(&Pose3::exp([error[0], error[1], error[2], error[3], error[4], error[5]])).normalised();
        let mut to = vec![0.0; 7];
        b.write(&mut to);
        for form in [PoseResidual::Log, PoseResidual::Split] {
            let factor = RelativePose3::new(array(&z), noise(6)).unwrap().with_form(form);
            prop_assert_eq!(check_expansion(&factor, &[Space::Se3, Space::Se3], &[&a, &to], 1e-5), Ok(()));
            prop_assert_eq!(check_residual(&factor, &[&a, &to], 1e-5), Ok(()));
        }
        let prior = PosePrior3::new(array(&a), noise(6)).unwrap();
        let mut near = a.clone();
        Space::Se3.retract(&mut near, &error);
        prop_assert_eq!(check_expansion(&prior, &[Space::Se3], &[&near], 1e-5), Ok(()));
    }

    #[test]
    fn points_seen_from_poses(plane in step(3, 3.1), solid in step(6, 1.7), point in prop::collection::vec(4.0f64..9.0, 3)) {
        let (plane, solid) = (pose(&Space::Se2, &plane), pose(&Space::Se3, &solid));
        let seen = PointInFrame::new(&[1.0, 2.0], 2, noise(2)).unwrap();
        let spaces = [Space::Se2, Space::real(2)];
        prop_assert_eq!(check_expansion(&seen, &spaces, &[&plane, &point[..2]], 1e-5), Ok(()));
        let seen = PointInFrame::new(&[1.0, 2.0, 3.0], 3, noise(3)).unwrap();
        let spaces = [Space::Se3, Space::real(3)];
        prop_assert_eq!(check_expansion(&seen, &spaces, &[&solid, &point], 1e-5), Ok(()));
        let range = Range::new(5.0, [7, 3], [[0, 1, 2]; 2], noise(1)).unwrap();
        prop_assert_eq!(check_expansion(&range, &spaces, &[&solid, &point], 1e-5), Ok(()));
        let range = Range::new(5.0, [3, 2], [[0, 1]; 2], noise(1)).unwrap();
        prop_assert_eq!(check_expansion(&range, &[Space::Se2, Space::real(2)], &[&plane, &point[..2]], 1e-5), Ok(()));
    }
}

#[test]
fn a_full_turn_is_no_error() {
    let factor = RelativePose::new([1.0, 0.0, 3.0], noise(3)).unwrap();
    let mut residual = [0.0; 3];
    use sumprod_models::Residual;
    let (from, to) = ([0.0, 0.0, 3.0], [3f64.cos(), 3f64.sin(), 6.0 - std::f64::consts::TAU]);
    factor.residual(&[&from[..], &to[..]], &mut residual);
    assert!(close(&residual, &[0.0; 3], 1e-12), "{residual:?}");
}

#[test]
fn poses_that_are_none_are_refused() {
    let none = RelativePose3::new([0.0; 7], noise(6)).unwrap_err();
    assert!(none.to_string().contains("quaternion"), "{none}");
    assert!(RelativePose3::new([1.0; 7], noise(3)).is_err());
    assert!(RelativePose::new([0.0, f64::NAN, 0.0], noise(3)).is_err());
    assert!(PosePrior::new([0.0; 3], noise(2)).is_err());
    assert!(PointInFrame::new(&[1.0], 2, noise(1)).is_err());
}
