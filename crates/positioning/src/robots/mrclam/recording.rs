//! Reading an MRCLAM folder.

use std::path::Path;

use crate::PositioningError;
use crate::robots::table::{Separator, Table, matching};

/// Names that every robot's files begin with.
const ROBOT: &str = "Robot";

/// An odometry command, which holds until the next.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Command {
    /// Time (s).
    pub time: f64,
    /// Forward speed (m/s).
    pub speed: f64,
    /// Turn rate (rad/s, anticlockwise).
    pub turn_rate: f64,
}

/// A true pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TruthRow {
    /// Time (s).
    pub time: f64,
    /// East, north (m) and heading (rad).
    pub pose: [f64; 3],
}

/// One robot's own files.
#[derive(Clone, Debug, PartialEq)]
pub struct Robot {
    /// Its number, which is its subject number too.
    pub id: u32,
    /// Commands, times never falling.
    pub commands: Vec<Command>,
    /// True poses, times increasing.
    pub truth: Vec<TruthRow>,
}

/// A barcode tube at a known place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Landmark {
    /// Its subject number.
    pub id: u32,
    /// East and north (m).
    pub position: [f64; 2],
}

/// What was seen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Subject {
    /// A robot, by its index.
    Robot(usize),
    /// A landmark, by its index.
    Landmark(usize),
}

/// A sighting by a robot's camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SightingRow {
    /// Time (s).
    pub time: f64,
    /// Index of the robot that saw.
    pub observer: usize,
    /// What it saw.
    pub subject: Subject,
    /// Range (m).
    pub range: f64,
    /// Bearing from the robot's heading (rad, anticlockwise).
    pub bearing: f64,
}

/// An MRCLAM recording.
#[derive(Clone, Debug, PartialEq)]
pub struct Recording {
    /// The robots, in the order of their numbers.
    pub robots: Vec<Robot>,
    /// The landmarks.
    pub landmarks: Vec<Landmark>,
    /// All robots' sightings in the order of time.
    pub sightings: Vec<SightingRow>,
    /// Number of sightings of unknown barcodes or of the robot's own, which are left out.
    pub unknown: usize,
}

impl Recording {
    /// Reads a folder with these files, N being each robot's number; lines that begin with `#` are comments.
    ///
    /// | file | columns |
    /// |---|---|
    /// | `Barcodes.dat` | subject, barcode |
    /// | `Landmark_Groundtruth.dat` | subject, x (m), y (m), standard deviations of both (m, not used) |
    /// | `RobotN_Odometry.dat` | time (s), forward speed (m/s), turn rate (rad/s) |
    /// | `RobotN_Measurement.dat` | time (s), barcode, range (m), bearing (rad) |
    /// | `RobotN_Groundtruth.dat` | time (s), x (m), y (m), heading (rad) |
    ///
    /// # Errors
    /// [`PositioningError::Data`] naming the folder, or the file, line and field.
    pub fn read(folder: &Path) -> Result<Self, PositioningError> {
        let numbers = robot_numbers(folder)?;
        let landmarks = landmarks(&folder.join("Landmark_Groundtruth.dat"), &numbers)?;
        let barcodes = Barcodes::read(&folder.join("Barcodes.dat"))?;
        let file = |id: u32, what: &str| folder.join(format!("{ROBOT}{id}_{what}.dat"));
        let mut robots = Vec::with_capacity(numbers.len());
        let (mut sightings, mut unknown) = (Vec::new(), 0);
        for (observer, &id) in numbers.iter().enumerate() {
            let commands = commands(&file(id, "Odometry"))?;
            robots.push(Robot { id, commands, truth: truth(&file(id, "Groundtruth"))? });
            let subject = |barcode| {
                let subject = barcodes.subject(barcode)?;
                let robot = numbers.iter().position(|&id| id == subject).map(Subject::Robot);
                let landmark = || landmarks.iter().position(|landmark| landmark.id == subject);
                robot.or_else(|| landmark().map(Subject::Landmark))
            };
            unknown += see(&file(id, "Measurement"), observer, &subject, &mut sightings)?;
        }
        sightings.sort_by(|a, b| a.time.total_cmp(&b.time));
        Ok(Self { robots, landmarks, sightings, unknown })
    }
}

