//! A function over the joint states of a few variables, by its values.

use super::TableError;
use super::strips::{Combine, Strips};
use std::sync::OnceLock;

/// A non-negative function of a few finite variables: one value per joint state, the last port's state running fastest,
/// as nested arrays are written.
///
/// Values are kept as they were given, logarithms or not; the other kind, and what fast rules need, is made when a message
/// first asks for it, once per table and never per message.
#[derive(Debug)]
pub struct Table {
    cardinalities: Vec<usize>,
    /// Logarithm of the largest value.
    peak: f64,
    /// Values over the largest.
    values: OnceLock<Vec<f64>>,
    /// Logarithms, less that of the largest.
    logs: OnceLock<Vec<f64>>,
    /// Of two ports.
    pairs: Pairs,
}

impl Clone for Table {
    fn clone(&self) -> Self {
        Self {
            cardinalities: self.cardinalities.clone(),
            peak: self.peak,
            values: self.values.clone(),
            logs: self.logs.clone(),
            pairs: Pairs::default(),
        }
    }
}

impl PartialEq for Table {
    fn eq(&self, other: &Self) -> bool {
        self.cardinalities == other.cardinalities && self.peak == other.peak && self.logs() == other.logs()
    }
}

impl Table {
    /// A table by its values.
    ///
    /// # Errors
    ///
    /// Where there is no port or a port has no state, the number of values is not the product of `cardinalities`, a value
    /// is negative or not finite, or all are zero.
    pub fn new(cardinalities: &[usize], values: Vec<f64>) -> Result<Self, TableError> {
        let states = |index| joint_state(cardinalities, index);
        check_shape(cardinalities, values.len())?;
        let mut largest: f64 = 0.0;
        for (index, &value) in values.iter().enumerate() {
            if !(value >= 0.0 && value.is_finite()) {
                return Err(TableError::Value { index, states: states(index), value });
            }
            largest = largest.max(value);
        }
        if largest == 0.0 {
            return Err(TableError::AllZero);
        }
        let mut values = values;
        values.iter_mut().for_each(|value| *value /= largest);
        Ok(Self::with(cardinalities, largest.ln(), values.into(), OnceLock::new()))
    }

    /// A table by the logarithms of its values; minus infinity is the logarithm of zero.
    ///
    /// # Errors
    ///
    /// As [`Table::new`], of logarithms that are not numbers or plus infinity.
    pub fn from_logs(cardinalities: &[usize], logs: Vec<f64>) -> Result<Self, TableError> {
        let states = |index| joint_state(cardinalities, index);
        check_shape(cardinalities, logs.len())?;
        let mut peak = f64::NEG_INFINITY;
        for (index, &value) in logs.iter().enumerate() {
            if value.is_nan() || value == f64::INFINITY {
                return Err(TableError::Log { index, states: states(index), value });
            }
            peak = peak.max(value);
        }
        if peak == f64::NEG_INFINITY {
            return Err(TableError::AllZero);
        }
        let mut logs = logs;
        logs.iter_mut().for_each(|log| *log -= peak);
        Ok(Self::with(cardinalities, peak, OnceLock::new(), logs.into()))
    }

    fn with(
        cardinalities: &[usize],
        peak: f64,
        values: OnceLock<Vec<f64>>,
        logs: OnceLock<Vec<f64>>,
    ) -> Self {
        Self { cardinalities: cardinalities.to_vec(), peak, values, logs, pairs: Pairs::default() }
    }

    /// States by port.
    pub fn cardinalities(&self) -> &[usize] {
        &self.cardinalities
    }

    /// Number of entries.
    pub fn len(&self) -> usize {
        self.cardinalities.iter().product()
    }

    /// Whether there is no entry, which no table allows.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Logarithm of the largest value.
    pub fn peak(&self) -> f64 {
        self.peak
    }

    /// The values over the largest.
    pub fn values(&self) -> &[f64] {
        self.values.get_or_init(|| self.logs().iter().map(|log| log.exp()).collect())
    }

    /// The logarithms of the values over the largest; minus infinity of zero.
    pub fn logs(&self) -> &[f64] {
        self.logs.get_or_init(|| match self.values.get() {
            Some(values) => values.iter().map(|value| value.ln()).collect(),
            None => Vec::new(),
        })
    }

    /// The logarithm of the value at a joint state, minus infinity where there is no such state.
    pub fn log_at(&self, states: &[usize]) -> f64 {
        let mut index = 0;
        for (&state, &cardinality) in states.iter().zip(&self.cardinalities) {
            if state >= cardinality {
                return f64::NEG_INFINITY;
            }
            index = index * cardinality + state;
        }
        if states.len() == self.cardinalities.len() {
            self.peak + self.logs()[index]
        } else {
            f64::NEG_INFINITY
        }
    }

    /// Of a table of two ports: for each state of the port that is summed over, a row by the state of `to`; of values
    /// for sums, of logarithms for maxima.
    pub(super) fn strips(&self, how: Combine, to: usize) -> &Strips {
        let entries = || match how {
            Combine::Sum => self.values(),
            Combine::Maximum => self.logs(),
        };
        let (first, second) = match how {
            Combine::Sum => &self.pairs.values,
            Combine::Maximum => &self.pairs.logs,
        };
        let (rows, columns) = (self.cardinalities[1 - to], self.cardinalities[to]);
        let to_first =
            || Strips::new(rows, columns, |row, column| entries()[column * self.cardinalities[1] + row]);
        if to == 0 {
            return first.get_or_init(to_first);
        }
        let own = second.get_or_init(|| {
            let entries = entries();
            let entry = |row, column| entries[row * columns + column];
            let symmetric = rows == columns && (0..rows).all(|i| (0..i).all(|j| entry(i, j) == entry(j, i)));
            (!symmetric).then(|| Strips::new(rows, columns, entry))
        });
        // Half the memory, which then stays in the nearest cache.
        own.as_ref().unwrap_or_else(|| first.get_or_init(to_first))
    }
}

/// The entries of a table of two ports, laid out for its messages; nothing for messages to the second port where
/// exchanging the ports changes nothing.
#[derive(Debug, Default)]
struct Pairs {
    values: (OnceLock<Strips>, OnceLock<Option<Strips>>),
    logs: (OnceLock<Strips>, OnceLock<Option<Strips>>),
}

fn check_shape(cardinalities: &[usize], found: usize) -> Result<(), TableError> {
    if cardinalities.is_empty() {
        return Err(TableError::NoPort);
    }
    if let Some(port) = cardinalities.iter().position(|&states| states == 0) {
        return Err(TableError::NoState { port });
    }
    let product = cardinalities.iter().try_fold(1_usize, |product, &states| product.checked_mul(states));
    let cardinalities = cardinalities.to_vec();
    match product {
        None => Err(TableError::TooLarge { cardinalities }),
        Some(expected) if expected != found => Err(TableError::Length { cardinalities, expected, found }),
        Some(_) => Ok(()),
    }
}

fn joint_state(cardinalities: &[usize], index: usize) -> Vec<usize> {
    let mut rest = index;
    let mut states = vec![0; cardinalities.len()];
    for (state, &cardinality) in states.iter_mut().zip(cardinalities).rev() {
        *state = rest % cardinality;
        rest /= cardinality;
    }
    states
}
