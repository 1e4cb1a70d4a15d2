//! The `[method.ID]` tables.

use serde::{Deserialize, Serialize};
use sumprod_optimizers::{BoardForm, BoardSettings};

use crate::error::PositioningError;

/// How a method estimates the state.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Algorithm {
    /// The exact posterior on a grid.
    Grid,
    /// The extended Kalman filter.
    ExtendedKalman,
    /// The bootstrap particle filter, reselected systematically at every step.
    Bootstrap,
    /// The knowledge-board swarm.
    KnowledgeBoard,
}

/// What the valid swarm takes for the density of the predicted state.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Predictive {
    /// Σ w_j N(x; f(x_j), Q) over the particles of the step before: exact, and there where Q has full rank.
    Marginal,
    /// The board's Gaussian sum.
    GaussianSum,
}

/// One `[method.ID]` table.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MethodSettings {
    /// How it estimates the state.
    pub algorithm: Algorithm,
    /// Number of particles, of the algorithms that have some.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub particles: Option<usize>,
    /// Number of cells of the grid.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cells: Option<usize>,
    /// What the swarm takes for the predicted density; the Gaussian sum where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub predictive: Option<Predictive>,
    /// The swarm's parameters.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub board: Option<BoardSettings>,
}

/// What a world offers to its methods.
#[derive(Clone, Copy, Debug)]
pub struct Offer {
    /// Whether its state fits on a grid.
    pub grid: bool,
    /// Whether its process noise has a density.
    pub density: bool,
}

impl MethodSettings {
    /// Number of particles; 1000 where the table does not say.
    pub fn particles(&self) -> usize {
        self.particles.unwrap_or(1000)
    }

    /// The swarm's parameters.
    pub fn board(&self) -> BoardSettings {
        self.board.clone().unwrap_or_default()
    }

    /// Whether it is the paper's algorithm as printed.
    pub fn is_literal(&self) -> bool {
        self.algorithm == Algorithm::KnowledgeBoard && self.board().form == BoardForm::Literal
    }

    /// Whether the swarm uses the exact predicted density.
    pub fn is_marginal(&self) -> bool {
        self.predictive == Some(Predictive::Marginal)
    }

    /// Checks the values of method `id`.
    ///
    /// # Errors
    /// [`PositioningError::Setting`] naming the key.
    pub fn validate(&self, id: &str, offer: Offer) -> Result<(), PositioningError> {
        let wrong = |key: &str, problem: String| {
            Err(PositioningError::setting(format!("method.{id}.{key}"), problem))
        };
        let sampled = matches!(self.algorithm, Algorithm::Bootstrap | Algorithm::KnowledgeBoard);
        if self.algorithm == Algorithm::Grid && !offer.grid {
            return wrong("algorithm", "is \"grid\", but this state has too many coordinates for one".into());
        }
        match self.particles {
            Some(0) => return wrong("particles", "is 0; at least 1 particle is needed".into()),
            Some(count) if !sampled => {
                return wrong(
                    "particles",
                    format!("is {count}, but this algorithm has no particles; leave it out"),
                );
            }
            _ => {}
        }
        match self.cells {
            Some(cells) if self.algorithm != Algorithm::Grid => {
                return wrong("cells", format!("is {cells}, but this algorithm has no grid; leave it out"));
            }
            Some(cells) if !(2..=100_000).contains(&cells) => {
                return wrong("cells", format!("is {cells}; it must lie between 2 and 100000"));
            }
            _ => {}
        }
        if self.algorithm != Algorithm::KnowledgeBoard {
            for (key, given) in [("board", self.board.is_some()), ("predictive", self.predictive.is_some())] {
                if given {
                    return wrong(key, "is for algorithm = \"knowledge-board\" alone; leave it out".into());
                }
            }
            return Ok(());
        }
        if self.is_marginal() && !offer.density {
            let problem = "is \"marginal\", but this motion's noise is singular, so that the predicted state has no density at a point; choose \"gaussian-sum\"";
            return wrong("predictive", problem.into());
        }
        if self.is_literal() && self.predictive.is_some() {
            return wrong("predictive", "is for the valid form alone, which the literal one is not".into());
        }
        let board = self.board().validate();
        board.or_else(|error| wrong("board", format!("cannot be used: {error}")))
    }
}
