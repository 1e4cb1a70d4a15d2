//! A hidden Markov model: the occasionally dishonest casino. Smoothing, the most probable path, and the evidence, by messages
//! on a chain and by a junction tree.
//!
//! `cargo run --release --example hidden_markov`

use rand::RngExt;
use std::sync::Arc;
use sumprod::exact::{JunctionOptions, JunctionTree, discrete_log_evidence};
use sumprod::prelude::*;

type Error = Box<dyn std::error::Error>;

const ROLLS: usize = 300;
const STAY: [f64; 2] = [0.95, 0.9];
/// Six comes up with one half of the loaded die.
const FACES: [[f64; 6]; 2] = [[1.0 / 6.0; 6], [0.1, 0.1, 0.1, 0.1, 0.1, 0.5]];

/// Simulates, then finds when the die was loaded.
pub fn main() -> Result<(), Error> {
    let mut random = Stream::new(2, 0, Purpose::World, 0).fast();
    let (mut loaded, mut truth, mut rolls) = (0, Vec::new(), Vec::new());
    for _ in 0..ROLLS {
        if random.random::<f64>() > STAY[loaded] {
            loaded = 1 - loaded;
        }
        let (mut left, mut face) = (random.random::<f64>(), 0);
        while face < 5 && left >= FACES[loaded][face] {
            left -= FACES[loaded][face];
            face += 1;
        }
        truth.push(loaded);
        rolls.push(face);
    }

    let change = vec![STAY[0], 1.0 - STAY[0], 1.0 - STAY[1], STAY[1]];
    let change = Arc::new(Table::new(&[2, 2], change)?);
    let mut graph = FactorGraph::<Categorical>::new();
    let mut dice = Vec::with_capacity(ROLLS);
    for (time, &face) in rolls.iter().enumerate() {
        let die = graph.variable(format!("die {time}"), Space::finite(2))?;
        graph.factor("roll", Box::new(Table::new(&[2], FACES.map(|faces| faces[face]).to_vec())?), &[die])?;
        match dice.last() {
            Some(&before) => graph.factor("change", Box::new(change.clone()), &[before, die])?,
            None => {
                graph.factor("start", Box::new(Table::new(&[2], vec![STAY[0], 1.0 - STAY[0]])?), &[die])?
            }
        };
        dice.push(die);
    }

    let mut sums = Engine::new(&graph, Options::default())?;
    sums.run(&mut ForwardBackward::new())?;
    let smoothed: Vec<f64> = dice.iter().map(|&die| sums.belief(die).probabilities()[1]).collect();
    let evidence = discrete_log_evidence(&sums)?;

    let mut maxima = Engine::new(&graph, Options::default())?;
    let edges: Vec<EdgeId> = maxima.topology().edges().collect();
    for edge in edges {
        maxima.set_edge_form(edge, CategoricalForm::max_product())?;
    }
    maxima.run(&mut ForwardBackward::new())?;
    let path: Vec<usize> = dice.iter().map(|&die| maxima.belief(die).most_likely()).collect();

    let tree = JunctionTree::new(&graph, JunctionOptions::default())?;
    let (exact, most) = (tree.solve()?, tree.most_probable()?);
    let right =
        |found: &dyn Fn(usize) -> usize| (0..ROLLS).filter(|&time| found(time) == truth[time]).count();
    println!("log evidence {evidence:.6}, exact {:.6}", exact.log_evidence);
    println!(
        "of {ROLLS} rolls the smoother tells {} dice right, the most probable path {}",
        right(&|time| usize::from(smoothed[time] > 0.5)),
        right(&|time| path[time])
    );
    let largest =
        smoothed.iter().zip(&exact.marginals).map(|(p, exact)| (p - exact[1]).abs()).fold(0.0, f64::max);
    if largest > 1e-12 || (evidence - exact.log_evidence).abs() > 1e-10 || path != most.states {
        return Err(format!("messages on a chain are exact, but differ by {largest:.1e}").into());
    }
    Ok(())
}
