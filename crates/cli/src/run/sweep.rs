//! `--sweep`: the scenario at every value of a key, in one table.

use std::path::PathBuf;

use serde::Serialize;
use serde_json::{Map, Value};
use sumprod_positioning::metrics::Report;
use sumprod_positioning::scenario::Scenario;

use super::{Run, report};
use crate::args::RunArguments;
use crate::document::Document;
use crate::failure::Failure;
use crate::output::{self, Folder};
use crate::setup;
use crate::systems::{Action, dispatch};
use crate::table::{Align, Table};

/// The reports of all points.
#[derive(Serialize)]
pub struct Swept {
    /// Name of the scenario.
    scenario: String,
    /// The keys that differ between the points.
    #[serde(skip)]
    keys: Vec<String>,
    /// The points, in the order of the command line.
    sweep: Vec<Point>,
}

/// One combination of values.
#[derive(Serialize)]
pub struct Point {
    /// The values by key.
    values: Map<String, Value>,
    #[serde(flatten)]
    report: Report,
}

impl Swept {
    /// The one key that is swept and the reports by its values, if all of them are numbers.
    pub fn curve(&self) -> Option<(&str, Vec<(f64, &Report)>)> {
        let [key] = &self.keys[..] else { return None };
        let points = self.sweep.iter().map(|point| Some((point.values.get(key)?.as_f64()?, &point.report)));
        let mut points = points.collect::<Option<Vec<_>>>()?;
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        Some((key, points))
    }
}

/// Runs every point. All are read and checked before the first one runs.
///
/// # Errors
/// As a run without a sweep, and for a sweep that is not `KEY=A,B,C` or names a key twice.
pub fn run(arguments: &RunArguments, extra: &[String]) -> Result<Swept, Failure> {
    let axes = arguments.sweep.iter().map(|text| axis(text)).collect::<Result<Vec<_>, _>>()?;
    let keys: Vec<String> = axes.iter().map(|(key, _)| key.clone()).collect();
    if let Some(twice) = keys.iter().enumerate().find(|(i, key)| keys[..*i].contains(key)) {
        let sentence = format!("--sweep names `{}` twice; give its values in one list", twice.1);
        return Err(Failure::input(sentence));
    }
    let documents = combinations(&axes)
        .into_iter()
        .map(|sets| {
            let all: Vec<String> = extra.iter().chain(&sets).cloned().collect();
            let document = setup::document(&arguments.scenario, &all)?;
            let plots = dispatch(&document, Check)?;
            Ok((sets, document, plots))
        })
        .collect::<Result<Vec<_>, Failure>>()?;

    let folder = arguments.out.as_deref().map(Folder::open).transpose()?;
    let mut sweep = Vec::new();
    for (sets, document, _) in &documents {
        let out: Option<PathBuf> = arguments.out.as_ref().map(|folder| folder.join(folder_name(sets)));
        let report = dispatch(document, Run { arguments, out: out.as_deref() })?;
        let values = sets.iter().filter_map(|set| set.split_once('='));
        let values = values.map(|(key, value)| (key.to_owned(), json(value))).collect();
        sweep.push(Point { values, report });
    }
    let scenario = sweep.first().map_or(String::new(), |point| point.report.scenario.clone());
    let swept = Swept { scenario, keys, sweep };
    if let Some(folder) = folder {
        let plots = documents.iter().any(|(_, _, plots)| *plots);
        output::write_sweep(&folder, plots, &swept)?;
    }
    Ok(swept)
}

/// One table over all points.
pub fn text(swept: &Swept) -> String {
    let own = swept.keys.iter().map(|key| (key.as_str(), Align::Right));
    let mut table = Table::new(&own.chain(report::columns()).collect::<Vec<_>>());
    for point in &swept.sweep {
        for row in report::rows(&point.report) {
            let values = swept.keys.iter().map(|key| match point.values.get(key) {
                Some(Value::String(text)) => text.clone(),
                other => other.map_or(String::new(), Value::to_string),
            });
            table.row(values.chain(row).collect());
        }
    }
    let about = swept.sweep.first().map_or(String::new(), |point| {
        format!("{} a point, seed {}", report::runs(&point.report), point.report.seed)
    });
    format!("{}: sweep of {}, {about}\n\n{table}", swept.scenario, swept.keys.join(" and "))
}

