//! Many runs of one scenario: in parallel, returned in the order of the runs, resumable.

mod run_log;

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use rayon::prelude::*;

use crate::error::PositioningError;
use crate::results::RunResult;
use crate::scenario::{RunRequest, Scenario};

pub use run_log::{Fingerprint, LogState, RunLog};

/// Called with the number of finished runs and of all runs, from whichever thread finished one.
pub type Progress<'a> = dyn Fn(usize, usize) + Sync + 'a;

/// Runs of one scenario that differ in nothing but the run's index.
#[derive(Debug)]
pub struct Campaign<'a, S: Scenario> {
    scenario: &'a S,
    prepared: &'a S::Prepared,
    seed: u64,
    runs: u32,
    methods: Vec<String>,
}

impl<'a, S: Scenario> Campaign<'a, S> {
    /// A campaign of `runs` runs. `wanted` names the methods; none names all. They are run in the scenario's order.
    ///
    /// # Errors
    /// [`PositioningError::UnknownMethod`], and [`PositioningError::Setting`] if the scenario has no method.
    pub fn new(
        scenario: &'a S,
        prepared: &'a S::Prepared,
        seed: u64,
        runs: u32,
        wanted: &[String],
    ) -> Result<Self, PositioningError> {
        let methods = choose_methods(scenario, wanted)?;
        Ok(Self { scenario, prepared, seed, runs, methods })
    }

    /// Ids of the methods that are run, in order.
    pub fn methods(&self) -> &[String] {
        &self.methods
    }

    /// Runs what `log` does not hold yet on rayon's threads, and appends each run to it as it finishes.
    ///
    /// The result is in the order of the runs and does not depend on the number of threads. After a failure no
    /// further run is started; finished ones stay in the log.
    ///
    /// # Errors
    /// The failure of the earliest run that failed, or a log that cannot be written.
    pub fn run(
        &self,
        log: Option<RunLog>,
        progress: &Progress<'_>,
    ) -> Result<Vec<RunResult>, PositioningError> {
        let total = self.runs as usize;
        let mut slots: Vec<Option<RunResult>> = vec![None; total];
        let mut log = log;
        for done in log.as_mut().map(RunLog::take_finished).unwrap_or_default() {
            if let Some(slot) = slots.get_mut(done.run as usize) {
                *slot = Some(done);
            }
        }
        let finished = AtomicUsize::new(slots.iter().flatten().count());
        progress(finished.load(Ordering::Relaxed), total);
        let failed = AtomicBool::new(false);
        let log = Mutex::new(log);

        let outcomes: Vec<Option<Result<RunResult, PositioningError>>> = slots
            .into_par_iter()
            .enumerate()
            .with_max_len(1)
            .map(|(run, slot)| {
                if let Some(done) = slot {
                    return Some(Ok(done));
                }
                if failed.load(Ordering::Relaxed) {
                    return None;
                }
                let outcome = self.one(run as u32).and_then(|result| {
                    append(&log, &result)?;
                    Ok(result)
                });
                match &outcome {
                    Ok(_) => progress(finished.fetch_add(1, Ordering::Relaxed) + 1, total),
                    Err(_) => failed.store(true, Ordering::Relaxed),
                }
                Some(outcome)
            })
            .collect();
        // A run is left out only after another failed, and then that failure is what is returned.
        outcomes.into_iter().flatten().collect()
    }

    fn one(&self, run: u32) -> Result<RunResult, PositioningError> {
        let request = RunRequest { seed: self.seed, run, methods: &self.methods };
        let mut result = self
            .scenario
            .run(self.prepared, request)
            .map_err(|source| PositioningError::Run { run, source: Box::new(source) })?;
        result.run = run;
        Ok(result)
    }
}

/// The methods of `scenario` that `wanted` names, all if it names none, in the scenario's order.
///
/// # Errors
/// [`PositioningError::UnknownMethod`], and [`PositioningError::Setting`] if the scenario has no method.
pub fn choose_methods<S: Scenario>(scenario: &S, wanted: &[String]) -> Result<Vec<String>, PositioningError> {
    let known = scenario.methods();
    if known.is_empty() {
        return Err(PositioningError::setting("method", "has no table; add at least one [method.ID]"));
    }
    if let Some(unknown) = wanted.iter().find(|id| !known.contains(id)) {
        return Err(PositioningError::UnknownMethod { method: unknown.clone(), known });
    }
    Ok(known.into_iter().filter(|id| wanted.is_empty() || wanted.contains(id)).collect())
}

fn append(log: &Mutex<Option<RunLog>>, result: &RunResult) -> Result<(), PositioningError> {
    // A poisoned lock means that another thread is already unwinding; the log itself is append-only.
    let mut guard = log.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    match guard.as_mut() {
        Some(log) => log.append(result),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests;
