//! Messages over finitely many states on one core: the peers' workload W7, and a restricted Boltzmann machine.
//!
//! A message is one directed message of a pairwise factor; a pass sends them all. Graphs are built before the clock starts.
//!
//! `cargo bench --bench discrete [SIDE OF THE ISING GRID]`

#[path = "common.rs"]
mod common;

use common::Timing;
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use std::sync::Arc;
use sumprod::models::discrete::{PairOdds, Table};
use sumprod::prelude::*;

type Error = Box<dyn std::error::Error>;

fn main() -> Result<(), Error> {
    for side in common::sizes(&[100, 300]) {
        ising(side)?;
    }
    denoising(true)?;
    denoising(false)?;
    boltzmann()
}

/// Pairs of a square grid, by row.
fn pairs(side: usize) -> impl Iterator<Item = [usize; 2]> {
    (0..side * side).flat_map(move |here| {
        let right = (here % side + 1 < side).then_some([here, here + 1]);
        let down = (here + side < side * side).then_some([here, here + side]);
        right.into_iter().chain(down)
    })
}

/// Times passes of a graph that is already warm.
fn passes<M: Message, F: Factor<M>>(
    what: &str,
    graph: &FactorGraph<M, F>,
    options: Options,
    messages: usize,
) -> Result<(), Error> {
    let options = Options { parallel: false, tolerance: 0.0, ..options };
    let passes = options.max_iterations;
    let mut engine = Engine::new(graph, options)?;
    engine.run(&mut Flooding)?;
    let timing = Timing::of_thread(9, || engine.run(&mut Flooding).map(|_| ()))?;
    let rate = |seconds: f64| (messages * passes) as f64 / seconds / 1e6;
    println!(
        "{what}: {messages} messages a pass, {:.4} M messages/s, at best {:.4} (median of {timing} for {passes} passes)",
        rate(timing.median()),
        rate(timing.least())
    );
    Ok(())
}

fn ising(side: usize) -> Result<(), Error> {
    let mut random = Stream::new(5, 0, Purpose::World, 0).fast();
    let mut graph = FactorGraph::<LogOdds, PairOdds>::new();
    let mut normal = || -> f64 { StandardNormal.sample(&mut random) };
    let mut spins = Vec::with_capacity(side * side);
    for _ in 0..side * side {
        let spin = graph.unnamed_variable(Space::finite(2));
        // A field h of spins -1 and 1.
        graph.set_prior(spin, LogOdds(2.0 * 0.5 * normal()))?;
        spins.push(spin);
    }
    let pair = PairOdds::ising(0.3)?;
    for ends in pairs(side) {
        graph.factor("", pair, &ends.map(|end| spins[end]))?;
    }
    let options = Options { max_iterations: 50, ..Options::default() };
    passes(&format!("ising {side} x {side}"), &graph, options, graph.edge_count())
}

/// A chequered image in noise, 50 grey levels, jumps that cost the same from eight levels on.
fn denoising(shared: bool) -> Result<(), Error> {
    const SIDE: usize = 50;
    const LEVELS: usize = 50;
    let mut random = Stream::new(5, 0, Purpose::World, 0).fast();
    let mut graph = FactorGraph::<Categorical>::new();
    let mut pixels = Vec::with_capacity(SIDE * SIDE);
    for place in 0..SIDE * SIDE {
        let noise: f64 = StandardNormal.sample(&mut random);
        let bright = ((place / SIDE + place % SIDE) / 12) % 2;
        let seen = 10.0 + 30.0 * bright as f64 + 6.0 * noise;
        let logs: Vec<f64> = (0..LEVELS).map(|k| -0.5 * ((seen - k as f64) / 6.0).powi(2)).collect();
        let pixel = graph.unnamed_variable(Space::finite(LEVELS));
        graph.set_prior(pixel, Categorical::new(&logs)?)?;
        pixels.push(pixel);
    }
    let table = || {
        let log = |k: usize| -0.3 * ((k / LEVELS).abs_diff(k % LEVELS) as f64).min(8.0);
        Table::from_logs(&[LEVELS; 2], (0..LEVELS * LEVELS).map(log).collect())
    };
    let one = Arc::new(table()?);
    for ends in pairs(SIDE) {
        let own = if shared { one.clone() } else { Arc::new(table()?) };
        graph.factor("", Box::new(own), &ends.map(|end| pixels[end]))?;
    }
    let what = if shared { "one table" } else { "a table each" };
    let options = Options { max_iterations: 5, ..Options::default() };
    passes(&format!("denoising 50 x 50, 50 states, {what}"), &graph, options, graph.edge_count())
}

fn boltzmann() -> Result<(), Error> {
    const UNITS: usize = 100;
    let mut random = Stream::new(5, 0, Purpose::World, 0).fast();
    let mut graph = FactorGraph::<LogOdds, PairOdds>::new();
    let mut units = Vec::with_capacity(2 * UNITS);
    for _ in 0..2 * UNITS {
        let unit = graph.unnamed_variable(Space::finite(2));
        graph.set_prior(unit, LogOdds(random.random_range(-1.0..1.0)))?;
        units.push(unit);
    }
    for visible in 0..UNITS {
        for hidden in 0..UNITS {
            let weight: f64 = StandardNormal.sample(&mut random);
            let factor = graph.factor(
                "",
                PairOdds::new([0.0; 2], weight)?,
                &[units[visible], units[UNITS + hidden]],
            )?;
            for port in 0..2 {
                graph.set_edge_form(factor, port, CategoricalForm::max_product())?;
            }
        }
    }
    let options =
        Options { parallel: false, tolerance: 0.0, max_iterations: 200, damping: 0.5, ..Options::default() };
    // From the compiled graph to the last pass: what a user waits for.
    let timing = Timing::of_thread(9, || Engine::new(&graph, options)?.run(&mut Flooding).map(|_| ()))?;
    println!(
        "RBM 100 + 100, 200 max-product passes, damping 0.5: {:.2} ms, at best {:.2} ms (of {timing})",
        timing.median() * 1e3,
        timing.least() * 1e3
    );
    Ok(())
}
