//! The search: sub-swarms that move as their life states say, and write what they find on the board.

use std::ops::Range;

use rand::RngExt;
use sumprod_graph::FastStream;
use sumprod_messages::{Evaluator, Mixture};

use super::knowledge::{Board, LifeState};
use super::proposal::{Components, draw, exponentials};
use super::settings::BoardSettings;
use crate::error::OptimizerError;
use crate::trigger::effective_sample_size;

/// Writes the log fitness of each row of standard coordinates.
pub(super) type Fitness<'a> = dyn FnMut(&[f64], &mut [f64]) -> Result<(), OptimizerError> + 'a;

pub(super) struct Swarms {
    /// Row by row, sub-swarm by sub-swarm, in standard coordinates.
    pub positions: Vec<f64>,
    pub fitness: Vec<f64>,
    pub board: Board,
    pub lives: [u64; 3],
    velocities: Vec<f64>,
    ranges: Vec<Range<usize>>,
}

impl Swarms {
    pub fn new(positions: Vec<f64>, ranges: &[Range<usize>]) -> Self {
        let count = ranges.last().map_or(0, |range| range.end);
        let dimension = positions.len() / count.max(1);
        Self {
            velocities: vec![0.0; positions.len()],
            fitness: vec![0.0; count],
            board: Board::newborn(ranges.len(), dimension),
            lives: [0; 3],
            ranges: ranges.to_vec(),
            positions,
        }
    }

    fn dimension(&self) -> usize {
        self.board.global.best_state.len()
    }

    /// Searches until the fitness is even enough or the iterations are used up. The fitness of the present
    /// positions has been written.
    pub fn search(
        &mut self,
        settings: &BoardSettings,
        prior: &Mixture,
        fitness: &mut Fitness<'_>,
        random: &mut FastStream,
    ) -> Result<(), OptimizerError> {
        self.write_board(settings, &vec![true; self.ranges.len()], true);
        for _ in 0..settings.iterations {
            let even = effective_sample_size(&exponentials(&self.fitness));
            if even >= settings.enough * self.fitness.len() as f64 {
                break;
            }
            let mut reborn = vec![false; self.ranges.len()];
            for (swarm, reborn) in reborn.iter_mut().enumerate() {
                let life = self.board.local[swarm].life;
                self.lives[life as usize] += 1;
                match life {
                    LifeState::Growing => self.fly(swarm, settings, false, random),
                    LifeState::PseudoMature => self.fly(swarm, settings, true, random),
                    LifeState::Mature => {
                        *reborn = true;
                        self.begin_again(swarm, prior, random)?;
                    }
                }
            }
            fitness(&self.positions, &mut self.fitness)?;
            self.write_board(settings, &reborn, false);
        }
        Ok(())
    }

    /// (6), or with `together` (7).
    fn fly(&mut self, swarm: usize, settings: &BoardSettings, together: bool, random: &mut FastStream) {
        let d = self.dimension();
        for particle in self.ranges[swarm].clone() {
            let own = &self.board.local[swarm].best_state;
            let other =
                together.then(|| self.board.draw(random)).map(|other| &self.board.local[other].best_state);
            for k in 0..d {
                let (x, v) = (&mut self.positions[particle * d + k], &mut self.velocities[particle * d + k]);
                *v = settings.inertia * *v + settings.own_pull * random.random::<f64>() * (own[k] - *x);
                if let Some(other) = other {
                    *v += settings.other_pull * random.random::<f64>() * (other[k] - *x);
                }
                *x += *v;
            }
        }
    }

    fn begin_again(
        &mut self,
        swarm: usize,
        prior: &Mixture,
        random: &mut FastStream,
    ) -> Result<(), OptimizerError> {
        let (range, d) = (self.ranges[swarm].clone(), self.dimension());
        let places = range.start * d..range.end * d;
        self.velocities[places.clone()].fill(0.0);
        self.positions[places].copy_from_slice(&draw(prior, range.len(), random)?);
        Ok(())
    }

    fn write_board(&mut self, settings: &BoardSettings, reborn: &[bool], first: bool) {
        let d = self.dimension();
        let fitness = exponentials(&self.fitness);
        for ((range, knowledge), &reborn) in self.ranges.iter().zip(&mut self.board.local).zip(reborn) {
            let best = range.clone().max_by(|&a, &b| self.fitness[a].total_cmp(&self.fitness[b]));
            if let Some(best) = best {
                knowledge.improve(&self.positions[best * d..(best + 1) * d], self.fitness[best], reborn);
            }
            knowledge.weight = fitness[range.clone()].iter().sum::<f64>() / range.len() as f64;
            knowledge.diversity = diversity(&self.positions[range.start * d..range.end * d], d);
            knowledge.judge(settings.ability_threshold, settings.diversity_threshold);
        }
        let local = &self.board.local;
        let best = local.iter().max_by(|a, b| a.best_fitness.total_cmp(&b.best_fitness));
        let global = &mut self.board.global;
        if let Some(best) = best {
            global.improve(&best.best_state, best.best_fitness, first);
        }
        let bests: Vec<f64> = local.iter().flat_map(|knowledge| &knowledge.best_state).copied().collect();
        global.weight = local.iter().map(|knowledge| knowledge.weight).sum::<f64>() / local.len() as f64;
        global.diversity = diversity(&bests, d);
        global.judge(settings.ability_threshold, settings.diversity_threshold);
    }

    /// The Gaussians of the moved particles, each weighed by its fitness over a Gaussian of twice its sub-swarm's
    /// width: importance sampling from where the search left them.
    pub fn corrected(&self) -> Result<Components, OptimizerError> {
        let d = self.dimension();
        let mut logs = vec![0.0; self.fitness.len()];
        for range in &self.ranges {
            let members = &self.positions[range.start * d..range.end * d];
            let all = 0..range.len();
            let own = Components::weighted(members, &vec![0.0; range.len()], std::slice::from_ref(&all), d);
            let logs = &mut logs[range.clone()];
            Evaluator::new(&own.widened(4.0).mixture()?).log_densities(members, logs)?;
            for (log, fitness) in logs.iter_mut().zip(&self.fitness[range.clone()]) {
                *log = fitness - *log - (range.len() as f64).ln();
            }
        }
        Ok(Components::weighted(&self.positions, &logs, &self.ranges, d))
    }
}

/// Mean distance from the mean.
fn diversity(points: &[f64], dimension: usize) -> f64 {
    let rows = || points.chunks_exact(dimension);
    let count = rows().len() as f64;
    let mut mean = vec![0.0; dimension];
    for row in rows() {
        mean.iter_mut().zip(row).for_each(|(mean, x)| *mean += x / count);
    }
    let distance = |row: &[f64]| row.iter().zip(&mean).map(|(x, m)| (x - m).powi(2)).sum::<f64>().sqrt();
    rows().map(distance).sum::<f64>() / count
}
