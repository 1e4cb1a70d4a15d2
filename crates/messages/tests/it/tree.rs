//! Gaussian beliefs on trees and grids against the dense joint.

use crate::linear::{Linear, noise};
use nalgebra::{DMatrix, DVector, Matrix2, Vector2};
use proptest::prelude::*;
use sumprod_graph::schedule::{Flooding, ForwardBackward, Residual, Sequential};
use sumprod_graph::{Engine, Factor, FactorGraph, FactorId, Message, Options, Schedule, Space, VariableId};
use sumprod_messages::{DynamicGaussian, Gaussian};

type Edges = Vec<(Linear<2>, Vec<usize>)>;

fn build<M: Message>(count: usize, factors: &Edges) -> (FactorGraph<M, Linear<2>>, Vec<VariableId>)
where
    Linear<2>: Factor<M>,
{
    let mut graph = FactorGraph::new();
    let x: Vec<_> = (0..count).map(|_| graph.unnamed_variable(Space::real(2))).collect();
    for (factor, ports) in factors {
        let ports: Vec<_> = ports.iter().map(|&k| x[k]).collect();
        let _: FactorId = graph.factor("linear", factor.clone(), &ports).unwrap();
    }
    (graph, x)
}

/// Mean and covariance of the joint over all variables.
fn joint(count: usize, factors: &Edges) -> (DVector<f64>, DMatrix<f64>) {
    let (mut information, mut vector) = (DMatrix::zeros(2 * count, 2 * count), DVector::zeros(2 * count));
    for (factor, ports) in factors {
        for (i, &row) in ports.iter().enumerate() {
            for (j, &column) in ports.iter().enumerate() {
                let mut block = information.fixed_view_mut::<2, 2>(2 * row, 2 * column);
                block += factor.blocks[i][j];
            }
            let mut block = vector.fixed_rows_mut::<2>(2 * row);
            block += factor.vectors[i];
        }
    }
    let covariance = information.cholesky().unwrap().inverse();
    (&covariance * vector, covariance)
}

/// A factor between two variables with matrices and an offset made of `seed`.
fn random_pair(seed: u64) -> Linear<2> {
    let entry = |k| 1.5 * noise(seed, k);
    let a = Matrix2::new(-1.0 + entry(0), entry(1), entry(2), -1.0 + entry(3));
    let spread = Matrix2::new(1.0 + noise(seed, 4).abs(), 0.0, noise(seed, 5), 0.5 + noise(seed, 6).abs());
    let offset = Vector2::new(3.0 * entry(7), entry(8));
    Linear::pair([a, Matrix2::identity()], offset, spread * spread.transpose())
}

fn random_unary(seed: u64) -> Linear<2> {
    let row = Vector2::new(noise(seed, 9), noise(seed, 10));
    // Rank one: a single unary factor does not determine its variable.
    Linear::unary(row * row.transpose(), row * noise(seed, 11))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]
    #[test]
    fn random_trees_equal_the_joint(seed in any::<u64>(), anchors in prop::collection::vec(0usize..1000, 29)) {
        let count = 30;
        let mut factors: Edges = vec![(Linear::unary(Matrix2::identity(), Vector2::new(1.0, -2.0)), vec![0])];
        for (k, anchor) in anchors.iter().enumerate() {
            let ports = if k % 2 == 0 { vec![anchor % (k + 1), k + 1] } else { vec![k + 1, anchor % (k + 1)] };
            factors.push((random_pair(seed.wrapping_add(k as u64)), ports));
            factors.push((random_unary(seed.wrapping_add(1000 + k as u64)), vec![k + 1]));
        }
        let (mean, covariance) = joint(count, &factors);
        let scale = 1.0 + mean.amax().max(covariance.amax());
        let options = Options { tolerance: 1e-13, max_iterations: 200, ..Options::default() };
        let schedules: [&mut dyn Schedule; 3] =
            [&mut ForwardBackward::new(), &mut Flooding, &mut Residual::default()];
        for schedule in schedules {
            let (graph, x) = build::<Gaussian<2>>(count, &factors);
            let mut engine = Engine::new(&graph, options).unwrap();
            engine.run(schedule).unwrap();
            for (k, &variable) in x.iter().enumerate() {
                let (own_mean, own_covariance) = engine.belief(variable).moments().unwrap();
                let far = (own_mean - mean.fixed_rows::<2>(2 * k)).amax();
                let wide = (own_covariance - covariance.fixed_view::<2, 2>(2 * k, 2 * k)).amax();
                prop_assert!(far < 1e-9 * scale && wide < 1e-9 * scale, "variable {}: {} {}", k, far, wide);
            }
            let (graph, x) = build::<DynamicGaussian>(count, &factors);
            let mut engine = Engine::new(&graph, options).unwrap();
            engine.run(&mut ForwardBackward::new()).unwrap();
            for (k, &variable) in x.iter().enumerate() {
                let moments = engine.belief(variable).moments().unwrap();
                for i in 0..2 {
                    prop_assert!((moments.mean[i] - mean[2 * k + i]).abs() < 1e-9 * scale);
                    for j in 0..2 {
                        let exact = covariance[(2 * k + i, 2 * k + j)];
                        prop_assert!((moments.covariance_at(i, j) - exact).abs() < 1e-9 * scale);
                    }
                }
            }
        }
    }
}

#[test]
fn loopy_means_are_exact_and_schedules_agree() {
    let side = 6;
    let mut factors: Edges = Vec::new();
    for k in 0..side * side {
        let seed = 77 + k as u64;
        let value = Vector2::new(noise(seed, 0), noise(seed, 1));
        factors.push((Linear::unary(Matrix2::identity(), value), vec![k]));
        let step =
            Linear::pair([-Matrix2::identity(), Matrix2::identity()], value, Matrix2::identity() * 0.4);
        if k % side + 1 < side {
            factors.push((step.clone(), vec![k, k + 1]));
        }
        if k + side < side * side {
            factors.push((step, vec![k, k + side]));
        }
    }
    let (mean, covariance) = joint(side * side, &factors);
    let options = Options { tolerance: 1e-13, max_iterations: 1000, ..Options::default() };
    let (graph, x) = build::<Gaussian<2>>(side * side, &factors);
    let solve = |schedule: &mut dyn Schedule, damping| {
        let mut engine = Engine::new(&graph, Options { damping, ..options }).unwrap();
        assert!(engine.run(schedule).unwrap().converged());
        x.iter().map(|&variable| engine.belief(variable).moments().unwrap()).collect::<Vec<_>>()
    };
    let reference = solve(&mut Flooding, 0.0);
    for (k, (own, variance)) in reference.iter().enumerate() {
        // Weiss and Freeman (2001): the means of a convergent run are exact; these variances are too small.
        assert!((own - mean.fixed_rows::<2>(2 * k)).amax() < 1e-9);
        assert!(variance[(0, 0)] < covariance[(2 * k, 2 * k)]);
    }
    let others = [
        solve(&mut Sequential::default(), 0.0),
        solve(&mut Residual::default(), 0.0),
        solve(&mut Flooding, 0.3),
        solve(&mut Residual::default(), 0.3),
    ];
    for other in others {
        for (a, b) in other.iter().zip(&reference) {
            assert!((a.0 - b.0).amax() < 1e-9 && (a.1 - b.1).amax() < 1e-9);
        }
    }
}
