//! The quantum genetic particle filter as printed: a search for likely points.

use sumprod_graph::FastStream;
use sumprod_messages::Particles;

use super::{Coding, Decoding, Register, Rotation};
use crate::error::OptimizerError;
use crate::moves::{Move, Moved, Validity, weights_of};
use crate::target::Target;
use crate::trigger::effective_sample_size;

/// Which string the gate turns towards.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Reference {
    /// The chromosome's own best.
    #[default]
    Own,
    /// The best of the population; sensible only where strings mean the same for all ([`Decoding::Global`]).
    Population,
}

/// The likeliest point that each chromosome has met, the particle itself included, weighed by its likelihood.
///
/// Not a sample of the posterior: the best of several draws follows the likelihood to a power, and the prior's
/// weights do not enter. Likelihoods a particle: 1 + generations.
#[derive(Clone, Debug, PartialEq)]
pub struct QuantumLiteral {
    /// How often the register is measured.
    pub generations: usize,
    /// Bits a coordinate.
    pub coding: Coding,
    /// The gate.
    pub rotation: Rotation,
    /// What a string stands for.
    pub decoding: Decoding,
    /// What the gate turns towards.
    pub reference: Reference,
}

impl Default for QuantumLiteral {
    /// 5 generations of 9 bits, decoded around the particle with c = 1, each chromosome by its own best.
    fn default() -> Self {
        Self {
            generations: 5,
            coding: Coding::default(),
            rotation: Rotation::default(),
            decoding: Decoding::local(1.0),
            reference: Reference::Own,
        }
    }
}

impl Move for QuantumLiteral {
    fn advance(&self, target: &mut Target<'_>, random: &mut FastStream) -> Result<Moved, OptimizerError> {
        let (prior, d) = (target.prior(), target.dimension());
        let count = prior.len();
        let decoder = self.decoding.prepare(prior, self.coding)?;
        let length = decoder.codes();
        let mut register = Register::uniform(self.coding, length, count);
        let mut best = prior.points().to_vec();
        let mut fitness = vec![0.0; count];
        target.log_likelihood(&best, &mut fitness)?;
        let mut strings = Strings::new(count, length);
        let (mut points, mut found) = (vec![0.0; best.len()], vec![0.0; count]);
        for _ in 0..self.generations {
            for (chromosome, point) in points.chunks_exact_mut(d).enumerate() {
                let codes = strings.measured_mut(chromosome);
                register.measure(chromosome, random, codes);
                decoder.point(chromosome, codes, random, point);
            }
            target.wrap(&mut points);
            target.log_likelihood(&points, &mut found)?;
            for chromosome in 0..count {
                let range = chromosome * d..(chromosome + 1) * d;
                if found[chromosome] > fitness[chromosome] {
                    fitness[chromosome] = found[chromosome];
                    best[range.clone()].copy_from_slice(&points[range]);
                }
            }
            strings.turn(&mut register, &found, self.reference, &self.rotation);
        }
        let (weights, _) = weights_of(&fitness)?;
        Ok(Moved {
            particles: Particles::new(&target.space(), best, fitness)?,
            ancestors: (0..count).collect(),
            log_evidence: None,
            acceptance: None,
            effective_sample_size: effective_sample_size(&weights),
        })
    }

    fn validity(&self) -> Validity {
        Validity::Literal
    }
}

/// The strings last measured, and the best of each chromosome.
pub(super) struct Strings {
    length: usize,
    measured: Vec<u16>,
    best: Vec<u16>,
    fitness: Vec<f64>,
}

impl Strings {
    pub(super) fn new(count: usize, length: usize) -> Self {
        let codes = vec![0; count * length];
        Self { length, measured: codes.clone(), best: codes, fitness: vec![f64::NEG_INFINITY; count] }
    }

    pub(super) fn measured_mut(&mut self, chromosome: usize) -> &mut [u16] {
        &mut self.measured[chromosome * self.length..(chromosome + 1) * self.length]
    }

    /// Keeps the strings that are their chromosome's best so far, and turns the others towards the reference.
    pub(super) fn turn(
        &mut self,
        register: &mut Register,
        found: &[f64],
        reference: Reference,
        gate: &Rotation,
    ) {
        let range = |chromosome: usize| chromosome * self.length..(chromosome + 1) * self.length;
        for (chromosome, &found) in found.iter().enumerate() {
            if found > self.fitness[chromosome] {
                self.fitness[chromosome] = found;
                self.best[range(chromosome)].copy_from_slice(&self.measured[range(chromosome)]);
            }
        }
        let best = self.fitness.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let leader = self.fitness.iter().position(|&fitness| fitness == best).unwrap_or(0);
        for (chromosome, &found) in found.iter().enumerate() {
            let towards = if reference == Reference::Own { chromosome } else { leader };
            if found < self.fitness[towards] {
                let (codes, towards) = (&self.measured[range(chromosome)], &self.best[range(towards)]);
                register.rotate(chromosome, codes, towards, gate);
            }
        }
    }
}