/// Numbers of the robots that have an odometry file, ascending.
fn robot_numbers(folder: &Path) -> Result<Vec<u32>, PositioningError> {
    let suffix = "_Odometry.dat";
    let files = matching(folder, ROBOT, suffix)?;
    let mut numbers: Vec<u32> = files.iter().filter_map(|(number, _)| number.parse().ok()).collect();
    numbers.sort_unstable();
    if numbers.is_empty() {
        let problem = format!("holds no file {ROBOT}N{suffix}, with N a robot's number");
        return Err(PositioningError::data(folder, None, problem));
    }
    Ok(numbers)
}

struct Barcodes(Vec<(u32, u32)>);

impl Barcodes {
    fn read(path: &Path) -> Result<Self, PositioningError> {
        let table = Table::read(path, Separator::Blank, ["subject", "barcode"])?;
        let mut pairs: Vec<(u32, u32)> = Vec::with_capacity(table.records().len());
        for record in table.records() {
            let (subject, barcode) = (table.whole(record, 0)?, table.whole(record, 1)?);
            if pairs.iter().any(|pair| pair.1 == barcode) {
                return Err(table.wrong(record, format!("barcode {barcode} is there twice")));
            }
            pairs.push((subject, barcode));
        }
        Ok(Self(pairs))
    }

    fn subject(&self, barcode: u32) -> Option<u32> {
        self.0.iter().find(|pair| pair.1 == barcode).map(|pair| pair.0)
    }
}

fn landmarks(path: &Path, robots: &[u32]) -> Result<Vec<Landmark>, PositioningError> {
    let table = Table::read(path, Separator::Blank, ["subject", "x m", "y m", "x sd m", "y sd m"])?;
    let mut landmarks: Vec<Landmark> = Vec::with_capacity(table.records().len());
    for record in table.records() {
        let id = table.whole(record, 0)?;
        if robots.contains(&id) || landmarks.iter().any(|landmark| landmark.id == id) {
            return Err(table.wrong(record, format!("subject {id} is there twice, or is a robot")));
        }
        landmarks.push(Landmark { id, position: [record.values[1], record.values[2]] });
    }
    Ok(landmarks)
}

fn commands(path: &Path) -> Result<Vec<Command>, PositioningError> {
    let table = Table::read(path, Separator::Blank, ["time s", "forward speed m/s", "turn rate rad/s"])?;
    table.check_rising(0, true)?;
    let row = |[time, speed, turn_rate]: [f64; 3]| Command { time, speed, turn_rate };
    Ok(table.records().iter().map(|record| row(record.values)).collect())
}

fn truth(path: &Path) -> Result<Vec<TruthRow>, PositioningError> {
    let table = Table::read(path, Separator::Blank, ["time s", "x m", "y m", "heading rad"])?;
    table.check_rising(0, false)?;
    let row = |[time, x, y, heading]: [f64; 4]| TruthRow { time, pose: [x, y, heading] };
    Ok(table.records().iter().map(|record| row(record.values)).collect())
}

