//! How rules read and write messages over states, whatever their family.

use super::passes::{LEAST, exponentials};
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

    /// The values of all states over the largest, where they are at hand: sums of values need no exponentials then.
    fn values(&self) -> Option<&[f64]> {
        None
    }

    /// Writes the values of all states over the largest into `values`, which has as many entries; zero below the range
    /// of doubles.
    fn read_values(&self, values: &mut [f64]) {
        if let Some(own) = self.values() {
            values.copy_from_slice(own);
            return;
        }
        self.read_logs(values);
        exponentials(values);
    }

    /// As [`CategoricalFamily::write_logs`], of values; false, and this is arbitrary, where a value is so small, alone or
    /// beside the largest, that sums may have lost digits of it to underflow: 1e-290.
    ///
    /// # Errors
    ///
    /// As [`CategoricalFamily::write_logs`].
    fn write_values(&mut self, like: &Self, values: &[f64]) -> Result<bool, MessageError> {
        if !values.iter().all(|value| (LEAST..f64::INFINITY).contains(value)) {
            return Ok(false);
        }
        let logs: SmallVec<[f64; 4]> = values.iter().map(|value| value.ln()).collect();
        self.write_logs(like, &logs).map(|()| true)
    }
}

impl CategoricalFamily for Categorical {
    fn categorical_form(form: &CategoricalForm) -> Option<CategoricalForm> {
        Some(*form)
    }

    fn states(&self) -> usize {
        Self::states(self)
    }

    fn read_logs(&self, logs: &mut [f64]) {
        self.with_logs(|own| logs.copy_from_slice(own));
    }

    fn write_logs(&mut self, _like: &Self, logs: &[f64]) -> Result<(), MessageError> {
        self.hold(false, logs);
        self.normalise_logs("the message")
    }

    fn values(&self) -> Option<&[f64]> {
        Self::values(self)
    }

    fn write_values(&mut self, _like: &Self, values: &[f64]) -> Result<bool, MessageError> {
        Ok(self.hold_values(values))
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
