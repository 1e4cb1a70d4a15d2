//! Constraints of binary variables, in linear time.
//!
//! Each is an automaton of two states that reads the variables port by port. The messages to all ports are sums over its
//! paths, by one pass forth and one back:
//!
//! m(x_k) = Σ_s α_k(s) β_{k+1}(δ_k(s, x_k)),
//!
//! at any temperature, without subtraction, and with certain messages as well as others.

use super::rules::{Numbers, read, temperature};
use super::semiring::{LogSums, Maxima, Semiring};
use super::{LocalEvidence, Table, TableError, Tabulation};
use smallvec::SmallVec;
use std::any::Any;
use sumprod_graph::{Factor, Incoming, MessageError, MessageStreams, Port, Stream};
use sumprod_messages::CategoricalFamily;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Or,
    And,
    AtMostOne,
    Parity { odd: usize },
}

/// A constraint of binary variables: one where it holds, zero where it does not.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Logical {
    kind: Kind,
    cardinalities: Vec<usize>,
}

/// Logarithms of the automaton's two states.
type States = [f64; 2];

impl Logical {
    fn new(kind: Kind, what: &'static str, least: usize, ports: usize) -> Result<Self, TableError> {
        if ports < least {
            return Err(TableError::Ports { what, least, ports });
        }
        Ok(Self { kind, cardinalities: vec![2; ports] })
    }

    /// The last of `ports` variables is 1 if and only if any other is.
    ///
    /// # Errors
    ///
    /// Where there are fewer than two.
    pub fn or(ports: usize) -> Result<Self, TableError> {
        Self::new(Kind::Or, "or", 2, ports)
    }

    /// The last of `ports` variables is 1 if and only if all others are.
    ///
    /// # Errors
    ///
    /// Where there are fewer than two.
    pub fn and(ports: usize) -> Result<Self, TableError> {
        Self::new(Kind::And, "and", 2, ports)
    }

    /// No two of `ports` variables are 1.
    ///
    /// # Errors
    ///
    /// Where there is none.
    pub fn at_most_one(ports: usize) -> Result<Self, TableError> {
        Self::new(Kind::AtMostOne, "at most one", 1, ports)
    }

    /// The number of ones among `ports` variables is even, or `odd`.
    ///
    /// # Errors
    ///
    /// Where there is none.
    pub fn parity(ports: usize, odd: bool) -> Result<Self, TableError> {
        Self::new(Kind::Parity { odd: usize::from(odd) }, "parity", 1, ports)
    }

    fn first_state(&self) -> usize {
        usize::from(self.kind == Kind::And)
    }

    /// The automaton's state after it has read `x` at `port` in state `s`; none where the constraint is broken.
    #[inline]
    fn step(&self, port: usize, s: usize, x: usize) -> Option<usize> {
        let last = port + 1 == self.cardinalities.len();
        match self.kind {
            Kind::Or | Kind::And if last => (x == s).then_some(0),
            Kind::Or => Some(s | x),
            Kind::And => Some(s & x),
            Kind::AtMostOne => (s + x <= 1).then_some(s + x),
            Kind::Parity { odd } if last => (s ^ x == odd).then_some(0),
            Kind::Parity { .. } => Some(s ^ x),
        }
    }

    /// The states before `port`, from those before the port before it.
    fn forth<S: Semiring>(&self, semiring: S, port: usize, before: States, logs: &[f64]) -> States {
        let mut after = [semiring.zero(); 2];
        for (s, &own) in before.iter().enumerate() {
            for x in 0..2 {
                if let Some(next) = self.step(port, s, x) {
                    let path = semiring.times(own, logs[2 * port + x]);
                    after[next] = semiring.plus(after[next], path);
                }
            }
        }
        after
    }

    /// What follows from the states before `port`, from what follows after it.
    fn back<S: Semiring>(&self, semiring: S, port: usize, after: States, logs: &[f64]) -> States {
        let mut before = [semiring.zero(); 2];
        for (s, sum) in before.iter_mut().enumerate() {
            for x in 0..2 {
                if let Some(next) = self.step(port, s, x) {
                    *sum = semiring.plus(*sum, semiring.times(after[next], logs[2 * port + x]));
                }
            }
        }
        before
    }

    fn start<S: Semiring>(&self, semiring: S) -> States {
        let mut states = [semiring.zero(); 2];
        states[self.first_state()] = semiring.one();
        states
    }

    fn message_at<S: Semiring>(&self, semiring: S, port: usize, before: States, after: States) -> [f64; 2] {
        let mut out = [semiring.zero(); 2];
        for (x, sum) in out.iter_mut().enumerate() {
            for (s, &own) in before.iter().enumerate() {
                if let Some(next) = self.step(port, s, x) {
                    *sum = semiring.plus(*sum, semiring.times(own, after[next]));
                }
            }
        }
        out
    }

