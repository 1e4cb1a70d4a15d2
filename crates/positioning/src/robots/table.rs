//! Files of numbers: one record a line, every mistake named with its file, line and field.

use std::fs;
use std::path::{Path, PathBuf};

use crate::PositioningError;

/// How the fields of a line are set apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Separator {
    /// Any run of spaces and tabs; there is no header.
    Blank,
    /// Commas; the first line names the fields.
    Comma,
}

/// One line of `N` numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Record<const N: usize> {
    /// The line it stood on, from 1.
    pub line: usize,
    /// Its fields, all finite.
    pub values: [f64; N],
}

/// A file of records of `N` numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct Table<const N: usize> {
    path: PathBuf,
    fields: [&'static str; N],
    records: Vec<Record<N>>,
}

impl<const N: usize> Table<N> {
    /// Reads a file whose fields are called `fields` (name and unit). Empty lines and lines that begin with `#` are
    /// skipped.
    ///
    /// # Errors
    /// [`PositioningError::Data`] naming file, line and field: a file that cannot be read or holds no record, a line
    /// with more or fewer fields, a field that is no number or not finite, a header that names other fields.
    pub fn read(
        path: &Path,
        separator: Separator,
        fields: [&'static str; N],
    ) -> Result<Self, PositioningError> {
        let text = fs::read_to_string(path)
            .map_err(|error| PositioningError::data(path, None, format!("cannot be read: {error}")))?;
        let mut lines = text
            .lines()
            .enumerate()
            .map(|(index, line)| (index + 1, line.trim()))
            .filter(|(_, line)| !line.is_empty() && !line.starts_with('#'));
        if separator == Separator::Comma {
            check_header(path, lines.next(), &fields)?;
        }
        let records: Vec<Record<N>> = lines
            .map(|(line, text)| {
                let values = parse(text, separator, &fields)
                    .map_err(|problem| PositioningError::data(path, Some(line), problem))?;
                Ok(Record { line, values })
            })
            .collect::<Result<_, PositioningError>>()?;
        if records.is_empty() {
            let problem = format!("holds no record; expected lines of {}", fields.join(", "));
            return Err(PositioningError::data(path, None, problem));
        }
        Ok(Self { path: path.to_path_buf(), fields, records })
    }

    /// The records in the order of the file; at least one.
    pub fn records(&self) -> &[Record<N>] {
        &self.records
    }

    /// Checks that a field rises from record to record, or with `ties` that it never falls.
    ///
    /// # Errors
    /// [`PositioningError::Data`] at the first line where it does not.
    pub fn check_rising(&self, field: usize, ties: bool) -> Result<(), PositioningError> {
        for pair in self.records.windows(2) {
            let (before, now) = (pair[0].values[field], pair[1].values[field]);
            if now < before || (now == before && !ties) {
                let relation = if now < before { "before" } else { "no later than" };
                let problem = format!(
                    "{} is {now}, {relation} the {before} of line {}; times must increase",
                    self.fields[field], pair[0].line
                );
                return Err(self.wrong(&pair[1], problem));
            }
        }
        Ok(())
    }

    /// Checks that a field is above zero in every record.
    ///
    /// # Errors
    /// [`PositioningError::Data`] at the first line where it is not.
    pub fn check_positive(&self, field: usize) -> Result<(), PositioningError> {
        match self.records.iter().find(|record| record.values[field] <= 0.0) {
            None => Ok(()),
            Some(bad) => {
                let problem = format!("{} is {}; it must be positive", self.fields[field], bad.values[field]);
                Err(self.wrong(bad, problem))
            }
        }
    }

    /// A field that holds a number of something: a beacon, a barcode.
    ///
    /// # Errors
    /// [`PositioningError::Data`] where it is not a whole number from 0 to 2³².
    pub fn whole(&self, record: &Record<N>, field: usize) -> Result<u32, PositioningError> {
        let value = record.values[field];
        if value.fract() == 0.0 && (0.0..=f64::from(u32::MAX)).contains(&value) {
            return Ok(value as u32);
        }
        let problem = format!("{} is {value}; it must be a whole number", self.fields[field]);
        Err(self.wrong(record, problem))
    }

    /// A mistake on the line of a record.
    pub fn wrong(&self, record: &Record<N>, problem: impl Into<String>) -> PositioningError {
        PositioningError::data(&self.path, Some(record.line), problem)
    }
}

fn parse<const N: usize>(text: &str, separator: Separator, fields: &[&str; N]) -> Result<[f64; N], String> {
    let parts: Vec<&str> = split(text, separator);
    if parts.len() != N {
        let (found, names) = (parts.len(), fields.join(", "));
        let fault = if found < N { "is cut short" } else { "is too long" };
        return Err(format!("the line {fault}: {found} of {N} fields; expected {names}"));
    }
    let mut values = [0.0; N];
    for (index, (part, value)) in parts.iter().zip(&mut values).enumerate() {
        let field = || format!("field {} ({})", index + 1, fields[index]);
        let number: f64 =
            part.parse().map_err(|_| format!("{} is \"{part}\", which is no number", field()))?;
        if !number.is_finite() {
            return Err(format!("{} is {number}; it must be finite", field()));
        }
        *value = number;
    }
    Ok(values)
}

fn split(text: &str, separator: Separator) -> Vec<&str> {
    match separator {
        Separator::Blank => text.split_whitespace().collect(),
        Separator::Comma => text.split(',').map(str::trim).collect(),
    }
}

/// A header names as many fields as expected, none of them a number.
fn check_header<const N: usize>(
    path: &Path,
    header: Option<(usize, &str)>,
    fields: &[&str; N],
) -> Result<(), PositioningError> {
    let Some((line, text)) = header else { return Ok(()) };
    let names = split(text, Separator::Comma);
    if names.len() == N && names.iter().all(|name| name.parse::<f64>().is_err()) {
        return Ok(());
    }
    let problem = format!("expected a header that names {}", fields.join(", "));
    Err(PositioningError::data(path, Some(line), problem))
}

/// The files of a folder whose names begin and end so, as the part between and the path, sorted.
///
/// # Errors
/// [`PositioningError::Data`] where the folder does not exist or cannot be read.
pub fn matching(
    folder: &Path,
    prefix: &str,
    suffix: &str,
) -> Result<Vec<(String, PathBuf)>, PositioningError> {
    if !folder.is_dir() {
        let problem = if folder.exists() { "is a file, not a folder" } else { "there is no such folder" };
        return Err(PositioningError::data(folder, None, problem));
    }
    let unreadable =
        |error: std::io::Error| PositioningError::data(folder, None, format!("cannot be read: {error}"));
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).map_err(unreadable)? {
        let path = entry.map_err(unreadable)?.path();
        let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        if let Some(between) = name.strip_prefix(prefix).and_then(|rest| rest.strip_suffix(suffix)) {
            found.push((between.to_owned(), path));
        }
    }
    found.sort();
    Ok(found)
}

