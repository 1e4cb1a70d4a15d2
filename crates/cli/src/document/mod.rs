//! A scenario as a document: where it comes from, what overrides it, and which line a wrong key is on.
//!
//! A file may start from a built-in scenario with `base = "NAME"` and gives only the keys that differ: tables are
//! merged key by key, while inline tables, arrays and plain values replace what the base has. `--set` replaces the
//! whole value of its key.

mod overrides;
mod places;
mod sentences;

use std::path::Path;

use serde::de::DeserializeOwned;
use sumprod_positioning::PositioningError;
use sumprod_positioning::scenario::{Scenario, Settings};
use toml::Table;
use toml::de::DeTable;

use crate::builtin::{self, BUILTINS};
use crate::failure::Failure;
use overrides::Override;

/// Built-in scenarios may start from others; a chain longer than this must be a circle.
const LONGEST_CHAIN: usize = 8;

/// A scenario after merging, with what is needed to name a wrong key's place.
#[derive(Debug)]
pub struct Document {
    /// File name, or the name of the built-in scenario.
    name: String,
    /// The file's own text, without its base.
    text: String,
    /// Keys after merging.
    table: Table,
    overrides: Vec<Override>,
}

impl Document {
    /// Reads a built-in scenario or a file, and applies the overrides `key=value`.
    ///
    /// # Errors
    /// An unknown scenario, a file that cannot be read or is not TOML, or an override without a key.
    pub fn load(scenario: &str, overrides: &[String]) -> Result<Self, Failure> {
        if let Some(builtin) = builtin::find(scenario) {
            return Self::parse(builtin.name, builtin.text, overrides);
        }
        let path = Path::new(scenario);
        if path.is_file() {
            let text = std::fs::read_to_string(path)
                .map_err(|error| Failure::input(format!("cannot read {scenario}: {error}")))?;
            return Self::parse(scenario, &text, overrides);
        }
        let names: Vec<&str> = BUILTINS.iter().map(|builtin| builtin.name).collect();
        let hint = match sentences::nearest(scenario, &names) {
            Some(near) => format!("did you mean `{near}`?"),
            None => "`sumprod list` shows the built-in ones".to_owned(),
        };
        Err(Failure::input(format!("{scenario} is neither a file nor a built-in scenario; {hint}")))
    }

    /// Reads a document from its text; `name` is what messages call it.
    ///
    /// # Errors
    /// As [`load`](Self::load).
    pub fn parse(name: &str, text: &str, overrides: &[String]) -> Result<Self, Failure> {
        let overrides = overrides.iter().map(|text| Override::parse(text)).collect::<Result<Vec<_>, _>>()?;
        let mut table = merged(name, text, 0)?;
        for change in &overrides {
            change.apply(&mut table)?;
        }
        Ok(Self { name: name.to_owned(), text: text.to_owned(), table, overrides })
    }

    /// The value of `system`.
    pub fn system(&self) -> Result<&str, Failure> {
        match self.table.get("system") {
            Some(toml::Value::String(system)) => Ok(system),
            Some(_) => Err(self.wrong("system", "must be a string")),
            None => {
                let problem =
                    "is missing; add the name of a system, or base = \"NAME\" of a built-in scenario";
                Err(self.wrong("system", problem))
            }
        }
    }

    /// Reads and checks the common settings and the system's own keys.
    ///
    /// # Errors
    /// An unknown or missing key, a value of the wrong type, or one that the system refuses.
    pub fn read<S: Scenario>(&self) -> Result<(Settings, S), Failure> {
        let mut own = self.table.clone();
        let mut common = Table::new();
        for key in Settings::KEYS {
            if let Some(value) = own.remove(key) {
                common.insert(key.to_owned(), value);
            }
        }
        let settings: Settings = self.deserialize(common)?;
        let scenario: S = self.deserialize(own)?;
        settings.validate().and_then(|()| scenario.validate()).map_err(|error| self.explain(error))?;
        Ok((settings, scenario))
    }

    fn deserialize<T: DeserializeOwned>(&self, table: Table) -> Result<T, Failure> {
        serde_path_to_error::deserialize(toml::Value::Table(table)).map_err(|error| {
            let (key, problem) =
                sentences::of_serde(&error.path().to_string(), error.inner().message(), &Settings::KEYS);
            self.wrong(&key, &problem)
        })
    }

    /// A failure at a dotted key: on the command line if it was set there, else on its line of the file.
    pub fn wrong(&self, key: &str, problem: &str) -> Failure {
        let sentence = format!("`{key}` {problem}");
        if let Some(change) = self.overrides.iter().rev().find(|change| change.concerns(key)) {
            return Failure::input(format!("--set {}: {sentence}", change.text()));
        }
        match places::find(&self.text, key) {
            Some(span) => {
                let line = places::line(&self.text, span.start);
                Failure::input(format!("{}:{line}: {sentence}", self.name)).at(&self.name, &self.text, span)
            }
            None => Failure::input(format!("{}: {sentence}", self.name)),
        }
    }

    /// A failure of the library, with the place of the key if it is about one.
    pub fn explain(&self, error: PositioningError) -> Failure {
        match error {
            PositioningError::Setting { key, problem } => self.wrong(&key, &problem),
            PositioningError::Run { source, .. } if matches!(*source, PositioningError::Setting { .. }) => {
                self.explain(*source)
            }
            other => other.into(),
        }
    }
}

/// The document with its base below it.
fn merged(name: &str, text: &str, depth: usize) -> Result<Table, Failure> {
    let parsed = DeTable::parse(text).map_err(|error| broken(name, text, &error))?;
    let plain: Table = toml::from_str(text).map_err(|error| broken(name, text, &error))?;
    let Some(base) = plain.get("base") else {
        return Ok(named(name, plain));
    };
    let spot = |problem: String| {
        let sentence = format!("`base` {problem}");
        match places::find(text, "base") {
            Some(span) => {
                let line = places::line(text, span.start);
                Failure::input(format!("{name}:{line}: {sentence}")).at(name, text, span)
            }
            None => Failure::input(format!("{name}: {sentence}")),
        }
    };
    let Some(builtin) = base.as_str().and_then(builtin::find) else {
        let problem = format!("is {base}, which is no built-in scenario; `sumprod list` shows them");
        return Err(spot(problem));
    };
    if depth >= LONGEST_CHAIN {
        return Err(spot("leads round in a circle".to_owned()));
    }
    let mut table = merged(builtin.name, builtin.text, depth + 1)?;
    overrides::merge(&mut table, &plain, parsed.get_ref(), text);
    table.remove("base");
    if !plain.contains_key("name") {
        table.remove("name");
    }
    Ok(named(name, table))
}

/// Calls a scenario without a name by its file's.
fn named(name: &str, mut table: Table) -> Table {
    if !table.contains_key("name") {
        let stem =
            Path::new(name).file_stem().map_or(name.into(), |stem| stem.to_string_lossy().into_owned());
        table.insert("name".to_owned(), toml::Value::String(stem));
    }
    table
}

fn broken(name: &str, text: &str, error: &toml::de::Error) -> Failure {
    let message = error.message().lines().collect::<Vec<_>>().join(", ");
    match error.span() {
        Some(span) => {
            let line = places::line(text, span.start);
            Failure::input(format!("{name}:{line}: this is not TOML: {message}")).at(name, text, span)
        }
        None => Failure::input(format!("{name}: this is not TOML: {message}")),
    }
}

#[cfg(test)]
mod tests;
