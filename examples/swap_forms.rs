//! One graph, its range edges held in turn as Gaussians, particles and mixtures: what each costs in error and time.
//!
//! A point with a weak prior hears two anchors. The truth has two places, mirror images in the anchors' line, of which
//! the prior prefers one; a grid says how much. A Gaussian linearised at the prior's mean finds one of them.

use std::time::Instant;
use sumprod::prelude::*;

const ANCHORS: [([f64; 2], f64); 2] = [([0.0, 0.0], 25.0), ([30.0, 0.0], 20.0)];
const PRIOR: ([f64; 2], f64) = ([10.0, 2.0], 100.0);

/// Mean, and mass above the anchors' line, of the exact posterior.
fn grid() -> ([f64; 2], f64) {
    let (mut total, mut mean, mut above) = (0.0, [0.0; 2], 0.0);
    for k in 0..1_000_000 {
        let x = [-20.0 + 0.07 * f64::from(k % 1000), -35.0 + 0.07 * (f64::from(k / 1000) + 0.5)];
        let away = (x[0] - PRIOR.0[0]).powi(2) + (x[1] - PRIOR.0[1]).powi(2);
        let miss = |(anchor, z): ([f64; 2], f64)| ((x[0] - anchor[0]).hypot(x[1] - anchor[1]) - z).powi(2);
        let weight = (-0.5 * (away / PRIOR.1 + ANCHORS.into_iter().map(miss).sum::<f64>())).exp();
        total += weight;
        mean = [mean[0] + weight * x[0], mean[1] + weight * x[1]];
        above += if x[1] > 0.0 { weight } else { 0.0 };
    }
    (mean.map(|sum| sum / total), above / total)
}

/// The belief with the two edges in these forms.
fn solve(forms: [AnyForm; 2]) -> Result<AnyMessage, Box<dyn std::error::Error>> {
    let plane = Space::real(2);
    let mut graph = FactorGraph::<AnyMessage>::new();
    let x = graph.variable("x", plane.clone())?;
    graph.set_prior(x, AnyMessage::gaussian(&plane, &PRIOR.0, &[PRIOR.1, 0.0, 0.0, PRIOR.1])?)?;
    for ((anchor, z), form) in ANCHORS.into_iter().zip(forms) {
        let range = AnchorRange::new(z, anchor, 2, [0, 1], Noise::isotropic(1, 1.0)?)?;
        let range = graph.add("range", range, &[x])?;
        graph.set_edge_form(range, 0, form)?;
    }
    let mut engine = Engine::new(&graph, Options { seed: 1, max_iterations: 10, ..Options::default() })?;
    engine.run(&mut Flooding)?;
    Ok(engine.belief(x).clone())
}

/// Prints one line per choice of forms; an error where the mixture is no better than it should be.
pub fn main() -> Result<(), Box<dyn std::error::Error>> {
    let (mean, above) = grid();
    println!("exact: mean ({:.2}, {:.2}) m, {:.1} % above", mean[0], mean[1], 100.0 * above);
    let (gaussian, particles, mixture) =
        (AnyForm::gaussian(), AnyForm::particles(2000), AnyForm::mixture(60));
    let mut of_mixtures = f64::INFINITY;
    for forms in [[gaussian; 2], [gaussian, mixture], [particles; 2], [particles, mixture], [mixture; 2]] {
        let start = Instant::now();
        let belief = solve(forms)?;
        let milliseconds = 1e3 * start.elapsed().as_secs_f64();
        let found = belief.moments()?.mean;
        let error = (found[0] - mean[0]).hypot(found[1] - mean[1]);
        let quality = belief.quality();
        let loss = quality.conversion_loss.map_or("none".into(), |nats| format!("{nats:.3} nats"));
        let names = forms.map(|form| form.name());
        println!("{names:?}: error {error:.2} m, {milliseconds:.1} ms, conversions cost {loss}");
        of_mixtures = if forms == [mixture; 2] { error } else { of_mixtures };
    }
    (of_mixtures < 0.5).then_some(()).ok_or("mixtures are far from the grid".into())
}
