//! A pose graph solved jointly: a square driven twice, its loops closed, with every covariance; and what is said when
//! nothing ties it to the world.
//!
//! `cargo run --release --example pose_graph`

use std::f64::consts::FRAC_PI_2;
use sumprod::exact::{ExactError, Problem, SolveOptions};
use sumprod::models::pose::Pose2;
use sumprod::prelude::*;

type Error = Box<dyn std::error::Error>;

const CORNERS: usize = 8;

/// A square's corners, driven twice; the second lap sees the first.
fn square() -> Result<(FactorGraph<DynamicGaussian>, Vec<VariableId>), Error> {
    let mut graph = FactorGraph::new();
    let poses: Vec<VariableId> =
        (0..CORNERS).map(|k| graph.variable(format!("corner {k}"), Space::Se2)).collect::<Result<_, _>>()?;
    let odometry = Noise::diagonal(&[0.04, 0.04, 0.01])?;
    for pair in poses.windows(2) {
        // The wheels slip: half a degree too much at every corner.
        let step = RelativePose::new([10.0, 0.0, FRAC_PI_2 + 0.01], odometry.clone())?;
        graph.add("odometry", step, pair)?;
    }
    let seen = Noise::diagonal(&[0.01, 0.01, 0.001])?;
    for k in 0..CORNERS - 4 {
        let same = RelativePose::new([0.0, 0.0, 0.0], seen.clone())?;
        graph.add("seen again", same, &[poses[k], poses[k + 4]])?;
    }
    Ok((graph, poses))
}

/// Solves the graph as it stands, which fails with a reason, and with an anchor.
pub fn main() -> Result<(), Error> {
    let (mut graph, poses) = square()?;
    let problem = Problem::new(&graph)?;
    match problem.solve(problem.start(), &SolveOptions::default()) {
        Err(ExactError::Unobservable(free)) => println!("as it stands, {}", free[0]),
        _ => return Err("a graph without an anchor was solved".into()),
    }

    let held = PosePrior::new([0.0; 3], Noise::isotropic(3, 1e-6)?)?;
    graph.add("anchor", held, &poses[..1])?;
    let problem = Problem::new(&graph)?;
    let mut start = problem.start();
    let mut pose = Pose2 { x: 0.0, y: 0.0, heading: 0.0 };
    for &variable in &poses {
        start.set(variable, &[pose.x, pose.y, pose.heading])?;
        pose = pose.compose(&Pose2 { x: 10.0, y: 0.0, heading: FRAC_PI_2 });
    }
    let mut solution = problem.solve(start, &SolveOptions::default())?;
    let report = solution.report();
    println!(
        "cost {:.4} after {} steps, log evidence {:.3}",
        report.cost,
        report.iterations,
        solution.log_evidence()?
    );
    let marginals = solution.marginals()?;
    for &variable in &poses {
        let (value, covariance) = (solution.values().get(variable), marginals.covariance(variable));
        let sd: Vec<f64> = [0, 4, 8].iter().map(|&k| covariance[k].sqrt()).collect();
        println!("{}: {value:.3?} sd {sd:.3?}", graph.variable_name(variable));
    }
    // The second lap is tied to the first, so that uncertainty does not grow from lap to lap.
    let (early, late) = (marginals.covariance(poses[3])[0], marginals.covariance(poses[7])[0]);
    let together = solution.joint(&[poses[3], poses[7]])?;
    let correlation = together.covariance_at(0, 3) / (early * late).sqrt();
    println!("corners 3 and 7 correlate by {correlation:.3} along their own x");
    if late > 2.0 * early || correlation < 0.5 { Err("the loops did not close".into()) } else { Ok(()) }
}
