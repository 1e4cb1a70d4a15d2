//! The recording: nodes, and sweeps of received signal strength over all directed links and channels.

use std::fs;
use std::path::{Path, PathBuf};

use crate::error::PositioningError;
use crate::robots::table::{Separator, Table, matching, only};

/// The value that stands for a packet that was not heard.
const NO_PACKET: f64 = 127.0;

/// A recording of C channels among n nodes.
pub struct Recording {
    /// Positions of the nodes (m).
    pub nodes: Vec<[f64; 2]>,
    /// Number of channels.
    pub channels: usize,
    /// The sweeps in order of time.
    pub sweeps: Vec<Sweep>,
}

/// Received signal strengths, in the order channel, transmitter, receiver.
pub struct Sweep {
    /// Time (s).
    pub time: f64,
    /// Strength (dBm) of each column; NaN where no packet was heard.
    pub strengths: Vec<f64>,
}

/// Two nodes, and the columns of a sweep that are measured between them, in both directions.
pub struct Pair {
    /// The nodes.
    pub ends: [usize; 2],
    /// The columns.
    pub columns: Vec<usize>,
}

impl Recording {
    /// Reads the nodes from `sensor_coords*.txt` and the sweeps from the file whose name contains `listen`.
    ///
    /// # Errors
    /// [`PositioningError::Data`] naming file, line and field.
    pub fn read(folder: &Path) -> Result<Self, PositioningError> {
        let path = only(folder, "sensor_coords", ".txt")?;
        let table = Table::<2>::read(&path, Separator::Blank, ["x m", "y m"])?;
        let nodes: Vec<[f64; 2]> = table.records().iter().map(|record| record.values).collect();
        if nodes.len() < 3 {
            let problem = format!("holds {} nodes; a walker is located by at least 3", nodes.len());
            return Err(PositioningError::data(&path, None, problem));
        }
        let path = listening(folder)?;
        let (channels, sweeps) = sweeps(&path, nodes.len())?;
        Ok(Self { nodes, channels, sweeps })
    }

    /// The pairs of nodes, and their columns.
    pub fn pairs(&self) -> Vec<Pair> {
        let n = self.nodes.len();
        let mut pairs: Vec<Pair> = (0..n)
            .flat_map(|a| (a + 1..n).map(move |b| Pair { ends: [a, b], columns: Vec::new() }))
            .collect();
        let column = |channel: usize, from: usize, to: usize| {
            (channel * n + from) * (n - 1) + if to < from { to } else { to - 1 }
        };
        for pair in &mut pairs {
            let [a, b] = pair.ends;
            pair.columns.extend(
                (0..self.channels).flat_map(|channel| [column(channel, a, b), column(channel, b, a)]),
            );
        }
        pairs
    }

    /// Number of columns of a sweep.
    pub fn columns(&self) -> usize {
        self.channels * self.nodes.len() * (self.nodes.len() - 1)
    }
}

/// The one file of sweeps.
fn listening(folder: &Path) -> Result<PathBuf, PositioningError> {
    let mut found: Vec<PathBuf> = matching(folder, "", ".txt")?
        .into_iter()
        .filter(|(name, _)| name.contains("listen"))
        .map(|(_, path)| path)
        .collect();
    match (found.pop(), found.pop()) {
        (Some(path), None) => Ok(path),
        (None, _) => Err(PositioningError::data(folder, None, "holds no file *listen*.txt of sweeps")),
        _ => {
            let problem = "holds several files *listen*.txt; a recording has one";
            Err(PositioningError::data(folder, None, problem))
        }
    }
}

fn sweeps(path: &Path, nodes: usize) -> Result<(usize, Vec<Sweep>), PositioningError> {
    let text = fs::read_to_string(path)
        .map_err(|error| PositioningError::data(path, None, format!("cannot be read: {error}")))?;
    let links = nodes * (nodes - 1);
    let mut channels = 0;
    let mut sweeps: Vec<Sweep> = Vec::new();
    for (line, text) in (1..).zip(text.lines()).filter(|(_, text)| !text.trim().is_empty()) {
        let wrong = |problem: String| PositioningError::data(path, Some(line), problem);
        let count = text.split_whitespace().count();
        if sweeps.is_empty() {
            channels = count.saturating_sub(1) / links;
            if channels == 0 || count != channels * links + 1 {
                return Err(wrong(format!(
                    "the line has {count} fields; expected {links} strengths for each channel (all ordered pairs of {nodes} nodes) and a time"
                )));
            }
        }
        let expected = channels * links + 1;
        if count != expected {
            let fault = if count < expected { "is cut short" } else { "is too long" };
            return Err(wrong(format!("the line {fault}: {count} of {expected} fields")));
        }
        let mut values = Vec::with_capacity(expected);
        for (field, part) in (1..).zip(text.split_whitespace()) {
            let value: f64 =
                part.parse().ok().filter(|value: &f64| value.is_finite()).ok_or_else(|| {
                    wrong(format!("field {field} is \"{part}\", which is no finite number"))
                })?;
            values.push(if value == NO_PACKET && field < expected { f64::NAN } else { value });
        }
        let time = values.pop().unwrap_or(0.0) / 1000.0;
        if let Some(before) = sweeps.last().filter(|sweep| sweep.time >= time) {
            return Err(wrong(format!(
                "the time is {time} s, no later than the {} s of the sweep before; times must increase",
                before.time
            )));
        }
        sweeps.push(Sweep { time, strengths: values });
    }
    if sweeps.is_empty() {
        return Err(PositioningError::data(path, None, "holds no sweep"));
    }
    Ok((channels, sweeps))
}
