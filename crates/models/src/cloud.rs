//! Many particles moved and weighed at a time: what the particle rules of a graph and the particle filters run on.
//!
//! Coordinates lie block by block, and within a block of [`BLOCK`] particles coordinate by coordinate, so that eight
//! particles are one load. A block is the unit of work: it stays in the nearest cache, and the stream it draws from
//! is its own, so that any number of threads computes the same bits.

mod select;
mod weigh;

pub use select::{Selection, select};
pub(crate) use weigh::each_point;
pub use weigh::{Likelihood, LogLikelihood, Residuals, log_values};

use crate::packed::{Packed, WIDTH, looked};
use crate::{Motion, ProcessNoise};
use rand_distr::{Distribution, StandardNormal};
use smallvec::SmallVec;
use sumprod_graph::{Coordinate, FastStream, wrap_angle};
use sumprod_messages::vector;

/// Particles in a block.
pub const BLOCK: usize = 512;

/// The coordinates of many particles.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Cloud {
    dimension: usize,
    count: usize,
    values: Vec<f64>,
}

impl Cloud {
    /// `count` particles of this dimension, all at the origin.
    pub fn new(dimension: usize, count: usize) -> Self {
        Self { dimension, count, values: vec![0.0; count.div_ceil(BLOCK) * BLOCK * dimension] }
    }

    /// Particles of this dimension, point by point.
    pub fn from_points(dimension: usize, points: &[f64]) -> Self {
        let mut cloud = Self::new(dimension, points.len() / dimension.max(1));
        for (particle, point) in points.chunks_exact(dimension.max(1)).enumerate() {
            point.iter().enumerate().for_each(|(k, x)| cloud.set(particle, k, *x));
        }
        cloud
    }

    /// Number of coordinates.
    pub fn dimension(&self) -> usize {
        self.dimension
    }

    /// Number of particles.
    pub fn len(&self) -> usize {
        self.count
    }

    /// Whether there is no particle.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// A coordinate of a particle.
    #[inline(always)]
    pub fn at(&self, particle: usize, coordinate: usize) -> f64 {
        self.values[self.place(particle, coordinate)]
    }

    /// Writes a coordinate of a particle.
    #[inline(always)]
    pub fn set(&mut self, particle: usize, coordinate: usize, value: f64) {
        let place = self.place(particle, coordinate);
        self.values[place] = value;
    }

    #[inline(always)]
    fn place(&self, particle: usize, coordinate: usize) -> usize {
        (particle / BLOCK * self.dimension + coordinate) * BLOCK + particle % BLOCK
    }

    /// Copies a particle out, one value per coordinate.
    #[inline]
    pub fn read(&self, particle: usize, out: &mut [f64]) {
        for (coordinate, out) in out.iter_mut().enumerate().take(self.dimension) {
            *out = self.at(particle, coordinate);
        }
    }

    /// All particles, point by point.
    pub fn points(&self) -> Vec<f64> {
        let mut points = vec![0.0; self.count * self.dimension];
        for (particle, point) in points.chunks_exact_mut(self.dimension.max(1)).enumerate() {
            self.read(particle, point);
        }
        points
    }

    /// The blocks: `dimension` runs of [`BLOCK`] values each, of which the last block may use the first few alone.
    pub fn blocks(&self) -> std::slice::ChunksExact<'_, f64> {
        self.values.chunks_exact((BLOCK * self.dimension).max(1))
    }

    /// The blocks, to be written.
    pub fn values_mut(&mut self) -> &mut [f64] {
        &mut self.values
    }

    /// The values of all blocks.
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// Number of particles in a block.
    pub fn block_len(&self, block: usize) -> usize {
        self.count.saturating_sub(block * BLOCK).min(BLOCK)
    }
}

/// The particles that those of a block move from.
#[derive(Clone, Copy, Debug)]
pub struct Source<'a> {
    /// Where they are.
    pub cloud: &'a Cloud,
    /// The first of the block's.
    pub first: usize,
    /// Which each of the block's moves from, where that is not the one of its own number.
    pub ancestors: Option<&'a [u32]>,
}

impl Source<'_> {
    #[inline(always)]
    fn particle(&self, i: usize) -> usize {
        match self.ancestors {
            Some(ancestors) => ancestors[i] as usize,
            None => self.first + i,
        }
    }

    /// Where the first coordinate of the particle that the i-th moves from lies.
    #[inline(always)]
    fn place(&self, i: usize) -> usize {
        self.cloud.place(self.particle(i), 0)
    }

    fn read(&self, i: usize, out: &mut [f64]) {
        self.cloud.read(self.particle(i), out);
    }
}

/// A motion ready to move many particles.
pub struct Mover<'a, M> {
    motion: &'a M,
    constant: Option<Sparse>,
    angles: SmallVec<[usize; 4]>,
}

/// A noise factor by its entries that are not zero.
struct Sparse {
    sources: usize,
    entries: Vec<Entry>,
}

struct Entry {
    row: usize,
    source: usize,
    value: f64,
}

impl<'a, M: Motion> Mover<'a, M> {
    /// A mover of states with these coordinates.
    pub fn new(motion: &'a M, coordinates: &[Coordinate]) -> Self {
        let constant = motion.constant_noise().map(Sparse::new);
        let angle = |(index, kind): (usize, &Coordinate)| (*kind == Coordinate::Angle).then_some(index);
        Self { motion, constant, angles: coordinates.iter().enumerate().filter_map(angle).collect() }
    }

