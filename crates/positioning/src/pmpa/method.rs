//! The `[method.ID]` tables: what a method hears, and how it holds each kind of edge.

use serde::{Deserialize, Serialize};
use sumprod_messages::{AnyForm, ParticlesForm, Proposal};
use sumprod_optimizers::{Scheme, Trigger};

use super::world::{NeighbourMeasurement, WorldSettings};
use crate::error::PositioningError;
use crate::form::{FormSpec, at_least_one};

/// Rounds within a scan where ranges are made linear: by then successive points agree to a millimetre.
const RANGE_ROUNDS: usize = 5;

/// What a method takes for the state.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum StateModel {
    /// Position and velocity, moved as in the world.
    #[default]
    PositionVelocity,
    /// Each coordinate by itself, moved by the velocity at time zero: m ← m + v₀ T, s ← s + s_pred (Fan, Wang, Zhou
    /// 2018, equations 13 to 16, to the letter).
    FrozenVelocity,
}

/// How each kind of edge is held; Gaussian where absent.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Forms {
    /// Edges of the motion.
    pub prediction: FormSpec,
    /// Edges of the target's measurement of itself.
    #[serde(rename = "self")]
    pub own: FormSpec,
    /// Edges of the neighbours' relative measurements.
    pub relative: FormSpec,
    /// Edges of the neighbours' ranges.
    pub range: FormSpec,
}

/// One `[method.ID]` table.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MethodSettings {
    /// What it takes for the state.
    #[serde(default)]
    pub state: StateModel,
    /// Whether it hears the neighbours.
    #[serde(default)]
    pub neighbours: bool,
    /// Whether it uses the target's measurement of itself.
    #[serde(default = "yes")]
    pub z_self: bool,
    /// Variance that a step adds to a coordinate under a frozen velocity (m²); the world's process variance times
    /// 1 s⁴ where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub s_pred: Option<f64>,
    /// Number of particles of every edge that holds particles, in place of what its form says.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub particles: Option<usize>,
    /// Where predicted particles are drawn from, in place of what the prediction's form says.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub proposal: Option<Proposal>,
    /// Rounds within a scan; 1 where absent, or 5 where ranges are made linear, each at the last round's estimate.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rounds: Option<usize>,
    /// How particles are reselected at the end of a scan.
    #[serde(default)]
    pub resampling: Scheme,
    /// They are reselected where their effective number is at or below this share of their number: 1 is always.
    #[serde(default = "one")]
    pub resample_below: f64,
    /// How each kind of edge is held.
    #[serde(default)]
    pub form: Forms,
}

fn yes() -> bool {
    true
}

fn one() -> f64 {
    1.0
}

impl MethodSettings {
    /// Form of the motion's edges.
    pub fn prediction_form(&self) -> AnyForm {
        match self.resolved(self.form.prediction) {
            AnyForm::Particles(form) => {
                let proposal = self.proposal.unwrap_or(form.proposal);
                AnyForm::Particles(ParticlesForm { proposal, ..form })
            }
            other => other,
        }
    }

    /// Form of the edges of the target's measurement of itself.
    pub fn own_form(&self) -> AnyForm {
        self.resolved(self.form.own)
    }

    /// Form of the neighbours' edges.
    pub fn neighbour_form(&self, measurement: NeighbourMeasurement) -> AnyForm {
        match measurement {
            NeighbourMeasurement::Relative => self.resolved(self.form.relative),
            NeighbourMeasurement::Range => self.resolved(self.form.range),
        }
    }

    fn resolved(&self, spec: FormSpec) -> AnyForm {
        match (spec.0, self.particles) {
            (AnyForm::Particles(form), Some(count)) => AnyForm::Particles(ParticlesForm { count, ..form }),
            (form, _) => form,
        }
    }

    /// Whether predicted particles are drawn where the measurements say, so that these must come first.
    pub fn is_guided(&self) -> bool {
        match self.prediction_form() {
            AnyForm::Particles(form) => form.proposal != Proposal::Prediction,
            AnyForm::Gaussian(_) => false,
        }
    }

