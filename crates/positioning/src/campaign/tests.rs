use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

use serde::{Deserialize, Serialize};

use super::*;
use crate::results::{MethodRun, StateLayout};
use crate::scenario::GraphSummary;

/// A system whose every number is a function of seed, run and method, and which counts its runs.
#[derive(Serialize, Deserialize)]
struct Toy {
    methods: Vec<String>,
    #[serde(skip)]
    started: AtomicU32,
    fails_at: Option<u32>,
}

impl Toy {
    fn new(fails_at: Option<u32>) -> Self {
        Self { methods: vec!["a".into(), "b".into()], started: AtomicU32::new(0), fails_at }
    }
}

impl Scenario for Toy {
    const SYSTEM: &'static str = "toy";
    const READS_DATA: bool = false;
    type Prepared = ();

    fn validate(&self) -> Result<(), PositioningError> {
        Ok(())
    }

    fn methods(&self) -> Vec<String> {
        self.methods.clone()
    }

    fn prepare(&self, _: u64, _: Option<&Path>) -> Result<(), PositioningError> {
        Ok(())
    }

    fn run(&self, (): &(), request: RunRequest<'_>) -> Result<RunResult, PositioningError> {
        self.started.fetch_add(1, Ordering::Relaxed);
        if self.fails_at == Some(request.run) {
            return Err(PositioningError::method("a", "the innovation is singular"));
        }
        let methods = request.methods.iter().map(|id| {
            let mut method = MethodRun::new(id, StateLayout::planar_position());
            let value = (request.seed * 31 + u64::from(request.run)) as f64 / 7.0 + id.len() as f64;
            method.push(0, 0.0, 0, &[0.0; 2], &[value, value / 3.0], &[1.0, 0.0, 0.0, 1.0])?;
            Ok(method)
        });
        let methods = methods.collect::<Result<_, PositioningError>>()?;
        Ok(RunResult { nodes: vec!["n".into()], methods, ..RunResult::default() })
    }

    fn check(&self, (): &(), _: u64, _: &[String]) -> Result<Vec<GraphSummary>, PositioningError> {
        Ok(Vec::new())
    }
}

fn fingerprint(name: &str) -> Fingerprint {
    Fingerprint { program: "test".into(), scenario: serde_json::json!({ "name": name }) }
}

/// A file of its own for one test, removed when dropped.
struct Scratch(PathBuf);

impl Scratch {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("sumprod-run-log-{}-{name}.jsonl", std::process::id()));
        let _ = fs::remove_file(&path);
        Self(path)
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = fs::remove_file(&self.0);
    }
}

fn campaign(toy: &Toy, runs: u32) -> Campaign<'_, Toy> {
    Campaign::new(toy, &(), 5, runs, &[]).unwrap()
}

#[test]
fn results_are_in_run_order_whatever_the_thread_count() {
    let toy = Toy::new(None);
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| campaign(&toy, 40).run(None, &|_, _| {}).unwrap())
    };
    let one = on(1);
    assert_eq!(one.iter().map(|run| run.run).collect::<Vec<_>>(), (0..40).collect::<Vec<_>>());
    assert_eq!(one, on(4));
}

#[test]
fn methods_are_chosen_in_the_order_of_the_scenario() {
    let toy = Toy::new(None);
    let methods = |wanted: &[&str]| {
        let wanted: Vec<String> = wanted.iter().map(|&id| id.to_owned()).collect();
        Campaign::new(&toy, &(), 1, 1, &wanted).map(|campaign| campaign.methods().to_vec())
    };
    assert_eq!(methods(&[]).unwrap(), ["a", "b"]);
    assert_eq!(methods(&["b", "a"]).unwrap(), ["a", "b"]);
    let message = methods(&["c"]).unwrap_err().to_string();
    assert_eq!(message, "there is no method `c` in this scenario; it has a, b");
}

