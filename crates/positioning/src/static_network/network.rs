//! The factor graph of one network, and the run on it: lattices until the network has decided, then Gaussians.

use nalgebra::{Matrix2, Vector2};
use sumprod_graph::schedule::Coloured;
use sumprod_graph::{EdgeId, Engine, FactorGraph, GraphError, MessageError, Options, Space, VariableId};
use sumprod_messages::{Gaussian, LatticeForm, LatticeMessage};
use sumprod_models::{LatticeRange, Noise, Silence};

use super::joint::{Joint, Moments, joint};
use super::method::{GAUSSIAN, Method, OWN};
use super::posterior::{Link, Posterior, links, missed};
use super::silence::{Silent, silent};
use super::world::{Draw, World};

/// Kinds of factors, which are their names.
pub(super) const ANCHOR: &str = "anchor";
pub(super) const RANGE: &str = "range";
pub(super) const SILENCE: &str = "silence";

/// The graph of a network, its variables the agents in order.
pub(super) fn graph(
    world: &World,
    draw: &Draw,
    method: &Method,
) -> Result<FactorGraph<LatticeMessage>, GraphError> {
    let mut graph: FactorGraph<LatticeMessage> = FactorGraph::new();
    let plane = Space::real(2);
    let spread = Matrix2::identity() * method.start_variance;
    let mut agents = Vec::with_capacity(draw.start.len());
    for (agent, &start) in draw.start.iter().enumerate() {
        let variable = graph.variable(format!("agent {}", agent + 1), plane.clone())?;
        let prior = Gaussian::from_moments(Vector2::from(start), spread).map_err(invalid)?;
        graph.set_prior(variable, prior.into())?;
        agents.push(variable);
    }
    let form = method.first_form();
    let noise =
        Noise::isotropic(1, world.range_variance).map_err(|error| GraphError::Schedule(error.to_string()))?;
    for range in &draw.anchor_ranges {
        let at = draw.anchors[range.anchor];
        let factor = LatticeRange::to_anchor(range.measured, at, noise.clone()).map_err(invalid)?;
        let factor = graph.factor(ANCHOR, Box::new(factor), &[agents[range.agent]])?;
        graph.set_edge_form(factor, OWN, form)?;
    }
    let mut pairs = Vec::with_capacity(draw.ranges.len());
    for range in &draw.ranges {
        let factor = LatticeRange::between(range.measured, noise.clone()).map_err(invalid)?;
        pairs.push(graph.factor(RANGE, Box::new(factor), &range.agents.map(|agent| agents[agent]))?);
    }
    // Gaussian edges have no use for silence.
    if let Some(missed) = missed(world).filter(|_| form != GAUSSIAN) {
        let Silent { agents: silent_agents, anchors } = silent(draw, world.radius);
        for pair in silent_agents {
            let factor = Silence::between(world.radius, missed).map_err(invalid)?;
            pairs.push(graph.factor(SILENCE, Box::new(factor), &pair.map(|agent| agents[agent]))?);
        }
        for [agent, anchor] in anchors {
            let factor = Silence::to_anchor(world.radius, missed, draw.anchors[anchor]).map_err(invalid)?;
            let factor = graph.factor(SILENCE, Box::new(factor), &[agents[agent]])?;
            graph.set_edge_form(factor, OWN, form)?;
        }
    }
    for factor in pairs {
        graph.set_edge_form(factor, OWN, form)?;
        graph.set_edge_form(factor, 1 - OWN, form)?;
    }
    Ok(graph)
}

fn invalid(error: MessageError) -> GraphError {
    GraphError::Schedule(error.to_string())
}

/// Edges whose family has changed during a run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Changes {
    /// Their number.
    pub(super) edges: usize,
    /// Number of the agents that they lead to.
    pub(super) agents: usize,
}

/// A run of one method on one network.
pub(super) struct Run<'g> {
    engine: Engine<'g, LatticeMessage>,
    agents: Vec<VariableId>,
    /// Whom each agent measures.
    links: Vec<Vec<Link>>,
    anchors: Vec<[f64; 2]>,
    range_variance: f64,
    /// Whether each agent's edges are Gaussian.
    gaussian: Vec<bool>,
    pub(super) changes: Changes,
    pub(super) iterations: usize,
}

impl<'g> Run<'g> {
    /// A run that has not begun.
    pub(super) fn new(
        graph: &'g FactorGraph<LatticeMessage>,
        world: &World,
        draw: &Draw,
        options: Options,
    ) -> Result<Self, GraphError> {
        let agents: Vec<VariableId> = graph.variable_ids().collect();
        let range_variance = world.range_variance;
        let gaussian = vec![false; agents.len()];
        let engine = Engine::new(graph, options)?;
        Ok(Self {
            engine,
            agents,
            links: links(draw),
            anchors: draw.anchors.clone(),
            range_variance,
            gaussian,
            changes: Changes::default(),
            iterations: 0,
        })
    }

