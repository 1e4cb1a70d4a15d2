//! The `[method.ID]` tables: which filter, which optimizer, with which parameters, and which sensors it asks.

use std::f64::consts::PI;

use serde::{Deserialize, Serialize};
use sumprod_filters::Recovery;
use sumprod_messages::Moments;
use sumprod_optimizers::quantum::Reference;
use sumprod_optimizers::{
    Coding, Decoding, Independence, Move, OptimizerError, QuantumImportance, QuantumLiteral,
    QuantumMetropolis, RandomWalk, Regularised, Rotation, Scheme, Trigger, Weigh,
};

use super::schedule::Rule;
use crate::error::PositioningError;
use crate::form::at_least_one;

/// How a method estimates.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Algorithm {
    /// Iterated extended Kalman filter.
    Iekf,
    /// Bootstrap particle filter.
    Bootstrap,
    /// Regularised particle filter.
    Regularised,
    /// Particle filter with random-walk Metropolis steps.
    RandomWalk,
    /// Particle filter with independence Metropolis-Hastings steps.
    Independence,
    /// Quantum genetic particle filter as printed.
    QuantumLiteral,
    /// Quantum genetic particle filter with the strings' probabilities in the weights.
    QuantumImportance,
    /// Quantum genetic particle filter by Metropolis-Hastings steps on the strings.
    QuantumMetropolis,
}

impl Algorithm {
    /// Whether it holds particles.
    pub fn has_particles(self) -> bool {
        self != Self::Iekf
    }

    fn has_generations(self) -> bool {
        !matches!(self, Self::Iekf | Self::Bootstrap | Self::Regularised)
    }

    fn has_bits(self) -> bool {
        matches!(self, Self::QuantumLiteral | Self::QuantumImportance | Self::QuantumMetropolis)
    }

    fn rotates(self) -> bool {
        matches!(self, Self::QuantumLiteral | Self::QuantumImportance)
    }
}

/// What a string of bits stands for in the literal form.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum StringDecoding {
    /// An offset of all four coordinates, up to `reach` deviations of the cloud.
    Local4,
    /// An offset of the position alone.
    Pos2,
    /// A place between the cloud's least and greatest coordinates; the gate turns towards the population's best.
    Global4,
    /// A place in the particle's kernel.
    Kernel,
}

/// What happens where no particle explains the readings of a scan.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Remedy {
    /// The method fails.
    Fail,
    /// The prediction stands.
    KeepPrediction,
    /// The particles are spread by nine times their covariance.
    Widen,
    /// The particles are drawn anew from the prior of the first scan.
    Redraw,
}

/// One `[method.ID]` table.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MethodSettings {
    /// How it estimates.
    pub algorithm: Algorithm,
    /// Number of particles; 2000 where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub particles: Option<usize>,
    /// Generations of the register, or steps of the Markov chains; 5 where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub generations: Option<usize>,
    /// Bits a coordinate; 9 where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bits: Option<u32>,
    /// What a string stands for; `local4` where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub decoding: Option<StringDecoding>,
    /// Deviations of the cloud that the local decodings reach; 1 where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reach: Option<f64>,
    /// Angle of the rotation gate (rad); 0.05 π where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rotation: Option<f64>,
    /// How many of the most significant bits of a coordinate rotate; all where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rotated_bits: Option<usize>,
    /// How particles are reselected at the end of a scan.
    #[serde(default)]
    pub resampling: Scheme,
    /// They are reselected where their effective number is at or below this share of their number: 1 is always, 0
    /// never.
    #[serde(default = "one")]
    pub resample_below: f64,
    /// Number of sensors asked at a scan; all where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub active: Option<usize>,
    /// Which are asked.
    #[serde(default)]
    pub schedule: Rule,
    /// Whether a track that the readings contradict is given up, and the target sought anew.
    #[serde(default)]
    pub reacquire: bool,
    /// Standard deviations of the readings' noise beyond which no particle explains them; where absent the likeliest
    /// are taken, however far they are.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gate: Option<f64>,
    /// What happens where no particle explains the readings of a scan; `fail` where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub recovery: Option<Remedy>,
}

/// Most points that a move may try at a scan.
const MOST_POINTS: usize = 20_000_000;

fn one() -> f64 {
    1.0
}

impl MethodSettings {
    /// Number of particles.
    pub fn count(&self) -> usize {
        self.particles.unwrap_or(2000)
    }

    /// When particles are reselected.
    pub fn trigger(&self) -> Trigger {
        Trigger::below(self.resample_below).unwrap_or(Trigger::ALWAYS)
    }

    /// What a filter that starts from `prior` does where no particle explains the readings.
    pub fn recovery(&self, prior: &Moments) -> Recovery {
        match self.recovery {
            None | Some(Remedy::Fail) => Recovery::Fail,
            Some(Remedy::KeepPrediction) => Recovery::KeepPrediction,
            Some(Remedy::Widen) => Recovery::Widen(9.0),
            Some(Remedy::Redraw) => Recovery::Redraw(prior.clone()),
        }
    }

