//! Checks of a scenario's numbers, each failing with the key, the number and what it must be.

use crate::PositioningError;

/// A variance or duration that must be positive and finite.
pub fn positive(key: &str, value: f64) -> Result<(), PositioningError> {
    if value > 0.0 && value.is_finite() {
        return Ok(());
    }
    Err(PositioningError::setting(key, format!("is {value}; it must be positive and finite")))
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
