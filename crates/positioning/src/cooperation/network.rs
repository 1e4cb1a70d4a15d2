//! Filters in which every agent keeps its own belief: Gaussian and particle belief propagation on time slices.
//!
//! Per slice: predict every agent, then rounds in which all messages within the slice are sent at once, ranges to
//! anchors included, and close: each agent's belief becomes the next slice's prior. Neighbours' beliefs become
//! correlated over time, and a filter that keeps marginals alone does not know it: it is over-confident.

use serde::{Deserialize, Serialize};
use sumprod_graph::schedule::Sliced;
use sumprod_graph::{
    Factor, FactorGraph, GraphError, Message, MessageError, Options, Outgoing, Space, Window, WindowVariable,
};
use sumprod_messages::{AnyForm, AnyMessage, DynamicGaussian, Proposal};
use sumprod_models::library::{AnchorRange, ConstantVelocity, Range};
use sumprod_models::{Model, Noise, ResidualModel, Transition};

use super::plug_in::PlugInRange;
use super::world::{Draw, Slice, State, World};
use crate::form::unused_products;

/// Number of state components of an agent.
pub(super) const DIMENSION: usize = 4;
/// Components that hold the position.
pub(super) const POSITION: [usize; 2] = [0, 2];

/// Kinds of edges, which are the names of their factors.
pub(super) const PREDICTION: &str = "prediction";
pub(super) const RANGE: &str = "range";
pub(super) const ANCHOR: &str = "anchor";
pub(super) const KINDS: [&str; 3] = [PREDICTION, RANGE, ANCHOR];

/// Rounds of the Gaussian messages that tell predicted particles where to be drawn.
const GUIDE_ROUNDS: usize = 2;

type AnyFactor = Box<dyn Factor<AnyMessage>>;

/// What an agent hears from its neighbours.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Neighbours {
    /// Their beliefs without its own message in them: sum-product proper.
    #[default]
    Extrinsic,
    /// Their beliefs as they are.
    Broadcast,
    /// The means of their beliefs, taken for known positions.
    PlugIn,
    /// Nothing: anchors alone are heard.
    Ignored,
}

/// How a network is filtered.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plan {
    /// Form of the messages from one slice to the next.
    pub prediction: AnyForm,
    /// Form of the messages among agents.
    pub range: AnyForm,
    /// Form of the messages from anchors.
    pub anchor: AnyForm,
    /// Rounds within a slice.
    pub rounds: usize,
    /// Whether the anchors are heard once before the first round.
    pub anchors_first: bool,
    /// What is heard of neighbours.
    pub neighbours: Neighbours,
}

impl Default for Plan {
    /// Gaussian belief propagation with two rounds.
    fn default() -> Self {
        let gaussian = AnyForm::gaussian();
        Self {
            prediction: gaussian,
            range: gaussian,
            anchor: gaussian,
            rounds: 2,
            anchors_first: false,
            neighbours: Neighbours::Extrinsic,
        }
    }
}

impl Plan {
    /// What to tell of a product method that the beliefs' form has no use for.
    pub(super) fn unused_products(&self) -> Option<String> {
        let edges = [(PREDICTION, self.prediction), (RANGE, self.range), (ANCHOR, self.anchor)];
        unused_products(&carried(self), &edges)
    }

    /// Whether predicted particles are drawn where Gaussian messages say.
    fn is_guided(&self) -> bool {
        matches!(self.prediction, AnyForm::Particles(form) if form.proposal != Proposal::Prediction)
    }
}

/// A network of agents, each with its own belief, filtered slice by slice.
///
/// A slice costs O(agents + ranges) with Gaussian messages; a particle message N·M evaluations, N particles and M
/// senders.
pub struct NetworkFilter {
    window: Window<AnyMessage, AnyFactor>,
    plan: Plan,
    motion: ConstantVelocity,
    noise: Noise,
    anchors: Vec<[f64; 2]>,
    space: Space,
    agents: Vec<WindowVariable>,
    /// The same network in Gaussians, which says where predicted particles are needed.
    guide: Option<Box<NetworkFilter>>,
}

