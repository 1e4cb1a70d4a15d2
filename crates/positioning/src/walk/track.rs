//! One way through the walk for every method.

use std::error::Error;

use sumprod_filters::{Correct, DrivenFilter, ParticleFilter, Predict};
use sumprod_graph::{MessageError, Space};
use sumprod_messages::{Moments, Particles};
use sumprod_models::cloud::LogLikelihood;
use sumprod_models::{Motion, ProcessNoise, Real};
use sumprod_optimizers::{KnowledgeBoard, Move, QuantumMetropolis, Trigger};

use super::Prepared;
use super::area::Area;
use super::grid::{Density, cell_logs};
use super::settings::{Algorithm, MethodSettings, ModelSettings};
use crate::error::PositioningError;
use crate::results::MethodRun;

/// A position that wanders.
struct Wander(ProcessNoise);

impl Wander {
    fn new(variance: f64) -> Result<Self, MessageError> {
        Ok(Self(ProcessNoise::diagonal(&[variance; 2])?))
    }
}

impl Motion for Wander {
    fn dimension(&self) -> usize {
        2
    }

    fn step<T: Real>(&self, state: &[T], next: &mut [T]) {
        next.copy_from_slice(state);
    }

    fn noise(&self, _state: &[f64]) -> ProcessNoise {
        self.0.clone()
    }
}

/// What a method says after a sweep.
struct Estimate {
    mean: Vec<f64>,
    covariance: Vec<f64>,
    log_evidence: Option<f64>,
    effective_sample_size: Option<f64>,
    acceptance: Option<f64>,
}

/// Runs a method over the sweeps of the walk, and scores it where the true path is known.
///
/// # Errors
/// [`PositioningError::Method`] where it fails.
pub(super) fn run(
    prepared: &Prepared,
    model: &ModelSettings,
    method: &MethodSettings,
    seed: u64,
    out: &mut MethodRun,
) -> Result<(), PositioningError> {
    match method.algorithm {
        Algorithm::Grid => {
            let mut density = Density::start(&prepared.area);
            walk(prepared, model, out, |variance, sweep| {
                density.predict(variance);
                let logs =
                    cell_logs(&prepared.calibration, &prepared.area, &prepared.recording.sweeps[sweep]);
                let log_evidence = density.correct(&logs);
                let (mean, covariance) = density.moments(&prepared.area);
                Ok(Estimate {
                    mean: mean.to_vec(),
                    covariance: covariance.to_vec(),
                    log_evidence,
                    effective_sample_size: None,
                    acceptance: None,
                })
            })
        }
        Algorithm::Bootstrap => {
            let prior = prior(&prepared.area);
            let filter = ParticleFilter::new(&Space::real(2), &prior, method.particles(), seed);
            let mut filter = filter.map_err(|error| PositioningError::method(&out.id, error))?;
            walk(prepared, model, out, |variance, sweep| {
                filter.predict(&Wander::new(variance)?)?;
                let correction = filter.correct(&LogLikelihood(likelihood(prepared, sweep)))?;
                let log_evidence = Some(correction.log_likelihood);
                let effective = Some(filter.effective_sample_size());
                Ok(of_particles(&filter.particles()?, log_evidence, effective, None))
            })
        }
        Algorithm::QuantumMetropolis => {
            driven(prepared, model, method, Box::new(QuantumMetropolis::default()), seed, out)
        }
        Algorithm::KnowledgeBoard => {
            let board = KnowledgeBoard::new(method.board());
            let board = board.map_err(|error| PositioningError::method(&out.id, error))?;
            driven(prepared, model, method, Box::new(board), seed, out)
        }
    }
}

fn driven(
    prepared: &Prepared,
    model: &ModelSettings,
    method: &MethodSettings,
    movement: Box<dyn Move>,
    seed: u64,
    out: &mut MethodRun,
) -> Result<(), PositioningError> {
    let prior = prior(&prepared.area);
    let filter = DrivenFilter::new(&Space::real(2), &prior, method.particles(), seed, movement);
    let filter = filter.map_err(|error| PositioningError::method(&out.id, error))?;
    // Both moves draw by the weights themselves.
    let mut filter = filter.reselecting_when(Trigger::NEVER);
    walk(prepared, model, out, |variance, sweep| {
        filter.predict(&Wander::new(variance)?)?;
        filter.correct(&LogLikelihood(likelihood(prepared, sweep)))?;
        let told = filter.told();
        let effective = Some(told.effective_sample_size);
        Ok(of_particles(filter.particles(), told.log_evidence, effective, told.acceptance))
    })?;
    out.diagnose("likelihood_evaluations", filter.evaluations() as f64);
    Ok(())
}

fn prior(area: &Area) -> Moments {
    let (mean, [x, y]) = area.moments();
    Moments { mean: mean.to_vec(), covariance: vec![x, 0.0, 0.0, y] }
}

/// Log likelihood of a position at a sweep; the walker is inside the area.
fn likelihood(prepared: &Prepared, sweep: usize) -> impl Fn(&[f64]) -> f64 + Sync + '_ {
    let Prepared { area, calibration, recording, .. } = prepared;
    let logs = calibration.sweep(&recording.sweeps[sweep]);
    move |point| {
        if area.holds(point) { calibration.log_likelihood(&logs, point) } else { f64::NEG_INFINITY }
    }
}

fn of_particles(
    particles: &Particles,
    log_evidence: Option<f64>,
    effective_sample_size: Option<f64>,
    acceptance: Option<f64>,
) -> Estimate {
    let Moments { mean, covariance } = particles.moments();
    Estimate { mean, covariance, log_evidence, effective_sample_size, acceptance }
}

/// Goes through the sweeps; `advance` is given the variance of the step and the sweep's index.
fn walk(
    prepared: &Prepared,
    model: &ModelSettings,
    out: &mut MethodRun,
    mut advance: impl FnMut(f64, usize) -> Result<Estimate, Box<dyn Error + Send + Sync>>,
) -> Result<(), PositioningError> {
    let sweeps = &prepared.recording.sweeps;
    let (mut evidence, mut effective, mut accepted) = (Some(0.0), Mean::default(), Mean::default());
    for index in prepared.calibration.walk() {
        // There is a sweep before the walk's first: the empty room has some.
        let time = sweeps[index].time;
        let variance = model.wander_variance * (time - sweeps[index - 1].time);
        let estimate = advance(variance, index).map_err(|error| {
            PositioningError::method(&out.id, format!("sweep {index} at {time} s: {error}"))
        })?;
        evidence = evidence.zip(estimate.log_evidence).map(|(sum, log): (f64, f64)| sum + log);
        effective.push(estimate.effective_sample_size);
        accepted.push(estimate.acceptance);
        if let Some(truth) = prepared.path.at(time) {
            out.push(index as u32, time, 0, &truth, &estimate.mean, &estimate.covariance)?;
        }
    }
    for (name, value) in
        [("log_evidence", evidence), ("n_eff", effective.value()), ("acceptance", accepted.value())]
    {
        if let Some(value) = value {
            out.diagnose(name, value);
        }
    }
    Ok(())
}

#[derive(Default)]
struct Mean {
    sum: f64,
    count: f64,
}

impl Mean {
    fn push(&mut self, value: Option<f64>) {
        if let Some(value) = value {
            self.sum += value;
            self.count += 1.0;
        }
    }

    fn value(&self) -> Option<f64> {
        (self.count > 0.0).then(|| self.sum / self.count)
    }
}
