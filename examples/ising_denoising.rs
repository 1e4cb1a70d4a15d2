//! A black and white image from a noisy one: an Ising model, its marginals by messages, and what the noise would leave.
//!
//! `cargo run --release --example ising_denoising`

use sumprod::exact::discrete_log_evidence;
use sumprod::prelude::*;

type Error = Box<dyn std::error::Error>;

const SIDE: usize = 64;
/// The share of pixels that are turned over.
const NOISE: f64 = 0.15;

/// A disc, a bar and the letter T.
fn image() -> Vec<bool> {
    let black = |row: usize, column: usize| {
        let (y, x) = (row as f64 - 18.0, column as f64 - 18.0);
        let disc = y * y + x * x < 150.0;
        let bar = (44..52).contains(&row) && (6..40).contains(&column);
        let letter = (10..16).contains(&row) && (38..60).contains(&column)
            || (10..40).contains(&row) && (46..52).contains(&column);
        disc || bar || letter
    };
    (0..SIDE * SIDE).map(|place| black(place / SIDE, place % SIDE)).collect()
}

fn wrong(found: &[bool], truth: &[bool]) -> usize {
    found.iter().zip(truth).filter(|(a, b)| a != b).count()
}

/// Denoises by sums, which give each pixel's probability, and by maxima, which give one image.
pub fn main() -> Result<(), Error> {
    let truth = image();
    let mut random = Stream::new(1, 0, Purpose::World, 0).fast();
    let turned = |p: &bool| p ^ (rand::RngExt::random::<f64>(&mut random) < NOISE);
    let seen: Vec<bool> = truth.iter().map(turned).collect();

    let mut graph = FactorGraph::<LogOdds, PairOdds>::new();
    let evidence = ((1.0 - NOISE) / NOISE).ln();
    let mut pixels = Vec::with_capacity(seen.len());
    for &black in &seen {
        let pixel = graph.unnamed_variable(Space::finite(2));
        graph.set_prior(pixel, LogOdds(if black { evidence } else { -evidence }))?;
        pixels.push(pixel);
    }
    let alike = PairOdds::ising(0.55)?;
    for here in 0..SIDE * SIDE {
        if here % SIDE + 1 < SIDE {
            graph.factor("alike", alike, &[pixels[here], pixels[here + 1]])?;
        }
        if here + SIDE < SIDE * SIDE {
            graph.factor("alike", alike, &[pixels[here], pixels[here + SIDE]])?;
        }
    }

    for form in [CategoricalForm::sum_product(), CategoricalForm::max_product()] {
        let options = Options { max_iterations: 200, damping: 0.3, tolerance: 1e-6, ..Options::default() };
        let mut engine = Engine::new(&graph, options)?;
        let edges: Vec<EdgeId> = engine.topology().edges().collect();
        for edge in edges {
            engine.set_edge_form(edge, form)?;
        }
        let report = engine.run(&mut Flooding)?;
        let black: Vec<bool> = pixels.iter().map(|&pixel| engine.belief(pixel).most_likely() == 1).collect();
        let (before, after) = (wrong(&seen, &truth), wrong(&black, &truth));
        println!("temperature {}: {before} pixels wrong before, {after} after; {report}", form.temperature);
        if form.temperature == 1.0 {
            println!("log evidence (Bethe) {:.3}", discrete_log_evidence(&engine)?);
        }
        if 4 * after > before {
            return Err(format!("{after} of {before} wrong pixels are left").into());
        }
    }
    Ok(())
}
