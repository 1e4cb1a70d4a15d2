//! Corrections that move particles: the slot of a particle filter's optimizer.

use sumprod_graph::{Purpose, Stream};
use sumprod_messages::Particles;
use sumprod_models::cloud::{Cloud, Likelihood, log_values};
use sumprod_optimizers::{LogDensity, Move, OptimizerError, Target};

use super::ParticleFilter;
use super::filter::Outcome;
use crate::{Correction, FilterError};

/// What the last correction by a move tells of it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MoveReport {
    /// Share of the proposed points that were accepted, where the move proposes.
    pub acceptance: Option<f64>,
    /// Effective sample size before anything was reselected within the move.
    pub effective_sample_size: f64,
    /// For each particle the predicted one that it stems from; empty where they were drawn anew.
    pub ancestors: Vec<usize>,
}

/// A likelihood at points in rows.
struct AtPoints<'a, L>(&'a L);

impl<L: Likelihood> LogDensity for AtPoints<'_, L> {
    fn log_values(&self, points: &[f64], values: &mut [f64]) -> Result<(), OptimizerError> {
        log_values(self.0, points, values);
        Ok(())
    }
}

impl ParticleFilter {
    /// Corrects by moving particles to the posterior, instead of weighing them where they are: the slot for an
    /// optimizer.
    #[must_use]
    pub fn moving_by(mut self, mover: impl Move + 'static) -> Self {
        self.mover = Some(Box::new(mover));
        self
    }

    /// What the last correction's move told; none before, or where particles are weighed only.
    pub fn move_report(&self) -> Option<&MoveReport> {
        self.move_report.as_ref()
    }

    /// Corrects through the move.
    pub(super) fn move_towards<L: Likelihood>(
        &mut self,
        mover: &dyn Move,
        likelihood: &L,
    ) -> Result<Outcome, FilterError> {
        let step = self.step;
        let failed = |source| FilterError::Optimizer { step, source };
        let prior: Particles = self.particles()?;
        let density = AtPoints(likelihood);
        let mut target = Target::new(&prior, &density).map_err(failed)?;
        let mut stream = Stream::new(self.seed, step, Purpose::Optimizer, 1 + self.corrections);
        let moved = mover.apply(&mut target, &mut stream);
        self.evaluations += target.evaluations();
        let moved = match moved {
            Ok(moved) => moved,
            Err(OptimizerError::Unexplained { .. }) => {
                return Ok(Outcome::Unexplained("its likelihood is zero wherever the move looked".into()));
            }
            Err(source) => return Err(failed(source)),
        };
        self.cloud = Cloud::from_points(prior.dimension(), moved.particles.points());
        if self.scratch.cloud.len() != self.cloud.len() {
            self.scratch.cloud = self.cloud.clone();
        }
        self.weights.become_logs(moved.particles.log_weights());
        self.move_report = Some(MoveReport {
            acceptance: moved.acceptance,
            effective_sample_size: moved.effective_sample_size,
            ancestors: moved.ancestors,
        });
        // A move that estimates no evidence leaves none to report.
        let log_likelihood = moved.log_evidence.unwrap_or(f64::NAN);
        Ok(Outcome::Weighed(Correction { log_likelihood, ..Correction::default() }))
    }
}
