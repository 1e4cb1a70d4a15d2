//! System `graph`: a graph from a file, by every method that can run it, held against the exact answer.
//!
//! | method | does |
//! |---|---|
//! | `joint` | the minimum of the cost, all marginal covariances, the evidence; exact where the graph is linear |
//! | `map` | the minimum of the cost alone |
//! | `gaussian-bp` | loopy Gaussian belief propagation on the linear form, again and again made linear at its own means |
//! | `junction-tree` | of finitely many states: all marginals and the evidence, exact; `map` is the most probable state |
//! | `bp`, `max-product` | of finitely many states: loopy messages that sum or maximise, by `schedule` |
//!
//! Methods that are not for the file's kind of variables are left out. One that has no answer says why in a note; a run in
//! which none has one fails as the last of them did.
//!
//! Files are those of [`sumprod_exact::read`]. The first method's answer is written to `marginals.json`, those of the
//! others to `marginals-ID.json`: by variable the mean in stored coordinates and the covariance in local ones, of a pose in
//! its own frame, translation before rotation.

mod marginals;
mod method;
mod states;

use std::path::Path;

use serde::{Deserialize, Serialize};
use sumprod_exact::observability::{free_directions, mirror_images};
use sumprod_exact::read::{self, GraphFile, TableFile};
use sumprod_exact::{Answer, ExactError, Problem, Values, chordal_start};
use sumprod_graph::{FactorGraph, Space};
use sumprod_messages::DynamicGaussian;
use sumprod_models::library::PoseResidual;

use crate::error::{PositioningError, unsolvable};
use crate::results::{MethodRun, OutputFile, RunResult};
use crate::scenario::{FormUse, GraphSummary, Methods, RunRequest, Scenario};
use method::{Inference, MethodSettings};
use states::States;

/// A scenario of system `graph`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Graphs {
    /// How the file is read.
    #[serde(default)]
    pub world: WorldSettings,
    /// The methods to compare.
    pub method: Methods<MethodSettings>,
}

/// How a file becomes a graph.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WorldSettings {
    /// The variable that is held where the file has it, if the file has poses and no prior: a name, `first`, or `none`.
    pub anchor: String,
    /// Standard deviation of its position (m).
    pub anchor_sd_m: f64,
    /// Standard deviation of its orientation (rad).
    pub anchor_sd_rad: f64,
    /// Where nonlinear solves start: `file`, `chordal`, or `best`, the one of lower cost.
    pub start: Start,
    /// The residual of a relative pose: `log`, or `split` as in g2o.
    pub residual: ResidualForm,
}

impl Default for WorldSettings {
    fn default() -> Self {
        Self {
            anchor: "first".into(),
            anchor_sd_m: 1e-4,
            anchor_sd_rad: 1e-4,
            start: Start::default(),
            residual: ResidualForm::default(),
        }
    }
}

/// Where nonlinear solves start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Start {
    /// The lower cost of the two others.
    #[default]
    Best,
    /// The file's values.
    File,
    /// Rotations, then positions, each by a linear solve.
    Chordal,
}

/// The residual of a relative pose.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ResidualForm {
    /// The logarithm of the error pose.
    #[default]
    Log,
    /// Its translation and its rotation by themselves.
    Split,
}

impl From<ResidualForm> for PoseResidual {
    fn from(form: ResidualForm) -> Self {
        match form {
            ResidualForm::Log => Self::Log,
            ResidualForm::Split => Self::Split,
        }
    }
}

/// A file that has been read.
pub struct Prepared(Kind);

enum Kind {
    Coordinates(Box<Coordinates>),
    States(Box<States>),
}

/// A graph of continuous variables.
struct Coordinates {
    /// What the file holds, its anchor included.
    file: GraphFile,
    graph: FactorGraph<DynamicGaussian>,
    start: Values,
}

