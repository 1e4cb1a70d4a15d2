//! Reading a Plaza folder.

use std::f64::consts::PI;
use std::path::Path;

use sumprod_graph::wrap_angle;

use crate::PositioningError;
use crate::robots::table::{Separator, Table, only};

/// A row of odometry: what was driven since the row before, the first since the first true pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OdometryRow {
    /// End of the row (s).
    pub time: f64,
    /// Distance driven (m).
    pub distance: f64,
    /// Change of the heading by the gyro (rad).
    pub turn: f64,
}

/// A range to a beacon.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RangeRow {
    /// Time (s).
    pub time: f64,
    /// Index of the beacon.
    pub beacon: usize,
    /// Range as measured (m).
    pub range: f64,
}

/// A true pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TruthRow {
    /// Time (s).
    pub time: f64,
    /// East, north (m) and heading in the direction of travel (rad).
    pub pose: [f64; 3],
}

/// A beacon at a known place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Beacon {
    /// Its number.
    pub id: u32,
    /// East and north (m).
    pub position: [f64; 2],
}

/// A Plaza recording.
#[derive(Clone, Debug, PartialEq)]
pub struct Recording {
    /// Odometry, times increasing and after the first true pose.
    pub odometry: Vec<OdometryRow>,
    /// Ranges, times never falling.
    pub ranges: Vec<RangeRow>,
    /// True poses, times increasing.
    pub truth: Vec<TruthRow>,
    /// Beacons.
    pub beacons: Vec<Beacon>,
    /// Number of ranges to beacons of no known place, which are left out.
    pub unknown: usize,
}

impl Recording {
    /// Reads a folder with these files; the part of the names after `Plaza` is free.
    ///
    /// | file | columns |
    /// |---|---|
    /// | `Plaza*_DR.txt` | time (s), distance (m) and heading change (rad) since the row before |
    /// | `Plaza*_TD.txt` | time (s), sender, beacon, range (m) |
    /// | `Plaza*_GT.csv` | time (s), x (m), y (m), heading (rad), under a header |
    /// | `Plaza*_TL.csv` | beacon, x (m), y (m), under a header |
    ///
    /// The recorded headings point against the direction of travel; half a turn is added to them.
    ///
    /// # Errors
    /// [`PositioningError::Data`] naming the folder, or the file, line and field.
    pub fn read(folder: &Path) -> Result<Self, PositioningError> {
        let file = |suffix: &str| only(folder, "Plaza", suffix);
        let beacons = beacons(&file("_TL.csv")?)?;
        let truth = truth(&file("_GT.csv")?)?;
        let odometry = odometry(&file("_DR.txt")?, truth[0].time)?;
        let (ranges, unknown) = ranges(&file("_TD.txt")?, &beacons)?;
        Ok(Self { odometry, ranges, truth, beacons, unknown })
    }
}

fn beacons(path: &Path) -> Result<Vec<Beacon>, PositioningError> {
    let table = Table::read(path, Separator::Comma, ["beacon", "x m", "y m"])?;
    let mut beacons: Vec<Beacon> = Vec::with_capacity(table.records().len());
    for record in table.records() {
        let id = table.whole(record, 0)?;
        if beacons.iter().any(|beacon| beacon.id == id) {
            return Err(table.wrong(record, format!("beacon {id} is there twice")));
        }
        beacons.push(Beacon { id, position: [record.values[1], record.values[2]] });
    }
    Ok(beacons)
}

fn truth(path: &Path) -> Result<Vec<TruthRow>, PositioningError> {
    let table = Table::read(path, Separator::Comma, ["time s", "x m", "y m", "heading rad"])?;
    table.check_rising(0, false)?;
    let row = |[time, x, y, heading]: [f64; 4]| TruthRow { time, pose: [x, y, wrap_angle(heading + PI)] };
    Ok(table.records().iter().map(|record| row(record.values)).collect())
}

fn odometry(path: &Path, begin: f64) -> Result<Vec<OdometryRow>, PositioningError> {
    let table = Table::read(path, Separator::Blank, ["time s", "distance m", "heading change rad"])?;
    table.check_rising(0, false)?;
    let first = &table.records()[0];
    if first.values[0] <= begin {
        let problem = format!(
            "time s is {}, but the first row must lie after the first true pose, at {begin} s",
            first.values[0]
        );
        return Err(table.wrong(first, problem));
    }
    let row = |[time, distance, turn]: [f64; 3]| OdometryRow { time, distance, turn };
    Ok(table.records().iter().map(|record| row(record.values)).collect())
}

