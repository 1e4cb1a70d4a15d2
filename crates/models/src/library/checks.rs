//! What the constructors of this library refuse: sizes that disagree, coordinates that a variable does not have, and
//! numbers that are not finite.

use sumprod_graph::MessageError;

/// Refuses a size other than the expected one.
pub(super) fn size(what: &'static str, found: usize, expected: usize) -> Result<(), MessageError> {
    if found == expected { Ok(()) } else { Err(MessageError::Dimension { what, found, expected }) }
}

/// Refuses the first number that is infinite or no number.
pub(super) fn finite<'a>(
    what: &'static str,
    values: impl IntoIterator<Item = &'a f64>,
) -> Result<(), MessageError> {
    match values.into_iter().find(|value| !value.is_finite()) {
        Some(&value) => Err(MessageError::NotFinite { what, value }),
        None => Ok(()),
    }
}

/// Refuses a number that is not positive and finite.
pub(super) fn positive(what: &'static str, value: f64) -> Result<(), MessageError> {
    if value > 0.0 && value.is_finite() {
        return Ok(());
    }
    Err(MessageError::NotPositiveDefinite { what, pivot: 0, value })
}

/// Refuses the first coordinate that a variable of this dimension does not have.
pub(super) fn coordinates(what: &'static str, read: &[usize], dimension: usize) -> Result<(), MessageError> {
    match read.iter().find(|&&index| index >= dimension) {
        Some(&index) => Err(MessageError::Coordinate { what, index, dimension }),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn refusals_say_the_number_and_what_is_expected() {
        let said = |result: Result<(), MessageError>| result.unwrap_err().to_string();
        assert_eq!(said(size("the noise", 2, 1)), "the noise has dimension 2, expected 1");
        assert_eq!(said(finite("the range", &[1.0, f64::INFINITY])), "the range is inf");
        assert_eq!(
            said(coordinates("the position", &[0, 4], 3)),
            "the position reads coordinate 4, expected one below the variable's dimension 3"
        );
        assert_eq!(
            (size("", 0, 0), finite("", &[0.0]), coordinates("", &[2, 0], 3)),
            (Ok(()), Ok(()), Ok(()))
        );
    }
}
