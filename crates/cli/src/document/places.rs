//! Where a dotted key stands in a TOML text.

use std::ops::Range;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// Bytes of the key (or of the array element) that `path` names, as in `world.links[2].length`, or of its innermost
/// part that the text has; `None` if not even its first part is there.
pub fn find(text: &str, path: &str) -> Option<Range<usize>> {
    let document = DeTable::parse(text).ok()?;
    let mut found = None;
    let mut value: Option<&Spanned<DeValue<'_>>> = None;
    for part in path.split(['.', '[']) {
        let index = part.strip_suffix(']').and_then(|index| index.parse::<usize>().ok());
        let next = match (value.map(Spanned::get_ref), index) {
            (Some(DeValue::Array(array)), Some(index)) => {
                array.get(index).map(|element| (element.span(), element))
            }
            (None, None) => entry(document.get_ref(), part),
            (Some(DeValue::Table(table)), None) => entry(table, part),
            _ => None,
        };
        let Some((span, inner)) = next else {
            break;
        };
        found = Some(span);
        value = Some(inner);
    }
    found
}

fn entry<'a, 'i>(table: &'a DeTable<'i>, name: &str) -> Option<(Range<usize>, &'a Spanned<DeValue<'i>>)> {
    let (key, value) = table.iter().find(|(key, _)| key.get_ref().as_ref() == name)?;
    Some((key.span(), value))
}

/// Line of a byte, from 1.
pub fn line(text: &str, byte: usize) -> usize {
    text.as_bytes().iter().take(byte).filter(|&&byte| byte == b'\n').count() + 1
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "\
system = \"s\"

[world]
steps = 3
links = [
    { length = 1 },
    { length = 2 },
]

[method.kf]
form = { range = \"gaussian\" }
";

    fn line_of(path: &str) -> Option<usize> {
        find(TEXT, path).map(|span| line(TEXT, span.start))
    }

    #[test]
    fn keys_are_found_through_tables_inline_tables_and_arrays() {
        assert_eq!(line_of("system"), Some(1));
        assert_eq!(line_of("world.steps"), Some(4));
        assert_eq!(line_of("world.links[1].length"), Some(7));
        assert_eq!(line_of("method.kf.form.range"), Some(11));
        assert_eq!(&TEXT[find(TEXT, "world.steps").unwrap()], "steps");
    }

    #[test]
    fn a_missing_key_is_sought_at_its_table() {
        assert_eq!(line_of("world.noise"), Some(3));
        assert_eq!(line_of("world.links[9]"), Some(5));
        assert_eq!(line_of("world.steps.more"), Some(4));
        assert_eq!(line_of("output"), None);
    }
}
