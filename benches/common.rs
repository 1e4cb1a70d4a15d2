//! What the benchmarks share: sizes from the command line, timing, random matrices.
#![allow(dead_code, reason = "each benchmark uses a part")]

use nalgebra::Matrix2;
use rand::RngExt;
use rand_xoshiro::Xoshiro256PlusPlus;
use std::fmt;
use std::time::Instant;

/// Sizes given on the command line, or these.
pub fn sizes(default: &[usize]) -> Vec<usize> {
    let given: Vec<usize> = std::env::args().skip(1).filter_map(|argument| argument.parse().ok()).collect();
    if given.is_empty() { default.to_vec() } else { given }
}

/// Seconds of repeated calls, sorted.
pub struct Timing(Vec<f64>);

impl Timing {
    /// Times `work`, after whatever warm-up the caller did.
    pub fn of<E>(repeats: usize, mut work: impl FnMut() -> Result<(), E>) -> Result<Self, E> {
        let mut seconds = Vec::with_capacity(repeats);
        for _ in 0..repeats {
            let start = Instant::now();
            work()?;
            seconds.push(start.elapsed().as_secs_f64());
        }
        seconds.sort_by(f64::total_cmp);
        Ok(Self(seconds))
    }

    /// Times `work` by the processor time of this thread, where the system tells it: other work on the machine then
    /// counts for nothing. The system counts in ticks of some milliseconds, so that each of the `repeats` is of as
    /// much work as fills a fifth of a second.
    pub fn of_thread<E>(repeats: usize, mut work: impl FnMut() -> Result<(), E>) -> Result<Self, E> {
        let start = Instant::now();
        work()?;
        let batch = (0.2 / start.elapsed().as_secs_f64()).ceil().max(1.0) as usize;
        let mut seconds = Vec::with_capacity(repeats);
        for _ in 0..repeats {
            let (start, before) = (Instant::now(), thread_seconds());
            (0..batch).try_for_each(|_| work())?;
            let wall = start.elapsed().as_secs_f64();
            let spent = before.zip(thread_seconds()).map_or(wall, |(before, after)| after - before);
            seconds.push(spent / batch as f64);
        }
        seconds.sort_by(f64::total_cmp);
        Ok(Self(seconds))
    }

    /// The median (s).
    pub fn median(&self) -> f64 {
        self.0[self.0.len() / 2]
    }

    /// The least (s).
    pub fn least(&self) -> f64 {
        self.0[0]
    }
}

/// Processor time that this thread has had (s).
fn thread_seconds() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    text.split(' ').next()?.parse().ok().map(|nanoseconds: f64| nanoseconds * 1e-9)
}

impl fmt::Display for Timing {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{}; least {:.3e} s, median {:.3e} s", self.0.len(), self.least(), self.median())
    }
}

/// A random information matrix with eigenvalues between `low` and `high`.
pub fn information(random: &mut Xoshiro256PlusPlus, low: f64, high: f64) -> Matrix2<f64> {
    let (sine, cosine) = random.random_range(0.0..std::f64::consts::PI).sin_cos();
    let turn = Matrix2::new(cosine, -sine, sine, cosine);
    let stretch = Matrix2::new(random.random_range(low..high), 0.0, 0.0, random.random_range(low..high));
    turn * stretch * turn.transpose()
}
