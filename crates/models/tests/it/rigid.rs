//! A rigid motion of the world moves the answer rigidly.

use crate::support::{Draw, assert_close, moments_of, rows, square};
use nalgebra::{DMatrix, DVector, Matrix2, Matrix3, Vector2};
use sumprod_graph::schedule::Flooding;
use sumprod_graph::{Engine, FactorGraph, Options, Space, wrap_angle};
use sumprod_messages::{DynamicGaussian, GaussianForm, Linearisation};
use sumprod_models::library::{AnchorOffset, AnchorRange, Range, RangeBearing, RelativePosition};
use sumprod_models::{AddModel, Noise};

/// A rotation (rad) and then a translation (m).
#[derive(Clone, Copy)]
struct Rigid {
    angle: f64,
    shift: Vector2<f64>,
}

impl Rigid {
    fn rotation(&self) -> Matrix2<f64> {
        Matrix2::new(self.angle.cos(), -self.angle.sin(), self.angle.sin(), self.angle.cos())
    }

    fn point(&self, x: [f64; 2]) -> [f64; 2] {
        (self.rotation() * Vector2::from(x) + self.shift).into()
    }

    fn offset(&self, x: [f64; 2]) -> [f64; 2] {
        (self.rotation() * Vector2::from(x)).into()
    }
}

const STILL: Rigid = Rigid { angle: 0.0, shift: Vector2::new(0.0, 0.0) };

/// Beliefs of five agents in a plane after a few rounds.
fn agents(world: Rigid, linearisation: Linearisation) -> Vec<(DVector<f64>, DMatrix<f64>)> {
    let mut draw = Draw::new(500);
    let mut graph = FactorGraph::<DynamicGaussian>::new();
    let anchors = [[0.0, 0.0], [30.0, 2.0], [8.0, 25.0]];
    let truth: Vec<[f64; 2]> = (0..5).map(|_| [draw.uniform(2.0, 25.0), draw.uniform(3.0, 22.0)]).collect();
    let x: Vec<_> = (0..5).map(|_| graph.unnamed_variable(Space::real(2))).collect();
    let distance = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
    let noise = || Noise::isotropic(1, 0.25).unwrap();
    let mut factors = Vec::new();
    for (k, &at) in truth.iter().enumerate() {
        let guess = world.point([at[0] + draw.normal(), at[1] + draw.normal()]);
        let start = moments_of(&DVector::from_column_slice(&guess), &(DMatrix::identity(2, 2) * 4.0));
        graph.set_start(x[k], start).unwrap();
        for anchor in anchors {
            let z = distance(at, anchor) + 0.5 * draw.normal();
            let ring = AnchorRange::new(z, world.point(anchor), 2, [0, 1], noise()).unwrap();
            factors.push(graph.add("ring", ring, &[x[k]]).unwrap());
        }
        let next = (k + 1) % 5;
        let z = distance(at, truth[next]) + 0.5 * draw.normal();
        let pair = Range::new(z, [2, 2], [[0, 1], [0, 1]], noise()).unwrap();
        factors.push(graph.add("range", pair, &[x[k], x[next]]).unwrap());
        let other = (k + 2) % 5;
        let offset = world.offset([truth[other][0] - at[0], truth[other][1] - at[1]]);
        let rough = Noise::isotropic(2, 9.0).unwrap();
        let pair = RelativePosition::new(&offset, [2, 2], [&[0, 1], &[0, 1]], rough).unwrap();
        graph.add("offset", pair, &[x[k], x[other]]).unwrap();
    }
    for factor in factors {
        for port in 0..graph.ports(factor).count() {
            graph.set_edge_form(factor, port, GaussianForm { linearisation }).unwrap();
        }
    }
    let options = Options { max_iterations: 12, tolerance: 0.0, ..Options::default() };
    let mut engine = Engine::new(&graph, options).unwrap();
    engine.run(&mut Flooding).unwrap();
    let read = |x| {
        let moments = engine.belief(x).moments().unwrap();
        (DVector::from_vec(moments.mean), square(&moments.covariance, 2))
    };
    x.into_iter().map(read).collect()
}