/// Adds a robot's sightings; returns the number of those that are left out.
fn see(
    path: &Path,
    observer: usize,
    subject: &dyn Fn(u32) -> Option<Subject>,
    sightings: &mut Vec<SightingRow>,
) -> Result<usize, PositioningError> {
    let table = Table::read(path, Separator::Blank, ["time s", "barcode", "range m", "bearing rad"])?;
    table.check_rising(0, true)?;
    table.check_positive(2)?;
    let before = sightings.len();
    for record in table.records() {
        let [time, _, range, bearing] = record.values;
        let seen = subject(table.whole(record, 1)?).filter(|&seen| seen != Subject::Robot(observer));
        sightings.extend(seen.map(|subject| SightingRow { time, observer, subject, range, bearing }));
    }
    Ok(table.records().len() - (sightings.len() - before))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robots::scratch::Scratch;

    fn folder() -> Scratch {
        let folder = Scratch::new();
        folder.write("Barcodes.dat", "# subject barcode\n1 5\n2 14\n6 72\n7 90\n");
        folder.write("Landmark_Groundtruth.dat", "6 1.5 -2.0 0.001 0.001\n");
        for (robot, barcode) in [(1, 72), (2, 5)] {
            folder.write(&format!("Robot{robot}_Odometry.dat"), "1.0 0.1 0\n1.0 0.2 0\n9.0 0 0\n");
            folder.write(&format!("Robot{robot}_Groundtruth.dat"), "1.0 0 0 0.5\n2.0 0 0 0.5\n");
            let text = format!("{robot}.5 {barcode} 2.0 0.1\n4.0 {barcode} 2.0 -0.1\n");
            folder.write(&format!("Robot{robot}_Measurement.dat"), &text);
        }
        folder
    }

    #[test]
    fn sightings_of_all_robots_are_merged_in_time_and_strangers_counted() {
        let folder = folder();
        folder.write("Robot1_Measurement.dat", "1.5 72 2 0\n1.6 90 2 0\n1.7 8 2 0\n1.8 5 2 0\n3 14 2 0\n");
        let recording = Recording::read(&folder.path("")).unwrap();
        let seen: Vec<(f64, usize, Subject)> =
            recording.sightings.iter().map(|row| (row.time, row.observer, row.subject)).collect();
        let expected = [
            (1.5, 0, Subject::Landmark(0)),
            (2.5, 1, Subject::Robot(0)),
            (3.0, 0, Subject::Robot(1)),
            (4.0, 1, Subject::Robot(0)),
        ];
        assert_eq!(seen, expected);
        // A subject without a place, an unknown barcode, and the robot's own.
        assert_eq!(recording.unknown, 3);
        assert_eq!(recording.robots.iter().map(|robot| robot.id).collect::<Vec<_>>(), [1, 2]);
        assert_eq!(recording.landmarks, [Landmark { id: 6, position: [1.5, -2.0] }]);
    }

    #[test]
    fn broken_files_are_named_with_their_line() {
        for (file, text, sentence) in [
            ("Robot2_Odometry.dat", "1 0.1 0\n2 0.1\n", "Robot2_Odometry.dat:2: the line is cut short"),
            ("Robot2_Odometry.dat", "2 0 0\n1 0 0\n", "Robot2_Odometry.dat:2: time s is 1, before the 2"),
            ("Robot1_Measurement.dat", "1 72 inf 0\n", "Robot1_Measurement.dat:1: field 3 (range m) is inf"),
            ("Robot1_Measurement.dat", "1 72 x 0\n", "Robot1_Measurement.dat:1: field 3 (range m) is \"x\""),
            ("Robot1_Measurement.dat", "# none\n", "Robot1_Measurement.dat: holds no record"),
            ("Robot1_Groundtruth.dat", "1 0 0 0\n1 0 0 0\n", "Robot1_Groundtruth.dat:2: time s is 1, no"),
            ("Barcodes.dat", "1 5\n2 5\n", "Barcodes.dat:2: barcode 5 is there twice"),
            (
                "Landmark_Groundtruth.dat",
                "2 0 0 0 0\n",
                "Landmark_Groundtruth.dat:1: subject 2 is there twice",
            ),
        ] {
            let folder = folder();
            folder.write(file, text);
            let found = Recording::read(&folder.path("")).unwrap_err();
            assert!(found.to_string().contains(sentence), "{found}");
            assert!(found.is_input());
        }
    }

    #[test]
    fn missing_files_are_named() {
        let folder = folder();
        std::fs::remove_file(folder.path("Robot2_Measurement.dat")).unwrap();
        let found = Recording::read(&folder.path("")).unwrap_err().to_string();
        assert!(found.contains("Robot2_Measurement.dat: cannot be read"), "{found}");
        let found = Recording::read(&Scratch::new().path("")).unwrap_err().to_string();
        assert!(found.contains("holds no file RobotN_Odometry.dat"), "{found}");
    }
}