/// The one file of a folder whose name begins and ends so.
///
/// # Errors
/// [`PositioningError::Data`] where there is none or more than one, or no such folder.
pub fn only(folder: &Path, prefix: &str, suffix: &str) -> Result<PathBuf, PositioningError> {
    let mut found = matching(folder, prefix, suffix)?;
    let pattern = format!("{prefix}*{suffix}");
    match (found.pop(), found.pop()) {
        (Some((_, path)), None) => Ok(path),
        (None, _) => Err(PositioningError::data(folder, None, format!("holds no file {pattern}"))),
        (Some(_), Some(_)) => {
            let problem = format!("holds several files {pattern}; a recording has one");
            Err(PositioningError::data(folder, None, problem))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robots::scratch::Scratch;

    const FIELDS: [&str; 2] = ["time s", "range m"];

    fn read(text: &str, separator: Separator) -> Result<Table<2>, String> {
        let folder = Scratch::new();
        folder.write("a.dat", text);
        Table::read(&folder.path("a.dat"), separator, FIELDS)
            .map_err(|error| error.to_string().replace(&folder.path("").display().to_string(), ""))
    }

    #[test]
    fn comments_blanks_and_headers_are_skipped_and_lines_counted() {
        let table = read("# a comment\n\n 1.5 \t 2e1 \r\n2 3\n", Separator::Blank).unwrap();
        let expected = [Record { line: 3, values: [1.5, 20.0] }, Record { line: 4, values: [2.0, 3.0] }];
        assert_eq!(table.records(), expected);
        let table = read("t_s,r_m\n1, 2\n", Separator::Comma).unwrap();
        assert_eq!(table.records(), [Record { line: 2, values: [1.0, 2.0] }]);
    }

    #[test]
    fn a_mistake_is_named_with_its_file_line_and_field() {
        for (text, sentence) in [
            ("1 2\n3\n", "a.dat:2: the line is cut short: 1 of 2 fields; expected time s, range m"),
            ("1 2 3\n", "a.dat:1: the line is too long: 3 of 2 fields; expected time s, range m"),
            ("1 2\n# x\n3 abc\n", "a.dat:3: field 2 (range m) is \"abc\", which is no number"),
            ("1 NaN\n", "a.dat:1: field 2 (range m) is NaN; it must be finite"),
            ("-inf 1\n", "a.dat:1: field 1 (time s) is -inf; it must be finite"),
            ("# nothing\n", "a.dat: holds no record; expected lines of time s, range m"),
        ] {
            assert_eq!(read(text, Separator::Blank).unwrap_err(), sentence);
        }
        for text in ["1,2\n", "t_s\n1,2\n"] {
            let sentence = "a.dat:1: expected a header that names time s, range m";
            assert_eq!(read(text, Separator::Comma).unwrap_err(), sentence);
        }
    }

    #[test]
    fn values_are_checked_where_they_stand() {
        let table = read("1 2\n1 -3\n0.5 2.5\n", Separator::Blank).unwrap();
        let sentence = |result: Result<(), PositioningError>| result.unwrap_err().to_string();
        assert!(
            sentence(table.check_rising(0, false))
                .contains("a.dat:2: time s is 1, no later than the 1 of line 1; times must increase")
        );
        assert!(
            sentence(table.check_rising(0, true))
                .contains("a.dat:3: time s is 0.5, before the 1 of line 2; times must increase")
        );
        assert!(sentence(table.check_positive(1)).contains("a.dat:2: range m is -3; it must be positive"));
        assert_eq!(table.whole(&table.records()[0], 1).unwrap(), 2);
        assert!(table.whole(&table.records()[1], 1).is_err());
        assert!(table.whole(&table.records()[2], 1).is_err());
    }

    #[test]
    fn files_are_found_by_pattern() {
        let folder = Scratch::new();
        let sentence = |result: Result<PathBuf, PositioningError>| result.unwrap_err().to_string();
        assert!(sentence(only(&folder.path("none"), "P", "_D")).ends_with("there is no such folder"));
        assert!(sentence(only(&folder.path(""), "P", "_D")).ends_with("holds no file P*_D"));
        folder.write("P2_D", "");
        assert_eq!(only(&folder.path(""), "P", "_D").unwrap(), folder.path("P2_D"));
        assert!(sentence(only(&folder.path("P2_D"), "P", "_D")).ends_with("is a file, not a folder"));
        folder.write("P1_D", "");
        assert!(sentence(only(&folder.path(""), "P", "_D")).contains("several files P*_D"));
        let found: Vec<String> =
            matching(&folder.path(""), "P", "_D").unwrap().into_iter().map(|(between, _)| between).collect();
        assert_eq!(found, ["1", "2"]);
    }
}
