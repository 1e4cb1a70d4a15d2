//! Forward-backward smoothing of a constant-velocity chain, held against the dense joint of all its states.
//!
//! The acceleration is held over each step, so the process noise has rank one per axis; nothing inverts it.

use sumprod::messages::Cholesky;
use sumprod::prelude::*;

const STEPS: usize = 50;

/// Prints the largest difference of a mean and of a covariance from the dense joint's.
pub fn main() -> Result<(), Box<dyn std::error::Error>> {
    let space = Space::real(4);
    let (start, variances, fix_variance) = ([0.0, 1.0, 0.0, -0.5], [100.0, 1.0, 100.0, 1.0], 4.0);
    let motion = ConstantVelocity::held_acceleration(2, 1.0, 0.1)?;
    let fixes: Vec<f64> = (0..2 * STEPS).map(|k| (k / 2 % 2) as f64 + 0.1 * (7 * k % 23) as f64).collect();

    let mut graph = FactorGraph::<DynamicGaussian>::new();
    let mut states = Vec::new();
    for (step, fix) in fixes.chunks(2).enumerate() {
        let state = graph.variable(format!("state {step}"), space.clone())?;
        match states.last() {
            Some(&last) => graph.add_motion("motion", motion.clone(), last, state)?,
            None => {
                graph.add("prior", Prior::new(&space, &start, Noise::diagonal(&variances)?)?, &[state])?
            }
        };
        let noise = Noise::isotropic(2, fix_variance)?;
        graph.add("fix", AnchorOffset::new(fix, &[0.0, 0.0], 4, &[0, 2], noise)?, &[state])?;
        states.push(state);
    }
    let mut engine = Engine::new(&graph, Options::default())?;
    println!("{}", engine.run(&mut ForwardBackward::new())?);

    // Before any fix: mean and covariance of all states, column by column through the motion.
    let n = 4 * STEPS;
    let (mut mean, mut prior) = (start.to_vec(), vec![vec![0.0; n]; n]);
    (0..4).for_each(|k| prior[k][k] = variances[k]);
    let process = motion.noise(&start).covariance();
    let mut next = [0.0; 4];
    for last in (0..n - 4).step_by(4) {
        motion.step(&mean[last..], &mut next);
        mean.extend(next);
        for column in 0..last + 8 {
            motion.step(&[0, 1, 2, 3].map(|k| prior[last + k][column]), &mut next);
            for row in 0..4 {
                let noise = if column < last + 4 { 0.0 } else { process[4 * row + column - last - 4] };
                prior[last + 4 + row][column] = next[row] + noise;
                prior[column][last + 4 + row] = next[row] + noise;
            }
        }
    }
    // All fixes at once.
    let seen: Vec<usize> = (0..2 * STEPS).map(|k| 2 * k).collect();
    let fixed = |a: usize, b: usize| prior[a][b] + if a == b { fix_variance } else { 0.0 };
    let spread: Vec<f64> = seen.iter().flat_map(|&a| seen.iter().map(move |&b| fixed(a, b))).collect();
    let factor = Cholesky::new(&spread, seen.len(), "the covariance of the fixes")?;
    let gain = |row: usize| {
        let mut gain: Vec<f64> = seen.iter().map(|&k| prior[row][k]).collect();
        factor.solve(&mut gain);
        gain
    };
    let (mut of_means, mut of_covariances) = (0f64, 0f64);
    for (step, &state) in states.iter().enumerate() {
        let smoothed = engine.belief(state).moments()?;
        for row in 0..4 {
            let gain = gain(4 * step + row);
            let dot = |f: &dyn Fn(usize) -> f64| (0..seen.len()).map(|k| gain[k] * f(k)).sum::<f64>();
            let exact = mean[4 * step + row] + dot(&|k| fixes[k] - mean[seen[k]]);
            of_means = of_means.max((smoothed.mean[row] - exact).abs());
            for column in 0..4 {
                let prior_entry = prior[4 * step + row][4 * step + column];
                let exact = prior_entry - dot(&|k| prior[seen[k]][4 * step + column]);
                of_covariances = of_covariances.max((smoothed.covariance_at(row, column) - exact).abs());
            }
        }
    }
    println!("largest difference of a mean {of_means:.1e}, of a covariance {of_covariances:.1e}");
    (of_means.max(of_covariances) < 1e-9).then_some(()).ok_or("the answers differ".into())
}
