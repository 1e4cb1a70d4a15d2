//! One way through a run for every algorithm: the start, the motions and measurements, and the truth beside them.

use std::error::Error;

use sumprod_filters::{Correct, DrivenFilter, Filter, Kalman, ParticleFilter, Predict};
use sumprod_graph::Space;
use sumprod_messages::{Moments, Particles};
use sumprod_models::{Motion, Residual};
use sumprod_optimizers::{KnowledgeBoard, Trigger};

use super::method::{Algorithm, MethodSettings};
use crate::error::PositioningError;
use crate::results::{DiagnosticSeries, MethodRun};

/// Half the central 95 % interval of a normal, in standard deviations.
pub(super) const NORMAL_95: f64 = 1.959_963_984_540_054;

/// Ends of the central 95 % interval.
pub(super) const TAILS: [f64; 2] = [0.025, 0.975];

/// What the table says of the algorithm as printed.
const LITERAL: &str = "literal: the moved particles follow no known distribution and their weights are no posterior's, so that neither its interval nor its covariance is calibrated";

/// One step of the world as a filter sees it, and the state that it is scored against.
pub(super) struct Step<M, R> {
    pub time: f64,
    pub motion: M,
    pub measurement: R,
    pub truth: Vec<f64>,
}

/// Runs a method over the steps from a prior of `D` coordinates.
///
/// # Errors
/// [`PositioningError::Method`] where it fails.
pub(super) fn run<const D: usize, M: Motion, R: Residual>(
    method: &MethodSettings,
    prior: &Moments,
    steps: &[Step<M, R>],
    seed: u64,
    out: &mut MethodRun,
) -> Result<(), PositioningError> {
    match method.algorithm {
        Algorithm::ExtendedKalman => gaussian::<D, M, R>(prior, steps, out),
        Algorithm::KnowledgeBoard => board(method, prior, steps, seed, out),
        // A grid belongs to the world that has one.
        Algorithm::Bootstrap | Algorithm::Grid => bootstrap(method, prior, steps, seed, out),
    }
}

fn gaussian<const D: usize, M: Motion, R: Residual>(
    prior: &Moments,
    steps: &[Step<M, R>],
    out: &mut MethodRun,
) -> Result<(), PositioningError> {
    let mut filter = Kalman::<D>::new(prior).map_err(failed(&out.id))?;
    let (scored, mut log_evidence) = (out.layout.scored(), 0.0);
    for (number, step) in (1..).zip(steps) {
        filter.predict(&step.motion).map_err(failed(&out.id))?;
        log_evidence += filter.correct(&step.measurement).map_err(failed(&out.id))?.log_likelihood;
        let Moments { mean, covariance } = filter.moments();
        let intervals: Vec<[f64; 2]> = scored
            .iter()
            .map(|&k| {
                let half = NORMAL_95 * covariance[k * (D + 1)].sqrt();
                [mean[k] - half, mean[k] + half]
            })
            .collect();
        out.push_with_intervals(number, step.time, 0, &step.truth, &mean, &covariance, &intervals)?;
    }
    out.diagnose("log_evidence", log_evidence);
    Ok(())
}

fn bootstrap<M: Motion, R: Residual>(
    method: &MethodSettings,
    prior: &Moments,
    steps: &[Step<M, R>],
    seed: u64,
    out: &mut MethodRun,
) -> Result<(), PositioningError> {
    let space = Space::real(prior.dimension());
    let mut filter = ParticleFilter::new(&space, prior, method.particles(), seed).map_err(failed(&out.id))?;
    let mut log_evidence = 0.0;
    let mut effective = EffectiveSizes::default();
    for (number, step) in (1..).zip(steps) {
        filter.predict(&step.motion).map_err(failed(&out.id))?;
        log_evidence += filter.correct(&step.measurement).map_err(failed(&out.id))?.log_likelihood;
        effective.push(number, filter.effective_sample_size());
        let particles = filter.particles().map_err(failed(&out.id))?;
        estimate(out, number, step, &particles)?;
    }
    out.diagnose("log_evidence", log_evidence);
    out.diagnose("likelihood_evaluations", (steps.len() * filter.len()) as f64);
    effective.report(out);
    Ok(())
}

fn board<M: Motion, R: Residual>(
    method: &MethodSettings,
    prior: &Moments,
    steps: &[Step<M, R>],
    seed: u64,
    out: &mut MethodRun,
) -> Result<(), PositioningError> {
    let swarm = Box::new(KnowledgeBoard::new(method.board()).map_err(failed(&out.id))?);
    let space = Space::real(prior.dimension());
    let filter =
        DrivenFilter::new(&space, prior, method.particles(), seed, swarm).map_err(failed(&out.id))?;
    // The swarm draws anew by the weights; reselection before it would only add noise.
    let mut filter = filter.reselecting_when(Trigger::NEVER);
    if method.is_marginal() {
        filter = filter.knowing_density();
    }
    let mut log_evidence = Some(0.0);
    let mut effective = EffectiveSizes::default();
    for (number, step) in (1..).zip(steps) {
        filter.predict(&step.motion).map_err(failed(&out.id))?;
        filter.correct(&step.measurement).map_err(failed(&out.id))?;
        let told = filter.told();
        log_evidence = log_evidence.zip(told.log_evidence).map(|(sum, log)| sum + log);
        effective.push(number, told.effective_sample_size);
        estimate(out, number, step, filter.particles())?;
    }
    if let Some(log_evidence) = log_evidence {
        out.diagnose("log_evidence", log_evidence);
    }
    out.diagnose("likelihood_evaluations", filter.evaluations() as f64);
    effective.report(out);
    if method.is_literal() {
        out.notes.push(LITERAL.to_owned());
    }
    Ok(())
}

/// Adds mean, covariance and weighted quantiles of particles.
fn estimate<M, R>(
    out: &mut MethodRun,
    number: u32,
    step: &Step<M, R>,
    particles: &Particles,
) -> Result<(), PositioningError> {
    let Moments { mean, covariance } = particles.moments();
    let intervals: Vec<[f64; 2]> = out
        .layout
        .scored()
        .into_iter()
        .map(|k| TAILS.map(|tail| particles.quantile(k, tail).unwrap_or(mean[k])))
        .collect();
    out.push_with_intervals(number, step.time, 0, &step.truth, &mean, &covariance, &intervals)
}

fn failed<E: Error + Send + Sync + 'static>(id: &str) -> impl FnOnce(E) -> PositioningError + '_ {
    move |error| PositioningError::method(id, error)
}

/// Effective sample sizes by step.
#[derive(Default)]
pub(super) struct EffectiveSizes {
    steps: Vec<u32>,
    values: Vec<f64>,
}

impl EffectiveSizes {
    fn push(&mut self, step: u32, value: f64) {
        self.steps.push(step);
        self.values.push(value);
    }

    fn report(self, out: &mut MethodRun) {
        out.diagnose("n_eff", self.values.iter().sum::<f64>() / self.values.len().max(1) as f64);
        let series = DiagnosticSeries { name: "n_eff".to_owned(), steps: self.steps, values: self.values };
        out.series.push(series);
    }
}
