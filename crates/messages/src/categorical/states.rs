//! What a message over states holds.

use super::impossible;
use super::passes::{LEAST, exponentials, logarithms, normalise_logs, normalise_values, normalised_values};
use serde::{Deserialize, Serialize};
use smallvec::SmallVec;
use std::sync::OnceLock;
use sumprod_graph::MessageError;

/// Room for the numbers of many a message without an allocation.
pub(super) type Room = SmallVec<[f64; 64]>;

/// A function of finitely many states, up to a factor.
#[derive(Debug, Default, Serialize, Deserialize)]
#[serde(into = "Stored", try_from = "Stored")]
pub struct Categorical {
    /// By state: values over the largest where `valued`, else their logarithms.
    pub(super) numbers: SmallVec<[f64; 4]>,
    /// Whether the numbers are values, all of them in the range that can be multiplied and divided.
    pub(super) valued: bool,
    /// The other of the two, where it was asked for or given.
    other: OnceLock<Box<[f64]>>,
}

impl PartialEq for Categorical {
    fn eq(&self, other: &Self) -> bool {
        if self.valued == other.valued { self.numbers == other.numbers } else { self.logs() == other.logs() }
    }
}

impl Clone for Categorical {
    fn clone(&self) -> Self {
        let numbers = SmallVec::from_slice(&self.numbers);
        Self { numbers, valued: self.valued, other: self.other.clone() }
    }

    fn clone_from(&mut self, source: &Self) {
        self.hold(source.valued, &source.numbers);
        if source.other.get().is_some() {
            self.other = source.other.clone();
        }
    }
}

impl Categorical {
    /// The function with these logarithms, up to a constant; minus infinity rules a state out.
    ///
    /// # Errors
    ///
    /// Where one is not a number or plus infinity, or all states are ruled out.
    pub fn new(logs: &[f64]) -> Result<Self, MessageError> {
        let mut own = Self { numbers: SmallVec::from_slice(logs), ..Self::default() };
        own.normalise_logs("the message")?;
        own.know_values();
        Ok(own)
    }

    /// The function with these values, up to a factor.
    ///
    /// # Errors
    ///
    /// Where one is negative or not finite, or all are zero.
    pub fn from_probabilities(probabilities: &[f64]) -> Result<Self, MessageError> {
        if let Some(&value) = probabilities.iter().find(|p| !(**p >= 0.0 && p.is_finite())) {
            return Err(MessageError::NotFinite {
                what: "the logarithm of a probability",
                value: value.ln(),
            });
        }
        let logs: SmallVec<[f64; 4]> = probabilities.iter().map(|p| p.ln()).collect();
        Self::new(&logs)
    }

    /// The function that is one at `state` and zero at all others of `states`.
    ///
    /// # Errors
    ///
    /// Where there is no such state.
    pub fn certain(states: usize, state: usize) -> Result<Self, MessageError> {
        if state >= states {
            let what = "a certain state";
            return Err(MessageError::Coordinate { what, index: state, dimension: states });
        }
        let mut numbers = SmallVec::from_elem(f64::NEG_INFINITY, states);
        numbers[state] = 0.0;
        Ok(Self { numbers, ..Self::default() })
    }

    pub(super) fn vacuous_of(states: usize) -> Self {
        Self { numbers: SmallVec::from_elem(1.0, states), valued: true, ..Self::default() }
    }

    /// Number of states.
    pub fn states(&self) -> usize {
        self.numbers.len()
    }

    /// The logarithms, the largest of which is zero.
    pub fn logs(&self) -> &[f64] {
        if !self.valued {
            return &self.numbers;
        }
        self.other.get_or_init(|| {
            let mut logs = vec![0.0; self.states()];
            logarithms(&self.numbers, &mut logs);
            logs.into()
        })
    }

    /// The values over the largest, where they are in the range of doubles and at hand.
    pub(super) fn values(&self) -> Option<&[f64]> {
        if self.valued { Some(&self.numbers) } else { self.other.get().map(|values| &**values) }
    }

    /// Calls `read` with the logarithms, without keeping them.
    pub(super) fn with_logs<T>(&self, read: impl FnOnce(&[f64]) -> T) -> T {
        if !self.valued || self.other.get().is_some() {
            return read(self.logs());
        }
        let mut logs = Room::from_elem(0.0, self.states());
        logarithms(&self.numbers, &mut logs);
        read(&logs)
    }

