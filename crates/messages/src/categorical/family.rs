//! How rules read and write messages over states, whatever their family.

use super::{Categorical, CategoricalForm, LogOdds};
use smallvec::SmallVec;
use sumprod_graph::{Message, MessageError};

/// A family that can be read and written as a function of finitely many states.
pub trait CategoricalFamily: Message {
    /// The form of an edge, where it holds states.
    fn categorical_form(form: &Self::Form) -> Option<CategoricalForm>;

    /// Number of states; zero where the message holds none.
    fn states(&self) -> usize;

    /// Writes the logarithms of all states, the largest zero, into `logs`, which has as many entries.
    fn read_logs(&self, logs: &mut [f64]);

    /// Becomes the function with these logarithms, up to a constant, on the space of `like`.
    ///
    /// # Errors
    ///
    /// Where one is not a number or plus infinity, or all states are ruled out.
    fn write_logs(&mut self, like: &Self, logs: &[f64]) -> Result<(), MessageError>;
}

impl CategoricalFamily for Categorical {
    fn categorical_form(form: &CategoricalForm) -> Option<CategoricalForm> {
        Some(*form)
    }

    fn states(&self) -> usize {
        Self::states(self)
    }

    fn read_logs(&self, logs: &mut [f64]) {
        logs.copy_from_slice(&self.logs);
    }

    fn write_logs(&mut self, _like: &Self, logs: &[f64]) -> Result<(), MessageError> {
        if self.logs.len() == logs.len() {
            self.logs.copy_from_slice(logs);
        } else {
            self.logs = SmallVec::from_slice(logs);
        }
        self.normalise("the message")
    }
}

impl CategoricalFamily for LogOdds {
    fn categorical_form(form: &CategoricalForm) -> Option<CategoricalForm> {
        Some(*form)
    }

    fn states(&self) -> usize {
        2
    }

    fn read_logs(&self, logs: &mut [f64]) {
        logs[0] = (-self.0).min(0.0);
        logs[1] = self.0.min(0.0);
    }

    fn write_logs(&mut self, _like: &Self, logs: &[f64]) -> Result<(), MessageError> {
        let odds = logs[1] - logs[0];
        if odds.is_nan() {
            if logs == [f64::NEG_INFINITY; 2] {
                return Err(super::impossible("the message"));
            }
            return Err(MessageError::NotFinite { what: "the log odds", value: odds });
        }
        self.0 = odds;
        Ok(())
    }
}
