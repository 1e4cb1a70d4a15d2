//! Graphs of finitely many states, from files of tables.

use serde_json::{Map, Value, json};
use sumprod_exact::read::TableFile;
use sumprod_exact::{ExactError, JunctionOptions, JunctionTree, MostProbable, discrete_log_evidence};
use sumprod_graph::schedule::{Flooding, Residual, Schedule};
use sumprod_graph::{Engine, FactorGraph, Options};
use sumprod_messages::{Categorical, CategoricalForm};

use super::method::{Inference, MethodSettings, Order, report, unsettled};
use super::{Graphs, marginals};
use crate::error::{PositioningError, unsolvable};
use crate::results::{MethodRun, OutputFile, RunResult};
use crate::scenario::{FormUse, GraphSummary, RunRequest};

/// A file of tables that has been read.
pub(super) struct States {
    pub(super) file: TableFile,
    pub(super) graph: FactorGraph<Categorical>,
}

/// What a method finds: probabilities of all states, or the most probable ones, or both.
#[derive(Clone, Debug, Default)]
struct Found {
    probabilities: Option<Vec<Vec<f64>>>,
    states: Option<Vec<usize>>,
    log_evidence: Option<f64>,
}

impl States {
    pub(super) fn new(file: TableFile) -> Result<Self, ExactError> {
        let graph = file.graph()?;
        Ok(Self { file, graph })
    }

    /// Runs a method that is for states.
    fn run(&self, method: &MethodSettings, out: &mut MethodRun) -> Result<Found, ExactError> {
        match method.inference {
            Inference::JunctionTree => {
                let tree = self.tree(method, out)?;
                let answer = tree.solve()?;
                let log_evidence = answer.log_evidence + self.file.log_constant;
                out.diagnose("log_evidence", log_evidence);
                let probabilities = Some(answer.marginals);
                Ok(Found { probabilities, states: None, log_evidence: Some(log_evidence) })
            }
            Inference::Map => {
                let MostProbable { states, log_score } = self.tree(method, out)?.most_probable()?;
                out.diagnose("cost", -(log_score + self.file.log_constant));
                Ok(Found { states: Some(states), ..Found::default() })
            }
            Inference::MaxProduct => self.messages(method, CategoricalForm::max_product(), out),
            _ => self.messages(method, CategoricalForm::sum_product(), out),
        }
    }

    fn tree(&self, method: &MethodSettings, out: &mut MethodRun) -> Result<JunctionTree, ExactError> {
        let options = JunctionOptions { most_entries: method.most_entries };
        let tree = JunctionTree::new(&self.graph, options)?;
        out.diagnose("junction_tree.width", tree.width() as f64);
        out.diagnose("junction_tree.entries", tree.entries() as f64);
        Ok(tree)
    }

    fn messages(
        &self,
        method: &MethodSettings,
        form: CategoricalForm,
        out: &mut MethodRun,
    ) -> Result<Found, ExactError> {
        let options = Options {
            max_iterations: method.iterations,
            damping: method.damping,
            tolerance: method.tolerance,
            ..Options::default()
        };
        let mut engine = Engine::new(&self.graph, options)?;
        let edges: Vec<_> = engine.topology().edges().collect();
        for edge in edges {
            engine.set_edge_form(edge, form)?;
        }
        let mut schedule: Box<dyn Schedule> = match method.schedule {
            Order::Flooding => Box::new(Flooding),
            Order::Residual => Box::new(Residual::default()),
        };
        let run = engine.run(schedule.as_mut())?;
        out.diagnose("converged", f64::from(u8::from(run.converged())));
        if !run.converged() {
            out.notes.push(unsettled(&run.changes, "`junction-tree`"));
        }
        let beliefs = || self.graph.variable_ids().map(|variable| engine.belief(variable));
        let mut found = Found {
            probabilities: Some(beliefs().map(Categorical::probabilities).collect()),
            ..Found::default()
        };
        if form.temperature == 0.0 {
            let states: Vec<usize> = beliefs().map(Categorical::most_likely).collect();
            let cost = -self.log_score(&states);
            if cost.is_finite() {
                report(out, cost, run.iterations);
            } else {
                out.diagnose("iterations", run.iterations as f64);
                out.notes.push("the states of the largest beliefs are impossible together".into());
            }
            found.states = Some(states);
        } else {
            out.diagnose("iterations", run.iterations as f64);
            let log_evidence = discrete_log_evidence(&engine)? + self.file.log_constant;
            if log_evidence.is_finite() {
                out.diagnose("log_evidence", log_evidence);
                found.log_evidence = Some(log_evidence);
            }
        }
        Ok(found)
    }

