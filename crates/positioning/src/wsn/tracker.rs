//! One way through the scans for every method: predict, ask sensors, correct, score.

use std::error::Error;

use sumprod_filters::{Approximation, Correct, DrivenFilter, Filter, FilterError, Kalman, Predict, Told};
use sumprod_graph::{Purpose, Space, Stream};
use sumprod_messages::Moments;
use sumprod_models::library::ConstantVelocity;
use sumprod_optimizers::Validity;

use super::acquisition::{Watch, acquire};
use super::method::MethodSettings;
use super::ranges::Ranges;
use super::schedule::{choose, transmissions};
use super::world::{Reading, World, WorldSettings};
use crate::error::PositioningError;
use crate::results::{DiagnosticSeries, MethodRun};

/// Gauss-Newton steps of the iterated filter: by then successive points agree to a micrometre.
const ITERATIONS: u32 = 10;

const LITERAL: &str = "literal: the likeliest points met are weighed by their likelihood once more, so that the likelihood counts several times; what comes out is no posterior, and neither its covariance nor n_eff tells anything about its quality";

/// Deviations beyond which a density is no number any more: what a particle filter is gated at by itself.
const FAR: f64 = 37.6;

const UNEXPLAINED: &str = "unexplained: there were scans whose readings no particle explains (the nearest beyond 37.6 standard deviations, or the gate); without a recovery the likeliest were kept; use more particles, reacquire = true, or a gate with a recovery";

const BEARING: &str =
    "a single sensor says nothing of the bearing: the error is the prior's, and no measure of the filter";

type Failure = Box<dyn Error + Send + Sync>;

/// What the tracker needs of a filter beside the verbs.
trait Tracking: Predict<ConstantVelocity> + Correct<Ranges> + Filter {
    /// A filter of the same kind that starts anew.
    fn restarted(&self, start: &Moments, seed: u64) -> Result<Self, Failure>
    where
        Self: Sized;

    /// What the last correction told, and ends the step; none of a filter without particles.
    fn finish(&mut self) -> Result<Option<Particular>, FilterError>;
}

/// What a particle filter says of one step.
struct Particular {
    told: Told,
    effective_sample_size: f64,
    distinct_fraction: f64,
    unique_ancestors: Option<usize>,
    evaluations: u64,
}

impl Tracking for Kalman<4> {
    fn restarted(&self, start: &Moments, _: u64) -> Result<Self, Failure> {
        Ok(Kalman::new(start)?.approximated(Approximation::Iterated(ITERATIONS)))
    }

    fn finish(&mut self) -> Result<Option<Particular>, FilterError> {
        Ok(None)
    }
}

/// A driven filter that remembers how it is made.
struct Particled<'a> {
    filter: DrivenFilter,
    method: &'a MethodSettings,
}

impl<'a> Particled<'a> {
    fn new(method: &'a MethodSettings, start: &Moments, seed: u64) -> Result<Self, Failure> {
        let movement = method.optimizer()?.ok_or("this algorithm has no particles")?;
        let filter = DrivenFilter::new(&Space::real(4), start, method.count(), seed, movement)?
            .reselecting_when(method.trigger())
            .reselecting_by(method.resampling)
            .recovering_by(method.recovery(start));
        let filter = match method.gate {
            Some(gate) => filter.gated_at(gate)?,
            None => filter,
        };
        Ok(Self { filter, method })
    }
}

impl Predict<ConstantVelocity> for Particled<'_> {
    fn predict(&mut self, motion: &ConstantVelocity) -> Result<(), FilterError> {
        self.filter.predict(motion)
    }
}

impl Correct<Ranges> for Particled<'_> {
    fn correct(&mut self, ranges: &Ranges) -> Result<sumprod_filters::Correction, FilterError> {
        self.filter.correct(ranges)
    }
}

impl Filter for Particled<'_> {
    type Record = <DrivenFilter as Filter>::Record;

    fn moments(&self) -> Moments {
        self.filter.moments()
    }

    fn step(&self) -> u64 {
        self.filter.step()
    }

    fn record(&self) -> Self::Record {
        self.filter.record()
    }
}

