//! Sparse answers against dense algebra, and robust solves against what they should ignore.

use crate::support::assert_close;
use nalgebra::{DMatrix, DVector};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use sumprod_exact::{
    Kernel, Optimizer, Ordering, Problem, SolveOptions, Solver, Values, bethe_log_evidence, compare,
};
use sumprod_graph::schedule::ForwardBackward;
use sumprod_graph::{Engine, FactorGraph, Options, Space, VariableId};
use sumprod_messages::DynamicGaussian;
use sumprod_models::library::{AnchorRange, LinearGaussian, PosePrior, RelativePose};
use sumprod_models::pose::Pose2;
use sumprod_models::{AddModel, Motion, Noise, ProcessNoise, Real};

/// A random linear graph: dimensions, and factors as (variables, entries).
#[derive(Clone, Debug)]
struct Random {
    dimensions: Vec<usize>,
    factors: Vec<(Vec<usize>, Vec<f64>)>,
}

fn random() -> impl Strategy<Value = Random> {
    prop::collection::vec(1usize..5, 1..12).prop_flat_map(|dimensions| {
        let count = dimensions.len();
        let factor = (prop::collection::vec(0..count, 1..4), prop::collection::vec(-1.0f64..1.0, 64));
        prop::collection::vec(factor, 0..25)
            .prop_map(move |factors| Random { dimensions: dimensions.clone(), factors })
    })
}

impl Random {
    /// The graph, every variable with a prior, and the dense information, vector and evidence offset.
    fn graph(&self) -> (FactorGraph<DynamicGaussian>, Vec<VariableId>, DMatrix<f64>, DVector<f64>, f64) {
        let mut graph = FactorGraph::new();
        let handles: Vec<_> =
            self.dimensions.iter().map(|&d| graph.unnamed_variable(Space::real(d))).collect();
        let starts: Vec<usize> = self
            .dimensions
            .iter()
            .scan(0, |sum, d| {
                *sum += d;
                Some(*sum - d)
            })
            .collect();
        let n: usize = self.dimensions.iter().sum();
        let (mut information, mut vector, mut offset) = (DMatrix::zeros(n, n), DVector::zeros(n), 0.0);
        let mut add = |wide: DMatrix<f64>, target: DVector<f64>, variance: f64| {
            let m = target.len() as f64;
            information += wide.transpose() * &wide / variance;
            vector += wide.transpose() * &target / variance;
            offset -= 0.5 * (target.norm_squared() / variance + m * (std::f64::consts::TAU * variance).ln());
        };
        for (k, (&handle, &d)) in handles.iter().zip(&self.dimensions).enumerate() {
            let unit = DMatrix::<f64>::identity(d, d);
            let target = DVector::from_element(d, 0.3 * k as f64);
            let factor =
                LinearGaussian::new(&[unit.as_slice()], target.as_slice(), Noise::isotropic(d, 2.0).unwrap());
            graph.add("prior", factor.unwrap(), &[handle]).unwrap();
            let mut wide = DMatrix::zeros(d, n);
            wide.view_mut((0, starts[k]), (d, d)).copy_from(&unit);
            add(wide, target, 2.0);
        }
        for (variables, entries) in &self.factors {
            let mut entries = entries.iter().copied().cycle();
            let mut wide = DMatrix::zeros(2, n);
            let mut matrices = Vec::new();
            for &variable in variables {
                let d = self.dimensions[variable];
                let matrix: Vec<f64> = entries.by_ref().take(2 * d).collect();
                let mut own = wide.view_mut((0, starts[variable]), (2, d));
                own += DMatrix::from_row_slice(2, d, &matrix);
                matrices.push(matrix);
            }
            let slices: Vec<&[f64]> = matrices.iter().map(Vec::as_slice).collect();
            let target = DVector::from_row_slice(&[entries.next().unwrap(), 1.0]);
            let ports: Vec<_> = variables.iter().map(|&v| handles[v]).collect();
            let factor =
                LinearGaussian::new(&slices, target.as_slice(), Noise::isotropic(2, 0.5).unwrap()).unwrap();
            graph.add("factor", factor, &ports).unwrap();
            add(wide, target, 0.5);
        }
        (graph, handles, information, vector, offset)
    }
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 150, rng_seed: RngSeed::Fixed(3), failure_persistence: None, ..ProptestConfig::default()
    })]

    /// Factors may touch a variable twice, and variables may have any size.
    #[test]
    fn linear_graphs_equal_dense_algebra(random in random()) {
        let (graph, handles, information, vector, offset) = random.graph();
        let factor = information.clone().cholesky().unwrap();
        let (mean, covariance) = (factor.solve(&vector), factor.inverse());
        let log_determinant: f64 = 2.0 * factor.l().diagonal().iter().map(|x| x.ln()).sum::<f64>();
        let n = mean.len() as f64;
        let evidence = offset + 0.5 * (vector.dot(&mean) + n * std::f64::consts::TAU.ln() - log_determinant);
        let problem = Problem::new(&graph).unwrap();
        for ordering in [Ordering::MinimumDegree, Ordering::Natural] {
            let options = SolveOptions { ordering, ..SolveOptions::default() };
            let mut solution = problem.solve(problem.start(), &options).unwrap();
            prop_assert!((solution.log_evidence().unwrap() - evidence).abs() < 1e-9 * (1.0 + evidence.abs()));
            let marginals = solution.marginals().unwrap();
            let mut start = 0;
            for (&handle, &d) in handles.iter().zip(&random.dimensions) {
                let own = covariance.view((start, start), (d, d)).transpose();
                assert_close(marginals.covariance(handle), own.as_slice(), 1e-10, "covariance");
                for (a, b) in solution.values().get(handle).iter().zip(mean.rows(start, d).iter()) {
                    prop_assert!((a - b).abs() < 1e-10);
                }
                start += d;
            }
            let joint = solution.joint(&handles).unwrap();
            assert_close(&joint.covariance, covariance.transpose().as_slice(), 1e-10, "joint covariance");
        }
    }
}

