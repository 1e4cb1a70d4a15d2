//! Whether a method knows how wrong it is.

use super::MethodMetrics;

/// Coverage of the 95 % region below this is called over-confident whatever the NEES says, in a single run.
const LEAST_COVERAGE: f64 = 0.85;
/// The same where runs tell the coverage's standard error, and it is below 95 % by more than three of them.
const LEAST_COVERAGE_OF_MANY: f64 = 0.935;
/// Coverage of 95 % intervals above this is called too cautious.
const MOST_COVERAGE: f64 = 0.98;
/// Limits of the position NEES per degree of freedom where a single run gives no band.
const SINGLE_RUN_LIMITS: [f64; 2] = [0.5, 2.0];

/// A method's claimed uncertainty against its errors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Calibration {
    /// The judgement.
    pub verdict: Verdict,
    /// NEES per degree of freedom, of the position where there is one: 1 is right, above is over-confident.
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
    /// Judges the position, or a state that has none: over-confident if the mean NEES is above its 95 % band (above 2
    /// per degree of freedom in a single run) or the 95 % region covers less than 85 % (93.5 % where many runs tell),
    /// cautious if the mean NEES is below the band (below 0.5 in a single run). Where the method gives intervals it is
    /// judged by their coverage alone, cautious above 98 %. `None` without a NEES and coverage.
    pub fn calibration(&self) -> Option<Calibration> {
        let blocks = self.summary.nees.as_ref()?;
        let nees = blocks.position.as_ref().or(blocks.state.as_ref())?;
        let coverage = self.summary.coverage95?;
        let dof = nees.dof as f64;
        let ratio = nees.mean / dof;
        let least = self.summary.coverage95_se.map_or(LEAST_COVERAGE, |error| {
            (0.95 - 3.0 * error).clamp(LEAST_COVERAGE, LEAST_COVERAGE_OF_MANY)
        });
        let [low, high] = nees.band95.map_or(SINGLE_RUN_LIMITS, |[low, high]| [low / dof, high / dof]);
        // A method gives intervals where no ellipse describes its posterior, and then no NEES does.
        let (short, long) = match self.summary.width95 {
            Some(_) => (false, coverage > MOST_COVERAGE),
            None => (ratio > high, ratio < low),
        };
        let verdict = if coverage < least || short {
            Verdict::Overconfident
        } else if long {
            Verdict::Cautious
        } else {
            Verdict::Calibrated
        };
        Some(Calibration { verdict, ratio })
    }
}
