//! The verbs of every filter: predict, correct, run, smooth.

use smallvec::SmallVec;
use sumprod_messages::Moments;

use crate::FilterError;

/// Moves the belief to the next time.
pub trait Predict<M: ?Sized> {
    /// Passes the belief through a motion.
    ///
    /// # Errors
    ///
    /// Where the motion does not fit the state, or what it predicts is no distribution; the belief is then as before.
    fn predict(&mut self, motion: &M) -> Result<(), FilterError>;
}

/// Absorbs a measurement.
pub trait Correct<R: ?Sized> {
    /// Multiplies the belief by a measurement's likelihood.
    ///
    /// # Errors
    ///
    /// Where the measurement does not fit the state or contradicts it; the belief is then as before.
    fn correct(&mut self, measurement: &R) -> Result<Correction, FilterError>;
}

/// What a correction tells.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Correction {
    /// Log of the measurement's probability density given all before it: their sum over a run is the log-evidence of
    /// the model.
    pub log_likelihood: f64,
    /// The innovation z - E h(x), minus the residual that was expected; empty where a likelihood has no residual.
    pub innovation: SmallVec<[f64; 6]>,
    /// The innovation's covariance (row-major), by Gaussian filters; empty of particle filters.
    pub innovation_covariance: SmallVec<[f64; 9]>,
    /// Whether no particle explained the measurement, and the recovery that the user chose was used.
    pub recovered: bool,
}

/// One time step: how the state got there, and what was measured there.
#[derive(Clone, Debug, PartialEq)]
pub struct Step<M, R> {
    /// The motion from the step before; none where the prior is of this time.
    pub motion: Option<M>,
    /// The measurements, none of which need be there.
    pub measurements: Vec<R>,
}

/// What a run leaves behind.
#[derive(Clone, Debug)]
pub struct Run<B, M> {
    /// Each step's belief, as much of it as smoothing needs.
    pub records: Vec<B>,
    /// Each step's motion.
    pub motions: Vec<Option<M>>,
    /// Each step's corrections, in the order of its measurements.
    pub corrections: Vec<Vec<Correction>>,
    /// Log-evidence of all measurements.
    pub log_evidence: f64,
}

/// A recursive estimate of a state.
pub trait Filter {
    /// What smoothing needs of a step.
    type Record;

    /// Mean and covariance of the belief.
    fn moments(&self) -> Moments;

    /// Predictions so far.
    fn step(&self) -> u64;

    /// The belief as it is after a step's corrections.
    fn record(&self) -> Self::Record;

    /// Goes through steps in order, and keeps a record of each.
    ///
    /// # Errors
    ///
    /// That of the first verb that fails; the filter then stands where it failed.
    fn run<M, R>(
        &mut self,
        steps: impl IntoIterator<Item = Step<M, R>>,
    ) -> Result<Run<Self::Record, M>, FilterError>
    where
        Self: Predict<M> + Correct<R>,
    {
        let mut run =
            Run { records: Vec::new(), motions: Vec::new(), corrections: Vec::new(), log_evidence: 0.0 };
        for Step { motion, measurements } in steps {
            if let Some(motion) = &motion {
                self.predict(motion)?;
            }
            let corrections: Result<Vec<_>, _> =
                measurements.iter().map(|measurement| self.correct(measurement)).collect();
            let corrections = corrections?;
            run.log_evidence += corrections.iter().map(|correction| correction.log_likelihood).sum::<f64>();
            run.corrections.push(corrections);
            run.records.push(self.record());
            run.motions.push(motion);
        }
        Ok(run)
    }
}

/// A filter whose past can be told better by what came after.
pub trait Smooth<M>: Filter {
    /// What smoothing gives.
    type Smoothed;

    /// Smooths a run of this filter.
    ///
    /// # Errors
    ///
    /// Where the run cannot be smoothed; the error says why.
    fn smooth(&self, run: &Run<Self::Record, M>) -> Result<Self::Smoothed, FilterError>;
}
