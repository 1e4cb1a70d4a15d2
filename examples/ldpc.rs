//! A low-density parity-check code, decoded up to the threshold of its messages.
//!
//! A regular code of column weight 3 and row weight 6 (rate one half) on the binary symmetric channel: as codes get long,
//! sum-product messages correct every error below a crossover probability of 0.084, and fail above (Richardson and Urbanke
//! 2001, "The capacity of low-density parity-check codes under message-passing decoding").
//!
//! `cargo run --release --example ldpc`

use rand::RngExt;
use sumprod::prelude::*;

type Error = Box<dyn std::error::Error>;

const BITS: usize = 9_600;
const COLUMN: usize = 3;
const ROW: usize = 6;

/// The bits of each check: sockets are joined at random, no check twice to the same bit.
fn checks(random: &mut impl RngExt) -> Vec<[usize; ROW]> {
    let mut sockets: Vec<usize> = (0..BITS * COLUMN).map(|socket| socket / COLUMN).collect();
    for at in (1..sockets.len()).rev() {
        sockets.swap(at, random.random_range(0..=at));
    }
    loop {
        let twice = (0..sockets.len()).find(|&at| sockets[at - at % ROW..at].contains(&sockets[at]));
        let Some(at) = twice else { break };
        let other = random.random_range(0..sockets.len());
        sockets.swap(at, other);
    }
    sockets.as_chunks::<ROW>().0.to_vec()
}

/// Bits that are wrong after decoding, of a code word sent through the channel.
fn decode(
    checks: &[[usize; ROW]],
    crossover: f64,
    random: &mut impl RngExt,
) -> Result<(usize, Report), Error> {
    let mut graph = FactorGraph::<LogOdds, Logical>::new();
    let certainty = ((1.0 - crossover) / crossover).ln();
    // The code is linear and the channel symmetric: the word of zeros stands for all.
    let mut bits = Vec::with_capacity(BITS);
    for _ in 0..BITS {
        let bit = graph.unnamed_variable(Space::finite(2));
        let flipped = random.random::<f64>() < crossover;
        graph.set_prior(bit, LogOdds(if flipped { certainty } else { -certainty }))?;
        bits.push(bit);
    }
    let parity = Logical::parity(ROW, false)?;
    for check in checks {
        graph.factor("check", parity.clone(), &check.map(|bit| bits[bit]))?;
    }
    let options = Options { max_iterations: 100, tolerance: 1e-3, ..Options::default() };
    let mut engine = Engine::new(&graph, options)?;
    let report = engine.run(&mut Flooding)?;
    Ok((bits.iter().filter(|&&bit| engine.belief(bit).most_likely() == 1).count(), report))
}

/// Decodes at crossover probabilities on both sides of the threshold.
pub fn main() -> Result<(), Error> {
    let mut random = Stream::new(3, 0, Purpose::World, 0).fast();
    let checks = checks(&mut random);
    println!("{BITS} bits, {} checks", checks.len());
    for (crossover, decodes) in [(0.06, Some(true)), (0.07, Some(true)), (0.084, None), (0.095, Some(false))]
    {
        let (wrong, report) = decode(&checks, crossover, &mut random)?;
        println!("crossover {crossover}: {wrong} bits wrong; {report}");
        if decodes.is_some_and(|decodes| decodes != (wrong == 0)) {
            return Err(format!("at {crossover}, with the threshold at 0.084, {wrong} bits are wrong").into());
        }
    }
    Ok(())
}
