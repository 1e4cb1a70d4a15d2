//! The output folder: opened before anything is computed, its files written whole or not at all.

mod estimates;
mod json;

use std::fs;
use std::path::{Path, PathBuf};

use sumprod_positioning::PositioningError;
use sumprod_positioning::campaign::{Fingerprint, RunLog};
use sumprod_positioning::metrics::Report;
use sumprod_positioning::results::RunResult;
use sumprod_positioning::scenario::Output;

use crate::failure::Failure;
use crate::plots;
use crate::run::Swept;

pub use json::json;

/// File of finished runs within the folder.
const RUN_LOG: &str = "runs.jsonl";

/// A folder that can be written to. One that was made for a command that then finishes no run is removed again.
pub struct Folder {
    path: PathBuf,
    made: bool,
}

impl Folder {
    /// Makes the folder if it is not there.
    ///
    /// # Errors
    /// It cannot be made, or is no folder.
    pub fn open(path: &Path) -> Result<Self, Failure> {
        let made = !path.exists();
        fs::create_dir_all(path).map_err(|error| unwritable(path, &error))?;
        Ok(Self { path: path.to_path_buf(), made })
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Opens the file of finished runs, which shows as well that the folder can be written to.
    ///
    /// # Errors
    /// The folder cannot be written to, or another command is using it.
    pub fn run_log(&self, fingerprint: &Fingerprint) -> Result<RunLog, Failure> {
        RunLog::open(&self.path.join(RUN_LOG), fingerprint).map_err(|error| match error {
            PositioningError::File { source, .. } => unwritable(&self.path, &source),
            other => other.into(),
        })
    }

    /// Writes one file: to a temporary name first, then renamed.
    fn write(&self, name: &str, contents: &str) -> Result<(), Failure> {
        let temporary = self.path.join(format!(".{name}.tmp"));
        let target = self.path.join(name);
        fs::write(&temporary, contents).and_then(|()| fs::rename(&temporary, &target)).map_err(|error| {
            // The first error is the one worth telling; what is left is only a hidden file.
            let _ = fs::remove_file(&temporary);
            Failure::running(format!("cannot write {}: {error}", target.display()))
        })
    }
}

impl Folder {
    /// Removes what an earlier command left under a name that this one has nothing for.
    fn remove(&self, name: &str) {
        // Where it is not there, all is well.
        let _ = fs::remove_file(self.path.join(name));
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let log = self.path.join(RUN_LOG);
        if fs::metadata(&log).is_ok_and(|metadata| metadata.len() == 0) {
            // Nothing was finished; a leftover empty file would do no harm.
            let _ = fs::remove_file(&log);
            if self.made {
                let _ = fs::remove_dir(&self.path);
            }
        }
    }
}

fn unwritable(path: &Path, error: &std::io::Error) -> Failure {
    let reason = error.to_string();
    let reason = reason.split(" (os error").next().unwrap_or(&reason);
    Failure::input(format!("--out {}: cannot write there ({reason}); choose another folder", path.display()))
}

/// Writes the metrics, the system's own files, and the estimates and plots as `wanted` says; returns their names.
///
/// # Errors
/// A file that cannot be written, or a plot that cannot be drawn.
pub fn write(
    folder: &Folder,
    wanted: &Output,
    report: &Report,
    runs: &[RunResult],
) -> Result<Vec<String>, Failure> {
    let mut files = Vec::new();
    if wanted.estimates {
        if runs.iter().flat_map(|run| &run.methods).any(|method| !method.is_empty()) {
            files.push(("estimates.csv".to_owned(), estimates::csv(runs)));
        } else {
            folder.remove("estimates.csv");
        }
    }
    for file in runs.first().iter().flat_map(|run| &run.files) {
        files.push((file.name.clone(), file.contents.clone()));
    }
    if wanted.plots {
        for (name, svg) in plots::draw(report, runs, wanted)? {
            match svg {
                Some(svg) => files.push((name.to_owned(), svg)),
                None => folder.remove(name),
            }
        }
    }
    files.push(("metrics.json".to_owned(), json(report)? + "\n"));
    for (name, contents) in &files {
        folder.write(name, contents)?;
    }
    Ok(files.into_iter().map(|(name, _)| name).collect())
}

/// Writes the reports of a sweep, and where `plots` says so a figure over the swept key.
///
/// # Errors
/// A file that cannot be written, or a plot that cannot be drawn.
pub fn write_sweep(folder: &Folder, plots: bool, swept: &Swept) -> Result<(), Failure> {
    let drawn = match swept.curve().filter(|_| plots) {
        Some((key, points)) => plots::draw_sweep(key, &points)?,
        None => None,
    };
    match drawn {
        Some(svg) => folder.write("sweep.svg", &svg)?,
        None => folder.remove("sweep.svg"),
    }
    folder.write("metrics.json", &(json(swept)? + "\n"))
}
