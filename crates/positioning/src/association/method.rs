//! The `[method.ID]` tables.

use serde::{Deserialize, Serialize};
use sumprod_fusion::association::{BiasPrior, Mixture, Start, Tails};

use crate::error::PositioningError;

/// Length and stiffness of a drift, and deviations of a bias prior, where a table does not say.
const LENGTH: f64 = 3.0;
const STIFFNESS: f64 = 3.0;
const RANGE_DEVIATION: f64 = 1500.0;
const AZIMUTH_DEVIATION: f64 = 2.5 * std::f64::consts::PI / 180.0;

/// How tracks are associated.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Algorithm {
    /// To each first track the nearest second one.
    Nearest,
    /// The assignment of least total squared distance.
    GlobalNearest,
    /// The mixture whose components are displaced by a smooth field: coherent point drift.
    Drift,
    /// The mixture whose components are displaced by the sensors' biases.
    Bias,
    /// The assignment after the true biases are taken out: no method, but what there is to reach.
    KnownBias,
}

/// Tails of a mixture's components.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TailsSettings {
    /// Gaussian.
    Gaussian,
    /// Student's t with fixed degrees of freedom.
    Student,
    /// Student's t with estimated ones.
    StudentEstimated,
}

/// Deviation at the start of a mixture's iterations.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum StartSettings {
    /// What the field's prior expects of the displacements.
    Prior,
    /// The root mean square distance of all pairs.
    Spread,
    /// This many metres.
    Metres(f64),
}

/// One `[method.ID]` table.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MethodSettings {
    /// How tracks are associated.
    pub algorithm: Algorithm,
    /// Farthest that the tracks of a pair may be apart (m); of a mixture, after displacement.
    #[serde(default = "kilometre")]
    pub gate_m: f64,
    /// What the gate grows by with each level of bias (m): a bound of the displacement that the method is told.
    #[serde(default)]
    pub gate_per_level_m: f64,
    /// Tails of a mixture; Student's t with fixed degrees of freedom where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tails: Option<TailsSettings>,
    /// Degrees of freedom of Student's t, at the start where they are estimated; 3 where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub degrees_of_freedom: Option<f64>,
    /// Weight of a mixture's uniform density; 0.1 where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub outlier_weight: Option<f64>,
    /// Deviation at a mixture's start; the prior's displacement where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub start: Option<StartSettings>,
    /// Whether a mixture goes on with Gaussian tails in the end; where absent, of biases beside a uniform density.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub refine: Option<bool>,
    /// Least deviation of a mixture (m); 10 where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub least_deviation_m: Option<f64>,
    /// Most iterations of a mixture; 150 where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub iterations: Option<usize>,
    /// Length of a drift, in root mean square coordinates of the tracks; 3 where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub length: Option<f64>,
    /// Stiffness of a drift; 3 where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stiffness: Option<f64>,
    /// Prior deviation of the range biases (m); 1500 where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub range_deviation_m: Option<f64>,
    /// Prior deviation of the azimuth biases (rad); 2.5 degrees where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub azimuth_deviation_rad: Option<f64>,
}

fn kilometre() -> f64 {
    1000.0
}

impl MethodSettings {
    /// The mixture with this gate.
    pub fn mixture(&self, gate: f64) -> Mixture {
        let degrees = self.degrees_of_freedom.unwrap_or(3.0);
        let tails = match self.tails.unwrap_or(TailsSettings::Student) {
            TailsSettings::Gaussian => Tails::Gaussian,
            TailsSettings::Student => Tails::Student(degrees),
            TailsSettings::StudentEstimated => Tails::Estimated(degrees),
        };
        let default = Mixture::default();
        Mixture {
            tails,
            outlier_weight: self.outlier_weight.unwrap_or(default.outlier_weight),
            // Gaussian coherent point drift has equal weights.
            estimate_weights: tails != Tails::Gaussian,
            start: match self.start.unwrap_or(StartSettings::Prior) {
                StartSettings::Prior => Start::Prior,
                StartSettings::Spread => Start::Spread,
                StartSettings::Metres(deviation) => Start::Deviation(deviation),
            },
            iterations: self.iterations.unwrap_or(default.iterations),
            refine: self
                .refine
                .unwrap_or(self.algorithm == Algorithm::Bias && self.outlier_weight != Some(0.0)),
            miss_probability: if self.algorithm == Algorithm::Bias { default.miss_probability } else { 0.0 },
            least_deviation: self.least_deviation_m.unwrap_or(default.least_deviation),
            gate,
            ..default
        }
    }

