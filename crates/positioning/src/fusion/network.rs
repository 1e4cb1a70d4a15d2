//! A method's nodes at work, and the figures of the paper.
//!
//! With N scored nodes at a step: D = √(Σ |x̂_i - mean|² / N), E = √(Σ |x̂_i - x|² / N), P = Σ tr P_i / N. A run reports the
//! root mean squares of D (`disagreement`) and E (`run_rmse_m`) over its scored steps and the mean of P
//! (`claimed_trace`).

use nalgebra::{Matrix2, Vector2};
use sumprod_fusion::{
    Communication, Direction, FusionError, FusionNode, InformationSet, Item, Known, Outcome, Rule,
};
use sumprod_graph::Space;
use sumprod_messages::Gaussian;

use super::method::{Exchange, MethodSettings};
use super::structure::{Phase, Structure};
use super::world::{World, WorldSettings};
use crate::error::PositioningError;
use crate::results::{DiagnosticSeries, MethodRun};

type Node = FusionNode<Gaussian<2>>;
type Estimate = (Vector2<f64>, Matrix2<f64>);

/// The filter of all measurements, at every exchange from the first that is scored.
pub(super) fn centralised(
    settings: &WorldSettings,
    world: &World,
) -> Result<Vec<Estimate>, PositioningError> {
    let failed = |error| PositioningError::method("centralised", error);
    let mut belief = settings.prior().map_err(failed)?;
    let mut estimates = Vec::new();
    for step in 1..=settings.steps {
        belief = settings.predicted(&belief).map_err(failed)?;
        for (sensor, measured) in world.measured.iter().enumerate() {
            belief = belief.times(&settings.likelihood(sensor, &measured[step as usize - 1]));
        }
        if scored(settings, step) {
            estimates.push(belief.moments().map_err(failed)?);
        }
    }
    Ok(estimates)
}

fn scored(settings: &WorldSettings, step: u32) -> bool {
    step >= settings.first_scored && settings.exchanges(step)
}

/// Runs a method and scores it.
pub(super) fn run(
    settings: &WorldSettings,
    structure: &Structure,
    method: &MethodSettings,
    world: &World,
    central: &[Estimate],
    out: &mut MethodRun,
) -> Result<(), PositioningError> {
    let mut score = Score::default();
    let mut estimates = central.iter();
    let Some(rule) = method.node_rule() else {
        for step in (1..=settings.steps).filter(|&step| scored(settings, step)) {
            if let Some(estimate) = estimates.next() {
                score.step(settings, world, step, &[(structure.top, *estimate)], None, out)?;
            }
        }
        score.report(out);
        return Ok(());
    };
    let id = out.id.clone();
    let failed = |error| PositioningError::method(&id, error);
    let mut nodes = network(settings, structure, method, rule).map_err(failed)?;
    let phases = structure.phases(method);
    let chosen: Vec<usize> = match method.exchange {
        Exchange::Collect => vec![structure.top],
        _ => (0..nodes.len()).collect(),
    };
    let mut fallback = Fallback::default();
    for step in 1..=settings.steps {
        let time = f64::from(step) * settings.interval;
        for node in &mut nodes {
            node.predict(time, |belief| settings.predicted(belief)).map_err(failed)?;
        }
        for (sensor, measured) in world.measured.iter().enumerate() {
            let likelihood = settings.likelihood(sensor, &measured[step as usize - 1]);
            nodes[sensor].observe(Item::new(sensor as u32, u64::from(step)), &likelihood).map_err(failed)?;
        }
        if !settings.exchanges(step) {
            continue;
        }
        for phase in &phases {
            let sent = send(settings, world, step, phase, &mut nodes).map_err(failed)?;
            for message in sent {
                // What is distributed replaces what was held, unless a rule knows better.
                let to = message.to;
                let replaces = rule == Rule::Naive && structure.distributes(method, message.from, to);
                let outcome = if replaces {
                    nodes[to].adopt(&message)
                } else {
                    nodes[to].receive(&message, |belief, _| Ok(*belief))
                };
                fallback.note(step, &structure.names, to, outcome.map_err(failed)?);
            }
        }
        if step >= settings.first_scored {
            let estimates_now: Vec<(usize, Estimate)> = chosen
                .iter()
                .map(|&node| Ok((node, nodes[node].belief().moments()?)))
                .collect::<Result<_, sumprod_graph::MessageError>>()
                .map_err(|error| PositioningError::method(&out.id, error))?;
            score.step(settings, world, step, &estimates_now, estimates.next(), out)?;
        }
    }
    score.report(out);
    fallback.report(rule, out);
    for &sensor in &settings.silent {
        let name = &structure.names[sensor as usize];
        out.notes.push(format!("{name} never sends: what it measures reaches nobody but itself"));
    }
    Ok(())
}

