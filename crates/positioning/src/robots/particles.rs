//! Recorded robots by particles: each robot's position sampled, the rest of its state a Gaussian a particle.

use sumprod_filters::{Filter, FilterError, Predict, RaoBlackwellised};
use sumprod_messages::Moments;
use sumprod_models::{Block, Motion};
use sumprod_optimizers::Trigger;

use super::chain::{self, Chain, Inference, Plan, Visit};
use super::marginal;
use super::numbers::at_least_one;
use crate::PositioningError;
use crate::scenario::GraphSummary;

/// Particles where a method does not say how many.
const PARTICLES: u32 = 500;
/// Coordinates of a robot's own state that are sampled: its position. The rest, heading and errors of scale, enters
/// motions and measurements almost linearly once the position is known.
const SAMPLED: [usize; 2] = [0, 1];

/// A chain whose joint state falls into parts that move and are measured by themselves.
pub trait Parts: Chain {
    /// One part's step from one slice to the next.
    type PartMotion: Motion;

    /// The coordinates of each part.
    fn parts(&self) -> Vec<Block>;

    /// A part's motion from slice `slice` − 1 to `slice`.
    fn part_motion(&self, part: usize, slice: usize) -> Self::PartMotion;

    /// Corrects a part's filter by what is measured of it alone at `slice` (from 1).
    ///
    /// # Errors
    /// Where a measurement cannot be used.
    fn absorb(&self, part: usize, slice: usize, filter: &mut RaoBlackwellised) -> Result<(), FilterError>;
}

/// How a method estimates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Way {
    /// Gaussian messages on the chain.
    Messages(Plan),
    /// So many particles a part.
    Particles(usize),
}

impl Way {
    /// The way of a method table.
    ///
    /// # Errors
    /// [`PositioningError::Setting`] for a zero, or a key that its inference does not know.
    pub fn new(
        id: &str,
        inference: Inference,
        [rounds, lag, sweeps]: [Option<u32>; 3],
        particles: Option<u32>,
    ) -> Result<Self, PositioningError> {
        let key = |name: &str| format!("method.{id}.{name}");
        if inference != Inference::ParticleFilter {
            if particles.is_some() {
                let problem = "belongs to a particle filter; leave it out";
                return Err(PositioningError::setting(key("particles"), problem));
            }
            return Ok(Self::Messages(Plan::new(id, inference, rounds, lag, sweeps)?));
        }
        for (name, value) in [("rounds", rounds), ("lag", lag), ("sweeps", sweeps)] {
            if value.is_some() {
                return Err(PositioningError::setting(
                    key(name),
                    "means nothing to a particle filter; leave it out",
                ));
            }
        }
        let count = particles.unwrap_or(PARTICLES);
        at_least_one(&key("particles"), count)?;
        Ok(Self::Particles(count as usize))
    }

    /// Runs the method `id` on a chain and hands each slice's belief to `visit`.
    ///
    /// # Errors
    /// [`PositioningError::Method`] where a message or a filter cannot be computed, and whatever `visit` returns.
    pub fn run<C: Parts>(
        self,
        id: &str,
        chain: &C,
        seed: u64,
        visit: &mut Visit<'_>,
    ) -> Result<(), PositioningError> {
        match self {
            Self::Messages(plan) => chain::run(id, chain, plan, seed, visit),
            Self::Particles(count) => run(id, chain, count, seed, visit),
        }
    }

    /// The size and shape of a method's graph.
    ///
    /// # Errors
    /// As [`Way::run`].
    pub fn summary<C: Chain>(self, id: &str, chain: &C) -> Result<GraphSummary, PositioningError> {
        match self {
            Self::Messages(plan) => chain::summary(id, chain, plan),
            Self::Particles(count) => {
                let mut summary = chain::summary(id, chain, Plan::Filter { rounds: 1 })?;
                let form = format!("particles({count}), each with a Gaussian");
                summary.forms.iter_mut().for_each(|used| used.form.clone_from(&form));
                Ok(summary)
            }
        }
    }
}

/// Filters each part of a chain by `count` particles and hands each slice's joint moments to `visit`.
///
/// # Errors
/// [`PositioningError::Method`] where a filter fails, naming the part and the slice, and whatever `visit` returns.
fn run<C: Parts>(
    id: &str,
    chain: &C,
    count: usize,
    seed: u64,
    visit: &mut Visit<'_>,
) -> Result<(), PositioningError> {
    let parts = chain.parts();
    let failed = |part: usize, slice: usize| {
        move |error: FilterError| PositioningError::method(id, format!("part {part}, slice {slice}: {error}"))
    };
    let half = Trigger::below(0.5).map_err(|error| PositioningError::method(id, error))?;
    let mut filters = Vec::with_capacity(parts.len());
    for (part, block) in parts.iter().enumerate() {
        let prior = marginal(chain.start(), block.start, block.length);
        let own_seed = seed.wrapping_mul(1 << 16).wrapping_add(part as u64);
        let filter = RaoBlackwellised::new(&prior, &SAMPLED, count, own_seed).map_err(failed(part, 0))?;
        filters.push(filter.reselecting_when(half));
    }
    let d = chain.start().dimension();
    for slice in 0..chain.times().len() {
        let mut joint = Moments { mean: vec![0.0; d], covariance: vec![0.0; d * d] };
        for (part, (filter, block)) in filters.iter_mut().zip(&parts).enumerate() {
            if slice > 0 {
                filter.predict(&chain.part_motion(part, slice)).map_err(failed(part, slice))?;
                chain.absorb(part, slice, filter).map_err(failed(part, slice))?;
            }
            let own = filter.moments();
            joint.mean[block.start..][..block.length].copy_from_slice(&own.mean);
            for (row, entries) in own.covariance.chunks_exact(block.length).enumerate() {
                joint.covariance[(block.start + row) * d + block.start..][..block.length]
                    .copy_from_slice(entries);
            }
        }
        visit(slice, &joint)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_that_mean_nothing_are_refused() {
        let sentence =
            |inference, keys, particles| Way::new("m", inference, keys, particles).unwrap_err().to_string();
        assert_eq!(
            sentence(Inference::Filter, [None; 3], Some(10)),
            "`method.m.particles` belongs to a particle filter; leave it out"
        );
        assert_eq!(
            sentence(Inference::ParticleFilter, [None, Some(2), None], None),
            "`method.m.lag` means nothing to a particle filter; leave it out"
        );
        assert_eq!(
            sentence(Inference::ParticleFilter, [None; 3], Some(0)),
            "`method.m.particles` is 0; it must be at least 1"
        );
        assert_eq!(
            Way::new("m", Inference::ParticleFilter, [None; 3], None).unwrap(),
            Way::Particles(PARTICLES as usize)
        );
    }
}
