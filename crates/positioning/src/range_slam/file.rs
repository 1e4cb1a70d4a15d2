//! The file of a range-only graph: one variable or factor a line.
//!
//! | line | after it |
//! |---|---|
//! | `Variable Pose SE2 NAME` | true x, y (m), heading (rad) |
//! | `Variable Landmark R2 NAME` | true x, y (m) |
//! | `Factor UnarySE2ApproximateGaussianPriorFactor POSE` | x, y, heading, `covariance`, nine numbers by rows |
//! | `Factor SE2RelativeGaussianLikelihoodFactor POSE POSE` | x, y, heading in the first pose's frame, `covariance`, nine numbers |
//! | `Factor SE2R2RangeGaussianLikelihoodFactor POSE LANDMARK` | distance, standard deviation (m) |
//!
//! Source of the format: the program of Huang, Pu, Khosoussi, Leonard, "NF-iSAM" (ICRA 2021).

use std::collections::HashMap;
use std::fs;
use std::path::Path;

use sumprod_models::Noise;

use crate::PositioningError;

const PRIOR: &str = "UnarySE2ApproximateGaussianPriorFactor";
const RELATIVE: &str = "SE2RelativeGaussianLikelihoodFactor";
const RANGE: &str = "SE2R2RangeGaussianLikelihoodFactor";

/// A variable and its true value, which scores it and is no evidence.
#[derive(Clone, Debug, PartialEq)]
pub struct Named<const N: usize> {
    /// Its name.
    pub name: String,
    /// Its true value (m, m, rad).
    pub truth: [f64; N],
}

/// A prior on a pose.
#[derive(Clone, Debug, PartialEq)]
pub struct PriorLine {
    /// Number of the pose.
    pub pose: usize,
    /// Where it is (m, m, rad).
    pub at: [f64; 3],
    /// Noise in the Lie algebra.
    pub noise: Noise,
}

/// A measured pose of `to` in the frame of `from`.
#[derive(Clone, Debug, PartialEq)]
pub struct RelativeLine {
    /// Number of the first pose.
    pub from: usize,
    /// Number of the second pose.
    pub to: usize,
    /// The measurement (m, m, rad).
    pub measured: [f64; 3],
    /// Noise in the Lie algebra.
    pub noise: Noise,
}

/// A distance between a pose and a landmark.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RangeLine {
    /// Number of the pose.
    pub pose: usize,
    /// Number of the landmark.
    pub landmark: usize,
    /// The measured distance (m).
    pub measured: f64,
    /// Its variance (m²).
    pub variance: f64,
}

/// A whole graph, in the order of its file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RangeGraph {
    /// The poses in the order in which the robot was at them.
    pub poses: Vec<Named<3>>,
    /// The landmarks.
    pub landmarks: Vec<Named<2>>,
    /// Priors on poses.
    pub priors: Vec<PriorLine>,
    /// Odometry, and relative poses of any other source.
    pub relative: Vec<RelativeLine>,
    /// Ranges.
    pub ranges: Vec<RangeLine>,
}

impl RangeGraph {
    /// Reads a file. Empty lines and lines that begin with `#` are skipped.
    ///
    /// # Errors
    /// [`PositioningError::Data`] naming file and line: a file that cannot be read or has no pose or no range, a line
    /// that is cut short or too long, a number that is none or not finite, a variable or factor of an unknown kind, a
    /// name that is taken or not declared above, a covariance that is none.
    pub fn read(path: &Path) -> Result<Self, PositioningError> {
        let text = fs::read_to_string(path)
            .map_err(|error| PositioningError::data(path, None, format!("cannot be read: {error}")))?;
        let mut graph = Self::default();
        let mut names = HashMap::new();
        for (index, line) in text.lines().enumerate() {
            let line = line.trim();
            if line.is_empty() || line.starts_with('#') {
                continue;
            }
            graph
                .line(line, &mut names)
                .map_err(|problem| PositioningError::data(path, Some(index + 1), problem))?;
        }
        if graph.poses.is_empty() || graph.ranges.is_empty() {
            let problem = format!(
                "holds {} poses and {} ranges; a range-only graph has at least one of each",
                graph.poses.len(),
                graph.ranges.len()
            );
            return Err(PositioningError::data(path, None, problem));
        }
        Ok(graph)
    }

