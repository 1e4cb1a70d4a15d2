//! The quantum genetic algorithm as the proposal of Metropolis-Hastings chains.

use sumprod_graph::FastStream;

use super::{Coding, Register};
use crate::chains::Chains;
use crate::error::OptimizerError;
use crate::moves::{Move, Moved, Validity};
use crate::target::Target;

/// Least floor: the probability of a string of 16 such bits is still a number.
const LEAST_FLOOR: f64 = 1e-6;

/// Weighs and reselects once, from the uniform register; then each generation measures a register for every chain and
/// accepts the string with probability min(1, π(x') q(b) / (π(x) q(b'))).
///
/// A half of the population is measured from a register whose qubits have been turned to the frequencies of the
/// other half's bits, at most `floor` away from certainty, so that no proposal depends on the chain that it moves.
/// Likelihoods a particle: 1 + generations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct QuantumMetropolis {
    /// Steps of each chain.
    pub generations: usize,
    /// Bits a coordinate.
    pub coding: Coding,
    /// Least probability of a bit, between 10⁻⁶ and ½.
    pub floor: f64,
    /// Factor of the kernel's width.
    pub kernel_scale: f64,
}

impl Default for QuantumMetropolis {
    /// 5 generations of 9 bits, q between 0.1 and 0.9.
    fn default() -> Self {
        Self { generations: 5, coding: Coding::default(), floor: 0.1, kernel_scale: 1.0 }
    }
}

impl Move for QuantumMetropolis {
    fn advance(&self, target: &mut Target<'_>, random: &mut FastStream) -> Result<Moved, OptimizerError> {
        if !(LEAST_FLOOR..=0.5).contains(&self.floor) {
            let (what, value) = ("the least probability of a bit", self.floor);
            return Err(OptimizerError::Parameter { what, value, must: "it must lie between 1e-6 and 0.5" });
        }
        let d = target.dimension();
        let scale = crate::regularised::kernel_scale(self.kernel_scale)?;
        let mut chains = Chains::start(target, scale, random)?;
        let mut codes: Vec<u16> = (0..chains.len())
            .flat_map(|chain| chains.standard(chain))
            .map(|&standard| self.coding.code(standard))
            .collect();
        for _ in 0..self.generations {
            for (half, others) in chains.halves() {
                let register = Register::frequencies(
                    self.coding,
                    d,
                    &codes[others.start * d..others.end * d],
                    self.floor,
                );
                let mut measured = vec![0; half.len() * d];
                let mut proposals = vec![0.0; half.len() * d];
                let mut ratios = Vec::with_capacity(half.len());
                let rows = measured.chunks_exact_mut(d).zip(proposals.chunks_exact_mut(d));
                for (chain, (new, proposal)) in half.clone().zip(rows) {
                    register.measure(0, random, new);
                    for (u, &code) in proposal.iter_mut().zip(&*new) {
                        *u = self.coding.normal(code, random);
                    }
                    let old = &codes[chain * d..(chain + 1) * d];
                    // A string's cell carries the standard normal density: q(u) = Π q(bit) 2^(bits) N(u; 0, I).
                    let normal = 0.5 * (squares(proposal) - squares(chains.standard(chain)));
                    ratios.push(
                        normal + register.log_uniform_ratio(0, new) - register.log_uniform_ratio(0, old),
                    );
                }
                let verdicts = chains.accept(target, half.clone(), &proposals, &ratios, random)?;
                for ((chain, new), accepted) in half.zip(measured.chunks_exact(d)).zip(verdicts) {
                    if accepted {
                        codes[chain * d..(chain + 1) * d].copy_from_slice(new);
                    }
                }
            }
        }
        chains.finish(target)
    }

    fn validity(&self) -> Validity {
        Validity::Smoothed
    }
}

fn squares(values: &[f64]) -> f64 {
    values.iter().map(|value| value * value).sum()
}
