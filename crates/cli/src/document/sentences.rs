//! What serde says about a document, in words for whoever wrote it.

/// Names within this similarity (Jaro–Winkler, 0 to 1) are offered as what was meant.
const SIMILAR: f64 = 0.8;

/// The dotted key that an error is about and the rest of the sentence, from the path at which reading stopped and
/// serde's message. `also` are keys that the top level knows besides those in the message.
pub fn of_serde(path: &str, message: &str, also: &[&str]) -> (String, String) {
    let path = if path == "." { "" } else { path };
    let message = message.lines().next().unwrap_or(message);
    if let Some((name, mut known)) = named(message, "unknown field ") {
        let parent = match path.strip_suffix(name) {
            Some(rest) if rest.is_empty() || rest.ends_with('.') => rest.trim_end_matches('.'),
            _ => path,
        };
        if parent.is_empty() {
            known.extend(also);
        }
        let hint = match nearest(name, &known) {
            Some(near) => format!("did you mean `{}`?", join(parent, near)),
            None if known.is_empty() => "no key is known here".to_owned(),
            None => format!("known here: {}", known.join(", ")),
        };
        return (join(parent, name), format!("is an unknown key; {hint}"));
    }
    if let Some((name, known)) = named(message, "unknown variant ") {
        return (
            path.to_owned(),
            format!("is `{name}`, which does not exist; choose one of {}", known.join(", ")),
        );
    }
    if let Some((name, _)) = named(message, "missing field ") {
        return (join(path, name), "is missing; add it".to_owned());
    }
    if let Some((found, expected)) =
        message.strip_prefix("invalid type: ").and_then(|rest| rest.split_once(", expected "))
    {
        return (path.to_owned(), format!("is {}; it must be {}", plain(found), plain(expected)));
    }
    if let Some((found, expected)) =
        message.strip_prefix("invalid value: ").and_then(|rest| rest.split_once(", expected "))
    {
        return (path.to_owned(), format!("is {}; it must be {}", plain(found), plain(expected)));
    }
    (path.to_owned(), format!("cannot be used: {message}"))
}

/// The candidate that `name` most resembles, if it resembles one.
pub fn nearest<'a>(name: &str, candidates: &[&'a str]) -> Option<&'a str> {
    candidates
        .iter()
        .map(|&candidate| (strsim::jaro_winkler(name, candidate), candidate))
        .filter(|&(similarity, _)| similarity >= SIMILAR)
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, candidate)| candidate)
}

/// The name in back quotes after `prefix`, and all names in back quotes after it.
fn named<'a>(message: &'a str, prefix: &str) -> Option<(&'a str, Vec<&'a str>)> {
    let mut quoted = message.strip_prefix(prefix)?.split('`').skip(1).step_by(2);
    let name = quoted.next()?;
    Some((name, quoted.collect()))
}

/// Rust's type names in words.
fn plain(what: &str) -> String {
    match what {
        "u8" | "u16" | "u32" | "u64" | "usize" => "a whole number that is not negative".to_owned(),
        "i32" | "i64" => "a whole number".to_owned(),
        "f32" | "f64" => "a number".to_owned(),
        "a boolean" => "true or false".to_owned(),
        "a sequence" => "an array".to_owned(),
        "map" | "a map" => "a table".to_owned(),
        // What the TOML reader says of anything but a text where a name is wanted.
        "unit variant" => "no text".to_owned(),
        "string only" | "variant identifier" => "a name in quotes".to_owned(),
        other => {
            match other.strip_prefix("struct ").or_else(|| other.strip_prefix("internally tagged enum ")) {
                Some(_) => "a table".to_owned(),
                None => other
                    .replace("floating point `", "`")
                    .replace("integer `", "`")
                    .replace("boolean `", "`")
                    .replace("string \"", "the text \""),
            }
        }
    }
}

fn join(parent: &str, name: &str) -> String {
    if parent.is_empty() { name.to_owned() } else { format!("{parent}.{name}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_are_put_in_words() {
        for (path, message, key, problem) in [
            (
                "world.stesp",
                "unknown field `stesp`, expected `steps` or `noise`",
                "world.stesp",
                "is an unknown key; did you mean `world.steps`?",
            ),
            (
                ".",
                "unknown field `xyz`, expected `world`",
                "xyz",
                "is an unknown key; known here: world, runs",
            ),
            ("world", "missing field `steps`", "world.steps", "is missing; add it"),
            (
                "world.anchors",
                "invalid type: unit variant, expected string only",
                "world.anchors",
                "is no text; it must be a name in quotes",
            ),
            (
                "method.a.form.range",
                "unknown variant `gausian`, expected `gaussian` or `particles`",
                "method.a.form.range",
                "is `gausian`, which does not exist; choose one of gaussian, particles",
            ),
            (
                "world.steps",
                "invalid type: string \"ten\", expected u32",
                "world.steps",
                "is the text \"ten\"; it must be a whole number that is not negative",
            ),
            (
                "world.steps",
                "invalid value: integer `-3`, expected u32",
                "world.steps",
                "is `-3`; it must be a whole number that is not negative",
            ),
        ] {
            assert_eq!(of_serde(path, message, &["runs"]), (key.to_owned(), problem.to_owned()));
        }
    }

    #[test]
    fn only_similar_names_are_offered() {
        assert_eq!(nearest("coop-c1", &["pmpa-cdf", "coop-c10"]), Some("coop-c10"));
        assert_eq!(nearest("zebra", &["pmpa-cdf", "coop-c10"]), None);
    }
}
