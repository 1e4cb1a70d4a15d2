//! The `[world]`, `[model]` and `[method.ID]` tables.

use serde::{Deserialize, Serialize};
use sumprod_optimizers::{BoardForm, BoardSettings};

use super::area::Area;
use crate::error::PositioningError;

/// The `[world]` table: what is known of the recording.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WorldSettings {
    /// Until when the room is empty, which is when the walk starts (s).
    pub empty_until: f64,
    /// Time that the walker takes from each point of the true path to the next (s); used to score, not to track.
    pub leg: f64,
}

/// The `[model]` table: what the tracker assumes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ModelSettings {
    /// Growth of the variance of each coordinate of the position (m²/s): 0.25 is a step of half a metre in a second.
    pub wander_variance: f64,
    /// How far the walker may be outside the network's bounding box (m).
    pub margin: f64,
    /// Side of the grid's cells (m).
    pub cell: f64,
    /// Number of classes of fade level, each with a profile of its own.
    pub fade_classes: usize,
    /// Rounds of expectation maximisation.
    pub rounds: usize,
    /// Share of the columns of a sweep that counts as independent, in place of what the recording says.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub independent_share: Option<f64>,
}

impl Default for ModelSettings {
    fn default() -> Self {
        Self {
            wander_variance: 0.25,
            margin: 0.3,
            cell: 0.2,
            fade_classes: 4,
            rounds: 8,
            independent_share: None,
        }
    }
}

/// How a method estimates the position.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Algorithm {
    /// The exact posterior on the grid.
    Grid,
    /// The bootstrap particle filter.
    Bootstrap,
    /// Metropolis-Hastings chains with quantum genetic proposals.
    QuantumMetropolis,
    /// The knowledge-board swarm.
    KnowledgeBoard,
}

/// One `[method.ID]` table.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MethodSettings {
    /// How it estimates the position.
    pub algorithm: Algorithm,
    /// Number of particles, of the algorithms that have some; 1000 where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub particles: Option<usize>,
    /// The swarm's parameters.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub board: Option<BoardSettings>,
}

fn positive(key: &str, value: f64, unit: &str) -> Result<(), PositioningError> {
    if value > 0.0 && value.is_finite() {
        return Ok(());
    }
    Err(PositioningError::setting(key, format!("is {value} {unit}; it must be positive and finite")))
}

impl WorldSettings {
    pub(super) fn validate(&self) -> Result<(), PositioningError> {
        positive("world.empty_until", self.empty_until, "s")?;
        positive("world.leg", self.leg, "s")
    }
}

impl ModelSettings {
    pub(super) fn validate(&self) -> Result<(), PositioningError> {
        positive("model.wander_variance", self.wander_variance, "m²/s")?;
        positive("model.cell", self.cell, "m")?;
        if !(self.margin >= 0.0 && self.margin.is_finite()) {
            let problem = format!("is {} m; it must be finite and not negative", self.margin);
            return Err(PositioningError::setting("model.margin", problem));
        }
        if self.fade_classes == 0 {
            return Err(PositioningError::setting("model.fade_classes", "is 0; at least 1 class is needed"));
        }
        match self.independent_share {
            Some(share) if !(share > 0.0 && share <= 1.0) => {
                let problem = format!("is {share}; a share lies above 0 and at most at 1");
                Err(PositioningError::setting("model.independent_share", problem))
            }
            _ => Ok(()),
        }
    }
}

impl MethodSettings {
    /// Number of particles.
    pub fn particles(&self) -> usize {
        self.particles.unwrap_or(1000)
    }

    /// The swarm's parameters.
    pub fn board(&self) -> BoardSettings {
        self.board.clone().unwrap_or_default()
    }

    pub(super) fn form(&self, area: &Area) -> String {
        match self.algorithm {
            Algorithm::Grid => format!("grid of {} cells", area.len()),
            _ => format!("particles {}", self.particles()),
        }
    }

    pub(super) fn validate(&self, id: &str) -> Result<(), PositioningError> {
        let wrong = |key: &str, problem: String| {
            Err(PositioningError::setting(format!("method.{id}.{key}"), problem))
        };
        match (self.algorithm, self.particles) {
            (_, Some(0)) => return wrong("particles", "is 0; at least 1 particle is needed".into()),
            (Algorithm::Grid, Some(count)) => {
                return wrong("particles", format!("is {count}, but a grid has none; leave it out"));
            }
            _ => {}
        }
        let Some(board) = &self.board else { return Ok(()) };
        if self.algorithm != Algorithm::KnowledgeBoard {
            return wrong("board", "is for algorithm = \"knowledge-board\" alone; leave it out".into());
        }
        if board.form == BoardForm::Literal {
            return wrong("board.form", "is \"literal\", which is no posterior; choose \"valid\"".into());
        }
        board.validate().or_else(|error| wrong("board", format!("cannot be used: {error}")))
    }
}
