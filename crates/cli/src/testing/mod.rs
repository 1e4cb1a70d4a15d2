//! A system small enough for the program's own tests: walkers in the plane seen in noise, and their exact filter.

use std::path::Path;

use serde::{Deserialize, Serialize};
use sumprod_positioning::PositioningError;
use sumprod_positioning::results::{Anchor, BoundStep, MethodRun, OutputFile, RunResult, StateLayout};
use sumprod_positioning::scenario::{FormUse, GraphSummary, Methods, RunRequest, Scenario};

#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Walk {
    world: World,
    method: Methods<Method>,
}

#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct World {
    steps: u32,
    process_variance: f64,
    noise_variance: f64,
    #[serde(default)]
    fails_at: Option<u32>,
}

#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Method {
    form: Form,
    #[serde(default = "honest")]
    claimed: f64,
}

fn honest() -> f64 {
    1.0
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Form {
    Gaussian,
    Measurement,
}

/// splitmix64 and Box–Muller.
struct Normals(u64);

impl Normals {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    fn draw(&mut self, variance: f64) -> f64 {
        let radius = (-2.0 * variance * (1.0 - self.uniform()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform()).cos()
    }
}

struct Walker {
    truth: [f64; 2],
    mean: [f64; 2],
}

impl Scenario for Walk {
    const SYSTEM: &'static str = "walk";
    const READS_DATA: bool = false;
    type Prepared = ();

    fn validate(&self) -> Result<(), PositioningError> {
        let variance = self.world.process_variance;
        if variance < 0.0 {
            let problem = format!("is {variance} m²; a variance cannot be negative");
            return Err(PositioningError::setting("world.process_variance", problem));
        }
        Ok(())
    }

    fn methods(&self) -> Vec<String> {
        self.method.ids()
    }

    fn prepare(&self, _: u64, _: Option<&Path>) -> Result<(), PositioningError> {
        Ok(())
    }

    fn run(&self, (): &(), request: RunRequest<'_>) -> Result<RunResult, PositioningError> {
        if self.world.fails_at == Some(request.run) {
            return Err(PositioningError::method("kf", "the innovation covariance is singular"));
        }
        let (process, noise) = (self.world.process_variance, self.world.noise_variance);
        let mut bound = Vec::new();
        let mut methods = Vec::new();
        for id in request.methods {
            let Some(method) = self.method.get(id) else { continue };
            let mut normals = Normals(request.seed << 32 | u64::from(request.run));
            let mut walkers = [0.0, 15.0].map(|x| Walker { truth: [x, 0.0], mean: [x, 0.0] });
            let mut variance = 0.0;
            bound.clear();
            let mut run = MethodRun::timed(id, StateLayout::planar_position(), |run| {
                for step in 0..self.world.steps {
                    let time = f64::from(step);
                    variance += process;
                    let gain = variance / (variance + noise);
                    variance *= 1.0 - gain;
                    let (gain, claimed) = match method.form {
                        Form::Gaussian => (gain, variance * method.claimed),
                        Form::Measurement => (1.0, noise),
                    };
                    for (node, walker) in walkers.iter_mut().enumerate() {
                        for axis in 0..2 {
                            walker.truth[axis] += normals.draw(process) + 0.5;
                            let measured = walker.truth[axis] + normals.draw(noise);
                            walker.mean[axis] += 0.5 + gain * (measured - walker.mean[axis] - 0.5);
                        }
                        let covariance = [claimed, 0.0, 0.0, claimed];
                        run.push(step, time, node as u32, &walker.truth, &walker.mean, &covariance)?;
                    }
                    bound.push(BoundStep { step, time, position_variance: 2.0 * variance });
                }
                Ok::<(), PositioningError>(())
            })?;
            run.diagnose("conversion_loss.range", 0.25);
            run.notes.push("an exact answer".into());
            methods.push(run);
        }
        let anchors = vec![Anchor { name: "a1".into(), position: vec![5.0, 15.0] }];
        let nodes = vec!["walker 1".into(), "walker 2".into()];
        let files = vec![OutputFile { name: "walk.txt".into(), contents: format!("run {}\n", request.run) }];
        Ok(RunResult { nodes, anchors, bound, methods, files, ..RunResult::default() })
    }

    fn check(&self, (): &(), _: u64, methods: &[String]) -> Result<Vec<GraphSummary>, PositioningError> {
        let summary = |id: &String| GraphSummary {
            method: id.clone(),
            extent: "one slice".into(),
            variables: 2,
            factors: 4,
            edges: 4,
            components: 2,
            loops: 0,
            forms: vec![FormUse { kind: "measurement".into(), form: "gaussian".into(), edges: 2 }],
            unconstrained: Vec::new(),
        };
        Ok(methods.iter().map(summary).collect())
    }
}
