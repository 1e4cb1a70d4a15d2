//! A hybrid graph: a drifting position that sometimes jumps, and a switch per step that says whether it did. Messages with all
//! branches are the enumeration of them; with few, the loss is told.
//!
//! `cargo run --release --example switching`

use std::f64::consts::TAU;
use sumprod::models::Switch;
use sumprod::prelude::*;

type Error = Box<dyn std::error::Error>;

/// A step of x' = 0.9 x + noise, whose variance the switch chooses.
#[derive(Clone, Copy)]
struct Drift {
    variance: f64,
}

const DECAY: f64 = 0.9;
const VARIANCES: [f64; 2] = [0.04, 9.0];
const JUMPS: f64 = 0.2;
const SENSOR: f64 = 0.5;
const SEEN: [f64; 7] = [0.1, -0.2, 3.4, 3.1, 2.7, -1.9, -1.6];

impl Motion for Drift {
    fn dimension(&self) -> usize {
        1
    }

    fn step<T: Real>(&self, state: &[T], next: &mut [T]) {
        next[0] = state[0] * T::from(DECAY);
    }

    fn noise(&self, _state: &[f64]) -> ProcessNoise {
        ProcessNoise::from_factor(1, &[self.variance.sqrt()])
    }
}

/// Probability of a jump at each step, and means of all states.
struct Answer {
    jumps: Vec<f64>,
    means: Vec<f64>,
}

/// Every sequence of switches, each a Kalman filter and smoother.
fn enumerate() -> Answer {
    let steps = SEEN.len() - 1;
    let mut all = Vec::new();
    for sequence in 0..1_usize << steps {
        let (mut mean, mut variance, mut log) = (0.0, 1.0, 0.0);
        let mut filtered = Vec::new();
        for (time, seen) in SEEN.iter().enumerate() {
            let predicted = (mean, variance);
            let innovation = variance + SENSOR;
            log -= 0.5 * ((seen - mean) * (seen - mean) / innovation + (TAU * innovation).ln());
            mean += variance / innovation * (seen - mean);
            variance *= SENSOR / innovation;
            filtered.push((predicted, (mean, variance)));
            if time < steps {
                let jump = sequence >> time & 1;
                log += [1.0 - JUMPS, JUMPS][jump].ln();
                (mean, variance) = (DECAY * mean, DECAY * DECAY * variance + VARIANCES[jump]);
            }
        }
        let mut means = vec![mean];
        for time in (0..steps).rev() {
            let (_, (own, spread)) = filtered[time];
            let ((ahead, uncertain), _) = filtered[time + 1];
            let later = means[means.len() - 1];
            means.push(own + DECAY * spread / uncertain * (later - ahead));
        }
        means.reverse();
        all.push((sequence, log, means));
    }
    let largest = all.iter().map(|(_, log, _)| *log).fold(f64::NEG_INFINITY, f64::max);
    let total: f64 = all.iter().map(|(_, log, _)| (log - largest).exp()).sum();
    let mut answer = Answer { jumps: vec![0.0; steps], means: vec![0.0; SEEN.len()] };
    for (sequence, log, means) in all {
        let weight = (log - largest).exp() / total;
        for (time, jump) in answer.jumps.iter_mut().enumerate() {
            *jump += weight * (sequence >> time & 1) as f64;
        }
        answer.means.iter_mut().zip(means).for_each(|(sum, mean)| *sum += weight * mean);
    }
    answer
}

/// The same by messages that hold this many branches, and the largest loss that a belief tells (nats).
fn messages(branches: usize) -> Result<(Answer, f64), Error> {
    let mut graph = FactorGraph::<AnyMessage>::new();
    let line = Space::real(1);
    let (mut states, mut switches) = (Vec::new(), Vec::new());
    let mixture = AnyForm::Mixture(MixtureForm::new(branches).with_product(ProductChoice::Exact));
    for (time, &seen) in SEEN.iter().enumerate() {
        let state = graph.variable(format!("state {time}"), line.clone())?;
        let sensor =
            graph.add("sensor", Prior::new(&line, &[seen], Noise::isotropic(1, SENSOR)?)?, &[state])?;
        graph.set_edge_form(sensor, 0, mixture)?;
        match states.last() {
            None => {
                graph.add("start", Prior::new(&line, &[0.0], Noise::isotropic(1, 1.0)?)?, &[state])?;
            }
            Some(&before) => {
                let switch = graph.variable(format!("switch {time}"), Space::finite(2))?;
                graph.factor("jumps", Box::new(Table::new(&[2], vec![1.0 - JUMPS, JUMPS])?), &[switch])?;
                let motions = VARIANCES.map(|variance| Drift { variance }).to_vec();
                let step = graph.factor("step", Box::new(Switch::new(motions)?), &[switch, before, state])?;
                graph.set_edge_form(step, 1, mixture)?;
                graph.set_edge_form(step, 2, mixture)?;
                switches.push(switch);
            }
        }
        states.push(state);
    }
    let mut engine = Engine::new(&graph, Options::default())?;
    engine.run(&mut ForwardBackward::new())?;
    let jumps = switches.iter().filter_map(|&switch| engine.belief(switch).categorical());
    let jumps = jumps.map(|belief| belief.probabilities()[1]).collect();
    let mut means = Vec::new();
    let mut loss: f64 = 0.0;
    for &state in &states {
        means.push(engine.belief(state).moments()?.mean[0]);
        loss = loss.max(engine.belief(state).quality().conversion_loss.unwrap_or(0.0));
    }
    let edges: Vec<EdgeId> = engine.topology().edges().collect();
    for edge in edges {
        loss = loss.max(engine.edge_quality(edge).conversion_loss.unwrap_or(0.0));
    }
    Ok((Answer { jumps, means }, loss))
}

/// The largest difference of a probability or mean.
fn difference(a: &Answer, b: &Answer) -> f64 {
    let all = a.jumps.iter().zip(&b.jumps).chain(a.means.iter().zip(&b.means));
    all.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// Runs with all branches and with few. Even all are not exact: what is one Gaussian to within 1e-3 nats becomes one, which
/// moves a probability by up to √(1e-3 / 2) (Pinsker).
pub fn main() -> Result<(), Error> {
    let exact = enumerate();
    println!("probability of a jump, by enumeration: {:.3?}", exact.jumps);
    for (branches, most) in [(4096, 0.022), (8, 0.05), (2, 0.5)] {
        let (answer, loss) = messages(branches)?;
        let off = difference(&answer, &exact);
        println!(
            "{branches} branches: {:.3?}, off by {off:.1e}, told a loss of {loss:.1e} nats",
            answer.jumps
        );
        if off > most {
            return Err(format!("with {branches} branches the answer is off by {off}").into());
        }
    }
    Ok(())
}
