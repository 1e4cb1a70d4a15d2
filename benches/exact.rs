//! Joint solves on one core: pose graphs by Gauss-Newton from the file's values, alone and with every marginal covariance;
//! one of them again pose by pose; a grid of two-dimensional variables; a long chain. The peers' workloads W1, W2 and W3.
//!
//! Times include the analysis, linearisation, factorisation and steps; not reading the file or building the graph. Pose
//! graphs are read below SUMPROD_DATA (default ../shared/data) and left out, aloud, where they are absent.
//!
//! `cargo bench --bench exact [GRID_SIDE]`

#[path = "common.rs"]
mod common;

use common::Timing;
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;
use std::hint::black_box;
use std::path::PathBuf;
use sumprod::exact::read::{GraphFile, Measurement};
use sumprod::exact::{Incremental, Optimizer, Ordering, Problem, SolveOptions};
use sumprod::models::pose::Pose2;
use sumprod::prelude::*;

type Error = Box<dyn std::error::Error>;

fn main() -> Result<(), Error> {
    for name in [
        "pose_graphs_golden/M3500.g2o",
        "pose_graphs_golden/sphere2500.g2o",
        "pose_graphs/parking-garage.g2o",
    ] {
        pose_graph(name)?;
    }
    growing("pose_graphs_golden/M3500.g2o")?;
    for side in common::sizes(&[30, 100, 300]) {
        linear(&format!("grid of {side} x {side}, dimension 2"), &grid(side)?, Ordering::MinimumDegree)?;
    }
    linear("chain of 1000000, dimension 2", &chain(1_000_000)?, Ordering::Natural)
}

/// A recorded file, its first pose held; none, aloud, where it is absent.
fn read(name: &str) -> Result<Option<GraphFile>, Error> {
    let data =
        std::env::var_os("SUMPROD_DATA").map_or_else(|| PathBuf::from("../shared/data"), PathBuf::from);
    let root = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../..");
    let Some(path) = [data.join(name), root.join(&data).join(name)].into_iter().find(|path| path.exists())
    else {
        println!("{name}: skipped, not below {}", data.display());
        return Ok(None);
    };
    let mut file = GraphFile::read(&path)?;
    file.hold(0, 1e-3, 1e-3)?;
    Ok(Some(file))
}

fn pose_graph(name: &str) -> Result<(), Error> {
    let Some(file) = read(name)? else { return Ok(()) };
    let graph = file.graph(PoseResidual::Log)?;
    let problem = Problem::new(&graph)?;
    let start = file.values(&problem)?.ok_or("the file has no values")?;
    // The peers' tolerances.
    let options = SolveOptions {
        optimizer: Optimizer::GaussNewton,
        relative_tolerance: 1e-6,
        absolute_tolerance: 1e-6,
        ..SolveOptions::default()
    };
    let mut report = None;
    let solve = Timing::of(9, || -> Result<(), Error> {
        report = Some(problem.solve(start.clone(), &options)?.report());
        Ok(())
    })?;
    let all = Timing::of(5, || -> Result<(), Error> {
        black_box(problem.solve(start.clone(), &options)?.marginals()?);
        Ok(())
    })?;
    if let Some(report) = report {
        println!("{name}: cost {:.6} after {} steps", report.cost, report.iterations);
    }
    println!("  Gauss-Newton {solve}\n  with all marginal covariances {all}");
    Ok(())
}

/// Pose by pose as a robot would: an update after each, the values of new poses by odometry.
fn growing(name: &str) -> Result<(), Error> {
    let Some(file) = read(name)? else { return Ok(()) };
    let mut factors_of: Vec<Vec<usize>> = vec![Vec::new(); file.variables.len()];
    for (number, factor) in file.factors.iter().enumerate() {
        let last = factor.variables.iter().max().copied().ok_or("a factor without variables")?;
        factors_of[last].push(number);
    }
    let (mut eliminated, mut relinearised, mut cost) = (0, 0, 0.0);
    let all = Timing::of(3, || -> Result<(), Error> {
        let (mut graph, mut smoother) = (FactorGraph::new(), Incremental::default());
        let mut handles: Vec<VariableId> = Vec::new();
        let mut pose = Pose2 { x: 0.0, y: 0.0, heading: 0.0 };
        (eliminated, relinearised) = (0, 0);
        for (variable, factors) in file.variables.iter().zip(&factors_of) {
            handles.push(graph.variable(variable.name.clone(), variable.space.clone())?);
            for &factor in factors {
                let factor = &file.factors[factor];
                file.add_factor(&mut graph, factor, &handles, PoseResidual::Log)?;
                if let (Measurement::RelativePose(step), Some(last)) =
                    (&factor.measurement, handles.len().checked_sub(2))
                    && factor.variables[0] == last
                {
                    let from = smoother.value(handles[last])?;
                    pose = Pose2 { x: from[0], y: from[1], heading: from[2] }.compose(&Pose2 {
                        x: step[0],
                        y: step[1],
                        heading: step[2],
                    });
                }
            }
            let newest = handles[handles.len() - 1];
            let update = smoother.update(&graph, &[(newest, &[pose.x, pose.y, pose.heading])])?;
            eliminated += update.eliminated;
            relinearised += update.relinearised;
        }
        smoother.settle(&graph, 1e-6, 20)?;
        cost = Problem::new(&graph)?.cost(&smoother.values())?;
        Ok(())
    })?;
    let updates = file.variables.len();
    println!(
        "{name} pose by pose, {updates} updates: {all}\n  {eliminated} variables eliminated, {relinearised} relinearised, \
         cost {cost:.6}"
    );
    Ok(())
}