    fn line<'a>(&mut self, line: &'a str, names: &mut HashMap<&'a str, Variable>) -> Result<(), String> {
        let mut fields = Fields { words: line.split_whitespace().collect(), next: 0 };
        match fields.word("Variable or Factor")? {
            "Variable" => self.variable(&mut fields, names)?,
            "Factor" => self.factor(&mut fields, names)?,
            other => return Err(format!("begins with \"{other}\"; a line begins with Variable or Factor")),
        }
        fields.end()
    }

    fn variable<'a>(
        &mut self,
        fields: &mut Fields<'a>,
        names: &mut HashMap<&'a str, Variable>,
    ) -> Result<(), String> {
        let kind = (fields.word("the kind of variable")?, fields.word("the space of the variable")?);
        let name = fields.word("the name of the variable")?;
        let variable = match kind {
            ("Pose", "SE2") => {
                let truth = [fields.number("x")?, fields.number("y")?, fields.number("heading")?];
                self.poses.push(Named { name: name.to_owned(), truth });
                Variable::Pose(self.poses.len() - 1)
            }
            ("Landmark", "R2") => {
                let truth = [fields.number("x")?, fields.number("y")?];
                self.landmarks.push(Named { name: name.to_owned(), truth });
                Variable::Landmark(self.landmarks.len() - 1)
            }
            (kind, space) => {
                return Err(format!(
                    "a variable \"{kind} {space}\" is unknown; there are \"Pose SE2\" and \"Landmark R2\""
                ));
            }
        };
        match names.insert(name, variable) {
            None => Ok(()),
            Some(_) => Err(format!("the name {name} is taken by a variable above")),
        }
    }

    fn factor(&mut self, fields: &mut Fields<'_>, names: &HashMap<&str, Variable>) -> Result<(), String> {
        match fields.word("the kind of factor")? {
            PRIOR => {
                let pose = fields.pose(names)?;
                let (at, noise) = fields.pose_with_noise()?;
                self.priors.push(PriorLine { pose, at, noise });
            }
            RELATIVE => {
                let (from, to) = (fields.pose(names)?, fields.pose(names)?);
                if from == to {
                    return Err(format!("{} is measured from itself", self.poses[from].name));
                }
                let (measured, noise) = fields.pose_with_noise()?;
                self.relative.push(RelativeLine { from, to, measured, noise });
            }
            RANGE => {
                let pose = fields.pose(names)?;
                let landmark = fields.landmark(names)?;
                let measured = fields.number("the distance")?;
                if measured < 0.0 {
                    return Err(format!("the distance is {measured} m; it must not be negative"));
                }
                let deviation = fields.number("the standard deviation")?;
                let variance = deviation * deviation;
                if !(deviation > 0.0 && variance > 0.0 && variance.is_finite()) {
                    return Err(format!("the standard deviation is {deviation} m; it must be positive"));
                }
                self.ranges.push(RangeLine { pose, landmark, measured, variance });
            }
            other => {
                return Err(format!(
                    "a factor {other} is unknown; there are {PRIOR}, {RELATIVE} and {RANGE}"
                ));
            }
        }
        Ok(())
    }
}

#[derive(Clone, Copy)]
enum Variable {
    Pose(usize),
    Landmark(usize),
}

/// The words of a line, taken one by one.
struct Fields<'a> {
    words: Vec<&'a str>,
    next: usize,
}

impl<'a> Fields<'a> {
    fn word(&mut self, what: &str) -> Result<&'a str, String> {
        let word = self.words.get(self.next).copied();
        self.next += 1;
        word.ok_or_else(|| {
            format!("the line is cut short: {what} is missing after {} fields", self.words.len())
        })
    }

    fn number(&mut self, what: &str) -> Result<f64, String> {
        let word = self.word(what)?;
        let number: f64 = word.parse().map_err(|_| format!("{what} is \"{word}\", which is no number"))?;
        if number.is_finite() { Ok(number) } else { Err(format!("{what} is {number}; it must be finite")) }
    }

    fn pose(&mut self, names: &HashMap<&str, Variable>) -> Result<usize, String> {
        let name = self.word("the name of a pose")?;
        match names.get(name) {
            Some(Variable::Pose(number)) => Ok(*number),
            Some(Variable::Landmark(_)) => Err(format!("{name} is a landmark; a pose is expected here")),
            None => Err(format!("{name} is declared by no line above")),
        }
    }

    fn landmark(&mut self, names: &HashMap<&str, Variable>) -> Result<usize, String> {
        let name = self.word("the name of a landmark")?;
        match names.get(name) {
            Some(Variable::Landmark(number)) => Ok(*number),
            Some(Variable::Pose(_)) => Err(format!("{name} is a pose; a landmark is expected here")),
            None => Err(format!("{name} is declared by no line above")),
        }
    }

    fn pose_with_noise(&mut self) -> Result<([f64; 3], Noise), String> {
        let pose = [self.number("x")?, self.number("y")?, self.number("heading")?];
        let word = self.word("the word covariance")?;
        if word != "covariance" {
            return Err(format!("\"{word}\" stands where the word covariance is expected"));
        }
        let mut covariance = [0.0; 9];
        for (index, entry) in covariance.iter_mut().enumerate() {
            *entry = self.number(&format!("entry {} of the covariance", index + 1))?;
        }
        let noise = Noise::gaussian(&covariance).map_err(|error| error.to_string())?;
        Ok((pose, noise))
    }

    fn end(&self) -> Result<(), String> {
        match self.words.get(self.next) {
            None => Ok(()),
            Some(word) => {
                Err(format!("\"{word}\" stands after the end of the {} fields expected", self.next))
            }
        }
    }
}