/// Reads a scenario, and says whether it wants plots.
struct Check;

impl Action for Check {
    type Output = bool;

    fn on<S: Scenario>(self, document: &Document) -> Result<bool, Failure> {
        document.read::<S>().map(|(settings, _)| settings.output.plots)
    }
}

/// A key and its values as they were written.
fn axis(text: &str) -> Result<(String, Vec<String>), Failure> {
    let wrong = |problem: &str| Failure::input(format!("--sweep {text}: {problem}, as in world.steps=20,40"));
    let (key, values) = text.split_once('=').ok_or_else(|| wrong("write KEY=A,B,C"))?;
    let values: Vec<String> = split(values).into_iter().map(|value| value.trim().to_owned()).collect();
    if values.iter().any(String::is_empty) {
        return Err(wrong("a value is missing"));
    }
    if let Some((_, twice)) = values.iter().enumerate().find(|(i, value)| values[..*i].contains(value)) {
        return Err(wrong(&format!("the value {twice} is there twice; give each once")));
    }
    Ok((key.trim().to_owned(), values))
}

/// Splits at commas outside of brackets, braces and quotes.
fn split(text: &str) -> Vec<&str> {
    let (mut depth, mut quote, mut start, mut parts) = (0_usize, None, 0, Vec::new());
    for (at, letter) in text.char_indices() {
        match letter {
            '"' | '\'' if quote.is_none() => quote = Some(letter),
            _ if quote.is_some() => quote = quote.filter(|&open| open != letter),
            '[' | '{' => depth += 1,
            ']' | '}' => depth = depth.saturating_sub(1),
            ',' if depth == 0 => {
                parts.push(&text[start..at]);
                start = at + 1;
            }
            _ => {}
        }
    }
    parts.push(&text[start..]);
    parts
}

/// Every combination of values, as overrides `key=value`; the last axis turns fastest.
fn combinations(axes: &[(String, Vec<String>)]) -> Vec<Vec<String>> {
    axes.iter().fold(vec![Vec::new()], |points, (key, values)| {
        points
            .iter()
            .flat_map(|point| {
                values.iter().map(move |value| {
                    let mut longer = point.clone();
                    longer.push(format!("{key}={value}"));
                    longer
                })
            })
            .collect()
    })
}

/// The folder of a point: its overrides, without what file systems refuse.
fn folder_name(sets: &[String]) -> String {
    let keep = |letter: char| letter.is_alphanumeric() || "._=+-,".contains(letter);
    sets.join(",").chars().map(|letter| if keep(letter) { letter } else { '_' }).collect()
}

/// A value as JSON: what TOML makes of it, else the bare string.
fn json(value: &str) -> Value {
    let read = value.parse::<toml::Value>().ok().and_then(|value| serde_json::to_value(value).ok());
    read.unwrap_or_else(|| Value::String(value.to_owned()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_split_outside_of_brackets_and_quotes() {
        let (key, values) = axis("a.b=1, [2,3],\"x,y\",{c = 1, d = 2}").unwrap();
        assert_eq!(key, "a.b");
        assert_eq!(values, ["1", "[2,3]", "\"x,y\"", "{c = 1, d = 2}"]);
        assert_eq!(json("[2,3]"), serde_json::json!([2, 3]));
        assert_eq!(json("joint"), serde_json::json!("joint"));
    }

    #[test]
    fn two_sweeps_make_every_combination() {
        let axes = [axis("a=1,2").unwrap(), axis("b=x,y").unwrap()];
        let points: Vec<String> = combinations(&axes).iter().map(|point| point.join(" ")).collect();
        assert_eq!(points, ["a=1 b=x", "a=1 b=y", "a=2 b=x", "a=2 b=y"]);
        assert_eq!(folder_name(&["a=[1/2]".into()]), "a=_1_2_");
    }

    #[test]
    fn wrong_sweeps_say_what_to_write() {
        for (text, part) in [("a", "write KEY=A,B,C"), ("a=1,,2", "missing"), ("a=1,2,1", "1 is there twice")]
        {
            let failure = axis(text).unwrap_err();
            assert_eq!(failure.status(), 2);
            assert!(failure.sentence().contains(part), "{}", failure.sentence());
        }
    }
}
