//! What is written on the board: a five-tuple of each sub-swarm, and one of the whole.

use sumprod_graph::FastStream;

use rand::RngExt;

/// What a sub-swarm is at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LifeState {
    /// Its best state still improves.
    Growing,
    /// It stagnates while spread.
    PseudoMature,
    /// It has converged.
    Mature,
}

/// The five-tuple.
#[derive(Clone, Debug, PartialEq)]
pub struct Knowledge {
    /// Mean distance from the mean (of the particles in a sub-swarm; of the sub-swarms' best states in the whole),
    /// in standard deviations of the prior's cloud.
    pub diversity: f64,
    /// By how much the best log fitness rose in the last iteration; infinite when life begins.
    pub ability: f64,
    /// The life state.
    pub life: LifeState,
    /// The best state met in this life.
    pub best_state: Vec<f64>,
    /// Its log fitness.
    pub best_fitness: f64,
    /// Mean fitness over the largest fitness of all particles.
    pub weight: f64,
}

/// The knowledge of all sub-swarms.
#[derive(Clone, Debug, PartialEq)]
pub struct Board {
    /// Of each sub-swarm.
    pub local: Vec<Knowledge>,
    /// Of the whole.
    pub global: Knowledge,
}

impl Knowledge {
    /// Of a sub-swarm at the beginning of its life.
    pub(super) fn newborn(dimension: usize) -> Self {
        Self {
            diversity: 0.0,
            ability: f64::INFINITY,
            life: LifeState::Growing,
            best_state: vec![0.0; dimension],
            best_fitness: f64::NEG_INFINITY,
            weight: 0.0,
        }
    }

    /// Compares the best of now with the best so far; `first` is the first look at this life.
    pub(super) fn improve(&mut self, state: &[f64], fitness: f64, first: bool) {
        let rise = if fitness > self.best_fitness { fitness - self.best_fitness } else { 0.0 };
        self.ability = if first { f64::INFINITY } else { rise };
        if first || fitness > self.best_fitness {
            self.best_state.copy_from_slice(state);
            self.best_fitness = fitness;
        }
    }

    /// The life state that ability and diversity amount to.
    pub(super) fn judge(&mut self, ability_threshold: f64, diversity_threshold: f64) {
        self.life = if self.ability > ability_threshold {
            LifeState::Growing
        } else if self.diversity > diversity_threshold {
            LifeState::PseudoMature
        } else {
            LifeState::Mature
        };
    }
}

impl Board {
    pub(super) fn newborn(sub_swarms: usize, dimension: usize) -> Self {
        Self { local: vec![Knowledge::newborn(dimension); sub_swarms], global: Knowledge::newborn(dimension) }
    }

    /// A sub-swarm drawn by the weights on the board.
    pub(super) fn draw(&self, random: &mut FastStream) -> usize {
        let total: f64 = self.local.iter().map(|knowledge| knowledge.weight).sum();
        let mut left = total * random.random::<f64>();
        for (index, knowledge) in self.local.iter().enumerate() {
            left -= knowledge.weight;
            if left < 0.0 {
                return index;
            }
        }
        self.local.len() - 1
    }
}
