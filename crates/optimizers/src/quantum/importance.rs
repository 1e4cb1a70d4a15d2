//! The quantum genetic algorithm with the probability of each measured string in its weight.

use sumprod_graph::FastStream;
use sumprod_messages::Particles;

use super::literal::Strings;
use super::{Coding, Decoding, Reference, Register, Rotation};
use crate::Systematic;
use crate::error::OptimizerError;
use crate::moves::{Move, Moved, Validity, weights_of};
use crate::reselection::Reselection;
use crate::target::Target;
use crate::trigger::effective_sample_size;

/// Every generation's strings, decoded by the kernel, with weights ℓ(x) Π ½ / q(bit); the pool of all generations is
/// reselected to the prior's number.
///
/// A generation's register depends on earlier generations alone, so that each weight is right given the past and the
/// evidence has no bias whatever the gate does. Keeping only the best would break this. Likelihoods a particle: the
/// generations. The effective sample size is the pool's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct QuantumImportance {
    /// How often the register is measured; at least once.
    pub generations: usize,
    /// Bits a coordinate.
    pub coding: Coding,
    /// The gate.
    pub rotation: Rotation,
}

impl Default for QuantumImportance {
    fn default() -> Self {
        Self { generations: 5, coding: Coding::default(), rotation: Rotation::default() }
    }
}

impl Move for QuantumImportance {
    fn advance(&self, target: &mut Target<'_>, random: &mut FastStream) -> Result<Moved, OptimizerError> {
        let (prior, d) = (target.prior(), target.dimension());
        let (count, generations) = (prior.len(), self.generations.max(1));
        let decoder = Decoding::Kernel.prepare(prior, self.coding)?;
        let mut register = Register::uniform(self.coding, d, count);
        let mut strings = Strings::new(count, d);
        let mut pool = vec![0.0; generations * count * d];
        let mut log_weights = Vec::with_capacity(generations * count);
        let (mut found, mut ratios) = (vec![0.0; count], vec![0.0; count]);
        for points in pool.chunks_exact_mut(count * d) {
            for (chromosome, point) in points.chunks_exact_mut(d).enumerate() {
                let codes = strings.measured_mut(chromosome);
                register.measure(chromosome, random, codes);
                ratios[chromosome] = register.log_uniform_ratio(chromosome, codes);
                decoder.point(chromosome, codes, random, point);
            }
            target.wrap(points);
            target.log_likelihood(points, &mut found)?;
            let logs = found.iter().zip(&ratios).zip(prior.log_weights());
            log_weights.extend(logs.map(|((likelihood, ratio), prior)| prior + likelihood + ratio));
            strings.turn(&mut register, &found, Reference::Own, &self.rotation);
        }
        let (mut weights, log_total) = weights_of(&log_weights)?;
        let effective_sample_size = effective_sample_size(&weights);
        let total: f64 = weights.iter().sum();
        weights.iter_mut().for_each(|weight| *weight /= total);
        let chosen = Systematic.choose(&weights, count, random);
        let points = chosen.iter().flat_map(|&row| &pool[row * d..(row + 1) * d]).copied().collect();
        Ok(Moved {
            particles: Particles::equally_weighted(&target.space(), points)?,
            ancestors: chosen.iter().map(|row| row % count).collect(),
            log_evidence: Some(log_total - (generations as f64).ln()),
            acceptance: None,
            effective_sample_size,
        })
    }

    fn validity(&self) -> Validity {
        Validity::Smoothed
    }
}
