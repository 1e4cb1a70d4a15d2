//! Gaussian belief propagation in a network of moving agents: time per slice, which should grow linearly.
//!
//! The density of the built-in scenario `coop-c100`, two rounds a slice, through the same filter that the scenario
//! runs.
//!
//! `cargo bench --bench network [AGENTS]`

#[path = "common.rs"]
mod common;

use common::Timing;
use sumprod::positioning::cooperation::{NetworkFilter, Plan, World};
use sumprod::prelude::*;

const SLICES: u32 = 6;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    for agents in common::sizes(&[100, 1_000, 10_000]) {
        let world = World::at_density(agents, SLICES);
        let draw = world.draw(1, 0)?;
        let ranges: usize = draw.slices.iter().map(|slice| slice.ranges.len()).sum();
        let mut filter = NetworkFilter::new(&world, &draw, Plan::default(), Options::default())?;
        let mut slices = draw.slices.iter();
        let timing =
            Timing::of(SLICES as usize, || slices.next().map_or(Ok(()), |slice| filter.step(slice)))?;
        println!(
            "network of {agents}: {:.4} s a slice, {:.2} us an agent, {} ranges a slice (median of {timing})",
            timing.median(),
            timing.median() / agents as f64 * 1e6,
            ranges / SLICES as usize,
        );
    }
    Ok(())
}
