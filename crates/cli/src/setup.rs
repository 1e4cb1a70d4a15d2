//! From the command line to a scenario that is ready to run.

use std::path::{Path, PathBuf};

use sumprod_positioning::campaign::choose_methods;
use sumprod_positioning::scenario::{Scenario, Settings};

use crate::args::ScenarioArguments;
use crate::document::Document;
use crate::failure::Failure;

/// Folder of data sets, relative to the working directory, if the environment names none.
const DATA_FOLDER: &str = "../shared/data";
/// Environment variable that names the folder of data sets.
const DATA_VARIABLE: &str = "SUMPROD_DATA";

/// A scenario that is ready to run.
pub struct Setup<S: Scenario> {
    pub settings: Settings,
    pub scenario: S,
    pub methods: Vec<String>,
    pub data: Option<PathBuf>,
    pub prepared: S::Prepared,
}

/// Loads the document that the command line names; `extra` are overrides from other options.
pub fn document(arguments: &ScenarioArguments, extra: &[String]) -> Result<Document, Failure> {
    let mut overrides = arguments.set.clone();
    overrides.extend(arguments.seed.map(|seed| format!("seed={seed}")));
    overrides.extend_from_slice(extra);
    Document::load(&arguments.scenario, &overrides)
}

impl<S: Scenario> Setup<S> {
    /// Reads, checks and prepares.
    ///
    /// # Errors
    /// Wrong input of any kind.
    pub fn new(document: &Document, arguments: &ScenarioArguments) -> Result<Self, Failure> {
        let (settings, scenario) = document.read::<S>()?;
        let methods =
            choose_methods(&scenario, &arguments.method).map_err(|error| document.explain(error))?;
        let given = arguments.data.as_deref();
        let data = match (S::READS_DATA, given) {
            (true, _) => Some(recording(given, settings.data.as_deref())?),
            (false, None) => None,
            (false, Some(path)) => {
                let sentence =
                    format!("--data {}: this scenario reads no data; leave it out", path.display());
                return Err(Failure::input(sentence));
            }
        };
        let prepared =
            scenario.prepare(settings.seed, data.as_deref()).map_err(|error| document.explain(error))?;
        Ok(Self { settings, scenario, methods, data, prepared })
    }
}

fn recording(given: Option<&Path>, subfolder: Option<&str>) -> Result<PathBuf, Failure> {
    if let Some(path) = given {
        return if path.exists() {
            Ok(path.to_path_buf())
        } else {
            Err(Failure::input(format!("--data {}: there is no such file or folder", path.display())))
        };
    }
    let Some(subfolder) = subfolder else {
        return Err(Failure::input("this scenario reads recorded data; name it with --data PATH"));
    };
    let root = std::env::var_os(DATA_VARIABLE).map_or_else(|| PathBuf::from(DATA_FOLDER), PathBuf::from);
    let path = root.join(subfolder);
    if path.exists() {
        return Ok(path);
    }
    Err(Failure::input(format!(
        "the recording {subfolder} is not at {}; name it with --data PATH, or set {DATA_VARIABLE} to the folder of data sets",
        path.display()
    )))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_recording_says_where_it_was_sought() {
        let sentence = |given: Option<&str>, subfolder| {
            recording(given.map(Path::new), subfolder).unwrap_err().sentence().to_owned()
        };
        assert_eq!(sentence(Some("no/such"), None), "--data no/such: there is no such file or folder");
        assert!(sentence(None, None).contains("--data PATH"));
        assert!(sentence(None, Some("no/such")).starts_with("the recording no/such is not at "));
    }
}