impl Graphs {
    /// Holds a variable, where nothing else ties the file's poses to the world.
    fn anchor(&self, file: &mut GraphFile) -> Result<(), PositioningError> {
        let world = &self.world;
        let held = match world.anchor.as_str() {
            "none" => return Ok(()),
            "first" if file.has_priors() => return Ok(()),
            "first" => file.variables.iter().position(|v| matches!(v.space, Space::Se2 | Space::Se3)),
            name => Some(file.find(name).ok_or_else(|| {
                let problem = format!("is {name:?}, but the file has no variable of that name");
                PositioningError::setting("world.anchor", problem)
            })?),
        };
        match held {
            Some(variable) => file.hold(variable, world.anchor_sd_m, world.anchor_sd_rad).map_err(unsolvable),
            None => Ok(()),
        }
    }

    fn start(&self, file: &GraphFile, problem: &Problem<'_>) -> Result<Values, ExactError> {
        if !file.has_poses() {
            return Ok(file.values(problem)?.unwrap_or_else(|| problem.start()));
        }
        let given = || file.values(problem);
        match self.world.start {
            Start::Chordal => chordal_start(file, problem),
            Start::File => match given()? {
                Some(values) => Ok(values),
                None => chordal_start(file, problem),
            },
            Start::Best => {
                let chordal = chordal_start(file, problem);
                match (given()?, chordal) {
                    (None, chordal) => chordal,
                    (Some(values), Err(_)) => Ok(values),
                    (Some(values), Ok(chordal)) => {
                        let better = problem.cost(&chordal)? < problem.cost(&values)?;
                        Ok(if better { chordal } else { values })
                    }
                }
            }
        }
    }

    /// The methods among these that are for a kind of variables.
    fn applicable<'a>(
        &self,
        ids: &'a [String],
        kind: &str,
        takes: fn(Inference) -> bool,
    ) -> Result<Vec<&'a String>, PositioningError> {
        let takes = |id: &&String| self.method.get(id).is_some_and(|method| takes(method.inference));
        let chosen: Vec<&String> = ids.iter().filter(takes).collect();
        if chosen.is_empty() {
            let all = self.method.ids();
            let fit = all.iter().filter(takes).map(String::as_str).collect::<Vec<_>>().join(", ");
            let remedy =
                if fit.is_empty() { "none of the scenario's can".into() } else { format!("take {fit}") };
            let problem = format!("is {}, but the file holds a graph of {kind}; {remedy}", ids.join(", "));
            return Err(PositioningError::setting("method", problem));
        }
        Ok(chosen)
    }

    fn for_coordinates<'a>(&self, ids: &'a [String]) -> Result<Vec<&'a String>, PositioningError> {
        self.applicable(ids, "continuous variables", Inference::takes_coordinates)
    }

    fn for_states<'a>(&self, ids: &'a [String]) -> Result<Vec<&'a String>, PositioningError> {
        self.applicable(ids, "variables of finitely many states", Inference::takes_states)
    }

    /// Every method that is for continuous variables.
    fn run_coordinates(
        &self,
        prepared: &Coordinates,
        request: RunRequest<'_>,
    ) -> Result<RunResult, PositioningError> {
        let ids = self.for_coordinates(request.methods)?;
        let mut methods = Vec::with_capacity(ids.len());
        let mut answers: Vec<(String, Answer)> = Vec::new();
        let mut failed = None;
        for id in ids {
            let settings = self.method.named(id)?;
            let mut answer = None;
            let mut run = MethodRun::timed(id, marginals::layout(), |out| {
                match settings.run(prepared, out) {
                    Ok(found) => answer = Some(found),
                    // Messages may fail where a joint solve does not; the others' answers stand.
                    Err(error) if settings.inference == Inference::GaussianBp => {
                        out.notes.push(format!("no answer: {error}"));
                        failed = Some(PositioningError::method(id, error));
                    }
                    Err(error) => return Err(solving(id, error)),
                }
                Ok(())
            })?;
            if let (Some(answer), Inference::Joint) = (&answer, settings.inference) {
                let problem = Problem::new(&prepared.graph).map_err(unsolvable)?;
                let mirrored = mirror_images(&problem, &answer.values).map_err(unsolvable)?;
                run.notes.extend(mirrored.iter().map(ToString::to_string));
            }
            methods.push(run);
            answers.extend(answer.map(|answer| (id.clone(), answer)));
        }
        if let (true, Some(error)) = (answers.is_empty(), failed) {
            return Err(error);
        }
        let joint = |(id, _): &&(String, Answer)| {
            self.method.get(id).is_some_and(|method| method.inference == Inference::Joint)
        };
        if let Some(exact) = answers.iter().find(joint) {
            marginals::compare(exact, &answers, &mut methods);
        }
        let file = |(k, (id, answer)): (usize, &(String, Answer))| OutputFile {
            name: if k == 0 { "marginals.json".to_owned() } else { format!("marginals-{id}.json") },
            contents: marginals::json(answer, &prepared.file),
        };
        let files = answers.iter().enumerate().map(file).collect();
        Ok(RunResult { run: request.run, methods, files, ..RunResult::default() })
    }
}

