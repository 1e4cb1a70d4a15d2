//! Positive functions of two binary variables, for messages that are log odds.
//!
//! With log f(x, y) = c + a x + b y + J x y, the message to x from log odds l at y is
//!
//! a + log(1 + exp(l + b + J)) - log(1 + exp(l + b)),
//!
//! to y the same with a and b exchanged; their maxima instead at temperature zero. Messages of many such factors are
//! computed in one loop over their edges.

use super::{LocalEvidence, Table, TableError, Tabulation};
use std::any::Any;
use sumprod_graph::{Factor, Group, Incoming, MessageError, Port, Stream};
use sumprod_messages::vector::{exp, greater, ln, widest};
use sumprod_messages::{CategoricalForm, LogOdds};

/// The largest coupling: its exponential is a double.
const LARGEST: f64 = 600.0;

/// A positive function of two binary variables.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PairOdds {
    /// a and b.
    fields: [f64; 2],
    /// J.
    coupling: f64,
    /// e^J.
    gain: f64,
    /// c.
    constant: f64,
}

impl PairOdds {
    /// exp(`fields[0]` x + `fields[1]` y + `coupling` x y), of states 0 and 1.
    ///
    /// # Errors
    ///
    /// Where a number is not finite, or the coupling is beyond 600.
    pub fn new(fields: [f64; 2], coupling: f64) -> Result<Self, TableError> {
        let logs = vec![0.0, fields[1], fields[0], fields[0] + fields[1] + coupling];
        Self::from_table(&Table::from_logs(&[2, 2], logs)?)
    }

    /// exp(`coupling` s t) of spins -1 and 1, which are states 0 and 1: the pair of an Ising model.
    ///
    /// # Errors
    ///
    /// Where the coupling is not finite or beyond 150.
    pub fn ising(coupling: f64) -> Result<Self, TableError> {
        Self::from_table(&Table::from_logs(&[2, 2], vec![coupling, -coupling, -coupling, coupling])?)
    }

    /// The function of a table.
    ///
    /// # Errors
    ///
    /// Where the table is not two by two, has a zero entry, or its coupling is beyond 600.
    pub fn from_table(table: &Table) -> Result<Self, TableError> {
        let cardinalities = table.cardinalities().to_vec();
        let [t00, t01, t10, t11] = match (table.cardinalities(), table.logs()) {
            ([2, 2], &[t00, t01, t10, t11]) => [t00, t01, t10, t11],
            _ => return Err(TableError::NotBinaryPair { cardinalities }),
        };
        if let Some(index) = table.logs().iter().position(|log| !log.is_finite()) {
            return Err(TableError::Zero { index });
        }
        let coupling = (t11 - t10) - (t01 - t00);
        if coupling.abs() > LARGEST {
            return Err(TableError::Coupling { coupling, largest: LARGEST });
        }
        let (fields, gain) = ([t10 - t00, t01 - t00], coupling.exp());
        Ok(Self { fields, coupling, gain, constant: table.peak() + t00 })
    }

    /// The function as a table.
    ///
    /// # Errors
    ///
    /// Where the numbers are beyond the range of doubles together.
    pub fn table(&self) -> Result<Table, TableError> {
        let ([a, b], c) = (self.fields, self.constant);
        Table::from_logs(&[2, 2], vec![c, c + b, c + a, c + a + b + self.coupling])
    }

    /// The message to one end from the log odds at the other, at any temperature.
    fn send(&self, to: Port, odds: f64, temperature: f64) -> f64 {
        let (own, other) = (self.fields[to], self.fields[1 - to]);
        let x = odds + other;
        if temperature == 0.0 {
            own + maxima(x, self.coupling)
        } else if temperature == 1.0 {
            own + sums(x, self.gain)
        } else {
            own + temperature * sums(x / temperature, (self.coupling / temperature).exp())
        }
    }
}