    fn one<S: Semiring>(&self, semiring: S, to: Port, logs: &[f64]) -> [f64; 2] {
        let before =
            (0..to).fold(self.start(semiring), |states, port| self.forth(semiring, port, states, logs));
        let ports = (to + 1..self.cardinalities.len()).rev();
        let after = ports.fold([semiring.one(); 2], |states, port| self.back(semiring, port, states, logs));
        self.message_at(semiring, to, before, after)
    }

    /// The messages to all ports, over those from them.
    fn all<S: Semiring>(&self, semiring: S, logs: &mut [f64]) {
        let ports = self.cardinalities.len();
        let mut before: SmallVec<[States; 64]> = SmallVec::with_capacity(ports);
        let mut states = self.start(semiring);
        for port in 0..ports {
            before.push(states);
            states = self.forth(semiring, port, states, logs);
        }
        let mut after = [semiring.one(); 2];
        for port in (0..ports).rev() {
            let out = self.message_at(semiring, port, before[port], after);
            after = self.back(semiring, port, after, logs);
            logs[2 * port..2 * port + 2].copy_from_slice(&out);
        }
    }

    fn tabulate(&self) -> Option<Table> {
        let ports = self.cardinalities.len();
        let allowed = |index: usize| {
            let bit = |port: usize| index >> (ports - 1 - port) & 1;
            let mut ports = 0..ports;
            ports.try_fold(self.first_state(), |s, port| self.step(port, s, bit(port))).is_some()
        };
        let values = (0..1_usize << ports).map(|index| f64::from(u8::from(allowed(index)))).collect();
        Table::new(&self.cardinalities, values).ok()
    }
}

impl<M: CategoricalFamily> Factor<M> for Logical {
    fn dimensions(&self) -> &[usize] {
        &self.cardinalities
    }

    fn message(
        &self,
        to: Port,
        incoming: &Incoming<'_, M>,
        form: &M::Form,
        stream: &mut Stream,
    ) -> Result<M, MessageError> {
        let mut out = incoming.belief(to).clone();
        self.message_into(to, incoming, form, stream, &mut out)?;
        Ok(out)
    }

    fn message_into(
        &self,
        to: Port,
        incoming: &Incoming<'_, M>,
        form: &M::Form,
        _stream: &mut Stream,
        out: &mut M,
    ) -> Result<(), MessageError> {
        let temperature = temperature::<M>(form)?;
        let mut logs = Numbers::from_elem(0.0, 2 * self.cardinalities.len());
        read(&self.cardinalities, to, incoming, &mut logs, M::read_logs)?;
        let sent = if temperature == 0.0 {
            self.one(Maxima, to, &logs)
        } else {
            self.one(LogSums { temperature }, to, &logs)
        };
        out.write_logs(incoming.belief(to), &sent)
    }

    fn all_messages_into(
        &self,
        incoming: &Incoming<'_, M>,
        forms: &[M::Form],
        streams: MessageStreams,
        out: &mut [M],
    ) -> Result<(), (Port, MessageError)> {
        if forms.iter().any(|form| *form != forms[0]) {
            for (to, (out, form)) in out.iter_mut().zip(forms).enumerate() {
                self.message_into(to, incoming, form, &mut streams.of(to), out)
                    .map_err(|error| (to, error))?;
            }
            return Ok(());
        }
        let temperature = temperature::<M>(&forms[0]).map_err(|error| (0, error))?;
        let mut logs = Numbers::from_elem(0.0, 2 * self.cardinalities.len());
        let nowhere = self.cardinalities.len();
        read(&self.cardinalities, nowhere, incoming, &mut logs, M::read_logs).map_err(|error| (0, error))?;
        if temperature == 0.0 {
            self.all(Maxima, &mut logs);
        } else {
            self.all(LogSums { temperature }, &mut logs);
        }
        for (to, (out, sent)) in out.iter_mut().zip(logs.chunks_exact(2)).enumerate() {
            out.write_logs(incoming.belief(to), sent).map_err(|error| (to, error))?;
        }
        Ok(())
    }

    fn answer(&self, question: &mut dyn Any) -> bool {
        if let Some(question) = question.downcast_mut::<Tabulation>() {
            let ports = u32::try_from(self.cardinalities.len()).unwrap_or(u32::MAX);
            question.entries = 1_usize.checked_shl(ports);
            let small = question.entries.is_some_and(|entries| entries <= question.most);
            question.table = if small { self.tabulate() } else { None };
            return true;
        }
        let Some(question) = question.downcast_mut::<LocalEvidence>() else { return false };
        let sums = LogSums { temperature: 1.0 };
        let ports = 0..self.cardinalities.len();
        let end = ports.fold(self.start(sums), |states, port| self.forth(sums, port, states, &question.logs));
        question.log_sum = sums.plus(end[0], end[1]);
        true
    }
}