    /// The whole of a method.
    pub(super) fn complete(&mut self, method: &Method) -> Result<(), GraphError> {
        if method.first_form() != GAUSSIAN {
            // Whoever hears an anchor gets a ring of its own before anyone listens to agents who know nothing.
            let anchors = self.edges_of(ANCHOR);
            self.advance(Coloured::new().among(anchors).rounds(1))?;
        }
        for (form, rounds) in method.levels() {
            self.hold_all(form)?;
            self.advance(Coloured::new().rounds(rounds))?;
        }
        self.engine.set_damping(method.damping)?;
        let mut silent = vec![false; self.engine.topology().edge_count()];
        self.edges_of(SILENCE).into_iter().for_each(|edge| silent[edge.index()] = true);
        for _ in 0..method.gaussian_rounds {
            // Silence has nothing more to say to those who were Gaussian before.
            let before = self.gaussian.clone();
            self.switch(method.one_mode_deviation)?;
            let topology = self.engine.topology();
            let due = topology
                .edges()
                .filter(|&edge| !silent[edge.index()] || !before[topology.variable_of(edge).index()]);
            let round = Coloured::new().among(due).rounds(1);
            self.advance(round)?;
        }
        Ok(())
    }

    fn advance(&mut self, mut schedule: Coloured) -> Result<(), GraphError> {
        self.iterations += self.engine.run(&mut schedule)?.iterations;
        Ok(())
    }

    fn edges_of(&self, kind: &str) -> Vec<EdgeId> {
        let (graph, topology) = (self.engine.graph(), self.engine.topology());
        let factors = graph.factor_ids().filter(|&factor| graph.factor_kind(factor) == kind);
        factors.flat_map(|factor| topology.edges_of_factor(factor)).collect()
    }

    fn hold_all(&mut self, form: LatticeForm) -> Result<(), GraphError> {
        for agent in 0..self.agents.len() {
            self.hold(agent, form)?;
        }
        Ok(())
    }

    /// Holds everything into an agent in another form; returns the number of its edges.
    fn hold(&mut self, agent: usize, form: LatticeForm) -> Result<usize, GraphError> {
        let variable = self.agents[agent];
        let edges: Vec<EdgeId> = self.engine.topology().edges_of_variable(variable).collect();
        for &edge in &edges {
            self.engine.set_edge_form(edge, form)?;
        }
        self.engine.set_belief_form(variable, form)?;
        Ok(edges.len())
    }

    /// Makes the edges into agents Gaussian whose belief on a lattice is one mode that their ranges alone would keep:
    /// where silence has a part in it, Gaussians would forget it.
    fn switch(&mut self, deviation: f64) -> Result<(), GraphError> {
        let most = deviation * deviation;
        for agent in 0..self.agents.len() {
            if self.gaussian[agent] {
                continue;
            }
            let Some(lattice) = self.belief(agent).lattice() else { continue };
            let (mean, covariance) = lattice.moments();
            if largest_variance(&covariance) <= most && self.linearised_variance(agent, mean) <= most {
                self.gaussian[agent] = true;
                self.changes.edges += self.hold(agent, GAUSSIAN)?;
                self.changes.agents += 1;
            }
        }
        Ok(())
    }

    /// Variance along the worst axis (m²) that an agent's ranges leave, linearised at `mean`.
    fn linearised_variance(&self, agent: usize, mean: Vector2<f64>) -> f64 {
        let mut information = Matrix2::zeros();
        for link in &self.links[agent] {
            let (at, covariance) = match link.node.checked_sub(self.agents.len()) {
                Some(anchor) => (Vector2::from(self.anchors[anchor]), Matrix2::zeros()),
                None => match self.belief(link.node).moments() {
                    Ok(moments) => moments,
                    Err(_) => continue,
                },
            };
            let offset = mean - at;
            let length = offset.norm();
            if length > 0.0 {
                let direction = offset / length;
                let variance = self.range_variance + direction.dot(&(covariance * direction));
                information += direction * direction.transpose() / variance;
            }
        }
        information.try_inverse().map_or(f64::INFINITY, |covariance| largest_variance(&covariance))
    }

    /// An agent's belief.
    pub(super) fn belief(&self, agent: usize) -> &LatticeMessage {
        self.engine.belief(self.agents[agent])
    }

    /// What the joint posterior around the beliefs says of every agent.
    pub(super) fn joint(&self, world: &World, draw: &Draw, method: &Method) -> Result<Joint, MessageError> {
        let beliefs: Vec<Moments> =
            (0..self.agents.len()).map(|agent| self.belief(agent).moments()).collect::<Result<_, _>>()?;
        let place = |agent: usize| match self.belief(agent).lattice() {
            Some(lattice) => lattice.heaviest(),
            None => beliefs[agent].0.into(),
        };
        let places = (0..beliefs.len()).map(place).collect();
        let posterior = Posterior::new(world, draw, method.start_variance, places);
        Ok(joint(posterior, beliefs, method.one_mode_deviation))
    }

    /// Every message with the kind of its factor.
    pub(super) fn messages(&self) -> impl Iterator<Item = (&str, &LatticeMessage)> {
        let (graph, topology) = (self.engine.graph(), self.engine.topology());
        topology
            .edges()
            .map(move |edge| (graph.factor_kind(topology.factor_of(edge)), self.engine.message(edge)))
    }
}

/// Variance along the worst axis (m²): the larger eigenvalue.
fn largest_variance(covariance: &Matrix2<f64>) -> f64 {
    let (half_sum, half_difference) =
        (0.5 * (covariance[(0, 0)] + covariance[(1, 1)]), 0.5 * (covariance[(0, 0)] - covariance[(1, 1)]));
    half_sum + half_difference.hypot(covariance[(0, 1)])
}