/// max(0, x + J) - max(0, x).
#[inline(always)]
fn maxima(x: f64, coupling: f64) -> f64 {
    let difference = greater(x + coupling, 0.0) - greater(x, 0.0);
    // The same, where infinite odds leave no difference.
    if x > LARGEST { coupling } else { difference }
}

/// log(1 + e^J e^x) - log(1 + e^x), of e^J.
#[inline(always)]
fn sums(x: f64, gain: f64) -> f64 {
    let t = exp(-x.abs());
    let above = if x > 0.0 { t + gain } else { 1.0 + gain * t };
    ln(above / (1.0 + t))
}

/// Edges that are computed in one loop; two per factor.
const LANES: usize = 64;

/// The messages of consecutive factors from their edges' inputs, all at one temperature.
struct Many<'a> {
    factors: &'a [PairOdds],
    inputs: &'a [LogOdds],
    out: &'a mut [LogOdds],
    maximise: bool,
}

impl pulp::NullaryFnOnce for Many<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let mut own = [0.0; LANES];
        let mut strength = [0.0; LANES];
        let mut x = [0.0; LANES];
        let chunks =
            self.factors.chunks(LANES / 2).zip(self.inputs.chunks(LANES)).zip(self.out.chunks_mut(LANES));
        for ((factors, inputs), out) in chunks {
            for (k, (factor, ends)) in factors.iter().zip(inputs.chunks_exact(2)).enumerate() {
                let [a, b] = factor.fields;
                (own[2 * k], own[2 * k + 1]) = (a, b);
                let own_strength = if self.maximise { factor.coupling } else { factor.gain };
                (strength[2 * k], strength[2 * k + 1]) = (own_strength, own_strength);
                // What is sent to one end comes from the other.
                (x[2 * k], x[2 * k + 1]) = (ends[1].0 + b, ends[0].0 + a);
            }
            // Loops, since a closure may be compiled apart from them, for the least machine.
            let lanes = own.iter_mut().zip(&x).zip(&strength);
            if self.maximise {
                for ((own, x), coupling) in lanes {
                    *own += maxima(*x, *coupling);
                }
            } else {
                for ((own, x), gain) in lanes {
                    *own += sums(*x, *gain);
                }
            }
            for (out, own) in out.iter_mut().zip(&own) {
                out.0 = *own;
            }
        }
    }
}

impl Factor<LogOdds> for PairOdds {
    fn dimensions(&self) -> &[usize] {
        &[2, 2]
    }

    fn message(
        &self,
        to: Port,
        incoming: &Incoming<'_, LogOdds>,
        form: &CategoricalForm,
        _stream: &mut Stream,
    ) -> Result<LogOdds, MessageError> {
        Ok(LogOdds(self.send(to, incoming.message(1 - to).0, form.temperature)))
    }

    fn many_messages_into(
        factors: &[Self],
        group: &Group<'_, LogOdds>,
        out: &mut [LogOdds],
    ) -> Result<(), (usize, MessageError)> {
        if let Some(&CategoricalForm { temperature }) = group.common_form()
            && (temperature == 0.0 || temperature == 1.0)
        {
            widest(Many { factors, inputs: group.inputs(), out, maximise: temperature == 0.0 });
            return Ok(());
        }
        let pairs = factors.iter().zip(group.inputs().chunks_exact(2)).zip(group.forms().chunks_exact(2));
        for (((factor, ends), forms), out) in pairs.zip(out.chunks_exact_mut(2)) {
            for (to, (out, form)) in out.iter_mut().zip(forms).enumerate() {
                out.0 = factor.send(to, ends[1 - to].0, form.temperature);
            }
        }
        Ok(())
    }

    fn answer(&self, question: &mut dyn Any) -> bool {
        let Ok(table) = self.table() else { return false };
        if question.is::<Tabulation>() || question.is::<LocalEvidence>() {
            return Factor::<LogOdds>::answer(&table, question);
        }
        false
    }
}
