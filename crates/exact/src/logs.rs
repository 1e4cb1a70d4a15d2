//! Sums of numbers that are kept as logarithms.

/// log Σ exp, exact of infinities.
pub(crate) fn log_sum(logs: &[f64]) -> f64 {
    let largest = log_max(logs);
    if largest == f64::NEG_INFINITY {
        return largest;
    }
    largest + logs.iter().map(|log| (log - largest).exp()).sum::<f64>().ln()
}

/// The largest, minus infinity of none.
pub(crate) fn log_max(logs: &[f64]) -> f64 {
    logs.iter().copied().fold(f64::NEG_INFINITY, f64::max)
}
