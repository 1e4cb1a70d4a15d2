//! What exact solves and evidence ask of a factor over finitely many states, by [`sumprod_graph::Factor::answer`].

use super::Table;

/// Asks a factor for its values at all joint states.
#[derive(Debug, Default)]
pub struct Tabulation {
    /// Asked: the most entries a table may have.
    pub most: usize,
    /// The table, where it is not too large.
    pub table: Option<Table>,
    /// The number of entries it has; none where that cannot be counted.
    pub entries: Option<usize>,
}

impl Tabulation {
    /// Asks for a table of at most this many entries.
    pub fn new(most: usize) -> Self {
        Self { most, table: None, entries: None }
    }

    /// Takes the table where it is not too large, and its size in any case.
    pub(super) fn offer(&mut self, cardinalities: &[usize], table: impl FnOnce() -> Table) {
        self.entries = cardinalities.iter().try_fold(1_usize, |product, &states| product.checked_mul(states));
        self.table = self.entries.is_some_and(|entries| entries <= self.most).then(table);
    }
}

/// Asks a factor for the logarithm of its sum with messages, log Σ f(x) Π m(x).
#[derive(Debug, Default)]
pub struct LocalEvidence {
    /// Asked: the logarithms of the messages at all ports, port by port.
    pub logs: Vec<f64>,
    /// The answer.
    pub log_sum: f64,
}
