//! Counter-based random streams, named by what is drawn for and never by who draws.
//!
//! A [`Stream`] is keyed by a seed and addressed by (iteration, purpose, entity). Whichever thread computes a
//! message asks for the same address and so sees the same numbers: results do not depend on the thread count.
//! The generator is ChaCha8, set up only when the first number is drawn, so that rules which draw nothing pay
//! nothing; loops that draw many numbers seed a fast generator from it with [`Stream::fast`].

use rand::rand_core::{Infallible, SeedableRng, TryRng};
use rand_chacha::ChaCha8Rng;
use rand_xoshiro::Xoshiro256PlusPlus;

/// The generator for long loops, seeded from a [`Stream`].
pub type FastStream = Xoshiro256PlusPlus;

/// What a stream's numbers are drawn for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// A factor's message along an edge.
    Message,
    /// The product of a variable's incoming messages.
    Belief,
    /// The product of all but one of them, by edge.
    Extrinsic,
    /// Moving or reselecting a variable's particles.
    Optimizer,
    /// Simulating a world.
    World,
    /// Anything a user draws for, by their own number.
    User(u16),
}

impl Purpose {
    fn code(self) -> u64 {
        match self {
            Self::Message => 1,
            Self::Belief => 2,
            Self::Extrinsic => 3,
            Self::Optimizer => 4,
            Self::World => 5,
            Self::User(number) => 16 + u64::from(number),
        }
    }
}

/// A random stream with an address; implements rand's generator traits.
#[derive(Clone, Debug)]
pub struct Stream {
    key: [u64; 4],
    generator: Option<Box<ChaCha8Rng>>,
}

impl Stream {
    /// The stream of `entity` (an edge's or variable's number) for `purpose` in `iteration` under `seed`.
    #[inline]
    pub fn new(seed: u64, iteration: u64, purpose: Purpose, entity: u64) -> Self {
        Self { key: [seed, iteration, purpose.code(), entity], generator: None }
    }

    /// A stream below this one, for instance one per run of a Monte Carlo campaign.
    pub fn derive(&self, entity: u64) -> Self {
        let [seed, iteration, purpose, old] = self.key;
        Self {
            key: [seed ^ mix(iteration.wrapping_add(mix(old))), purpose, u64::MAX, entity],
            generator: None,
        }
    }

    /// A number that names this stream: equal for equal addresses.
    pub fn id(&self) -> u64 {
        self.key.iter().fold(0, |hash, &word| mix(hash ^ word))
    }

    /// A fast generator seeded from this stream.
    pub fn fast(&mut self) -> FastStream {
        FastStream::seed_from_u64(self.next())
    }

    fn generator(&mut self) -> &mut ChaCha8Rng {
        let key = self.key;
        self.generator.get_or_insert_with(|| {
            let mut seed = [0; 32];
            for (bytes, word) in seed.chunks_exact_mut(8).zip(key) {
                bytes.copy_from_slice(&word.to_le_bytes());
            }
            Box::new(ChaCha8Rng::from_seed(seed))
        })
    }

    fn next(&mut self) -> u64 {
        use rand::Rng;
        self.generator().next_u64()
    }
}

/// The streams of one factor's messages in one iteration, made when asked for.
#[derive(Clone, Copy, Debug)]
pub struct MessageStreams {
    seed: u64,
    iteration: u64,
    first_edge: u64,
}

impl MessageStreams {
    /// The streams of a factor whose edges are numbered from `first_edge`.
    pub fn new(seed: u64, iteration: u64, first_edge: u64) -> Self {
        Self { seed, iteration, first_edge }
    }

    /// The stream of the message to a port.
    #[inline]
    pub fn of(self, port: usize) -> Stream {
        Stream::new(self.seed, self.iteration, Purpose::Message, self.first_edge + port as u64)
    }
}

impl TryRng for Stream {
    type Error = Infallible;

    fn try_next_u32(&mut self) -> Result<u32, Infallible> {
        self.generator().try_next_u32()
    }

    fn try_next_u64(&mut self) -> Result<u64, Infallible> {
        self.generator().try_next_u64()
    }

    fn try_fill_bytes(&mut self, bytes: &mut [u8]) -> Result<(), Infallible> {
        self.generator().try_fill_bytes(bytes)
    }
}

/// The finaliser of SplitMix64: a bijection of 64-bit words that spreads every bit.
fn mix(word: u64) -> u64 {
    let word = word.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let word = (word ^ (word >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let word = (word ^ (word >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    word ^ (word >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::Rng;

    #[test]
    fn a_stream_depends_on_its_address_alone() {
        let draw =
            |seed, iteration, purpose, entity| Stream::new(seed, iteration, purpose, entity).next_u64();
        let first = draw(1, 2, Purpose::Message, 3);
        assert_eq!(first, draw(1, 2, Purpose::Message, 3));
        let others = [
            draw(2, 2, Purpose::Message, 3),
            draw(1, 3, Purpose::Message, 3),
            draw(1, 2, Purpose::Belief, 3),
            draw(1, 2, Purpose::Message, 4),
        ];
        assert!(others.iter().all(|&other| other != first));
    }

    #[test]
    fn derived_streams_differ_from_each_other_and_their_parent() {
        let parent = Stream::new(7, 0, Purpose::World, 0);
        let ids: std::collections::BTreeSet<u64> = (0..1000).map(|run| parent.derive(run).id()).collect();
        assert_eq!(ids.len(), 1000);
        assert!(!ids.contains(&parent.id()));
    }
}
