//! Distributions over finitely many states, in the log domain.
//!
//! A message is the logarithms of its values, the largest zero: a state that is ruled out has minus infinity. At a
//! temperature T a factor f sends
//!
//! m(x) = T log Σ_y exp((log f(x, y) + Σ m(y)) / T),
//!
//! which is sum-product at T = 1 and max-product in the limit T = 0. The temperature is part of an edge's form, so that
//! one graph may sum over some variables and maximise over others.

mod family;
mod log_odds;

pub use family::CategoricalFamily;
pub use log_odds::LogOdds;

use crate::vector::greater;
use serde::{Deserialize, Serialize};
use smallvec::SmallVec;
use sumprod_graph::{Message, MessageError, Messages, Space, Stream};

/// How an edge holds messages over finitely many states.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CategoricalForm {
    /// The temperature of sums over states: 1 for sum-product, 0 for max-product.
    pub temperature: f64,
}

/// A temperature that is not a number is refused by every check of forms.
impl Eq for CategoricalForm {}

impl Default for CategoricalForm {
    fn default() -> Self {
        Self { temperature: 1.0 }
    }
}

impl CategoricalForm {
    /// Sums over states.
    pub fn sum_product() -> Self {
        Self::default()
    }

    /// Maximises over states.
    pub fn max_product() -> Self {
        Self { temperature: 0.0 }
    }

    /// Refuses temperatures that are none, and spaces that are not finite.
    fn check(&self, space: &Space) -> Result<(), String> {
        if !(self.temperature >= 0.0 && self.temperature.is_finite()) {
            let temperature = self.temperature;
            return Err(format!("the temperature is {temperature}; it must be finite and not negative"));
        }
        match space {
            Space::Finite(0) => Err("a variable needs at least one state".into()),
            Space::Finite(_) => Ok(()),
            _ => Err("a categorical message needs a variable of finitely many states".into()),
        }
    }
}

/// Nats below the largest value at which a state no longer shows in any sum of doubles.
const SEEN: f64 = -36.0;

/// The largest change that is told: of states that become possible or impossible.
const APPEARED: f64 = 700.0;

/// A function of finitely many states by its logarithms, the largest of which is zero.
#[derive(Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Categorical {
    #[serde(with = "finite_or_nothing")]
    logs: SmallVec<[f64; 4]>,
}

impl Clone for Categorical {
    fn clone(&self) -> Self {
        Self { logs: SmallVec::from_slice(&self.logs) }
    }

    fn clone_from(&mut self, source: &Self) {
        if self.logs.len() == source.logs.len() {
            self.logs.copy_from_slice(&source.logs);
        } else {
            self.logs = SmallVec::from_slice(&source.logs);
        }
    }
}

/// What a set of states that all are ruled out is told by.
fn impossible(what: &'static str) -> MessageError {
    MessageError::Impossible { what }
}

impl Categorical {
    /// The function with these logarithms, up to a constant; minus infinity rules a state out.
    ///
    /// # Errors
    ///
    /// Where one is not a number or plus infinity, or all states are ruled out.
    pub fn new(logs: &[f64]) -> Result<Self, MessageError> {
        let mut own = Self { logs: SmallVec::from_slice(logs) };
        own.normalise("the message")?;
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
        let mut logs = SmallVec::from_elem(f64::NEG_INFINITY, states);
        logs[state] = 0.0;
        Ok(Self { logs })
    }

    fn vacuous_of(states: usize) -> Self {
        Self { logs: SmallVec::from_elem(0.0, states) }
    }

    /// Number of states.
    pub fn states(&self) -> usize {
        self.logs.len()
    }

    /// The logarithms, the largest of which is zero.
    pub fn logs(&self) -> &[f64] {
        &self.logs
    }

    /// The probabilities, which sum to one.
    pub fn probabilities(&self) -> Vec<f64> {
        let mut values: Vec<f64> = self.logs.iter().map(|log| log.exp()).collect();
        let sum: f64 = values.iter().sum();
        values.iter_mut().for_each(|value| *value /= sum);
        values
    }

    /// The state of the largest value, the first of several.
    pub fn most_likely(&self) -> usize {
        let mut best = 0;
        for (state, log) in self.logs.iter().enumerate() {
            if *log > self.logs[best] {
                best = state;
            }
        }
        best
    }

    /// Whether every state has the same value.
    pub fn is_vacuous(&self) -> bool {
        self.logs.iter().all(|&log| log == 0.0)
    }

