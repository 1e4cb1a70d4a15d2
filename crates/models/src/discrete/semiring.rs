//! The sums over states that messages are made of: sums of values, maxima of logarithms, and what lies between.

/// How the values of joint states are combined and weighed.
pub(super) trait Semiring: Copy {
    /// The identity of the sum.
    fn zero(self) -> f64;
    /// The identity of the product.
    fn one(self) -> f64;
    /// The sum of two.
    fn plus(self, a: f64, b: f64) -> f64;
    /// The product of two.
    fn times(self, a: f64, b: f64) -> f64;
}

/// Plain values.
#[derive(Clone, Copy)]
pub(super) struct Values;

impl Semiring for Values {
    fn zero(self) -> f64 {
        0.0
    }
    fn one(self) -> f64 {
        1.0
    }
    fn plus(self, a: f64, b: f64) -> f64 {
        a + b
    }
    fn times(self, a: f64, b: f64) -> f64 {
        a * b
    }
}

/// Logarithms, of which the largest counts.
#[derive(Clone, Copy)]
pub(super) struct Maxima;

impl Semiring for Maxima {
    fn zero(self) -> f64 {
        f64::NEG_INFINITY
    }
    fn one(self) -> f64 {
        0.0
    }
    fn plus(self, a: f64, b: f64) -> f64 {
        if a > b { a } else { b }
    }
    fn times(self, a: f64, b: f64) -> f64 {
        a + b
    }
}

/// Logarithms, of which T log Σ exp(a / T) counts.
#[derive(Clone, Copy)]
pub(super) struct LogSums {
    pub(super) temperature: f64,
}

impl Semiring for LogSums {
    fn zero(self) -> f64 {
        f64::NEG_INFINITY
    }
    fn one(self) -> f64 {
        0.0
    }
    fn plus(self, a: f64, b: f64) -> f64 {
        let (less, more) = if a > b { (b, a) } else { (a, b) };
        if less == f64::NEG_INFINITY {
            return more;
        }
        more + self.temperature * ((less - more) / self.temperature).exp().ln_1p()
    }
    fn times(self, a: f64, b: f64) -> f64 {
        a + b
    }
}

/// The sum over all joint states of a table that agree with each state of port `to`, of the table's entry times the
/// entries of `incoming` at all other ports; into `out`. `to` past the last port sums over everything, into one entry.
///
/// `incoming` holds one entry per port and state, port by port. One visit per entry of the table, row by row of its last
/// port.
pub(super) fn marginalise<S: Semiring>(
    semiring: S,
    cardinalities: &[usize],
    entries: &[f64],
    incoming: &[f64],
    to: usize,
    out: &mut [f64],
    room: &mut Room,
) {
    out.fill(semiring.zero());
    let Some((&last, outer)) = cardinalities.split_last() else { return };
    let (ports, from_last) = (outer.len(), incoming.len() - last);
    let own = &incoming[from_last..];
    // By outer port: its state, where its entries begin, and the product of the entries at the ports before it.
    room.states.clear();
    room.states.resize(ports, 0);
    room.weights.clear();
    room.weights.resize(ports + 1, semiring.one());
    room.starts.clear();
    room.starts.extend(outer.iter().scan(0, |start, states| {
        let begin = *start;
        *start += states;
        Some(begin)
    }));
    let mut changed = 0;
    for row in entries.chunks_exact(last) {
        for port in changed..ports {
            let weight = room.weights[port];
            let entry =
                if port == to { semiring.one() } else { incoming[room.starts[port] + room.states[port]] };
            room.weights[port + 1] = semiring.times(weight, entry);
        }
        let weight = room.weights[ports];
        if weight != semiring.zero() {
            if to == ports {
                for (out, &entry) in out.iter_mut().zip(row) {
                    *out = semiring.plus(*out, semiring.times(weight, entry));
                }
            } else {
                let place = if to < ports { room.states[to] } else { 0 };
                let mut sum = semiring.zero();
                for (&entry, &own) in row.iter().zip(own) {
                    sum = semiring.plus(sum, semiring.times(entry, own));
                }
                out[place] = semiring.plus(out[place], semiring.times(weight, sum));
            }
        }
        // The next joint state of the outer ports, the last of them running fastest.
        changed = ports;
        while changed > 0 {
            changed -= 1;
            room.states[changed] += 1;
            if room.states[changed] < outer[changed] {
                break;
            }
            room.states[changed] = 0;
        }
    }
}

/// Storage of a visit.
#[derive(Default)]
pub(super) struct Room {
    states: smallvec::SmallVec<[usize; 8]>,
    starts: smallvec::SmallVec<[usize; 8]>,
    weights: smallvec::SmallVec<[f64; 9]>,
}