impl NetworkFilter {
    /// A filter at the start of a draw. `options` gives the seed and whether threads are used; what is sent to
    /// neighbours is the plan's.
    ///
    /// # Errors
    ///
    /// Where the world's variances are not positive.
    pub fn new(world: &World, draw: &Draw, plan: Plan, options: Options) -> Result<Self, GraphError> {
        let outgoing = match plan.neighbours {
            Neighbours::Broadcast | Neighbours::PlugIn => Outgoing::Broadcast,
            Neighbours::Extrinsic | Neighbours::Ignored => Outgoing::Extrinsic,
        };
        let guide = if plan.is_guided() {
            let neighbours = match plan.neighbours {
                Neighbours::Ignored => Neighbours::Ignored,
                _ => Neighbours::Extrinsic,
            };
            let gaussian = Plan { neighbours, rounds: GUIDE_ROUNDS, ..Plan::default() };
            Some(Box::new(Self::new(world, draw, gaussian, options)?))
        } else {
            None
        };
        let space = Space::real(DIMENSION);
        let mut window = Window::new(1, Options { outgoing, ..options })?;
        window.begin(0.0)?;
        let mut agents = Vec::with_capacity(draw.start.len());
        for (agent, mean) in draw.start.iter().enumerate() {
            let variable = window.variable(format!("agent {} at the start", agent + 1), space.clone())?;
            window.set_prior(variable, start(&space, mean, &draw.start_variances).map_err(invalid)?)?;
            window.set_belief_form(variable, carried(&plan))?;
            agents.push(variable);
        }
        Ok(Self {
            window,
            plan,
            motion: ConstantVelocity::held_acceleration(2, world.interval, world.process_variance)
                .map_err(invalid)?,
            noise: Noise::isotropic(1, world.range_variance)
                .map_err(|error| GraphError::Schedule(error.to_string()))?,
            anchors: world.anchors.clone(),
            space,
            agents,
            guide,
        })
    }

    /// Predicts to a slice and takes in its measurements.
    ///
    /// # Errors
    ///
    /// As [`Window::run`], with the names of agents and factors.
    pub fn step(&mut self, slice: &Slice) -> Result<(), GraphError> {
        self.extend(slice)?;
        if let Some(guide) = &mut self.guide {
            guide.step(slice)?;
            for (agent, evidence) in guide.evidence()?.into_iter().enumerate() {
                if !evidence.is_flat() {
                    let start = AnyMessage::from_gaussian(&self.space, evidence).map_err(invalid)?;
                    self.window.set_start(self.agents[agent], start)?;
                }
            }
        }
        let mut schedule = Sliced::new(self.plan.rounds);
        if self.plan.anchors_first {
            schedule = schedule.evidence_before_rounds();
        }
        self.window.run(&mut schedule)?;
        self.teach_guide()
    }

    /// Gives the guide the particles' moments.
    fn teach_guide(&mut self) -> Result<(), GraphError> {
        let Some(guide) = &mut self.guide else { return Ok(()) };
        for (own, theirs) in self.agents.iter().zip(&guide.agents) {
            let Some(belief) = self.window.belief(*own) else { continue };
            let (gaussian, _) = belief.to_gaussian().map_err(invalid)?;
            let belief = AnyMessage::from_gaussian(&self.space, gaussian).map_err(invalid)?;
            guide.window.set_belief(*theirs, belief)?;
        }
        Ok(())
    }

