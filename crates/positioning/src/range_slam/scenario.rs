//! The scenario `range-slam`: its keys and its methods.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use sumprod_messages::AnyForm;

use super::file::RangeGraph;
use super::method::Method;
use super::solve::{ODOMETRY, RANGE, StepGraph};
use super::steps::Growing;
use crate::PositioningError;
use crate::form::FormSpec;
use crate::results::RunResult;
use crate::scenario::{FormUse, GraphSummary, Methods, RunRequest, Scenario};

/// A range-only graph that grows pose by pose.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RangeSlam {
    world: World,
    method: Methods<Method>,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct World {
    /// The graph's file within the folder of the data; not read where the data are a file themselves.
    file: PathBuf,
}

impl Scenario for RangeSlam {
    const SYSTEM: &'static str = "range-slam";
    const READS_DATA: bool = true;
    type Prepared = Growing;

    fn validate(&self) -> Result<(), PositioningError> {
        self.method.iter().try_for_each(|(id, method)| method.validate(id))
    }

    fn methods(&self) -> Vec<String> {
        self.method.ids()
    }

    fn prepare(&self, _seed: u64, data: Option<&Path>) -> Result<Growing, PositioningError> {
        let data = data.unwrap_or(Path::new("."));
        let path = if data.is_dir() { data.join(&self.world.file) } else { data.to_path_buf() };
        Growing::new(RangeGraph::read(&path)?)
    }

    fn run(&self, growing: &Growing, request: RunRequest<'_>) -> Result<RunResult, PositioningError> {
        let names = growing.graph().landmarks.iter().map(|landmark| landmark.name.clone());
        let mut result = RunResult { nodes: names.collect(), ..RunResult::default() };
        for (id, method) in
            self.method.iter().filter(|(id, _)| request.methods.iter().any(|wanted| wanted == id))
        {
            let (run, files) = method.run(growing, id, request.method_seed(id))?;
            result.methods.push(run);
            result.files.extend(files);
        }
        Ok(result)
    }

    fn check(
        &self,
        growing: &Growing,
        seed: u64,
        methods: &[String],
    ) -> Result<Vec<GraphSummary>, PositioningError> {
        let last = growing.steps() - 1;
        let seen = growing.seen(last)?;
        let wanted = self.method.iter().filter(|(id, _)| methods.iter().any(|wanted| wanted == id));
        wanted
            .map(|(id, method)| {
                let form = method.form.range;
                let graph = StepGraph::new(growing, last, &seen, form.0, seed)?.graph;
                let kinds = [(ODOMETRY, FormSpec(AnyForm::gaussian())), (RANGE, form)];
                let forms = kinds.map(|(kind, form)| {
                    let factors = graph.factor_ids().filter(|&factor| graph.factor_kind(factor) == kind);
                    let edges = factors.map(|factor| graph.ports(factor).count()).sum();
                    FormUse { kind: kind.to_owned(), form: form.to_string(), edges }
                });
                Ok(GraphSummary::new(id, "the last step", &graph, forms.into()))
            })
            .collect()
    }
}
