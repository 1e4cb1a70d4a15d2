//! The keys `[method.ID]`: the form of the ranges' edges and the number of draws; and one method's run.

use serde::{Deserialize, Serialize};
use sumprod_graph::{Purpose, Stream};
use sumprod_messages::{AnyForm, Moments, Particles};

use super::draws::{Draws, draw};
use super::samples::csv;
use super::solve::{DRAWS, StepGraph, dimension};
use super::steps::{Growing, Seen};
use crate::PositioningError;
use crate::form::{FormSpec, at_least_one};
use crate::results::{DiagnosticSeries, MethodRun, OutputFile, StateLayout};

/// The keys `[method.ID]`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Method {
    /// Joint draws of each step.
    #[serde(default = "samples")]
    pub samples: usize,
    /// Forms by kind of edge.
    pub form: Forms,
}

/// The keys `[method.ID.form]`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Forms {
    /// Messages of the ranges to one landmark: a mixture, or `gaussian`.
    pub range: FormSpec,
}

fn samples() -> usize {
    2000
}

/// Most joint draws of a step: beyond it their text alone takes hundreds of megabytes.
const MOST_SAMPLES: usize = 1_000_000;

/// Effective draws a written one below which the reader is told.
const FEW: f64 = 0.25;

impl Method {
    /// Checks every value of method `id`.
    ///
    /// # Errors
    /// [`PositioningError::Setting`] naming the key.
    pub fn validate(&self, id: &str) -> Result<(), PositioningError> {
        let key = format!("method.{id}.samples");
        at_least_one(&key, self.samples, "sample")?;
        if self.samples > MOST_SAMPLES {
            let problem = format!("is {}; at most {MOST_SAMPLES} samples are drawn", self.samples);
            return Err(PositioningError::setting(key, problem));
        }
        let key = format!("method.{id}.form.range");
        self.form.range.validate(&key)?;
        match self.form.range.0 {
            AnyForm::Gaussian(_) | AnyForm::Mixture(_) => Ok(()),
            AnyForm::Particles(_) | AnyForm::Categorical(_) => {
                let range = self.form.range;
                let problem = format!(
                    "is {range}; the ranges to a landmark are held as {{ mixture = 100 }} or \"gaussian\""
                );
                Err(PositioningError::setting(key, problem))
            }
        }
    }

    /// Whether draws are chosen by the exact factors' weights: a Gaussian is taken at its word, which shows what it
    /// claims.
    fn weighed(&self) -> bool {
        matches!(self.form.range.0, AnyForm::Mixture(_))
    }

    /// Every step's posterior, and the files of its draws.
    ///
    /// # Errors
    /// [`PositioningError::Method`] where a step cannot be solved.
    pub fn run(
        &self,
        growing: &Growing,
        id: &str,
        seed: u64,
    ) -> Result<(MethodRun, Vec<OutputFile>), PositioningError> {
        let mut solved = Vec::with_capacity(growing.steps());
        let mut run = MethodRun::timed(id, StateLayout::planar_position(), |run| {
            for step in 0..growing.steps() {
                let (seen, draws) = self.step(growing, id, step, seed)?;
                score(run, growing, step, &seen, &draws)?;
                solved.push((seen, draws));
            }
            Ok::<(), PositioningError>(())
        })?;
        report(&mut run, growing, &solved);
        let (step, weakest) = solved.iter().map(|(_, draws)| draws.effective).enumerate().fold(
            (0, f64::INFINITY),
            |least, (step, effective)| if effective < least.1 { (step, effective) } else { least },
        );
        if self.weighed() && weakest < FEW * self.samples as f64 {
            run.notes.push(format!(
                "step {step}: {weakest:.0} weighted draws are effective, fewer than the {} written; raise \
                 method.{id}.samples",
                self.samples
            ));
        }
        if !self.weighed() {
            let note = "draws are those of the Gaussian, not weighed by the factors; its evidence is what it accounts for";
            run.notes.push(note.into());
        }
        let file = |(step, (seen, draws)): (usize, &(Vec<Seen>, Draws))| OutputFile {
            name: format!("samples-{id}-step{step}.csv"),
            contents: csv(growing.graph(), step, seen, draws),
        };
        let files = solved.iter().enumerate().map(file).collect();
        Ok((run, files))
    }

