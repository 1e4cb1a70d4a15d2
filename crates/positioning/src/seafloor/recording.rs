//! Reading a station's pings.

use std::fs;
use std::path::{Path, PathBuf};

use crate::PositioningError;
use crate::robots::table::matching;

/// Ends of the names of a station's files.
const PINGS: &str = ".txt";
const PUBLISHED: &str = "_location.txt";

/// Where a ping's fields stand: a word that must be there, or a field.
const LAYOUT: &str = "6306 msec. Lat: 4 52.9270 S Lon: 132 41.4272 W Alt: 29.42 Time(UTC): 2018:114:06:04:30";

/// One ping that was answered.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ping {
    /// The line it stood on, from 1.
    pub line: usize,
    /// Two-way travel time (s), the transponder's turn-around time included.
    pub travel_time: f64,
    /// Latitude and longitude of the ship (degrees, north and east positive).
    pub place: [f64; 2],
    /// Time of day and year (s since the year began).
    pub time: f64,
}

/// The authors' answer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Published {
    /// East and north of the drop point and up from the sea surface (m).
    pub position: [f64; 3],
    /// Speed of sound (m/s).
    pub sound_speed: f64,
}

/// A station's pings and what was known when it was dropped.
#[derive(Clone, Debug, PartialEq)]
pub struct Recording {
    /// The file.
    pub path: PathBuf,
    /// Latitude and longitude of the drop point (degrees).
    pub drop_point: [f64; 2],
    /// Depth of the water there (m).
    pub depth: f64,
    /// Answered pings in the order of the file.
    pub pings: Vec<Ping>,
    /// Number of pings that were not answered.
    pub skipped: usize,
    /// The authors' answer, where it lies beside.
    pub published: Option<Published>,
}

impl Recording {
    /// Reads the file `STATION.txt` of a folder, and `reference/STATION_location.txt` where it is there.
    ///
    /// A header names the drop point in degrees and the depth in metres; a line of `=` ends it. Then a line a ping. Lines
    /// that begin with `Event skipped` are pings without an answer, empty ones and those that begin with anything but a
    /// number are comments.
    ///
    /// # Errors
    /// [`PositioningError::Data`] naming the folder and its stations, or the file, line and field.
    pub fn read(folder: &Path, station: &str) -> Result<Self, PositioningError> {
        let path = folder.join(format!("{station}{PINGS}"));
        if !path.is_file() {
            let stations: Vec<String> =
                matching(folder, "", PINGS)?.into_iter().map(|(name, _)| name).collect();
            let known = if stations.is_empty() { "none".to_owned() } else { stations.join(", ") };
            let problem = format!("holds no station {station} (file {station}{PINGS}); it holds {known}");
            return Err(PositioningError::data(folder, None, problem));
        }
        let mut recording = Self::parse(&path, &text(&path)?)?;
        let published = folder.join("reference").join(format!("{station}{PUBLISHED}"));
        if published.is_file() {
            recording.published = Some(published_in(&published, &text(&published)?)?);
        }
        Ok(recording)
    }

    fn parse(path: &Path, text: &str) -> Result<Self, PositioningError> {
        let header = |name: &str| number_after(path, text, name);
        let drop_point = [header("Drop Point (Latitude):")?, header("Drop Point (Longitude):")?];
        let depth = header("Depth (meters):")?;
        let at = |problem: String| PositioningError::data(path, None, problem);
        if drop_point[0].abs() > 90.0 || drop_point[1].abs() > 360.0 {
            let [latitude, longitude] = drop_point;
            return Err(at(format!(
                "the drop point is at {latitude}, {longitude} degrees, which is no place on earth"
            )));
        }
        if depth <= 0.0 {
            return Err(at(format!("the depth is {depth} m; it must be positive")));
        }
        let mut recording = Self {
            path: path.to_path_buf(),
            drop_point,
            depth,
            pings: Vec::new(),
            skipped: 0,
            published: None,
        };
        let body = text.lines().enumerate().skip_while(|(_, line)| !line.starts_with("====")).skip(1);
        for (index, line) in body {
            let line = (index + 1, line.trim());
            if line.1.starts_with("Event skipped") {
                recording.skipped += 1;
            } else if line.1.starts_with(|first: char| first.is_ascii_digit() || "+-.".contains(first)) {
                let ping =
                    ping(line).map_err(|problem| PositioningError::data(path, Some(line.0), problem))?;
                recording.pings.push(ping);
            }
        }
        if recording.pings.is_empty() {
            return Err(at(format!("holds no ping; expected lines like `{LAYOUT}` under a line of =")));
        }
        Ok(recording)
    }
}