/// A loop of poses with one relative pose that is far out.
fn ring(outlier: f64) -> FactorGraph<DynamicGaussian> {
    let mut graph = FactorGraph::new();
    let poses: Vec<_> = (0..12).map(|k| graph.variable(format!("x{k}"), Space::Se2).unwrap()).collect();
    let noise = || Noise::diagonal(&[0.01, 0.01, 1e-3]).unwrap();
    graph.add("anchor", PosePrior::new([0.0; 3], noise()).unwrap(), &poses[..1]).unwrap();
    let turn = std::f64::consts::TAU / 12.0;
    for k in 0..12 {
        let step = RelativePose::new([1.0, 0.0, turn], noise()).unwrap();
        graph.add("step", step, &[poses[k], poses[(k + 1) % 12]]).unwrap();
    }
    let wrong = RelativePose::new([outlier, 0.0, 0.0], noise()).unwrap();
    graph.add("step", wrong, &[poses[0], poses[6]]).unwrap();
    graph
}

fn ring_start(problem: &Problem<'_>) -> Values {
    let mut start = problem.start();
    let turn = std::f64::consts::TAU / 12.0;
    let (mut pose, step) = (Pose2 { x: 0.0, y: 0.0, heading: 0.0 }, Pose2 { x: 1.0, y: 0.0, heading: turn });
    for &variable in problem.variables() {
        start.set(variable, &[pose.x + 0.05, pose.y - 0.03, pose.heading + 0.02]).unwrap();
        pose = pose.compose(&step);
    }
    start
}

#[test]
fn optimizers_agree_and_kernels_ignore_outliers() {
    let graph = ring(9.0);
    let position = |kernel: Kernel, optimizer| {
        let mut problem = Problem::new(&graph).unwrap();
        problem.set_kernel("step", kernel);
        let options = SolveOptions { optimizer, ..SolveOptions::default() };
        let solution = problem.solve(ring_start(&problem), &options).unwrap();
        let value = solution.values().at(6);
        (value[0].hypot(value[1]), solution.report().cost)
    };
    let across = 1.0 / (std::f64::consts::PI / 12.0).sin();
    for kernel in [Kernel::GemanMcclure(3.0), Kernel::Tukey(6.0)] {
        let (robust, _) = position(kernel, Optimizer::LevenbergMarquardt);
        assert!((robust - across).abs() < 0.05, "{kernel:?}: {robust} expected {across}");
    }
    let (squares, cost) = position(Kernel::None, Optimizer::LevenbergMarquardt);
    assert!((squares - across).abs() > 0.3, "{squares}");
    for optimizer in [Optimizer::GaussNewton, Optimizer::Dogleg] {
        let (other, other_cost) = position(Kernel::None, optimizer);
        assert!((other - squares).abs() < 1e-6 && (other_cost - cost).abs() < 1e-8 * cost, "{optimizer:?}");
    }
}

#[test]
fn the_structure_is_kept_between_solves() {
    let graph = ring(3.0);
    let problem = Problem::new(&graph).unwrap();
    let solver = Solver::new(&problem, Ordering::MinimumDegree).unwrap();
    let options = SolveOptions::default();
    let mut start = problem.start();
    for (k, &variable) in problem.variables().iter().enumerate() {
        start.set(variable, &[k as f64, 0.0, 0.5 * k as f64]).unwrap();
    }
    let once = solver.solve(&problem, start, &options).unwrap();
    let again = solver.solve(&problem, once.values().clone(), &options).unwrap();
    assert!((once.report().cost - again.report().cost).abs() < 1e-9 * (1.0 + once.report().cost));
    let other = ring(4.0);
    let mut bigger = other;
    bigger.unnamed_variable(Space::real(1));
    let foreign = Problem::new(&bigger).unwrap();
    assert!(solver.solve(&foreign, foreign.start(), &options).is_err());
}