impl Tracking for Particled<'_> {
    fn restarted(&self, start: &Moments, seed: u64) -> Result<Self, Failure> {
        Self::new(self.method, start, seed)
    }

    fn finish(&mut self) -> Result<Option<Particular>, FilterError> {
        let effective_sample_size = self.filter.particles().effective_sample_size();
        self.filter.settle()?;
        Ok(Some(Particular {
            told: self.filter.told(),
            effective_sample_size,
            distinct_fraction: self.filter.particles().distinct_fraction(),
            unique_ancestors: self.filter.unique_ancestors(),
            evaluations: self.filter.evaluations(),
        }))
    }
}

/// Follows the target through a run by one method.
///
/// # Errors
/// [`PositioningError::Method`] where the filter fails, [`PositioningError::Estimate`] where its numbers are not finite.
pub(super) fn follow(
    settings: &WorldSettings,
    method: &MethodSettings,
    world: &World,
    seed: u64,
    out: &mut MethodRun,
) -> Result<(), PositioningError> {
    let id = out.id.clone();
    let failed = |error: Failure| PositioningError::method(&id, error);
    let prior = Moments::diagonal(&settings.prior_mean, &settings.prior_variance);
    if settings.sensors == 1 {
        out.notes.push(BEARING.to_owned());
    }
    match method.optimizer().map_err(|error| failed(error.into()))? {
        None => {
            let filter = Kalman::<4>::new(&prior).map_err(|error| failed(error.into()))?;
            run(settings, method, world, seed, filter.approximated(Approximation::Iterated(ITERATIONS)), out)
        }
        Some(movement) => {
            if movement.validity() == Validity::Literal {
                out.notes.push(LITERAL.to_owned());
            }
            run(settings, method, world, seed, Particled::new(method, &prior, seed).map_err(failed)?, out)
        }
    }
}

fn run<F: Tracking>(
    settings: &WorldSettings,
    method: &MethodSettings,
    world: &World,
    seed: u64,
    mut filter: F,
    out: &mut MethodRun,
) -> Result<(), PositioningError> {
    let id = out.id.clone();
    let failed = |error: Failure| PositioningError::method(&id, error);
    let motion = ConstantVelocity::held_acceleration(2, settings.interval, settings.process_variance)
        .map_err(|error| failed(error.into()))?;
    let (mut watch, mut tally) = (Watch::default(), Tally::default());
    for (step, (scan, truth)) in (1..).zip(world.scans.iter().zip(&world.truth[1..])) {
        filter.predict(&motion).map_err(|error| failed(error.into()))?;
        let predicted = filter.moments();
        let able: Vec<usize> =
            (0..world.sensors.len()).filter(|sensor| !scan.failed.contains(sensor)).collect();
        let asked = match method.active {
            None => able,
            Some(active) => {
                let mut random = Stream::new(seed, u64::from(step), Purpose::User(1), 0).fast();
                choose(method.schedule, active, &predicted, settings, &world.sensors, &able, &mut random)
            }
        };
        let readings: Vec<Reading> =
            scan.readings.iter().filter(|reading| asked.contains(&reading.sensor)).copied().collect();
        tally.asked(settings, world, &asked, readings.len());
        let lost = method.reacquire && watch.loses(&predicted, settings, &world.sensors, &readings);
        tally.lost += u32::from(lost);
        let found = if lost {
            acquire(settings, &world.sensors, &readings).map_err(|error| failed(error.into()))?
        } else {
            None
        };
        if let Some(found) = found {
            let seed = Stream::new(seed, u64::from(step), Purpose::User(2), 0).id();
            tally.restarted();
            filter = filter.restarted(&found, seed).map_err(failed)?;
            watch.trust();
        } else if !readings.is_empty() {
            let ranges = Ranges::new(&world.sensors, &readings, settings.measurement_variance)
                .map_err(|error| failed(error.into()))?;
            let correction = filter.correct(&ranges).map_err(|error| failed(error.into()))?;
            tally.log_evidence += correction.log_likelihood;
            tally.recovered += u32::from(correction.recovered);
        }
        let Moments { mean, covariance } = filter.moments();
        out.push(step, f64::from(step) * settings.interval, 0, truth, &mean, &covariance)?;
        let particular = filter.finish().map_err(|error| failed(error.into()))?;
        if let Some(particular) = particular {
            tally.particular(step, &particular, !readings.is_empty());
        }
    }
    tally.report(method, f64::from(settings.steps), out);
    Ok(())
}