    /// Takes over numbers and forgets what was derived from those before.
    pub(super) fn hold(&mut self, valued: bool, numbers: &[f64]) {
        self.room(numbers.len(), valued).copy_from_slice(numbers);
    }

    /// Storage for new numbers, arbitrary as yet.
    pub(super) fn room(&mut self, states: usize, valued: bool) -> &mut [f64] {
        self.valued = valued;
        self.other.take();
        if self.states() != states {
            self.numbers.resize(states, 0.0);
        }
        &mut self.numbers
    }

    /// Takes over values that need not be normalised; false, and the message is arbitrary, where they are out of range.
    pub(super) fn hold_values(&mut self, values: &[f64]) -> bool {
        normalised_values(values, self.room(values.len(), true))
    }

    /// Holds logarithms instead of values.
    pub(super) fn become_logs(&mut self) {
        if self.valued {
            let values = Room::from_slice(&self.numbers);
            logarithms(&values, self.room(values.len(), false));
        }
        self.other.take();
    }

    pub(super) fn normalise_logs(&mut self, what: &'static str) -> Result<(), MessageError> {
        let (largest, sum) = normalise_logs(&mut self.numbers);
        if sum.is_nan() || largest == f64::INFINITY {
            return Err(MessageError::NotFinite { what: "the logarithm of a state's value", value: sum });
        }
        if largest == f64::NEG_INFINITY {
            return Err(impossible(what));
        }
        Ok(())
    }

    /// Holds values beside logarithms, where they are in range.
    fn know_values(&mut self) {
        if self.numbers.iter().all(|&log| log > LEAST.ln()) {
            let mut values: Box<[f64]> = self.numbers.as_slice().into();
            exponentials(&mut values);
            if normalise_values(&mut values) {
                self.other = values.into();
            }
        }
    }

    /// The probabilities, which sum to one.
    pub fn probabilities(&self) -> Vec<f64> {
        let mut values = match self.values() {
            Some(values) => values.to_vec(),
            None => self.numbers.iter().map(|log| log.exp()).collect(),
        };
        let sum: f64 = values.iter().sum();
        values.iter_mut().for_each(|value| *value /= sum);
        values
    }

    /// The state of the largest value, the first of several.
    pub fn most_likely(&self) -> usize {
        let mut best = 0;
        for (state, number) in self.numbers.iter().enumerate() {
            if *number > self.numbers[best] {
                best = state;
            }
        }
        best
    }

    /// Whether every state has the same value.
    pub fn is_vacuous(&self) -> bool {
        self.numbers.iter().all(|number| *number == self.numbers[0])
    }
}

/// A message as it is written: what it holds, so that a run that goes on from it computes the same bits.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Stored {
    /// JSON has no infinity: a state that is ruled out is written as nothing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    logs: Option<Vec<Option<f64>>>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    values: Option<Vec<f64>>,
}

impl From<Categorical> for Stored {
    fn from(message: Categorical) -> Self {
        let logs = || message.numbers.iter().map(|log| log.is_finite().then_some(*log)).collect();
        let logs = (!message.valued).then(logs);
        Self { logs, values: message.values().map(<[f64]>::to_vec) }
    }
}

impl TryFrom<Stored> for Categorical {
    type Error = String;

    fn try_from(stored: Stored) -> Result<Self, String> {
        let values = stored.values.map(Vec::into_boxed_slice);
        if let Some(value) = values.iter().flatten().find(|value| !(**value >= LEAST && **value <= 2.0)) {
            return Err(format!(
                "a value of a message over states is {value}; values are above 1e-290 and at most 2"
            ));
        }
        let Some(logs) = stored.logs else {
            let numbers =
                SmallVec::from_slice(&values.ok_or("a message over states has neither logs nor values")?);
            return Ok(Self { numbers, valued: true, ..Self::default() });
        };
        let numbers: SmallVec<[f64; 4]> =
            logs.into_iter().map(|log| log.unwrap_or(f64::NEG_INFINITY)).collect();
        match values {
            Some(values) if values.len() != numbers.len() => {
                Err(format!("a message has logs of {} states and values of {}", numbers.len(), values.len()))
            }
            Some(values) => Ok(Self { numbers, valued: false, other: values.into() }),
            None => Ok(Self { numbers, ..Self::default() }),
        }
    }
}
