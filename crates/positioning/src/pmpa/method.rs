//! The `[method.ID]` tables: what a method hears, and how it holds each kind of edge.

use serde::{Deserialize, Serialize};
use sumprod_messages::{AnyForm, Gibbs, GibbsStart, ParticlesForm, ProductChoice, ProductMethod, Proposal};
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

/// What the kernels are of a method that multiplies kernel mixtures.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum KernelRule {
    /// Those of the motion and the measurements themselves; in use where neighbours measure ranges, the messages of
    /// relative measurements being Gaussian.
    Known,
    /// The variance N^(1/6) (m²) for every kernel of N, as printed, and velocities copied.
    Printed,
}

/// Kernels of a ring: at least, and a standard deviation of the range along the circle.
const FEWEST_KERNELS: f64 = 16.0;
const KERNELS_A_DEVIATION: f64 = 1.5;

/// Most kernels of a ring.
const MOST_KERNELS: f64 = 10_000.0;

/// Sweeps of the Gibbs sampler with known kernels, and with printed ones.
const SWEEPS: (usize, usize) = (5, 3);

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
    /// Which kernels messages are mixtures of, where the method multiplies mixtures. Its particles are then the
    /// prediction's kernels.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub kernels: Option<KernelRule>,
    /// How mixtures of known kernels are multiplied; as their sizes and separation suggest where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub product: Option<ProductChoice>,
    /// Sweeps of a Gibbs sampler over labels; 5 where absent, or 3 with printed kernels.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sweeps: Option<usize>,
    /// Where the chains of labels start; each label given those before it where absent, or by its weight alone with
    /// printed kernels.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub start: Option<GibbsStart>,
    /// Whether the printed conditional of a label counts its own present kernel as well, which its formula may mean.
    #[serde(default)]
    pub counted_twice: bool,
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
            _ => false,
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

    /// The kernels of the mixtures that the method multiplies; none where it multiplies none.
    pub fn kernel_rule(&self, measurement: NeighbourMeasurement) -> Option<KernelRule> {
        let needed = self.neighbours && measurement == NeighbourMeasurement::Range;
        self.kernels.filter(|&rule| rule == KernelRule::Printed || needed)
    }

    /// Number of the prediction's kernels.
    pub fn kernel_count(&self) -> usize {
        match self.prediction_form() {
            AnyForm::Particles(form) => form.count,
            AnyForm::Mixture(form) => form.components,
            AnyForm::Gaussian(_) | AnyForm::Categorical(_) => 1,
        }
    }

    /// Sweeps of the Gibbs sampler over labels.
    pub fn kernel_sweeps(&self) -> usize {
        let printed = self.kernels == Some(KernelRule::Printed);
        self.sweeps.unwrap_or(if printed { SWEEPS.1 } else { SWEEPS.0 })
    }

    /// Where the chains of labels start.
    pub fn kernel_start(&self) -> GibbsStart {
        let printed = self.kernels == Some(KernelRule::Printed);
        self.start.unwrap_or(if printed { GibbsStart::Independent } else { GibbsStart::Sequential })
    }

    /// How mixtures of known kernels are multiplied.
    pub fn kernel_product(&self) -> Box<dyn ProductMethod> {
        match self.product.unwrap_or_default() {
            ProductChoice::Gibbs => {
                Box::new(Gibbs { sweeps: self.kernel_sweeps(), start: self.kernel_start() })
            }
            other => other.method(),
        }
    }

    fn validate_kernels(&self, id: &str) -> Result<(), PositioningError> {
        let wrong = |key: &str, problem: &str| {
            Err(PositioningError::setting(format!("method.{id}.{key}"), problem.to_owned()))
        };
        if let Some(sweeps) = self.sweeps {
            at_least_one(&format!("method.{id}.sweeps"), sweeps, "sweep")?;
        }
        let Some(rule) = self.kernels else {
            let keys = [
                ("product", self.product.is_some()),
                ("sweeps", self.sweeps.is_some()),
                ("start", self.start.is_some()),
                ("counted_twice", self.counted_twice),
            ];
            return match keys.iter().find(|(_, given)| *given) {
                Some((key, _)) => wrong(key, "belongs to methods that multiply mixtures; give `kernels` too"),
                None => Ok(()),
            };
        };
        if self.state != StateModel::PositionVelocity {
            return wrong("kernels", "is for state = \"position-velocity\" alone; leave one of them out");
        }
        if !matches!(self.form.prediction.0, AnyForm::Particles(_)) {
            return wrong(
                "kernels",
                "needs a prediction to put them on; set form.prediction to { particles = 1000 }",
            );
        }
        match rule {
            KernelRule::Known if self.counted_twice => {
                wrong("counted_twice", "is for kernels = \"printed\" alone; leave it out")
            }
            KernelRule::Known
                if self.product != Some(ProductChoice::Gibbs)
                    && (self.sweeps.is_some() || self.start.is_some()) =>
            {
                let key = if self.sweeps.is_some() { "sweeps" } else { "start" };
                wrong(key, "is of the Gibbs sampler alone; set product = \"gibbs\" too")
            }
            KernelRule::Printed if self.product.is_some() => {
                wrong("product", "is for kernels = \"known\" alone; the printed ones have a printed product")
            }
            _ => Ok(()),
        }
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
        self.validate_kernels(id)?;
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
    pub fn admit(&self, id: &str, world: &WorldSettings) -> Result<(), PositioningError> {
        let measurement = world.neighbour_measurement;
        if !self.neighbours || measurement == NeighbourMeasurement::Relative {
            return Ok(());
        }
        if let Some(rule) = self.kernels {
            // Two deviations beyond the reach cover nearly every range that is measured.
            let deviation = world.measurement_variance.sqrt();
            let kernels = ring_kernels(world.radius + 2.0 * deviation, deviation);
            if rule == KernelRule::Known && kernels > MOST_KERNELS {
                let problem = format!(
                    "is {} m², so narrow against a radius of {} m that a ring needs {kernels:.0} kernels, more than {MOST_KERNELS}; leave method `{id}` out with --method",
                    world.measurement_variance, world.radius
                );
                return Err(PositioningError::setting("world.measurement_variance", problem));
            }
            return Ok(());
        }
        let reason = if self.state == StateModel::FrozenVelocity {
            "treats each coordinate by itself, and a range joins the two"
        } else if self.is_guided() && self.is_heard_first(measurement) {
            "draws its particles from the product of all messages, of which a range's is a ring that needs a mixture (kernels = \"known\")"
        } else {
            return Ok(());
        };
        let problem = format!(
            "is \"range\", which method `{id}` cannot use: it {reason}; choose \"relative\", or name the other methods with --method"
        );
        Err(PositioningError::setting("world.neighbour_measurement", problem))
    }
}

/// Number of kernels that make a ring of this radius smooth: so many a standard deviation along the circle.
pub(super) fn ring_kernels(radius: f64, deviation: f64) -> f64 {
    (KERNELS_A_DEVIATION * std::f64::consts::TAU * radius / deviation).ceil().max(FEWEST_KERNELS)
}