    /// Moves `count` (at most [`BLOCK`]) particles by x' = f(x) + B z into a block; returns whether all are finite.
    ///
    /// `draws` is working storage.
    pub fn advance(
        &self,
        count: usize,
        from: Source<'_>,
        random: &mut FastStream,
        draws: &mut Vec<f64>,
        block: &mut [f64],
    ) -> bool {
        let sources = self.constant.as_ref().map_or(0, |noise| noise.sources);
        draws.resize(sources * BLOCK, 0.0);
        for i in 0..count {
            for source in 0..sources {
                draws[source * BLOCK + i] = StandardNormal.sample(random);
            }
        }
        self.centres(count, from, block);
        match &self.constant {
            Some(noise) => vector::widest(AddNoise { entries: &noise.entries, draws, count, block }),
            None => self.add_noise(count, from, random, block),
        }
        self.wrap(count, block);
        vector::widest(AllFinite { count, block })
    }

    /// Writes f(x) of `count` particles, without noise, into a block; angles are not wrapped.
    pub fn centres(&self, count: usize, from: Source<'_>, block: &mut [f64]) {
        looked();
        vector::widest(Step { motion: self.motion, count, from, block });
        if looked() {
            let d = self.motion.dimension();
            let (mut x, mut next) = (values(d, 0.0), values(d, 0.0));
            for i in 0..count {
                from.read(i, &mut x);
                self.motion.step(&x, &mut next);
                next.iter().enumerate().for_each(|(k, next)| block[k * BLOCK + i] = *next);
            }
        }
    }

    /// Noise that depends on the state, one particle at a time.
    fn add_noise(&self, count: usize, from: Source<'_>, random: &mut FastStream, block: &mut [f64]) {
        let mut x = values(self.motion.dimension(), 0.0);
        for i in 0..count {
            from.read(i, &mut x);
            let noise = self.motion.noise(&x);
            for source in 0..noise.sources() {
                let z: f64 = StandardNormal.sample(random);
                for row in 0..x.len() {
                    block[row * BLOCK + i] += noise.factor()[row * noise.sources() + source] * z;
                }
            }
        }
    }

    /// Brings the angles of a block's first `count` particles into (-π, π].
    pub fn wrap(&self, count: usize, block: &mut [f64]) {
        for &angle in &self.angles {
            block[angle * BLOCK..][..count].iter_mut().for_each(|x| *x = wrap_angle(*x));
        }
    }
}

impl Sparse {
    fn new(noise: &ProcessNoise) -> Self {
        let sources = noise.sources();
        let each = noise.factor().iter().enumerate().filter(|(_, value)| **value != 0.0);
        let entries =
            each.map(|(index, &value)| Entry { row: index / sources, source: index % sources, value });
        Self { sources, entries: entries.collect() }
    }
}

fn values<T: Copy>(count: usize, value: T) -> SmallVec<[T; 6]> {
    SmallVec::from_elem(value, count)
}

struct Step<'a, M> {
    motion: &'a M,
    count: usize,
    from: Source<'a>,
    block: &'a mut [f64],
}

impl<M: Motion> pulp::NullaryFnOnce for Step<'_, M> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let d = self.motion.dimension();
        let (mut x, mut next) = (values(d, Packed::from(0.0)), values(d, Packed::from(0.0)));
        for first in (0..self.count).step_by(WIDTH) {
            let last = (self.count - 1).min(first + WIDTH - 1);
            let places: [usize; WIDTH] =
                std::array::from_fn(|lane| self.from.place((first + lane).min(last)));
            for (k, x) in x.iter_mut().enumerate() {
                let column = &self.from.cloud.values[k * BLOCK..];
                for (x, place) in x.0.iter_mut().zip(places) {
                    *x = column[place];
                }
            }
            self.motion.step(&x, &mut next);
            for (k, next) in next.iter().enumerate() {
                self.block[k * BLOCK + first..][..WIDTH].copy_from_slice(&next.0);
            }
        }
    }
}

struct AllFinite<'a> {
    count: usize,
    block: &'a [f64],
}

impl pulp::NullaryFnOnce for AllFinite<'_> {
    type Output = bool;

    #[inline(always)]
    fn call(self) -> bool {
        // A product with zero is zero for finite numbers alone.
        let mut doubt = [0.0; WIDTH];
        for column in self.block.chunks_exact(BLOCK) {
            let (chunks, rest) = column[..self.count].as_chunks::<WIDTH>();
            for chunk in chunks {
                doubt.iter_mut().zip(chunk).for_each(|(doubt, x)| *doubt += x * 0.0);
            }
            doubt.iter_mut().zip(rest).for_each(|(doubt, x)| *doubt += x * 0.0);
        }
        doubt == [0.0; WIDTH]
    }
}

struct AddNoise<'a> {
    entries: &'a [Entry],
    draws: &'a [f64],
    count: usize,
    block: &'a mut [f64],
}

impl pulp::NullaryFnOnce for AddNoise<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        for &Entry { row, source, value } in self.entries {
            let draws = &self.draws[source * BLOCK..][..self.count];
            for (x, z) in self.block[row * BLOCK..][..self.count].iter_mut().zip(draws) {
                *x += value * z;
            }
        }
    }
}