fn text(path: &Path) -> Result<String, PositioningError> {
    fs::read_to_string(path)
        .map_err(|error| PositioningError::data(path, None, format!("cannot be read: {error}")))
}

/// The first number after a name at the beginning of a line.
fn number_after(path: &Path, text: &str, name: &str) -> Result<f64, PositioningError> {
    for (index, line) in text.lines().enumerate() {
        if let Some(rest) = line.trim_start().strip_prefix(name) {
            let word = rest.split_whitespace().next().unwrap_or("");
            let field = name.trim_end_matches(':');
            return number(word, field)
                .map_err(|problem| PositioningError::data(path, Some(index + 1), problem));
        }
    }
    Err(PositioningError::data(path, None, format!("has no line `{name}` with a number")))
}

fn number(word: &str, field: &str) -> Result<f64, String> {
    match word.parse::<f64>() {
        Ok(value) if value.is_finite() => Ok(value),
        Ok(value) => Err(format!("{field} is {value}; it must be finite")),
        Err(_) if word.is_empty() => Err(format!("{field} has no number")),
        Err(_) => Err(format!("{field} is \"{word}\", which is no number")),
    }
}

/// A number within limits, the upper one not included.
fn limited(word: &str, field: &str, [low, high]: [f64; 2]) -> Result<f64, String> {
    let value = number(word, field)?;
    if (low..high).contains(&value) {
        Ok(value)
    } else {
        Err(format!("{field} is {value}; it must lie between {low} and {high}"))
    }
}

fn ping((line, text): (usize, &str)) -> Result<Ping, String> {
    let words: Vec<&str> = text.split_whitespace().collect();
    let [
        time,
        "msec.",
        "Lat:",
        north,
        north_minutes,
        north_side,
        "Lon:",
        east,
        east_minutes,
        east_side,
        "Alt:",
        height,
        "Time(UTC):",
        clock,
    ] = words[..]
    else {
        return Err(format!("the line is no ping of {} words like `{LAYOUT}`", LAYOUT.split(' ').count()));
    };
    let milliseconds = number(time, "the travel time")?;
    if milliseconds <= 0.0 {
        return Err(format!("the travel time is {milliseconds} ms; it must be positive"));
    }
    number(height, "the altitude")?;
    let latitude = angle([north, north_minutes, north_side], "latitude", 91.0, ["N", "S"])?;
    let longitude = angle([east, east_minutes, east_side], "longitude", 181.0, ["E", "W"])?;
    let time = time_of(clock)?;
    Ok(Ping { line, travel_time: 1e-3 * milliseconds, place: [latitude, longitude], time })
}

/// Degrees, minutes and side as signed degrees.
fn angle(
    [degrees, minutes, side]: [&str; 3],
    name: &str,
    most: f64,
    sides: [&str; 2],
) -> Result<f64, String> {
    let whole = limited(degrees, &format!("the {name} in degrees"), [0.0, most])?;
    let rest = limited(minutes, &format!("the minutes of the {name}"), [0.0, 60.0])?;
    let [positive, negative] = sides;
    if side != positive && side != negative {
        return Err(format!("the side of the {name} is \"{side}\"; it must be {positive} or {negative}"));
    }
    let size = whole + rest / 60.0;
    Ok(if side == negative { -size } else { size })
}

/// Year, day of the year, hours, minutes and seconds, set apart by colons, as seconds since the year began.
fn time_of(text: &str) -> Result<f64, String> {
    let words: Vec<&str> = text.split(':').collect();
    let [year, day, hours, minutes, seconds] = words[..] else {
        return Err(format!("the time is \"{text}\"; expected year:day:hours:minutes:seconds"));
    };
    limited(year, "the year", [1900.0, 3000.0])?;
    let day = limited(day, "the day of the year", [1.0, 367.0])?;
    let hours = limited(hours, "the hour", [0.0, 24.0])?;
    let minutes = limited(minutes, "the minute", [0.0, 60.0])?;
    let seconds = limited(seconds, "the second", [0.0, 61.0])?;
    Ok(86_400.0 * (day - 1.0) + 3_600.0 * hours + 60.0 * minutes + seconds)
}

