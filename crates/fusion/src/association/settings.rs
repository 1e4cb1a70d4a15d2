//! The parameters of the mixture.

use super::error::AssociationError;
use super::tails::Tails;

/// Deviation of a coordinate about its displaced track at the start of the iterations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Start {
    /// What the field's prior expects of the displacements.
    Prior,
    /// The root mean square distance of all pairs, as coherent point drift is usually started. Where few tracks are
    /// common the sets then slide.
    Spread,
    /// This deviation (m).
    Deviation(f64),
}

/// Parameters of the mixture, its iterations and the decision.
#[derive(Clone, Debug, PartialEq)]
pub struct Mixture {
    /// Tails of the components.
    pub tails: Tails,
    /// Weight w of the uniform density, in [0, 1): the share of second tracks without partner.
    pub outlier_weight: f64,
    /// Whether the weights π_m of the components are estimated; else they are equal.
    pub estimate_weights: bool,
    /// Deviation at the start.
    pub start: Start,
    /// Most iterations, as many again where they are refined.
    pub iterations: usize,
    /// The iterations end when one raises the penalised log likelihood by less than this much a track.
    pub tolerance: f64,
    /// Whether the iterations go on with Gaussian tails once they have ended with heavy ones. Heavy tails find the field
    /// while it is far off; tracks with Gaussian noise then tell it more exactly, and with an honest uncertainty. For
    /// fields of few unknowns: a flexible one takes the noise for displacement.
    pub refine: bool,
    /// Least deviation of a coordinate about its displaced track (m), what the tracks' noise cannot be below: a flexible
    /// field would run through all tracks without it.
    pub least_deviation: f64,
    /// A pair is declared only if it is closer than this after displacement, root mean square over the scans (m).
    pub gate: f64,
    /// Probability that Gaussian tails give to a pair farther apart than what is declared: a gate narrower than `gate`
    /// where the deviation at the end allows it. Heavy tails allow nothing. Zero keeps the gate.
    pub miss_probability: f64,
    /// Number of pairs up to which all are compared. Of larger sets those within ten deviations of the start are.
    pub dense_pairs: usize,
    /// Average number of first tracks that each second one of a larger set is compared with, at most: the nearest.
    pub neighbours: usize,
}

impl Mixture {
    /// For flexible fields, which run through the tracks so closely that the deviation at the end says nothing of their
    /// noise: neither refined nor the gate narrowed, started from displacements of this deviation (m).
    pub fn flexible(displacement: f64) -> Self {
        Self {
            start: Start::Deviation(displacement),
            refine: false,
            miss_probability: 0.0,
            ..Self::default()
        }
    }

    /// Checks the values.
    ///
    /// # Errors
    /// [`AssociationError::Parameter`].
    pub fn validate(&self) -> Result<(), AssociationError> {
        self.tails.validate()?;
        if !(0.0..1.0).contains(&self.outlier_weight) {
            let problem = format!("is {}; it must lie in [0, 1)", self.outlier_weight);
            return Err(AssociationError::parameter("outlier_weight", problem));
        }
        if let Start::Deviation(deviation) = self.start {
            positive("start", deviation)?;
        }
        positive("gate", self.gate)?;
        positive("least_deviation", self.least_deviation)?;
        if !(0.0..1.0).contains(&self.miss_probability) {
            let problem = format!("is {}; it must lie in [0, 1)", self.miss_probability);
            return Err(AssociationError::parameter("miss_probability", problem));
        }
        if self.refine && self.outlier_weight == 0.0 {
            let problem = "is true, but Gaussian tails without a uniform density let every track without partner pull; give `outlier_weight`";
            return Err(AssociationError::parameter("refine", problem));
        }
        if self.tolerance.is_nan() || self.tolerance < 0.0 {
            let problem = format!("is {}; it must not be negative", self.tolerance);
            return Err(AssociationError::parameter("tolerance", problem));
        }
        for (name, value) in [("iterations", self.iterations), ("neighbours", self.neighbours)] {
            if value == 0 {
                return Err(AssociationError::parameter(name, "is 0; at least 1 is needed"));
            }
        }
        Ok(())
    }
}

impl Default for Mixture {
    /// For fields of few unknowns: Student's t with three degrees of freedom beside a uniform density of weight 0.1,
    /// started at the prior's displacement, refined with Gaussian tails; a gate of 1 km.
    fn default() -> Self {
        Self {
            tails: Tails::Student(3.0),
            outlier_weight: 0.1,
            estimate_weights: true,
            start: Start::Prior,
            iterations: 150,
            tolerance: 1e-6,
            refine: true,
            least_deviation: 10.0,
            gate: 1000.0,
            miss_probability: 1e-5,
            dense_pairs: 100_000,
            neighbours: 100,
        }
    }
}

/// Fails unless the value is positive and finite.
pub(super) fn positive(name: &'static str, value: f64) -> Result<(), AssociationError> {
    if value > 0.0 && value.is_finite() {
        return Ok(());
    }
    Err(AssociationError::parameter(name, format!("is {value}; it must be positive and finite")))
}