/// A failing solve: the input's fault where the graph has no answer, else the method's.
fn solving(id: &str, error: ExactError) -> PositioningError {
    match error {
        ExactError::NotConverged { .. } => PositioningError::method(id, error),
        other => unsolvable(other),
    }
}

impl Scenario for Graphs {
    const SYSTEM: &'static str = "graph";
    const READS_DATA: bool = true;
    type Prepared = Prepared;

    fn validate(&self) -> Result<(), PositioningError> {
        let world = &self.world;
        for (key, value) in [("anchor_sd_m", world.anchor_sd_m), ("anchor_sd_rad", world.anchor_sd_rad)] {
            if !(value > 0.0 && value.is_finite()) {
                let problem = format!("is {value}; a standard deviation must be positive and finite");
                return Err(PositioningError::setting(format!("world.{key}"), problem));
            }
        }
        self.method.iter().try_for_each(|(id, method)| method.validate(id))
    }

    fn methods(&self) -> Vec<String> {
        self.method.ids()
    }

    fn prepare(&self, _seed: u64, data: Option<&Path>) -> Result<Prepared, PositioningError> {
        let path = data.unwrap_or(Path::new(""));
        if path.is_dir() {
            return Err(PositioningError::data(
                path,
                None,
                "is a folder; name one graph's file with --data FILE",
            ));
        }
        let text = read::text(path).map_err(unsolvable)?;
        if TableFile::recognises(path, &text) {
            let file = TableFile::parse(path, &text).map_err(unsolvable)?;
            return Ok(Prepared(Kind::States(Box::new(States::new(file).map_err(unsolvable)?))));
        }
        let mut file = GraphFile::parse(path, &text).map_err(unsolvable)?;
        self.anchor(&mut file)?;
        let graph = file.graph(self.world.residual.into()).map_err(unsolvable)?;
        let start = {
            let problem = Problem::new(&graph).map_err(unsolvable)?;
            self.start(&file, &problem).map_err(unsolvable)?
        };
        Ok(Prepared(Kind::Coordinates(Box::new(Coordinates { file, graph, start }))))
    }

    fn run(&self, prepared: &Prepared, request: RunRequest<'_>) -> Result<RunResult, PositioningError> {
        match &prepared.0 {
            Kind::Coordinates(prepared) => self.run_coordinates(prepared, request),
            Kind::States(prepared) => self.run_states(prepared, request),
        }
    }

    fn check(
        &self,
        prepared: &Prepared,
        _seed: u64,
        methods: &[String],
    ) -> Result<Vec<GraphSummary>, PositioningError> {
        let prepared = match &prepared.0 {
            Kind::States(prepared) => return Ok(prepared.summaries(&self.for_states(methods)?)),
            Kind::Coordinates(prepared) => prepared,
        };
        let graph = &prepared.graph;
        let problem = Problem::new(graph).map_err(unsolvable)?;
        let free = free_directions(&problem, &prepared.start).map_err(unsolvable)?;
        let mirrored = mirror_images(&problem, &prepared.start).map_err(unsolvable)?;
        let free = free.iter().map(ToString::to_string);
        let sentences: Vec<String> = free.chain(mirrored.iter().map(ToString::to_string)).collect();
        let forms = FormUse { kind: "all".into(), form: "gaussian".into(), edges: graph.edge_count() };
        let summary = |id: &&String| GraphSummary {
            unconstrained: sentences.clone(),
            ..GraphSummary::new(id, "the whole file", graph, vec![forms.clone()])
        };
        Ok(self.for_coordinates(methods)?.iter().map(summary).collect())
    }
}

#[cfg(test)]
mod tests;
