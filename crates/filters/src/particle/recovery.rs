//! What to do with a measurement that no particle explains.

use sumprod_messages::Moments;

/// What a particle filter does where no particle explains a measurement: where every log likelihood is below the
/// noise's peak by more than the gate, or is minus infinity.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Recovery {
    /// The correction fails, and the belief stays as it was.
    #[default]
    Fail,
    /// The belief stays as it was, and the correction says so; its log-likelihood is minus infinity.
    KeepPrediction,
    /// The particles are spread by a Gaussian of so many times their covariance, and weighed again; if that explains
    /// nothing either, the correction fails.
    Widen(f64),
    /// The particles are drawn anew from this distribution and weighed again; if that explains nothing either, the
    /// correction fails.
    Redraw(Moments),
}
