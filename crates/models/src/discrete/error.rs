//! What can be wrong with a table.

use thiserror::Error;

/// Why a function over finitely many states cannot be made.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum TableError {
    /// No port.
    #[error("a table has no port; a factor joins at least one variable")]
    NoPort,
    /// A port without states.
    #[error("port {port} of a table has no state; a variable needs at least one")]
    NoState {
        /// The port.
        port: usize,
    },
    /// More entries than can be counted.
    #[error("a table of {cardinalities:?} states has more entries than can be addressed")]
    TooLarge {
        /// States by port.
        cardinalities: Vec<usize>,
    },
    /// The number of values does not match the cardinalities.
    #[error("a table of {cardinalities:?} states has {expected} entries, but {found} values are given")]
    Length {
        /// States by port.
        cardinalities: Vec<usize>,
        /// Entries of such a table.
        expected: usize,
        /// Values given.
        found: usize,
    },
    /// A value that is negative or not finite.
    #[error("entry {index} (states {states:?}) is {value}; a value must be finite and not negative")]
    Value {
        /// Its place.
        index: usize,
        /// The states there.
        states: Vec<usize>,
        /// The value.
        value: f64,
    },
    /// A logarithm that is not a number or plus infinity.
    #[error(
        "the logarithm of entry {index} (states {states:?}) is {value}; it must be a number, or minus infinity"
    )]
    Log {
        /// Its place.
        index: usize,
        /// The states there.
        states: Vec<usize>,
        /// The logarithm.
        value: f64,
    },
    /// Every entry is zero.
    #[error("every entry of the table is zero, so that no state is possible; at least one must be positive")]
    AllZero,
    /// A table that a faster kind of factor cannot hold.
    #[error("entry {index} of the table is zero, which a pair of log odds cannot hold; use a `Table`")]
    Zero {
        /// Its place.
        index: usize,
    },
    /// A coupling beyond the range of exponentials.
    #[error("a pair of log odds has a coupling of {coupling}, beyond {largest}; use a `Table`")]
    Coupling {
        /// The coupling.
        coupling: f64,
        /// The largest.
        largest: f64,
    },
    /// A table of other cardinalities than two times two.
    #[error("a pair of log odds joins two variables of 2 states, not of {cardinalities:?}; use a `Table`")]
    NotBinaryPair {
        /// States by port.
        cardinalities: Vec<usize>,
    },
    /// Too few ports for a logical factor to say anything.
    #[error("{what} needs at least {least} ports, not {ports}")]
    Ports {
        /// Which one.
        what: &'static str,
        /// The least number.
        least: usize,
        /// The number given.
        ports: usize,
    },
}