#[test]
fn agents_move_with_their_world() {
    let world = Rigid { angle: 2.3, shift: Vector2::new(-40.0, 17.0) };
    let turn = DMatrix::from_column_slice(2, 2, world.rotation().as_slice());
    // Sigma points lie along the axes of a Cholesky factor, which do not turn with the world: only where the
    // residual is quadratic does the regression not notice.
    let (still, moved) = (agents(STILL, Linearisation::Jacobian), agents(world, Linearisation::Jacobian));
    for ((mean, covariance), (moved_mean, moved_covariance)) in still.iter().zip(&moved) {
        let expected = world.point([mean[0], mean[1]]);
        assert!((moved_mean - DVector::from_column_slice(&expected)).amax() < 1e-9);
        assert_close(moved_covariance, &(&turn * covariance * turn.transpose()), 1e-9, "covariance");
    }
}

/// Beliefs of two poses that see landmarks and each other.
fn poses(world: Rigid) -> Vec<(DVector<f64>, DMatrix<f64>)> {
    let mut draw = Draw::new(501);
    let mut graph = FactorGraph::<DynamicGaussian>::new();
    let truth = [[1.0, 2.0, 0.4], [7.0, 5.0, -2.0]];
    let landmarks = [[10.0, 0.0], [2.0, 9.0], [-4.0, -3.0]];
    let seen = |from: [f64; 3], to: [f64; 2]| {
        let (east, north) = (to[0] - from[0], to[1] - from[1]);
        [east.hypot(north), wrap_angle(north.atan2(east) - from[2])]
    };
    let noise = || Noise::diagonal(&[0.04, 0.01]).unwrap();
    let x: Vec<_> = truth.iter().map(|_| graph.unnamed_variable(Space::pose2())).collect();
    for (k, &pose) in truth.iter().enumerate() {
        let at = world.point([pose[0] + 0.3, pose[1] - 0.2]);
        let start = DVector::from_vec(vec![at[0], at[1], pose[2] + 0.1 + world.angle]);
        graph.set_start(x[k], moments_of(&start, &DMatrix::identity(3, 3))).unwrap();
        for landmark in landmarks {
            let [range, bearing] = seen(pose, landmark);
            let (range, bearing) = (range + 0.2 * draw.normal(), bearing + 0.1 * draw.normal());
            let factor = RangeBearing::to_anchor(range, bearing, world.point(landmark), noise()).unwrap();
            graph.add("landmark", factor, &[x[k]]).unwrap();
        }
    }
    let [range, bearing] = seen(truth[0], [truth[1][0], truth[1][1]]);
    let factor = RangeBearing::new(range + 0.1, bearing - 0.05, 3, noise()).unwrap();
    graph.add("each other", factor, &[x[0], x[1]]).unwrap();
    let fix = world.point([1.1, 2.1]);
    let fix = AnchorOffset::new(&fix, &[0.0, 0.0], 3, &[0, 1], Noise::isotropic(2, 0.5).unwrap()).unwrap();
    graph.add("fix", fix, &[x[0]]).unwrap();
    let options = Options { max_iterations: 12, tolerance: 0.0, ..Options::default() };
    let mut engine = Engine::new(&graph, options).unwrap();
    engine.run(&mut Flooding).unwrap();
    let read = |x| {
        let moments = engine.belief(x).moments().unwrap();
        (DVector::from_vec(moments.mean), square(&moments.covariance, 3))
    };
    x.into_iter().map(read).collect()
}

#[test]
fn poses_move_with_their_world() {
    let world = Rigid { angle: 2.0, shift: Vector2::new(60.0, -11.0) };
    let mut turn = Matrix3::identity();
    turn.fixed_view_mut::<2, 2>(0, 0).copy_from(&world.rotation());
    let turn = DMatrix::from_column_slice(3, 3, turn.as_slice());
    for ((mean, covariance), (moved_mean, moved_covariance)) in poses(STILL).iter().zip(&poses(world)) {
        let expected = world.point([mean[0], mean[1]]);
        assert!((moved_mean[0] - expected[0]).abs() < 1e-9 && (moved_mean[1] - expected[1]).abs() < 1e-9);
        assert!(wrap_angle(moved_mean[2] - mean[2] - world.angle).abs() < 1e-9);
        assert_close(moved_covariance, &(&turn * covariance * turn.transpose()), 1e-9, "covariance");
        assert!(rows(covariance)[0] > 0.0);
    }
}
