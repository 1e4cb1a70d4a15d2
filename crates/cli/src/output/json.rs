//! JSON that a person can read: one key a line, arrays on one.

use std::io::{self, Write};

use serde::Serialize;
use serde_json::Serializer;
use serde_json::ser::{Formatter, PrettyFormatter};

use crate::failure::Failure;

/// `value` as JSON, indented, with arrays on one line.
pub fn json(value: &impl Serialize) -> Result<String, Failure> {
    let wrong = |error: &dyn std::fmt::Display| Failure::running(format!("cannot write JSON: {error}"));
    let mut bytes = Vec::new();
    let mut serializer = Serializer::with_formatter(&mut bytes, FlatArrays(PrettyFormatter::new()));
    value.serialize(&mut serializer).map_err(|error| wrong(&error))?;
    String::from_utf8(bytes).map_err(|error| wrong(&error))
}

/// Objects as [`PrettyFormatter`] writes them; arrays as the trait's defaults do.
struct FlatArrays(PrettyFormatter<'static>);

impl Formatter for FlatArrays {
    fn begin_array_value<W: ?Sized + Write>(&mut self, writer: &mut W, first: bool) -> io::Result<()> {
        if first { Ok(()) } else { writer.write_all(b", ") }
    }

    fn begin_object<W: ?Sized + Write>(&mut self, writer: &mut W) -> io::Result<()> {
        self.0.begin_object(writer)
    }

    fn end_object<W: ?Sized + Write>(&mut self, writer: &mut W) -> io::Result<()> {
        self.0.end_object(writer)
    }

    fn begin_object_key<W: ?Sized + Write>(&mut self, writer: &mut W, first: bool) -> io::Result<()> {
        self.0.begin_object_key(writer, first)
    }

    fn begin_object_value<W: ?Sized + Write>(&mut self, writer: &mut W) -> io::Result<()> {
        self.0.begin_object_value(writer)
    }

    fn end_object_value<W: ?Sized + Write>(&mut self, writer: &mut W) -> io::Result<()> {
        self.0.end_object_value(writer)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrays_stay_on_one_line() {
        let value = serde_json::json!({"a": [1, 2.5, 3], "b": {"c": "d"}});
        let expected = "{\n  \"a\": [1, 2.5, 3],\n  \"b\": {\n    \"c\": \"d\"\n  }\n}";
        assert_eq!(json(&value).unwrap(), expected);
    }
}
