//! Whether a method knows how wrong it is.

use super::MethodMetrics;

/// Coverage of the 95 % region below this is called over-confident whatever the NEES says.
const LEAST_COVERAGE: f64 = 0.85;
/// Limits of the position NEES per degree of freedom where a single run gives no band.
const SINGLE_RUN_LIMITS: [f64; 2] = [0.5, 2.0];

/// A method's claimed uncertainty against its errors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Calibration {
    /// The judgement.
    pub verdict: Verdict,
    /// Position NEES per degree of freedom: 1 is right, above is over-confident.
    pub ratio: f64,
}

/// How claimed uncertainty compares with errors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// As large as the errors.
    Calibrated,
    /// Smaller than the errors.
    Overconfident,
    /// Larger than the errors.
    Cautious,
}

impl MethodMetrics {
    /// Judges the position: over-confident if the mean NEES is above its 95 % band (above 2 per degree of freedom
    /// in a single run) or the 95 % region covers less than 85 %, cautious if the mean NEES is below the band (below
    /// 0.5 in a single run). `None` without a position NEES and coverage.
    pub fn calibration(&self) -> Option<Calibration> {
        let nees = self.summary.nees.as_ref()?.position.as_ref()?;
        let coverage = self.summary.coverage95?;
        let dof = nees.dof as f64;
        let ratio = nees.mean / dof;
        let [low, high] = nees.band95.map_or(SINGLE_RUN_LIMITS, |[low, high]| [low / dof, high / dof]);
        let verdict = if coverage < LEAST_COVERAGE || ratio > high {
            Verdict::Overconfident
        } else if ratio < low {
            Verdict::Cautious
        } else {
            Verdict::Calibrated
        };
        Some(Calibration { verdict, ratio })
    }
}