    fn step(
        &self,
        growing: &Growing,
        id: &str,
        step: usize,
        seed: u64,
    ) -> Result<(Vec<Seen>, Draws), PositioningError> {
        let seen = growing.seen(step)?;
        let exact = growing.exact(step)?;
        let failed = |error: String| PositioningError::method(id, format!("step {step}: {error}"));
        let graph = StepGraph::new(growing, step, &seen, self.form.range.0, seed)?;
        let beliefs = graph.solve(seed).map_err(|error| failed(error.to_string()))?;
        let mut random = Stream::new(seed, step as u64, Purpose::User(DRAWS), 0).fast();
        let space = Growing::trajectory_space(step);
        draw(&space, &beliefs, &exact, &seen, self.samples, self.weighed(), &mut random)
            .map(|draws| (seen, draws))
            .map_err(|error| failed(error.to_string()))
    }
}

/// The landmarks' estimates, by the moments of their draws.
fn score(
    run: &mut MethodRun,
    growing: &Growing,
    step: usize,
    seen: &[Seen],
    draws: &Draws,
) -> Result<(), PositioningError> {
    for (j, seen) in seen.iter().enumerate() {
        let first = dimension(step) + 2 * j;
        let points =
            draws.coordinate(first).zip(draws.coordinate(first + 1)).flat_map(|(x, y)| [x, y]).collect();
        let drawn = Particles::equally_weighted(&sumprod_graph::Space::real(2), points);
        let Moments { mean, covariance } =
            drawn.map_err(|error| PositioningError::method(&run.id, error))?.moments();
        let truth = growing.graph().landmarks[seen.landmark].truth;
        run.push(step as u32, step as f64, seen.landmark as u32, &truth, &mean, &covariance)?;
    }
    Ok(())
}

fn report(run: &mut MethodRun, growing: &Growing, solved: &[(Vec<Seen>, Draws)]) {
    let column = |of: &dyn Fn(&Draws) -> f64| solved.iter().map(|(_, draws)| of(draws)).collect::<Vec<f64>>();
    let effective = column(&|draws| draws.effective);
    run.diagnose("n_eff", effective.iter().copied().fold(f64::INFINITY, f64::min));
    run.list("log_evidence", column(&|draws| draws.log_evidence));
    run.list("n_eff_by_step", effective);
    for (number, landmark) in growing.graph().landmarks.iter().enumerate() {
        // A landmark that a step has not seen yet has no mode there.
        let shares = |(seen, draws): &(Vec<Seen>, Draws)| {
            let place = seen.iter().position(|seen| seen.landmark == number);
            place.and_then(|place| draws.parts.get(place).cloned()).unwrap_or_default()
        };
        let parts: Vec<Vec<f64>> = solved.iter().map(shares).collect();
        run.list(&format!("modes.{}", landmark.name), parts.iter().map(|parts| parts.len() as f64).collect());
        let heaviest = parts.iter().map(|parts| parts.first().copied().unwrap_or(0.0)).collect();
        run.list(&format!("heaviest_mode.{}", landmark.name), heaviest);
    }
    let steps: Vec<u32> = (0..solved.len() as u32).collect();
    for list in ["log_evidence", "n_eff_by_step"] {
        if let Some(list) = run.lists.iter().find(|found| found.name == list) {
            let series = DiagnosticSeries {
                name: list.name.trim_end_matches("_by_step").to_owned(),
                steps: steps.clone(),
                values: list.values.clone(),
            };
            run.series.push(series);
        }
    }
}
