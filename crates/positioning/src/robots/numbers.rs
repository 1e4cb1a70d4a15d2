//! Checks of a scenario's numbers, each failing with the key, the number and what it must be.

use crate::PositioningError;
use sumprod_messages::Cholesky;

/// A variance or duration that must be positive and finite.
pub fn positive(key: &str, value: f64) -> Result<(), PositioningError> {
    if value > 0.0 && value.is_finite() {
        return Ok(());
    }
    Err(PositioningError::setting(key, format!("is {value}; it must be positive and finite")))
}

/// A covariance: symmetric and positive definite.
pub fn positive_definite<const D: usize>(key: &str, matrix: &[[f64; D]; D]) -> Result<(), PositioningError> {
    for (row, entries) in matrix.iter().enumerate() {
        for (column, &below) in entries.iter().enumerate().take(row) {
            let above = matrix[column][row];
            if below != above {
                let problem = format!(
                    "has {below} in row {row}, column {column} but {above} in row {column}, column {row}; a \
                     covariance must be symmetric"
                );
                return Err(PositioningError::setting(key, problem));
            }
        }
    }
    let problem = |error| format!("cannot be a covariance: {error}; correlations must lie between -1 and 1");
    match Cholesky::new(matrix.as_flattened(), D, "the matrix") {
        Ok(_) => Ok(()),
        Err(error) => Err(PositioningError::setting(key, problem(error))),
    }
}

/// A variance or duration that may be zero.
pub fn not_negative(key: &str, value: f64) -> Result<(), PositioningError> {
    if value >= 0.0 && value.is_finite() {
        return Ok(());
    }
    Err(PositioningError::setting(key, format!("is {value}; it must be finite and not negative")))
}

/// A count of at least one.
pub fn at_least_one(key: &str, value: u32) -> Result<(), PositioningError> {
    if value > 0 {
        return Ok(());
    }
    Err(PositioningError::setting(key, "is 0; it must be at least 1"))
}
