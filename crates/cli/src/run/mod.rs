//! `sumprod run`: all methods on the same runs, then a table, and files where a folder is named.

mod report;
mod sweep;

use std::path::Path;
use std::time::{Duration, UNIX_EPOCH};

use indicatif::{ProgressBar, ProgressStyle};
use sumprod_positioning::PositioningError;
use sumprod_positioning::campaign::{Campaign, Fingerprint, LogState, RunLog};
use sumprod_positioning::metrics::Report;
use sumprod_positioning::scenario::Scenario;

use crate::args::RunArguments;
use crate::document::Document;
use crate::failure::Failure;
use crate::output::{self, Folder};
use crate::print::print;
use crate::setup::{self, Setup};
use crate::systems::{Action, dispatch};
pub use sweep::Swept;

/// One scenario, and the folder for its files.
struct Run<'a> {
    arguments: &'a RunArguments,
    out: Option<&'a Path>,
}

impl Action for Run<'_> {
    type Output = Report;

    fn on<S: Scenario>(self, document: &Document) -> Result<Report, Failure> {
        let Setup { settings, scenario, methods, data, prepared } =
            Setup::<S>::new(document, &self.arguments.scenario)?;
        let explain = |error: PositioningError| document.explain(error);
        let campaign =
            Campaign::new(&scenario, &prepared, settings.seed, settings.runs, &methods).map_err(explain)?;

        let folder = self.out.map(Folder::open).transpose()?;
        let mut log = None;
        if let Some(folder) = &folder {
            let mark = fingerprint(&scenario, settings.seed, &methods, data.as_deref())?;
            log = Some(folder.run_log(&mark)?);
        }
        if let Some(log) = &log {
            announce(log);
        }

        let bar = progress_bar(&settings.name, settings.runs, methods.len());
        let results = campaign.run(log, &|finished, _| bar.set_position(finished as u64));
        bar.finish_and_clear();
        let results = results.map_err(explain)?;
        let report = Report::new(&settings.name, settings.seed, &results).map_err(explain)?;
        if let Some(folder) = folder {
            let names = output::write(&folder, &settings.output, &report, &results)?;
            eprintln!("note: {} now holds {}", folder.path().display(), names.join(", "));
        }
        Ok(report)
    }
}

/// Runs the scenario, or every point of its sweep, and prints the metrics.
pub fn execute(arguments: &RunArguments) -> Result<(), Failure> {
    let runs = arguments.runs.map(|runs| format!("runs={runs}"));
    let (json, text) = if arguments.sweep.is_empty() {
        let document = setup::document(&arguments.scenario, runs.as_slice())?;
        let report = dispatch(&document, Run { arguments, out: arguments.out.as_deref() })?;
        (output::json(&report)?, report::text(&report))
    } else {
        let swept = sweep::run(arguments, runs.as_slice())?;
        (output::json(&swept)?, sweep::text(&swept))
    };
    if arguments.json { print(&(json + "\n")) } else { print(&text) }
}

/// Everything that decides what a run computes: the keys, the data as they are now, and this very program.
fn fingerprint<S: Scenario>(
    scenario: &S,
    seed: u64,
    methods: &[String],
    data: Option<&Path>,
) -> Result<Fingerprint, Failure> {
    let keys = serde_json::to_value(scenario)
        .map_err(|error| Failure::running(format!("the scenario cannot be written as JSON: {error}")))?;
    let scenario = serde_json::json!({
        "system": S::SYSTEM,
        "keys": keys,
        "seed": seed,
        "methods": methods,
        "data": data.map(files),
    });
    let build = std::env::current_exe().ok().and_then(|path| age(&path));
    Ok(Fingerprint { program: format!("sumprod {} {build:?}", env!("CARGO_PKG_VERSION")), scenario })
}

/// Name, length and age of the recording's files.
fn files(path: &Path) -> Vec<(String, Option<(u64, u128)>)> {
    let mut found: Vec<_> = match std::fs::read_dir(path) {
        Ok(entries) => entries.flatten().map(|entry| entry.path()).collect(),
        Err(_) => vec![path.to_path_buf()],
    };
    found.sort();
    found.iter().map(|path| (path.display().to_string(), age(path))).collect()
}

fn age(path: &Path) -> Option<(u64, u128)> {
    let metadata = path.metadata().ok()?;
    let modified = metadata.modified().ok()?.duration_since(UNIX_EPOCH).ok()?;
    Some((metadata.len(), modified.as_nanos()))
}

fn announce(log: &RunLog) {
    match log.state() {
        LogState::New | LogState::Resumed(0) => {}
        LogState::Resumed(1) => eprintln!("note: 1 run was finished before and is not repeated"),
        LogState::Resumed(runs) => eprintln!("note: {runs} runs were finished before and are not repeated"),
        LogState::Replaced => {
            eprintln!(
                "note: the runs in the output folder are of another scenario, seed, choice of methods or program; they are kept in runs.before.jsonl"
            );
        }
    }
}

/// Draws on standard error, and only if that is a terminal.
fn progress_bar(name: &str, runs: u32, methods: usize) -> ProgressBar {
    let (bar, template) = if runs == 1 {
        (ProgressBar::new_spinner(), "{msg} {spinner} {elapsed}")
    } else {
        (ProgressBar::new(u64::from(runs)), "{msg} [{bar:40}] {pos}/{len} runs, {eta} left")
    };
    if let Ok(style) = ProgressStyle::with_template(template) {
        bar.set_style(style.progress_chars("━╸ "));
    }
    let methods = if methods == 1 { "1 method".to_owned() } else { format!("{methods} methods") };
    bar.set_message(format!("{name}, {methods}"));
    bar.enable_steady_tick(Duration::from_millis(200));
    bar
}

#[cfg(test)]
mod tests;