fn published_in(path: &Path, text: &str) -> Result<Published, PositioningError> {
    let value = |name| number_after(path, text, name);
    let position = [value("X:")?, value("Y:")?, value("Depth:")?];
    Ok(Published { position, sound_speed: value("Water Vel.:")? })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robots::scratch::Scratch;

    const HEADER: &str = "Site: AA01\nDrop Point (Latitude):  -4.5\nDrop Point (Longitude): 132.25\n\
                          Depth (meters):  4750\nComment: 12 msec.\n=====\n\n";

    fn read(body: &str) -> Result<Recording, String> {
        let folder = Scratch::new();
        folder.write("AA01.txt", &format!("{HEADER}{body}"));
        Recording::read(&folder.path(""), "AA01").map_err(|error| error.to_string())
    }

    #[test]
    fn pings_are_read_and_the_unanswered_counted() {
        let body = " 6306 msec. Lat: 4 30.6 S  Lon: 132 15.0 E  Alt: 29.42 Time(UTC): 2018:114:06:04:30\n\
                    Event skipped - Timeout\n* 7000 msec. by hand\nstopped for lunch\n";
        let found = read(body).unwrap();
        let time = 113.0 * 86_400.0 + 6.0 * 3_600.0 + 4.0 * 60.0 + 30.0;
        let ping = Ping { line: 8, travel_time: 6.306, place: [-4.51, 132.25], time };
        assert_eq!((found.pings.as_slice(), found.skipped), ([ping].as_slice(), 1));
        assert_eq!((found.drop_point, found.depth, found.published), ([-4.5, 132.25], 4750.0, None));
    }

    #[test]
    fn broken_pings_are_named_with_their_line() {
        let good = "6306 msec. Lat: 4 30.6 S Lon: 132 15.0 E Alt: 29.42 Time(UTC): 2018:114:06:04:30";
        for (from, to, sentence) in [
            ("6306", "6a06", "AA01.txt:9: the travel time is \"6a06\", which is no number"),
            ("6306", "-6306", "AA01.txt:9: the travel time is -6306 ms; it must be positive"),
            ("6306", "1e999", "AA01.txt:9: the travel time is inf; it must be finite"),
            (" Alt: 29.42", "", "AA01.txt:9: the line is no ping of 14 words like"),
            ("30.6", "60.0", "AA01.txt:9: the minutes of the latitude is 60; it must lie between 0 and 60"),
            (" S ", " X ", "AA01.txt:9: the side of the latitude is \"X\"; it must be N or S"),
            ("132 ", "232 ", "AA01.txt:9: the longitude in degrees is 232; it must lie between 0 and 181"),
            (":30", "", "AA01.txt:9: the time is \"2018:114:06:04\"; expected year:day:hours"),
            (":06:", ":26:", "AA01.txt:9: the hour is 26; it must lie between 0 and 24"),
        ] {
            let found = read(&format!("{good}\n{}\n", good.replace(from, to))).unwrap_err();
            assert!(found.contains(sentence), "{found}");
        }
        assert!(read("Event skipped\n").unwrap_err().contains("AA01.txt: holds no ping"));
    }

    #[test]
    fn broken_headers_and_missing_stations_are_named() {
        let folder = Scratch::new();
        let sentence = |station| Recording::read(&folder.path(""), station).unwrap_err().to_string();
        assert!(sentence("AA01").contains("holds no station AA01 (file AA01.txt); it holds none"));
        for (text, problem) in [
            ("=====\n", "AA01.txt: has no line `Drop Point (Latitude):` with a number"),
            ("Drop Point (Latitude): x\n", "AA01.txt:1: Drop Point (Latitude) is \"x\", which is no number"),
            (&HEADER.replace("-4.5", "-94.5"), "the drop point is at -94.5, 132.25 degrees"),
            (&HEADER.replace("4750", "-3"), "the depth is -3 m; it must be positive"),
        ] {
            folder.write("AA01.txt", text);
            assert!(sentence("AA01").contains(problem), "{}", sentence("AA01"));
        }
        assert!(sentence("AA02").contains("it holds AA01"));
    }

    #[test]
    fn the_published_answer_is_read_where_it_is_there() {
        let folder = Scratch::new();
        let ping = "6306 msec. Lat: 4 30.6 S Lon: 132 15.0 E Alt: 29.42 Time(UTC): 2018:114:06:04:30\n";
        folder.write("AA01.txt", &format!("{HEADER}{ping}"));
        std::fs::create_dir(folder.path("reference")).unwrap();
        let text = "  X: 13.4 m +- 1\n  Y: -89.3 m\n  Depth: -4739.1 m\nWater Vel.: 1506.9 m\n";
        folder.write("reference/AA01_location.txt", text);
        let published = Recording::read(&folder.path(""), "AA01").unwrap().published;
        let expected = Published { position: [13.4, -89.3, -4739.1], sound_speed: 1506.9 };
        assert_eq!(published, Some(expected));
        folder.write("reference/AA01_location.txt", "X: 13.4\nY: north\n");
        let error = Recording::read(&folder.path(""), "AA01").unwrap_err().to_string();
        assert!(error.contains("AA01_location.txt:2: Y is \"north\", which is no number"), "{error}");
    }
}