#[test]
fn a_tree_has_its_exact_evidence_by_messages() {
    let mut graph = FactorGraph::<DynamicGaussian>::new();
    let points: Vec<_> = (0..5).map(|k| graph.variable(format!("p{k}"), Space::real(2)).unwrap()).collect();
    let unit = [1.0, 0.0, 0.0, 1.0];
    let noise = || Noise::gaussian(&[0.5, 0.1, 0.1, 0.8]).unwrap();
    graph.add("prior", LinearGaussian::new(&[&unit], &[1.0, 2.0], noise()).unwrap(), &points[..1]).unwrap();
    for (from, to) in [(0, 1), (1, 2), (1, 3), (3, 4)] {
        let minus = unit.map(|x| -0.9 * x);
        let step = LinearGaussian::new(&[&minus, &unit], &[0.3, -0.2], noise()).unwrap();
        graph.add("step", step, &[points[from], points[to]]).unwrap();
    }
    graph.add("fix", LinearGaussian::new(&[&unit], &[2.0, 0.0], noise()).unwrap(), &[points[4]]).unwrap();
    let problem = Problem::new(&graph).unwrap();
    let values = problem.start();
    let linear = problem.linear_graph(&values).unwrap();
    let mut engine = Engine::new(&linear, Options::default()).unwrap();
    engine.run(&mut ForwardBackward::new()).unwrap();
    let bethe = bethe_log_evidence(&problem, &values, &engine).unwrap();
    let exact = problem.solve(values, &SolveOptions::default()).unwrap().log_evidence().unwrap();
    assert!((bethe - exact).abs() < 1e-10, "{bethe} {exact}");
}

#[test]
fn pinned_priors_are_evidence() {
    let mut graph = FactorGraph::<DynamicGaussian>::new();
    let x = graph.variable("x", Space::real(2)).unwrap();
    graph.set_prior(x, DynamicGaussian::from_moments(&[3.0, 0.5], &[4.0, 1.0, 1.0, 2.0]).unwrap()).unwrap();
    let range = AnchorRange::new(5.0, [0.0, 0.0], 2, [0, 1], Noise::isotropic(1, 0.1).unwrap()).unwrap();
    graph.add("range", range, &[x]).unwrap();
    let problem = Problem::new(&graph).unwrap();
    assert_eq!(problem.factor_count(), 2);
    let solution = problem.solve(problem.start(), &SolveOptions::default()).unwrap();
    let value = solution.values().get(x);
    assert!((value[0].hypot(value[1]) - 5.0).abs() < 0.1, "{value:?}");
}

#[test]
fn methods_stand_side_by_side() {
    let mut graph = FactorGraph::<DynamicGaussian>::new();
    let points: Vec<_> = (0..6).map(|k| graph.variable(format!("p{k}"), Space::real(1)).unwrap()).collect();
    let noise = || Noise::isotropic(1, 0.5).unwrap();
    graph.add("prior", LinearGaussian::new(&[&[1.0]], &[2.0], noise()).unwrap(), &points[..1]).unwrap();
    for k in 0..6 {
        let step = LinearGaussian::new(&[&[-1.0], &[1.0]], &[0.3 * k as f64 - 0.7], noise()).unwrap();
        graph.add("step", step, &[points[k], points[(k + 1) % 6]]).unwrap();
    }
    let problem = Problem::new(&graph).unwrap();
    let table = compare(&problem, &problem.start(), 2000).unwrap();
    let methods: Vec<&str> = table.0.iter().map(|row| row.method).collect();
    assert_eq!(methods, ["joint", "gaussian-bp", "gaussian-bp damped"]);
    for row in &table.0[1..] {
        let deviation = row.deviation.unwrap_or_else(|| panic!("{table}"));
        assert!(deviation.mean_sd < 1e-6, "{table}");
        assert!(deviation.covariance_relative > Some(0.01), "{table}");
    }
    assert_eq!(table.to_string().lines().count(), 4);
}

/// Position and velocity, pushed by one source: two coordinates of noise of rank one.
struct Pushed;

impl Motion for Pushed {
    fn dimension(&self) -> usize {
        2
    }

    fn step<T: Real>(&self, state: &[T], next: &mut [T]) {
        next[0] = state[0] + state[1] * 0.5;
        next[1] = state[1];
    }

    fn noise(&self, _state: &[f64]) -> ProcessNoise {
        ProcessNoise::driven(&[0.125, 0.5], &[0.8]).unwrap()
    }
}

