//! The keys `[method.ID]`: which cells messages are held on, for how long, and when Gaussians take over.

use serde::{Deserialize, Serialize};
use sumprod_graph::Port;
use sumprod_messages::{GaussianForm, LatticeForm};

use crate::error::PositioningError;
use crate::form::at_least_one;

/// The keys `[method.ID]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Method {
    /// Variance of each axis of the weak start as evidence (m²).
    #[serde(default = "weak")]
    pub start_variance: f64,
    /// Widths of the cells that messages are held on, one after the other (m), each a whole part of the one before.
    /// Without any all messages are Gaussian from the start.
    #[serde(default)]
    pub cells: Vec<f64>,
    /// Rounds on the cells of each width.
    #[serde(default)]
    pub rounds: Vec<usize>,
    /// The most cells that a belief keeps.
    #[serde(default = "two_hundred")]
    pub components: usize,
    /// Rounds in which edges into agents whose belief is one mode are Gaussian.
    #[serde(default)]
    pub gaussian_rounds: usize,
    /// Standard deviation along the worst axis up to which a belief is one mode (m).
    #[serde(default = "two")]
    pub one_mode_deviation: f64,
    /// Share of the old message kept in the Gaussian rounds.
    #[serde(default)]
    pub damping: f64,
    /// Whether the joint posterior around the beliefs has the last word: groups of agents that fit better in their
    /// mirror image go there, and covariances are those of joint windows instead of messages around loops.
    #[serde(default)]
    pub joint: bool,
}

/// A start known to 100 m, which says next to nothing and holds whoever measures nobody.
fn weak() -> f64 {
    1e4
}

fn two_hundred() -> usize {
    200
}

fn two() -> f64 {
    2.0
}

/// The form of the edges that hold Gaussians.
pub(super) const GAUSSIAN: LatticeForm =
    LatticeForm::Gaussian(GaussianForm { linearisation: sumprod_messages::Linearisation::Jacobian });

/// The port of a factor on one agent.
pub(super) const OWN: Port = 0;

impl Method {
    /// The lattice forms with their rounds, in order.
    pub(super) fn levels(&self) -> impl Iterator<Item = (LatticeForm, usize)> {
        let most = self.components;
        self.cells
            .iter()
            .zip(&self.rounds)
            .map(move |(&width, &rounds)| (LatticeForm::Lattice { width, most }, rounds))
    }

    /// The form that edges start in.
    pub(super) fn first_form(&self) -> LatticeForm {
        self.levels().next().map_or(GAUSSIAN, |(form, _)| form)
    }

    /// Checks every value of method `id`; `radius` is the world's (m).
    ///
    /// # Errors
    /// [`PositioningError::Setting`] naming the key.
    pub fn validate(&self, id: &str, radius: f64) -> Result<(), PositioningError> {
        let wrong = |name: &str, problem: String| {
            Err(PositioningError::setting(format!("method.{id}.{name}"), problem))
        };
        if !(self.start_variance > 0.0 && self.start_variance.is_finite()) {
            let problem = format!("is {} m²; a variance must be positive and finite", self.start_variance);
            return wrong("start_variance", problem);
        }
        at_least_one(&format!("method.{id}.components"), self.components, "cell")?;
        if self.cells.len() != self.rounds.len() {
            let (cells, rounds) = (self.cells.len(), self.rounds.len());
            return wrong(
                "rounds",
                format!("holds {rounds} numbers for {cells} widths of cells; give one each"),
            );
        }
        for (index, &width) in self.cells.iter().enumerate() {
            // Finer cells cost their square and say no more than the Gaussian rounds do.
            if !(width.is_finite() && width > radius / 100.0) {
                let least = radius / 100.0;
                return wrong(
                    "cells",
                    format!("holds {width} m; a width must be finite and above {least} m"),
                );
            }
            let Some(&before) = index.checked_sub(1).and_then(|before| self.cells.get(before)) else {
                continue;
            };
            let parts = before / width;
            if !(parts >= 2.0 && parts == parts.round()) {
                let problem =
                    format!("holds {width} m after {before} m; each must be a whole part of the one before");
                return wrong("cells", problem);
            }
        }
        if self.cells.is_empty() && self.gaussian_rounds == 0 {
            let problem = "is 0 and there are no cells; a method needs at least 1 round";
            return wrong("gaussian_rounds", problem.into());
        }
        if !(self.one_mode_deviation > 0.0 && self.one_mode_deviation.is_finite()) {
            let problem = format!("is {} m; it must be positive and finite", self.one_mode_deviation);
            return wrong("one_mode_deviation", problem);
        }
        if !(0.0..1.0).contains(&self.damping) {
            return wrong("damping", format!("is {}; it must be at least 0 and below 1", self.damping));
        }
        Ok(())
    }
}