    /// The prior of the biases.
    pub fn prior(&self) -> BiasPrior {
        let range = self.range_deviation_m.unwrap_or(RANGE_DEVIATION);
        BiasPrior::independent(range, self.azimuth_deviation_rad.unwrap_or(AZIMUTH_DEVIATION))
    }

    /// Length of the drift.
    pub fn length(&self) -> f64 {
        self.length.unwrap_or(LENGTH)
    }

    /// Stiffness of the drift.
    pub fn stiffness(&self) -> f64 {
        self.stiffness.unwrap_or(STIFFNESS)
    }

    /// Checks the values of method `id`.
    ///
    /// # Errors
    /// [`PositioningError::Setting`] naming the key.
    pub fn validate(&self, id: &str) -> Result<(), PositioningError> {
        let wrong = |key: &str, problem: String| {
            Err(PositioningError::setting(format!("method.{id}.{key}"), problem))
        };
        let started = match self.start {
            Some(StartSettings::Metres(deviation)) => Some(deviation),
            _ => None,
        };
        let positive = [
            ("gate_m", Some(self.gate_m)),
            ("degrees_of_freedom", self.degrees_of_freedom),
            ("start", started),
            ("least_deviation_m", self.least_deviation_m),
            ("length", self.length),
            ("stiffness", self.stiffness),
            ("range_deviation_m", self.range_deviation_m),
            ("azimuth_deviation_rad", self.azimuth_deviation_rad),
        ];
        for (key, value) in positive {
            let most = if key == "degrees_of_freedom" { 1e8 } else { 1e30 };
            if let Some(value) = value.filter(|value| !(*value > 0.0 && *value <= most)) {
                return wrong(key, format!("is {value}; it must be positive and at most {most:e}"));
            }
        }
        if !(0.0..1e30).contains(&self.gate_per_level_m) {
            let problem = format!("is {}; it must not be negative", self.gate_per_level_m);
            return wrong("gate_per_level_m", problem);
        }
        if let Some(weight) = self.outlier_weight.filter(|weight| !(0.0..1.0).contains(weight)) {
            return wrong("outlier_weight", format!("is {weight}; it must lie in [0, 1)"));
        }
        if self.refine == Some(true) && self.outlier_weight == Some(0.0) {
            let problem =
                "is true, but Gaussian tails need a uniform density beside them; give `outlier_weight`";
            return wrong("refine", problem.into());
        }
        if self.iterations == Some(0) {
            return wrong("iterations", "is 0; at least 1 is needed".into());
        }
        self.misplaced(id)
    }

    /// Keys that the algorithm does not read.
    fn misplaced(&self, id: &str) -> Result<(), PositioningError> {
        let (drift, bias) = (self.algorithm == Algorithm::Drift, self.algorithm == Algorithm::Bias);
        let student = self.tails != Some(TailsSettings::Gaussian);
        let keys = [
            ("tails", self.tails.is_some(), drift || bias, "mixtures"),
            (
                "degrees_of_freedom",
                self.degrees_of_freedom.is_some(),
                (drift || bias) && student,
                "Student's t",
            ),
            ("outlier_weight", self.outlier_weight.is_some(), drift || bias, "mixtures"),
            ("start", self.start.is_some(), drift || bias, "mixtures"),
            ("iterations", self.iterations.is_some(), drift || bias, "mixtures"),
            ("refine", self.refine.is_some(), drift || bias, "mixtures"),
            ("least_deviation_m", self.least_deviation_m.is_some(), drift || bias, "mixtures"),
            ("length", self.length.is_some(), drift, "algorithm = \"drift\""),
            ("stiffness", self.stiffness.is_some(), drift, "algorithm = \"drift\""),
            ("range_deviation_m", self.range_deviation_m.is_some(), bias, "algorithm = \"bias\""),
            ("azimuth_deviation_rad", self.azimuth_deviation_rad.is_some(), bias, "algorithm = \"bias\""),
        ];
        match keys.into_iter().find(|(_, given, read, _)| *given && !read) {
            Some((key, .., whose)) => {
                let problem = format!("is for {whose} alone; leave it out");
                Err(PositioningError::setting(format!("method.{id}.{key}"), problem))
            }
            None => Ok(()),
        }
    }
}