#[test]
fn process_noise_of_lower_rank_is_held() {
    const STEPS: usize = 30;
    let mut graph = FactorGraph::<DynamicGaussian>::new();
    let states: Vec<VariableId> = (0..STEPS).map(|_| graph.unnamed_variable(Space::real(2))).collect();
    let unit: &[f64] = &[1.0, 0.0, 0.0, 1.0];
    let prior = LinearGaussian::new(&[unit], &[1.0, -0.5], Noise::isotropic(2, 2.0).unwrap()).unwrap();
    graph.add("prior", prior, &states[..1]).unwrap();
    for pair in states.windows(2) {
        graph.add_motion("motion", Pushed, pair[0], pair[1]).unwrap();
    }
    let observed = |k: usize| (0.7 * k as f64).sin() + 0.1 * k as f64;
    for (k, state) in states.iter().enumerate() {
        let noise = Noise::isotropic(1, 0.3).unwrap();
        let seen = LinearGaussian::new(&[&[1.0, 0.0]], &[observed(k)], noise).unwrap();
        graph.add("seen", seen, &[*state]).unwrap();
    }
    // The joint prior of all states, conditioned on what is seen.
    let n = 2 * STEPS;
    let step = DMatrix::from_row_slice(2, 2, &[1.0, 0.5, 0.0, 1.0]);
    let push = DVector::from_column_slice(&[0.125, 0.5]) * 0.8f64.sqrt();
    let (mut mean, mut root) = (DVector::zeros(n), DMatrix::zeros(n, 2 + STEPS));
    mean.rows_mut(0, 2).copy_from_slice(&[1.0, -0.5]);
    root.view_mut((0, 0), (2, 2)).copy_from(&(DMatrix::identity(2, 2) * 2f64.sqrt()));
    for k in 1..STEPS {
        let next = &step * mean.rows(2 * k - 2, 2);
        mean.rows_mut(2 * k, 2).copy_from(&next);
        let next = &step * root.rows(2 * k - 2, 2);
        root.rows_mut(2 * k, 2).copy_from(&next);
        root.view_mut((2 * k, k + 1), (2, 1)).copy_from(&push);
    }
    let covariance = &root * root.transpose();
    let seen = DMatrix::from_fn(STEPS, n, |row, column| f64::from(u8::from(column == 2 * row)));
    let innovation = DVector::from_fn(STEPS, |k, _| observed(k) - mean[2 * k]);
    let spread = &seen * &covariance * seen.transpose() + DMatrix::identity(STEPS, STEPS) * 0.3;
    let factor = spread.clone().cholesky().unwrap();
    let gain = &covariance * seen.transpose() * factor.inverse();
    let (mean, covariance) = (mean + &gain * &innovation, &covariance - &gain * &seen * &covariance);
    let log_evidence = -0.5
        * (innovation.dot(&factor.solve(&innovation))
            + factor.determinant().ln()
            + STEPS as f64 * std::f64::consts::TAU.ln());

    let problem = Problem::new(&graph).unwrap();
    let mut solution = problem.solve(problem.start(), &SolveOptions::default()).unwrap();
    let marginals = solution.marginals().unwrap();
    for (k, &state) in states.iter().enumerate() {
        assert_close(solution.values().get(state), mean.rows(2 * k, 2).as_slice(), 1e-6, "mean");
        let expected = covariance.view((2 * k, 2 * k), (2, 2)).into_owned();
        assert_close(marginals.covariance(state), expected.as_slice(), 1e-6, "covariance");
    }
    let found = solution.log_evidence().unwrap();
    assert!((found - log_evidence).abs() < 1e-5, "{found} expected {log_evidence}");
}

/// A coordinate that nothing moves.
struct Still;

impl Motion for Still {
    fn dimension(&self) -> usize {
        1
    }

    fn step<T: Real>(&self, state: &[T], next: &mut [T]) {
        next[0] = state[0];
    }

    fn noise(&self, _state: &[f64]) -> ProcessNoise {
        ProcessNoise::from_factor(1, &[])
    }
}

#[test]
fn an_exact_coordinate_is_refused_by_its_number() {
    let mut graph = FactorGraph::<DynamicGaussian>::new();
    let states: Vec<VariableId> = (0..2).map(|_| graph.unnamed_variable(Space::real(1))).collect();
    graph.add_motion("still", Still, states[0], states[1]).unwrap();
    let problem = Problem::new(&graph).unwrap();
    let Err(error) = problem.solve(problem.start(), &SolveOptions::default()) else { panic!("solved") };
    let said = error.to_string();
    assert!(
        said.contains("coordinate 0 of the state exact") && said.contains("variable of its own"),
        "{said}"
    );
}