/// The nodes with their channels.
fn network(
    settings: &WorldSettings,
    structure: &Structure,
    method: &MethodSettings,
    rule: Rule,
) -> Result<Vec<Node>, FusionError> {
    let known = Known::new(InformationSet::prior(), settings.prior()?);
    let links = structure.links(method);
    let is_parent = |node: usize| links.iter().any(|(_, parent)| *parent == node);
    let mut nodes: Vec<Node> = structure
        .names
        .iter()
        .enumerate()
        .map(|(node, name)| {
            // Where all is collected, nodes on the way fuse exactly, so that rules differ at the top alone.
            let between = method.exchange != Exchange::Neighbours && is_parent(node) && node != structure.top;
            let plain = rule == Rule::Naive || method.exchange == Exchange::Collect && rule != Rule::Edge;
            let own = if between && plain { Rule::Removal } else { rule };
            FusionNode::new(name, Space::real(2), known.clone(), own)
        })
        .collect();
    let (up, down) = match method.exchange {
        Exchange::Collect => (Direction::Outgoing, Direction::Incoming),
        _ => (Direction::Both, Direction::Both),
    };
    for &(child, parent) in &links {
        nodes[child].connect(parent, up, known.clone());
        nodes[parent].connect(child, down, known.clone());
    }
    for &(child, parent) in &links {
        let shared = Structure::shared_children(child, &links);
        nodes[child].forward(&shared, parent)?;
    }
    Ok(nodes)
}

/// What is sent at once, without what gets lost.
fn send(
    settings: &WorldSettings,
    world: &World,
    step: u32,
    phase: &Phase,
    nodes: &mut [Node],
) -> Result<Vec<Communication<Gaussian<2>>>, FusionError> {
    let mut messages = Vec::with_capacity(phase.len());
    for &(from, to) in phase.iter().filter(|(from, _)| !settings.is_silent(*from)) {
        let message = nodes[from].send(from, to)?;
        if !settings.loses(world, step, from, to) {
            messages.push(message);
        }
    }
    Ok(messages)
}

/// How often, and since when, messages were fused by an intersection.
#[derive(Default)]
struct Fallback {
    messages: u64,
    intersected: u64,
    first: Option<String>,
}

impl Fallback {
    fn note(&mut self, step: u32, names: &[String], to: usize, outcome: Outcome) {
        self.messages += 1;
        if let Outcome::Intersected { looped, .. } = outcome {
            self.intersected += 1;
            if let (Some(looped), None) = (looped, &self.first) {
                let sources: Vec<&str> =
                    looped.sources().iter().map(|&k| names[k as usize].as_str()).collect();
                let to = &names[to];
                self.first = Some(if sources.is_empty() {
                    format!("found at step {step} that what is shared is narrower than what {to} received")
                } else {
                    format!(
                        "noticed a loop at step {step}: what {} measured reached {to} by more than one path, so that \
                         removal would count it twice",
                        sources.join(", ")
                    )
                });
            }
        }
    }

    fn report(self, rule: Rule, out: &mut MethodRun) {
        let Rule::Automatic(how) = rule else { return };
        out.diagnose("fallback_share", self.intersected as f64 / self.messages.max(1) as f64);
        match self.first {
            Some(first) => {
                out.notes
                    .push(format!("{first}; fused by {:?} covariance intersection from there on", how.kind));
            }
            None => out.notes.push("no loop: all was removed exactly".to_owned()),
        }
    }
}

/// Figures of the scored steps.
#[derive(Default)]
struct Score {
    steps: Vec<u32>,
    squared_error: Vec<f64>,
    squared_disagreement: Vec<f64>,
    trace: Vec<f64>,
    nodes: usize,
    mean_difference: Option<f64>,
    covariance_difference: f64,
}

impl Score {
    fn step(
        &mut self,
        settings: &WorldSettings,
        world: &World,
        step: u32,
        estimates: &[(usize, Estimate)],
        central: Option<&Estimate>,
        out: &mut MethodRun,
    ) -> Result<(), PositioningError> {
        let truth = world.truth[step as usize - 1];
        let count = estimates.len() as f64;
        let middle = estimates.iter().map(|(_, (mean, _))| mean).sum::<Vector2<f64>>() / count;
        let average =
            |of: &dyn Fn(&Estimate) -> f64| estimates.iter().map(|(_, e)| of(e)).sum::<f64>() / count;
        self.steps.push(step);
        self.nodes = estimates.len();
        self.squared_error.push(average(&|(mean, _)| (mean - truth).norm_squared()));
        self.squared_disagreement.push(average(&|(mean, _)| (mean - middle).norm_squared()));
        self.trace.push(average(&|(_, covariance)| covariance.trace()));
        for (node, (mean, covariance)) in estimates {
            let time = f64::from(step) * settings.interval;
            out.push(step, time, *node as u32, truth.as_slice(), mean.as_slice(), covariance.as_slice())?;
            if let Some((best, spread)) = central {
                let difference = (mean - best).amax();
                self.mean_difference = Some(self.mean_difference.unwrap_or(0.0).max(difference));
                self.covariance_difference = self.covariance_difference.max((covariance - spread).amax());
            }
        }
        Ok(())
    }

    fn report(self, out: &mut MethodRun) {
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len().max(1) as f64;
        out.diagnose("run_rmse_m", mean(&self.squared_error).sqrt());
        out.diagnose("claimed_trace", mean(&self.trace));
        if self.nodes > 1 {
            out.diagnose("disagreement", mean(&self.squared_disagreement).sqrt());
        }
        if let Some(difference) = self.mean_difference {
            out.diagnose("centralised_difference", difference);
            out.diagnose("centralised_covariance_difference", self.covariance_difference);
        }
        let mut by_step = vec![("claimed_trace", self.trace)];
        if self.nodes > 1 {
            let roots = self.squared_disagreement.iter().map(|square| square.sqrt()).collect();
            by_step.push(("disagreement", roots));
        }
        for (name, values) in by_step {
            out.series.push(DiagnosticSeries { name: name.to_owned(), steps: self.steps.clone(), values });
        }
    }
}