fn ranges(path: &Path, beacons: &[Beacon]) -> Result<(Vec<RangeRow>, usize), PositioningError> {
    let table = Table::read(path, Separator::Blank, ["time s", "sender", "beacon", "range m"])?;
    table.check_rising(0, true)?;
    table.check_positive(3)?;
    let mut ranges = Vec::with_capacity(table.records().len());
    for record in table.records() {
        let id = table.whole(record, 2)?;
        let known = beacons.iter().position(|beacon| beacon.id == id);
        let [time, _, _, range] = record.values;
        ranges.extend(known.map(|beacon| RangeRow { time, beacon, range }));
    }
    let unknown = table.records().len() - ranges.len();
    Ok((ranges, unknown))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robots::scratch::Scratch;

    fn folder() -> Scratch {
        let folder = Scratch::new();
        folder.write("Plaza9_TL.csv", "node_id,x_m,y_m\n1,10,0\n6,0,20\n");
        folder.write("Plaza9_GT.csv", "t_s,x_m,y_m,heading_rad\n5.0,1,2,-2.5\n5.1,1,2,-2.5\n");
        folder.write("Plaza9_DR.txt", "  5.1\t 0.4 -0.01\t\n5.2 0.3 0.0\n");
        folder.write("Plaza9_TD.txt", "5.05 2 6 19.5\n5.05 2 3 7.0\n5.15 2 1 9.1\n");
        folder
    }

    #[test]
    fn a_folder_is_read_and_headings_are_turned() {
        let recording = Recording::read(&folder().path("")).unwrap();
        assert_eq!(recording.odometry[0], OdometryRow { time: 5.1, distance: 0.4, turn: -0.01 });
        assert_eq!(recording.ranges.len(), 2);
        assert_eq!(recording.ranges[0], RangeRow { time: 5.05, beacon: 1, range: 19.5 });
        assert_eq!(recording.unknown, 1);
        assert!((recording.truth[0].pose[2] - (PI - 2.5)).abs() < 1e-15);
        assert_eq!(recording.beacons[1], Beacon { id: 6, position: [0.0, 20.0] });
    }

    #[test]
    fn broken_files_are_named_with_their_line() {
        for (file, text, sentence) in [
            ("Plaza9_DR.txt", "5.1 0.4 0\n5.2 0.3\n", "Plaza9_DR.txt:2: the line is cut short"),
            ("Plaza9_DR.txt", "5.1 0.4 0\n5.1 0.3 0\n", "Plaza9_DR.txt:2: time s is 5.1, no later than"),
            ("Plaza9_DR.txt", "4.9 0.4 0\n", "Plaza9_DR.txt:1: time s is 4.9, but the first row must"),
            ("Plaza9_TD.txt", "5.05 2 6 NaN\n", "Plaza9_TD.txt:1: field 4 (range m) is NaN"),
            ("Plaza9_TD.txt", "5.05 2 6 -3\n", "Plaza9_TD.txt:1: range m is -3; it must be positive"),
            ("Plaza9_TD.txt", "5.05 2 6.5 3\n", "Plaza9_TD.txt:1: beacon is 6.5; it must be a whole number"),
            ("Plaza9_TD.txt", "", "Plaza9_TD.txt: holds no record"),
            ("Plaza9_TL.csv", "id,x,y\n1,0,0\n1,1,1\n", "Plaza9_TL.csv:3: beacon 1 is there twice"),
            ("Plaza9_GT.csv", "5.0,1,2,-2.5\n", "Plaza9_GT.csv:1: expected a header that names time s"),
        ] {
            let folder = folder();
            folder.write(file, text);
            let found = Recording::read(&folder.path("")).unwrap_err();
            assert!(found.to_string().contains(sentence), "{found}");
            assert!(found.is_input());
        }
    }

    #[test]
    fn a_missing_file_is_named() {
        let folder = folder();
        std::fs::remove_file(folder.path("Plaza9_TD.txt")).unwrap();
        let found = Recording::read(&folder.path("")).unwrap_err().to_string();
        assert!(found.ends_with("holds no file Plaza*_TD.txt"), "{found}");
    }
}
