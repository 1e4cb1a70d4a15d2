//! The auxiliary particle filter: ancestors are chosen by how well the measurement suits where each would go.
//!
//! With μᵢ = f(xᵢ), ancestors are chosen by wᵢ p(z | μᵢ), move with fresh noise, and are weighed by
//! p(z | x') / p(z | μ). Source: Pitt and Shephard, "Filtering via simulation: auxiliary particle filters" (1999).

use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use sumprod_graph::{Purpose, Stream};
use sumprod_models::cloud::{BLOCK, Cloud, Likelihood, Mover, Residuals, Source, select};
use sumprod_models::{Motion, ProcessNoise};

use super::ParticleFilter;
use super::filter::Outcome;
use crate::{Correction, FilterError};

/// Where each particle of the last step would go without noise, until a measurement has chosen among them.
pub(super) struct Ahead {
    centres: Cloud,
    /// One for all, or one a particle.
    noise: Vec<ProcessNoise>,
}

impl ParticleFilter {
    /// Chooses ancestors by the first measurement after each prediction (auxiliary particle filter), instead of by
    /// their weights alone. Where measurements are sharp against the process noise this may choose badly: the
    /// effective sample size tells.
    #[must_use]
    pub fn looking_ahead(mut self) -> Self {
        self.looks_ahead = true;
        self
    }

    /// Remembers where the particles would go; called before they do.
    pub(super) fn remember<M: Motion>(&mut self, motion: &M) {
        let mut centres = Cloud::new(self.cloud.dimension(), self.len());
        let mover = Mover::new(motion, &self.coordinates);
        let (cloud, count) = (&self.cloud, self.len());
        let size = BLOCK * cloud.dimension();
        for (block, to) in centres.values_mut().chunks_mut(size).enumerate() {
            let own = (count - block * BLOCK).min(BLOCK);
            mover.centres(own, Source { cloud, first: block * BLOCK, ancestors: None }, to);
            mover.wrap(own, to);
        }
        let mut point = vec![0.0; cloud.dimension()];
        let noise = match motion.constant_noise() {
            Some(noise) => vec![noise.clone()],
            None => (0..count)
                .map(|particle| {
                    cloud.read(particle, &mut point);
                    motion.noise(&point)
                })
                .collect(),
        };
        self.ahead = Some(Ahead { centres, noise });
    }

    /// Corrects by looking ahead from the last step.
    pub(super) fn choose_and_weigh<L: Likelihood>(
        &mut self,
        ahead: &Ahead,
        likelihood: &L,
    ) -> Result<Outcome, FilterError> {
        let (count, d) = (self.len(), self.cloud.dimension());
        let predicted = std::mem::replace(&mut self.cloud, ahead.centres.clone());
        let before = self.weights.clone();
        let first = match self.weigh(likelihood) {
            Ok(Outcome::Weighed(correction)) => correction,
            other => {
                (self.cloud, self.weights) = (predicted, before);
                return other;
            }
        };
        let mut random = Stream::new(self.seed, self.step, Purpose::Optimizer, 0).fast();
        self.scratch.chosen.resize(count, 0);
        select(self.weights.selection(), random.random(), false, &mut self.scratch.chosen);
        let mut logs = vec![0.0; count];
        let mut z = Vec::new();
        for (particle, &ancestor) in self.scratch.chosen.iter().enumerate() {
            let noise = &ahead.noise[(ancestor as usize).min(ahead.noise.len() - 1)];
            z.clear();
            z.extend((0..noise.sources()).map(|_| -> f64 { StandardNormal.sample(&mut random) }));
            for k in 0..d {
                let row = &noise.factor()[k * noise.sources()..][..noise.sources()];
                let centre = ahead.centres.at(ancestor as usize, k);
                self.cloud.set(particle, k, centre);
                self.scratch.cloud.set(
                    particle,
                    k,
                    centre + row.iter().zip(&z).map(|(b, z)| b * z).sum::<f64>(),
                );
            }
        }
        // What the ancestors were chosen by is taken out again.
        let mut residuals = Residuals::new();
        for (block, logs) in self.cloud.blocks().zip(logs.chunks_mut(BLOCK)) {
            likelihood.add_log(block, logs, &mut residuals);
        }
        logs.iter_mut().for_each(|log| *log = -*log);
        self.wrap_scratch();
        std::mem::swap(&mut self.cloud, &mut self.scratch.cloud);
        self.weights.become_logs(&logs);
        let base = self.weights.log_total() - (count as f64).ln();
        match self.weigh(likelihood) {
            Ok(Outcome::Weighed(second)) => {
                let log_likelihood = first.log_likelihood + second.log_likelihood + base;
                Ok(Outcome::Weighed(Correction { log_likelihood, ..first }))
            }
            other => {
                (self.cloud, self.weights) = (predicted, before);
                other
            }
        }
    }
}