    /// The move of a particle filter; none of the Kalman filter.
    ///
    /// # Errors
    /// Where a parameter is out of range.
    pub fn optimizer(&self) -> Result<Option<Box<dyn Move>>, OptimizerError> {
        let generations = self.generations.unwrap_or(5);
        let coding = self.bits.map_or(Ok(Coding::default()), Coding::new)?;
        let angle = self.rotation.unwrap_or(0.05 * PI);
        let rotation = Rotation::new(angle, self.rotated_bits.unwrap_or(usize::MAX))?;
        let chosen: Box<dyn Move> = match self.algorithm {
            Algorithm::Iekf => return Ok(None),
            Algorithm::Bootstrap => Box::new(Weigh),
            Algorithm::Regularised => Box::new(Regularised::default()),
            Algorithm::RandomWalk => Box::new(RandomWalk::new(generations, 1.0)?),
            Algorithm::Independence => Box::new(Independence::new(generations, 1.2)?),
            Algorithm::QuantumLiteral => {
                let decoding = self.decoding.unwrap_or(StringDecoding::Local4);
                let scale = self.reach.unwrap_or(1.0);
                let reference =
                    if decoding == StringDecoding::Global4 { Reference::Population } else { Reference::Own };
                let decoding = match decoding {
                    StringDecoding::Local4 => Decoding::local(scale),
                    StringDecoding::Pos2 => Decoding::Local { scale, coordinates: Some(vec![0, 2]) },
                    StringDecoding::Global4 => Decoding::Global,
                    StringDecoding::Kernel => Decoding::Kernel,
                };
                Box::new(QuantumLiteral { generations, coding, rotation, decoding, reference })
            }
            Algorithm::QuantumImportance => Box::new(QuantumImportance { generations, coding, rotation }),
            Algorithm::QuantumMetropolis => {
                Box::new(QuantumMetropolis { generations, coding, ..QuantumMetropolis::default() })
            }
        };
        Ok(Some(chosen))
    }

    /// Checks the values of method `id`.
    ///
    /// # Errors
    /// [`PositioningError::Setting`] naming the key.
    pub fn validate(&self, id: &str) -> Result<(), PositioningError> {
        let key = |name: &str| format!("method.{id}.{name}");
        let algorithm = self.algorithm;
        let literal = algorithm == Algorithm::QuantumLiteral;
        let local = !matches!(self.decoding, Some(StringDecoding::Global4 | StringDecoding::Kernel));
        let useless = [
            ("gate", self.gate.is_some() && !algorithm.has_particles(), "holds no particles"),
            ("recovery", self.recovery.is_some() && !algorithm.has_particles(), "holds no particles"),
            ("particles", self.particles.is_some() && !algorithm.has_particles(), "holds no particles"),
            ("generations", self.generations.is_some() && !algorithm.has_generations(), "has no generations"),
            ("bits", self.bits.is_some() && !algorithm.has_bits(), "encodes nothing in bits"),
            ("decoding", self.decoding.is_some() && !literal, "decodes strings by the kernel alone"),
            ("reach", self.reach.is_some() && !(literal && local), "has no local decoding"),
            ("rotation", self.rotation.is_some() && !algorithm.rotates(), "rotates no register"),
            ("rotated_bits", self.rotated_bits.is_some() && !algorithm.rotates(), "rotates no register"),
        ];
        if let Some((name, _, why)) = useless.iter().find(|(_, set, _)| *set) {
            return Err(PositioningError::setting(
                key(name),
                format!("is set, but this method {why}; leave it out"),
            ));
        }
        if let Some(count) = self.particles {
            at_least_one(&key("particles"), count, "particle")?;
        }
        if algorithm.has_particles() {
            let generations = if algorithm.has_generations() { self.generations.unwrap_or(5) } else { 0 };
            let points = self.count().saturating_mul(generations.saturating_add(1));
            if points > MOST_POINTS {
                let problem = format!(
                    "is {}, which with {generations} generations makes {points} points a scan; at most {MOST_POINTS} can be held",
                    self.count()
                );
                return Err(PositioningError::setting(key("particles"), problem));
            }
        }
        if let Some(gate) = self.gate.filter(|gate| gate.is_nan() || *gate <= 0.0) {
            let problem = format!("is {gate}; a number of standard deviations must be positive");
            return Err(PositioningError::setting(key("gate"), problem));
        }
        if algorithm == Algorithm::QuantumImportance && self.generations == Some(0) {
            return at_least_one(&key("generations"), 0, "generation");
        }
        if let Some(active) = self.active {
            at_least_one(&key("active"), active, "sensor")?;
        }
        if Trigger::below(self.resample_below).is_err() {
            let problem = format!("is {}; a share lies between 0 and 1", self.resample_below);
            return Err(PositioningError::setting(key("resample_below"), problem));
        }
        let wrong = |name: &str| {
            let name = key(name);
            move |error: OptimizerError| PositioningError::setting(name, format!("cannot be used: {error}"))
        };
        self.bits.map_or(Ok(Coding::default()), Coding::new).map_err(wrong("bits"))?;
        Rotation::new(self.rotation.unwrap_or(0.0), 0).map_err(wrong("rotation"))?;
        if let Some(reach) = self.reach.filter(|reach| !(reach.is_finite() && *reach > 0.0)) {
            let problem = format!("is {reach}; it must be positive and finite");
            return Err(PositioningError::setting(key("reach"), problem));
        }
        Ok(())
    }
}