    /// Whether every measurement's edge is Gaussian, so that it can be heard before there are particles.
    pub fn is_heard_first(&self, measurement: NeighbourMeasurement) -> bool {
        let gaussian = |form| matches!(form, AnyForm::Gaussian(_));
        (!self.z_self || gaussian(self.own_form()))
            && (!self.neighbours || gaussian(self.neighbour_form(measurement)))
    }

    /// Rounds within a scan.
    pub fn rounds(&self, measurement: NeighbourMeasurement) -> usize {
        let linearises = self.neighbours
            && measurement == NeighbourMeasurement::Range
            && matches!(self.neighbour_form(measurement), AnyForm::Gaussian(_));
        self.rounds.unwrap_or(if linearises { RANGE_ROUNDS } else { 1 })
    }

    /// When particles are reselected.
    pub fn trigger(&self) -> Trigger {
        Trigger::below(self.resample_below).unwrap_or(Trigger::ALWAYS)
    }

    /// Variance that a step adds to a coordinate under a frozen velocity (m²).
    pub fn step_variance(&self, world: &WorldSettings) -> f64 {
        self.s_pred.unwrap_or(world.process_variance)
    }

    /// Checks the values of method `id`.
    ///
    /// # Errors
    /// [`PositioningError::Setting`] naming the key.
    pub fn validate(&self, id: &str) -> Result<(), PositioningError> {
        let wrong = |key: &str, problem: String| {
            Err(PositioningError::setting(format!("method.{id}.{key}"), problem))
        };
        if !self.z_self && !self.neighbours {
            return wrong(
                "z_self",
                "is false, and so is `neighbours`; a method must measure something".into(),
            );
        }
        if let Some(value) = self.s_pred {
            if self.state != StateModel::FrozenVelocity {
                return wrong("s_pred", "is for state = \"frozen-velocity\" alone; leave it out".into());
            }
            if !(value > 0.0 && value.is_finite()) {
                return wrong("s_pred", format!("is {value} m²; a variance must be positive and finite"));
            }
        }
        let specs = [
            ("prediction", self.form.prediction),
            ("self", self.form.own),
            ("relative", self.form.relative),
            ("range", self.form.range),
        ];
        for (kind, spec) in specs {
            spec.validate(&format!("method.{id}.form.{kind}"))?;
        }
        if let Some(count) = self.particles {
            at_least_one(&format!("method.{id}.particles"), count, "particle")?;
            if specs.iter().all(|(_, spec)| matches!(spec.0, AnyForm::Gaussian(_))) {
                let problem = format!(
                    "is {count}, but no edge of this method holds particles; set method.{id}.form.prediction to {{ particles = {count} }}"
                );
                return wrong("particles", problem);
            }
        }
        if let Some(rounds) = self.rounds {
            at_least_one(&format!("method.{id}.rounds"), rounds, "round")?;
        }
        if Trigger::below(self.resample_below).is_err() {
            return wrong(
                "resample_below",
                format!("is {}; a share lies between 0 and 1", self.resample_below),
            );
        }
        Ok(())
    }

    /// Whether method `id` can use what the world measures of its neighbours.
    ///
    /// # Errors
    /// [`PositioningError::Setting`] where it cannot.
    pub fn admit(&self, id: &str, measurement: NeighbourMeasurement) -> Result<(), PositioningError> {
        if !self.neighbours || measurement == NeighbourMeasurement::Relative {
            return Ok(());
        }
        let reason = if self.state == StateModel::FrozenVelocity {
            "treats each coordinate by itself, and a range joins the two"
        } else if self.is_guided() && self.is_heard_first(measurement) {
            "draws its particles from the product of all messages, of which a range's is a ring that needs a mixture"
        } else {
            return Ok(());
        };
        let problem = format!(
            "is \"range\", which method `{id}` cannot use: it {reason}; choose \"relative\", or name the other methods with --method"
        );
        Err(PositioningError::setting("world.neighbour_measurement", problem))
    }
}
