//! The file of finished runs, one JSON value a line, from which an interrupted campaign goes on.
//!
//! The first line is a header with the fingerprint of the effective scenario. A run is one line, written whole and
//! flushed; what an interruption leaves of a last line is dropped.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{BufRead, BufReader, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::error::PositioningError;
use crate::results::RunResult;

/// Version of the file's layout.
const VERSION: u32 = 1;

/// Extension under which the runs of another scenario are kept once.
const BEFORE: &str = "before.jsonl";

/// What must be the same for runs to belong together. The number of runs is not part of it, so that a campaign can
/// be extended.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Fingerprint {
    /// What identifies the program that computes: another build may compute something else.
    pub program: String,
    /// The effective scenario: every key but the number of runs, the seed, the methods, the data.
    pub scenario: serde_json::Value,
}

#[derive(Debug, Serialize, Deserialize)]
struct Header {
    version: u32,
    fingerprint: Fingerprint,
}

/// What was found when a log was opened.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LogState {
    /// There was none.
    New,
    /// It had this many whole runs.
    Resumed(usize),
    /// It belongs to another scenario or program. The first finished run replaces it, and what it held is kept beside it
    /// with the extension `before.jsonl`.
    Replaced,
}

/// An open file of finished runs; one process holds it at a time.
#[derive(Debug)]
pub struct RunLog {
    path: PathBuf,
    file: File,
    state: LogState,
    finished: Vec<RunResult>,
    /// Still to be written: a campaign that fails at once leaves what it found.
    header: Option<Header>,
}

impl RunLog {
    /// Opens or creates the log and reads the runs that belong to `fingerprint`. Until the first run is appended a
    /// log of another fingerprint is left as it is, and a new one is empty. O(size of the file).
    ///
    /// # Errors
    /// [`PositioningError::File`] if it cannot be opened, read or written; [`PositioningError::InUse`] if another
    /// process holds it.
    pub fn open(path: &Path, fingerprint: &Fingerprint) -> Result<Self, PositioningError> {
        let fail = |doing, source| PositioningError::File { path: path.to_path_buf(), doing, source };
        let file = OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .open(path)
            .map_err(|source| fail("write", source))?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                return Err(PositioningError::InUse { path: path.to_path_buf() });
            }
            Err(TryLockError::Error(source)) if source.kind() == std::io::ErrorKind::Unsupported => {}
            Err(TryLockError::Error(source)) => return Err(fail("lock", source)),
        }
        let held_something = file.metadata().map_err(|source| fail("read", source))?.len() > 0;
        let kept = read(&file, fingerprint).map_err(|source| fail("read", source))?;
        let mut log =
            Self { path: path.to_path_buf(), file, state: LogState::New, finished: Vec::new(), header: None };
        match kept {
            Some((length, finished)) => {
                log.cut(length)?;
                log.state = LogState::Resumed(finished.len());
                log.finished = finished;
            }
            None => {
                log.state = if held_something { LogState::Replaced } else { LogState::New };
                log.header = Some(Header { version: VERSION, fingerprint: fingerprint.clone() });
            }
        }
        Ok(log)
    }

    /// What was found on opening.
    pub fn state(&self) -> LogState {
        self.state
    }

    /// The runs that were found, which are handed over once.
    pub(super) fn take_finished(&mut self) -> Vec<RunResult> {
        std::mem::take(&mut self.finished)
    }

    /// Writes one finished run and flushes it to the operating system.
    ///
    /// # Errors
    /// [`PositioningError::File`].
    pub fn append(&mut self, result: &RunResult) -> Result<(), PositioningError> {
        if let Some(header) = self.header.take() {
            if self.state == LogState::Replaced {
                std::fs::copy(&self.path, self.path.with_extension(BEFORE))
                    .map_err(|source| self.failure(source))?;
            }
            self.cut(0)?;
            self.line(&header)?;
        }
        self.line(result)
    }

    fn line(&mut self, value: &impl Serialize) -> Result<(), PositioningError> {
        let mut line = serde_json::to_vec(value).map_err(|error| self.failure(error.into()))?;
        line.push(b'\n');
        self.file.write_all(&line).and_then(|()| self.file.flush()).map_err(|source| self.failure(source))
    }

    fn cut(&mut self, length: u64) -> Result<(), PositioningError> {
        self.file
            .set_len(length)
            .and_then(|()| self.file.seek(SeekFrom::Start(length)))
            .map(|_| ())
            .map_err(|source| self.failure(source))
    }

    fn failure(&self, source: std::io::Error) -> PositioningError {
        PositioningError::File { path: self.path.clone(), doing: "write", source }
    }
}

/// The runs before the first damaged line and the length that they take, or `None` if the header is not ours.
fn read(file: &File, fingerprint: &Fingerprint) -> std::io::Result<Option<(u64, Vec<RunResult>)>> {
    let mut reader = BufReader::new(file);
    let mut line = Vec::new();
    let mut length = reader.read_until(b'\n', &mut line)? as u64;
    let ours = line.ends_with(b"\n")
        && serde_json::from_slice::<Header>(&line)
            .is_ok_and(|header| header.version == VERSION && header.fingerprint == *fingerprint);
    if !ours {
        return Ok(None);
    }
    let mut runs = Vec::new();
    loop {
        line.clear();
        let read = reader.read_until(b'\n', &mut line)? as u64;
        if !line.ends_with(b"\n") {
            return Ok(Some((length, runs)));
        }
        match serde_json::from_slice::<RunResult>(&line) {
            Ok(run) if run.methods.iter().all(|method| method.is_whole()) => runs.push(run),
            _ => return Ok(Some((length, runs))),
        }
        length += read;
    }
}