    /// Logarithm of the product of all factors at a joint state.
    fn log_score(&self, states: &[usize]) -> f64 {
        let mut score = self.file.log_constant;
        for factor in &self.file.factors {
            let own: Vec<usize> = factor.variables.iter().map(|&variable| states[variable]).collect();
            score += factor.table.log_at(&own);
        }
        score
    }

    /// By variable: the probabilities of its states, or the state found.
    fn json(&self, found: &Found) -> String {
        let mut all = Map::new();
        for (number, variable) in self.file.variables.iter().enumerate() {
            let mut own = Map::new();
            if let Some(probabilities) = found.probabilities.as_ref().and_then(|all| all.get(number)) {
                own.insert("probabilities".into(), json!(probabilities));
            }
            if let Some(state) = found.states.as_ref().and_then(|all| all.get(number)) {
                own.insert("state".into(), json!(state));
            }
            all.insert(variable.name.clone(), Value::Object(own));
        }
        let mut text = Value::Object(all).to_string();
        text.push('\n');
        text
    }
}

impl States {
    /// What there is of the graph, by method.
    pub(super) fn summaries(&self, methods: &[&String]) -> Vec<GraphSummary> {
        let graph = &self.graph;
        let edges = graph.edge_count();
        let summary = |id: &&String| GraphSummary {
            method: (*id).clone(),
            extent: "the whole file".into(),
            variables: graph.variable_count(),
            factors: graph.factor_count(),
            edges,
            components: graph.components().len(),
            loops: graph.loop_count(),
            forms: vec![FormUse { kind: "all".into(), form: "categorical".into(), edges }],
            unconstrained: Vec::new(),
        };
        methods.iter().map(summary).collect()
    }
}

impl Graphs {
    /// Every method that is for states. One that has no answer, because the graph is too wide or messages contradict,
    /// says so; the others' answers stand.
    pub(super) fn run_states(
        &self,
        prepared: &States,
        request: RunRequest<'_>,
    ) -> Result<RunResult, PositioningError> {
        let ids = self.for_states(request.methods)?;
        let mut methods = Vec::with_capacity(ids.len());
        let mut answers = Vec::with_capacity(ids.len());
        let mut failed = None;
        for id in ids {
            let settings = self.method.named(id)?;
            let mut answer = None;
            let run = MethodRun::timed(id, marginals::layout(), |out| {
                match prepared.run(settings, out) {
                    Ok(found) => answer = Some(found),
                    Err(error) => {
                        out.notes.push(format!("no answer: {error}"));
                        failed = Some(unsolvable(error));
                    }
                }
                Ok(())
            })?;
            methods.push(run);
            answers.push((id, settings.inference, answer));
        }
        if let (true, Some(error)) = (answers.iter().all(|(_, _, answer)| answer.is_none()), failed) {
            return Err(error);
        }
        let exact = answers.iter().find_map(|(_, inference, found)| {
            found.as_ref().filter(|_| *inference == Inference::JunctionTree)
        });
        if let Some(exact) = exact {
            for ((_, inference, found), run) in answers.iter().zip(&mut methods) {
                if let (Some(found), true) = (found, *inference != Inference::JunctionTree) {
                    compare(exact, found, run);
                }
            }
        }
        let found = answers.iter().filter_map(|(id, _, found)| found.as_ref().map(|found| (id, found)));
        let file = |(k, (id, found)): (usize, (&&String, &Found))| OutputFile {
            name: if k == 0 { "marginals.json".to_owned() } else { format!("marginals-{id}.json") },
            contents: prepared.json(found),
        };
        let files = found.enumerate().map(file).collect();
        Ok(RunResult { run: request.run, methods, files, ..RunResult::default() })
    }
}

/// Adds to a method how far it is from the exact answer, where both sum over states.
fn compare(exact: &Found, found: &Found, run: &mut MethodRun) {
    if let (Some(exact), Some(own), None) = (&exact.probabilities, &found.probabilities, &found.states) {
        let pairs = exact.iter().flatten().zip(own.iter().flatten());
        let largest = pairs.map(|(exact, own)| (exact - own).abs()).fold(0.0, f64::max);
        run.diagnose("error_to_exact.probability", largest);
    }
    if let (Some(exact), Some(own)) = (exact.log_evidence, found.log_evidence) {
        run.diagnose("error_to_exact.log_evidence", own - exact);
    }
}