    /// Adds a slice's variables and factors, and leaves them unheard.
    fn extend(&mut self, slice: &Slice) -> Result<(), GraphError> {
        let Self { window, plan, motion, noise, anchors, space, agents, .. } = self;
        window.begin(slice.time)?;
        for (agent, state) in agents.iter_mut().enumerate() {
            let next = window.variable(format!("agent {} at {} s", agent + 1, slice.time), space.clone())?;
            let transition: AnyFactor = Box::new(Model(Transition::new(motion.clone())));
            // The state left behind keeps its belief's form: a conversion belongs to the prediction, which reports it.
            window.factor(PREDICTION, transition, &[(*state, carried(plan)), (next, plan.prediction)])?;
            *state = next;
        }
        for range in &slice.anchor_ranges {
            let at = anchors[range.anchor];
            let model =
                AnchorRange::new(range.measured, at, DIMENSION, POSITION, noise.clone()).map_err(invalid)?;
            let factor: AnyFactor = Box::new(Model(ResidualModel(model)));
            window.factor(ANCHOR, factor, &[(agents[range.agent], plan.anchor)])?;
        }
        if plan.neighbours == Neighbours::Ignored {
            return Ok(());
        }
        for range in &slice.ranges {
            let factor: AnyFactor = if plan.neighbours == Neighbours::PlugIn {
                Box::new(PlugInRange::new(range.measured, noise.clone()))
            } else {
                let model = Range::new(range.measured, [DIMENSION; 2], [POSITION; 2], noise.clone())
                    .map_err(invalid)?;
                Box::new(Model(ResidualModel(model)))
            };
            let ends = range.agents.map(|agent| (agents[agent], plan.range));
            window.factor(RANGE, factor, &ends)?;
        }
        Ok(())
    }

    /// Per agent, the product of the last slice's messages from ranges: what is known besides the prediction.
    fn evidence(&self) -> Result<Vec<DynamicGaussian>, GraphError> {
        let mut evidence = vec![DynamicGaussian::flat(DIMENSION); self.agents.len()];
        for (_, variable, message) in self.window.messages().filter(|(kind, ..)| *kind != PREDICTION) {
            // Agents' variables are created in order, so their handles are sorted.
            if let Ok(agent) = self.agents.binary_search(&variable) {
                let (gaussian, _) = message.to_gaussian().map_err(invalid)?;
                evidence[agent] = evidence[agent].times(&gaussian).map_err(invalid)?;
            }
        }
        Ok(evidence)
    }

    /// Number of agents.
    pub fn agents(&self) -> usize {
        self.agents.len()
    }

    /// The belief of an agent at the last slice; none before the first, or of an unknown agent.
    pub fn belief(&self, agent: usize) -> Option<&AnyMessage> {
        self.window.belief(*self.agents.get(agent)?)
    }

    /// The messages of the last slice with their kind of edge.
    pub(super) fn messages(&self) -> impl Iterator<Item = (&str, &AnyMessage)> {
        self.window.messages().map(|(kind, _, message)| (kind, message))
    }

    /// Adds a slice and hands its graph, unheard, to `read`.
    pub(super) fn describe<T>(
        mut self,
        slice: &Slice,
        read: impl FnOnce(&FactorGraph<AnyMessage, &AnyFactor>) -> T,
    ) -> Result<T, GraphError> {
        self.extend(slice)?;
        Ok(read(&self.window.graph()?))
    }
}

/// The form of an agent's belief: the richest of its edges'.
fn carried(plan: &Plan) -> AnyForm {
    AnyMessage::belief_form([&plan.prediction, &plan.range, &plan.anchor].into_iter())
}

/// What an agent knows of its start.
fn start(space: &Space, mean: &State, variances: &State) -> Result<AnyMessage, MessageError> {
    let mut covariance = [0.0; DIMENSION * DIMENSION];
    for (index, variance) in variances.iter().enumerate() {
        covariance[index * DIMENSION + index] = *variance;
    }
    AnyMessage::gaussian(space, mean, &covariance)
}

pub(super) fn invalid(error: MessageError) -> GraphError {
    GraphError::Schedule(error.to_string())
}