/// Sums over the scans of a run.
#[derive(Default)]
struct Tally {
    steps: Vec<u32>,
    effective: Vec<f64>,
    distinct: f64,
    ancestors: (f64, u32),
    acceptance: (f64, u32),
    log_evidence: f64,
    /// Evaluations of filters that a restart has replaced, and of the present one.
    evaluations: (u64, u64),
    measurements: usize,
    transmissions: u32,
    lost: u32,
    reacquisitions: u32,
    /// Scans whose readings no particle explained.
    unexplained: u32,
    recovered: u32,
}

impl Tally {
    fn asked(&mut self, settings: &WorldSettings, world: &World, asked: &[usize], readings: usize) {
        self.measurements += readings;
        self.transmissions +=
            asked.iter().map(|&sensor| transmissions(settings, world.sensors[sensor])).sum::<u32>();
    }

    fn restarted(&mut self) {
        self.reacquisitions += 1;
        self.evaluations = (self.evaluations.0 + self.evaluations.1, 0);
    }

    fn particular(&mut self, step: u32, particular: &Particular, corrected: bool) {
        // Before reselection within a move, where the scan had a correction that moved.
        let told = particular.told;
        let moved = corrected && told.effective_sample_size > 0.0;
        let effective = if moved { told.effective_sample_size } else { particular.effective_sample_size };
        self.steps.push(step);
        self.effective.push(effective);
        self.distinct += particular.distinct_fraction;
        if let Some(unique) = particular.unique_ancestors {
            self.ancestors = (self.ancestors.0 + unique as f64, self.ancestors.1 + 1);
        }
        self.unexplained += u32::from(corrected && told.nearest > FAR);
        if let Some(share) = told.acceptance.filter(|_| corrected) {
            self.acceptance = (self.acceptance.0 + share, self.acceptance.1 + 1);
        }
        self.evaluations.1 = particular.evaluations;
    }

    fn report(self, method: &MethodSettings, steps: f64, out: &mut MethodRun) {
        if self.log_evidence.is_finite() {
            out.diagnose("log_evidence", self.log_evidence);
        }
        out.diagnose("measurements", self.measurements as f64 / steps);
        out.diagnose("transmissions", f64::from(self.transmissions) / steps);
        if method.reacquire {
            out.diagnose("lost", f64::from(self.lost) / steps);
            out.diagnose("reacquisitions", f64::from(self.reacquisitions));
        }
        if self.steps.is_empty() {
            return;
        }
        out.diagnose("unexplained", f64::from(self.unexplained) / steps);
        if method.recovery.is_some() {
            out.diagnose("recovered", f64::from(self.recovered) / steps);
        }
        if self.unexplained > 0 {
            out.notes.push(UNEXPLAINED.to_owned());
        }
        out.diagnose("n_eff", self.effective.iter().sum::<f64>() / steps);
        out.diagnose("n_eff_final", self.effective.last().copied().unwrap_or_default());
        out.diagnose("distinct_fraction", self.distinct / steps);
        out.diagnose("likelihood_evaluations", (self.evaluations.0 + self.evaluations.1) as f64);
        for (name, (sum, count)) in [("unique_ancestors", self.ancestors), ("acceptance", self.acceptance)] {
            if count > 0 {
                out.diagnose(name, sum / f64::from(count));
            }
        }
        out.series.push(DiagnosticSeries {
            name: "n_eff".to_owned(),
            steps: self.steps,
            values: self.effective,
        });
    }
}