fn linear(name: &str, graph: &FactorGraph<DynamicGaussian>, ordering: Ordering) -> Result<(), Error> {
    let problem = Problem::new(graph)?;
    let options = SolveOptions { ordering, ..SolveOptions::default() };
    let repeats = if graph.variable_count() > 20_000 { 3 } else { 7 };
    let means = Timing::of(repeats, || -> Result<(), Error> {
        black_box(problem.solve(problem.start(), &options)?);
        Ok(())
    })?;
    let all = Timing::of(repeats, || -> Result<(), Error> {
        black_box(problem.solve(problem.start(), &options)?.marginals()?);
        Ok(())
    })?;
    println!("{name}\n  means {means}\n  means and all covariances {all}");
    Ok(())
}

fn noisy(random: &mut Xoshiro256PlusPlus, scale: f64) -> [f64; 2] {
    [(); 2].map(|()| {
        let z: f64 = StandardNormal.sample(random);
        scale * z
    })
}

/// A noise whose information has eigenvalues in this range.
fn noise(random: &mut Xoshiro256PlusPlus, low: f64, high: f64) -> Result<Noise, Error> {
    let information = common::information(random, low, high);
    let covariance = information.try_inverse().ok_or("a singular information")?;
    let (a, b, c) = (covariance[(0, 0)], 0.5 * (covariance[(0, 1)] + covariance[(1, 0)]), covariance[(1, 1)]);
    Ok(Noise::gaussian(&[a, b, b, c])?)
}

const UNIT: [f64; 4] = [1.0, 0.0, 0.0, 1.0];
const MINUS: [f64; 4] = [-1.0, 0.0, 0.0, -1.0];

/// Every variable observed, and a displacement along every edge of the grid.
fn grid(side: usize) -> Result<FactorGraph<DynamicGaussian>, Error> {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(7);
    let mut graph = FactorGraph::new();
    let variables: Vec<VariableId> =
        (0..side * side).map(|_| graph.unnamed_variable(Space::real(2))).collect();
    for &variable in &variables {
        let observed = noisy(&mut random, 4.0);
        graph.add(
            "",
            LinearGaussian::new(&[&UNIT], &observed, noise(&mut random, 0.05, 0.2)?)?,
            &[variable],
        )?;
    }
    for k in 0..side * side {
        let right = (k % side + 1 < side).then_some(k + 1);
        let below = (k + side < side * side).then_some(k + side);
        for other in right.into_iter().chain(below) {
            let step = noisy(&mut random, 1.0);
            let factor = LinearGaussian::new(&[&MINUS, &UNIT], &step, noise(&mut random, 0.5, 2.0)?)?;
            graph.add("", factor, &[variables[k], variables[other]])?;
        }
    }
    Ok(graph)
}

/// A walk, observed at every tenth step.
fn chain(length: usize) -> Result<FactorGraph<DynamicGaussian>, Error> {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(8);
    let mut graph = FactorGraph::new();
    let mut previous = None;
    for k in 0..length {
        let variable = graph.unnamed_variable(Space::real(2));
        if let Some(previous) = previous {
            let factor =
                LinearGaussian::new(&[&MINUS, &UNIT], &noisy(&mut random, 1.0), Noise::isotropic(2, 1.0)?)?;
            graph.add("", factor, &[previous, variable])?;
        }
        if k % 10 == 0 {
            let observed = [random.random::<f64>(), 0.0];
            graph.add(
                "",
                LinearGaussian::new(&[&UNIT], &observed, Noise::isotropic(2, 4.0)?)?,
                &[variable],
            )?;
        }
        previous = Some(variable);
    }
    Ok(graph)
}
