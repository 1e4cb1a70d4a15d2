//! The parameters of the swarm.

use serde::{Deserialize, Serialize};

use crate::error::OptimizerError;

/// What becomes of the cloud that the swarm has moved.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum BoardForm {
    /// It is taken for a sample of the posterior, as the paper does.
    Literal,
    /// It shapes a proposal.
    #[default]
    Valid,
}

/// Parameters of a [`KnowledgeBoard`](super::KnowledgeBoard).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BoardSettings {
    /// What becomes of the moved cloud.
    pub form: BoardForm,
    /// Number S of sub-swarms; fewer where a sub-swarm would have less than four particles.
    pub sub_swarms: usize,
    /// Most iterations of the search; 0 leaves the cloud where it is.
    pub iterations: usize,
    /// The search ends once the effective sample size of the fitness reaches this share of the particles.
    pub enough: f64,
    /// Inertia ω of the velocity.
    pub inertia: f64,
    /// Pull c₁ of the sub-swarm's own best state.
    pub own_pull: f64,
    /// Pull c₂ of another sub-swarm's best state.
    pub other_pull: f64,
    /// Rise ε_C of the best log fitness above which a sub-swarm is growing.
    pub ability_threshold: f64,
    /// Mean distance ε_D from the sub-swarm's mean, in standard deviations of the prior's cloud, above which it is
    /// spread.
    pub diversity_threshold: f64,
    /// Share α of the valid form's proposal that is the board's Gaussian sum of the prior.
    pub defensive_share: f64,
}

impl Default for BoardSettings {
    fn default() -> Self {
        Self {
            form: BoardForm::Valid,
            sub_swarms: 10,
            iterations: 5,
            enough: 0.9,
            inertia: 0.4,
            own_pull: 1.2,
            other_pull: 1.2,
            ability_threshold: 1e-2,
            diversity_threshold: 0.05,
            defensive_share: 0.2,
        }
    }
}

impl BoardSettings {
    /// The defaults of the literal form.
    pub fn literal() -> Self {
        Self { form: BoardForm::Literal, iterations: 8, enough: 0.5, ..Self::default() }
    }

    /// Checks the values.
    ///
    /// # Errors
    ///
    /// [`OptimizerError::Parameter`] naming the first that is out of range.
    pub fn validate(&self) -> Result<(), OptimizerError> {
        let wrong = |what, value, must| Err(OptimizerError::Parameter { what, value, must });
        if self.sub_swarms == 0 {
            return wrong("the number of sub-swarms", 0.0, "it must be at least 1");
        }
        for (what, value) in [
            ("the inertia", self.inertia),
            ("the pull of the own best state", self.own_pull),
            ("the pull of another's best state", self.other_pull),
            ("the threshold of the ability to search", self.ability_threshold),
            ("the threshold of the diversity", self.diversity_threshold),
        ] {
            if !(value.is_finite() && value >= 0.0) {
                return wrong(what, value, "it must be finite and not negative");
            }
        }
        if !(0.0..=1.0).contains(&self.enough) {
            return wrong("the share that is enough", self.enough, "it must lie between 0 and 1");
        }
        if !(self.defensive_share > 0.0 && self.defensive_share <= 1.0) {
            let must = "it must be above 0, so that no weight is without bound, and at most 1";
            return wrong("the defensive share", self.defensive_share, must);
        }
        Ok(())
    }
}
