//! Names and lists as a reader wants them.

/// `a`, `a and b`, `a, b and c`.
pub(super) fn list(items: &[String]) -> String {
    match items {
        [] => "nothing".to_owned(),
        [one] => one.clone(),
        [rest @ .., last] => format!("{} and {last}", rest.join(", ")),
    }
}

/// A few names in full, many by the first, the last and their number.
pub(super) fn names(names: &[String]) -> String {
    match names {
        [] => "no variable".to_owned(),
        [one] => one.clone(),
        [first, .., last] if names.len() > 4 => format!("{first} … {last} ({} variables)", names.len()),
        several => list(several),
    }
}