    fn normalise(&mut self, what: &'static str) -> Result<(), MessageError> {
        let (mut largest, mut sum) = (f64::NEG_INFINITY, 0.0);
        for &log in &self.logs {
            largest = greater(largest, log);
            sum += log;
        }
        if sum.is_nan() || largest == f64::INFINITY {
            return Err(MessageError::NotFinite { what: "the logarithm of a state's value", value: sum });
        }
        if largest == f64::NEG_INFINITY {
            return Err(impossible(what));
        }
        self.logs.iter_mut().for_each(|log| *log -= largest);
        Ok(())
    }
}

impl Message for Categorical {
    type Form = CategoricalForm;

    fn vacuous(space: &Space) -> Self {
        match space {
            Space::Finite(states) => Self::vacuous_of(*states),
            _ => Self::default(),
        }
    }

    fn product(
        incoming: Messages<'_, Self>,
        form: &CategoricalForm,
        stream: &mut Stream,
    ) -> Result<Self, MessageError> {
        let mut out = Self::default();
        Self::product_into(incoming, form, stream, &mut out)?;
        Ok(out)
    }

    fn product_into(
        incoming: Messages<'_, Self>,
        _form: &CategoricalForm,
        _stream: &mut Stream,
        out: &mut Self,
    ) -> Result<(), MessageError> {
        let (mut first, mut unequal) = (true, None);
        incoming.for_each(|message| {
            if first {
                out.clone_from(message);
                first = false;
            } else if message.states() == out.states() {
                out.logs.iter_mut().zip(&message.logs).for_each(|(log, other)| *log += other);
            } else {
                unequal = Some(message.states());
            }
        });
        if let Some(found) = unequal {
            let what = "a message over states";
            return Err(MessageError::Dimension { what, found, expected: out.states() });
        }
        out.normalise("the product of messages")
    }

    fn quotient(&self, incoming: &Self) -> Option<Self> {
        let mut out = Self::default();
        self.quotient_into(incoming, &mut out).then_some(out)
    }

    /// Where the message rules out no state; what it ruled out cannot be had back.
    fn quotient_into(&self, incoming: &Self, out: &mut Self) -> bool {
        if out.states() != self.states() {
            out.clone_from(self);
        }
        let (mut largest, mut least) = (f64::NEG_INFINITY, 0.0);
        for ((out, own), other) in out.logs.iter_mut().zip(&self.logs).zip(&incoming.logs) {
            *out = own - other;
            largest = greater(largest, *out);
            least = if *other < least { *other } else { least };
        }
        out.logs.iter_mut().for_each(|log| *log -= largest);
        least > f64::NEG_INFINITY && largest > f64::NEG_INFINITY && largest < f64::INFINITY
    }

    /// The largest change of a logarithm, of states within 36 nats of the most likely one.
    fn change(&self, previous: &Self) -> f64 {
        let (mut largest, mut sum) = (0.0, 0.0);
        for (now, before) in self.logs.iter().zip(&previous.logs) {
            let moved = if greater(*now, *before) > SEEN { (now - before).abs() } else { 0.0 };
            largest = greater(largest, moved);
            sum += moved;
        }
        if f64::is_nan(sum) { sum } else { largest.min(APPEARED) }
    }

    /// In the logarithms: what either rules out stays ruled out.
    fn damp(&mut self, previous: &Self, damping: f64) -> bool {
        let mut largest = f64::NEG_INFINITY;
        for (log, old) in self.logs.iter_mut().zip(&previous.logs) {
            *log = (1.0 - damping) * *log + damping * old;
            largest = greater(largest, *log);
        }
        self.logs.iter_mut().for_each(|log| *log -= largest);
        true
    }

    fn check_form(form: &CategoricalForm, space: &Space) -> Result<(), String> {
        form.check(space)
    }
}

/// JSON has no infinity: a state that is ruled out is written as nothing.
mod finite_or_nothing {
    use serde::{Deserialize, Deserializer, Serializer};
    use smallvec::SmallVec;

    pub(super) fn serialize<S: Serializer>(
        logs: &SmallVec<[f64; 4]>,
        serializer: S,
    ) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(logs.iter().map(|log| log.is_finite().then_some(*log)))
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(
        deserializer: D,
    ) -> Result<SmallVec<[f64; 4]>, D::Error> {
        let logs = Vec::<Option<f64>>::deserialize(deserializer)?;
        Ok(logs.into_iter().map(|log| log.unwrap_or(f64::NEG_INFINITY)).collect())
    }
}