#[test]
fn a_failure_names_its_run_and_keeps_what_was_finished() {
    let scratch = Scratch::new("failure");
    let toy = Toy::new(Some(3));
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let log = RunLog::open(&scratch.0, &fingerprint("x")).unwrap();
    let error = pool.install(|| campaign(&toy, 10).run(Some(log), &|_, _| {})).unwrap_err();
    assert_eq!(error.to_string(), "run 3: method `a`: the innovation is singular");
    assert!(!error.is_input());
    let again = RunLog::open(&scratch.0, &fingerprint("x")).unwrap();
    assert_eq!(again.state(), LogState::Resumed(3));
}

#[test]
fn an_interrupted_campaign_goes_on_and_equals_the_uninterrupted_one() {
    let scratch = Scratch::new("resume");
    let whole = campaign(&Toy::new(None), 8).run(None, &|_, _| {}).unwrap();

    let log = RunLog::open(&scratch.0, &fingerprint("x")).unwrap();
    assert_eq!(log.state(), LogState::New);
    campaign(&Toy::new(None), 5).run(Some(log), &|_, _| {}).unwrap();
    let mut bytes = fs::read(&scratch.0).unwrap();
    bytes.truncate(bytes.len() - 20);
    fs::write(&scratch.0, &bytes).unwrap();

    let log = RunLog::open(&scratch.0, &fingerprint("x")).unwrap();
    assert_eq!(log.state(), LogState::Resumed(4));
    let toy = Toy::new(None);
    let seen = AtomicUsize::new(0);
    let resumed = campaign(&toy, 8)
        .run(Some(log), &|done, total| {
            assert_eq!(total, 8);
            seen.fetch_max(done, Ordering::Relaxed);
        })
        .unwrap();
    assert_eq!(toy.started.load(Ordering::Relaxed), 4);
    assert_eq!(seen.load(Ordering::Relaxed), 8);
    assert_eq!(resumed, whole);

    let log = RunLog::open(&scratch.0, &fingerprint("x")).unwrap();
    assert_eq!(log.state(), LogState::Resumed(8));
    let fewer = campaign(&toy, 2).run(Some(log), &|_, _| {}).unwrap();
    assert_eq!(fewer, whole[..2]);
}

#[test]
fn another_scenario_starts_afresh() {
    let scratch = Scratch::new("afresh");
    let log = RunLog::open(&scratch.0, &fingerprint("x")).unwrap();
    campaign(&Toy::new(None), 2).run(Some(log), &|_, _| {}).unwrap();
    let log = RunLog::open(&scratch.0, &fingerprint("y")).unwrap();
    assert_eq!(log.state(), LogState::Replaced);
    campaign(&Toy::new(Some(0)), 2).run(Some(log), &|_, _| {}).unwrap_err();
    let log = RunLog::open(&scratch.0, &fingerprint("x")).unwrap();
    assert_eq!(log.state(), LogState::Resumed(2), "a failure at once leaves what it found");
    drop(log);
    let log = RunLog::open(&scratch.0, &fingerprint("y")).unwrap();
    campaign(&Toy::new(None), 1).run(Some(log), &|_, _| {}).unwrap();
    assert_eq!(RunLog::open(&scratch.0, &fingerprint("y")).unwrap().state(), LogState::Resumed(1));
    let before = scratch.0.with_extension("before.jsonl");
    assert_eq!(RunLog::open(&before, &fingerprint("x")).unwrap().state(), LogState::Resumed(2));
    fs::remove_file(before).unwrap();
}

#[test]
fn a_log_that_is_held_is_refused() {
    let scratch = Scratch::new("held");
    let _held = RunLog::open(&scratch.0, &fingerprint("x")).unwrap();
    let error = RunLog::open(&scratch.0, &fingerprint("x")).unwrap_err();
    assert!(matches!(error, PositioningError::InUse { .. }));
    assert!(error.is_input());
}
