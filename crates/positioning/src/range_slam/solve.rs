//! One step's messages: a trajectory, its odometry, and one clique for each landmark, which is a tree.

use rand::RngExt;
use std::f64::consts::TAU;
use sumprod_graph::schedule::ForwardBackward;
use sumprod_graph::{
    Engine, FactorGraph, GraphError, MessageError, Options, Purpose, Space, Stream, VariableId,
};
use sumprod_messages::{AnyForm, AnyMessage, DynamicGaussian, Mixture};
use sumprod_models::{AddModel, Model};

use super::steps::{Growing, POSE, Seen};
use crate::PositioningError;

/// Names of the factors, which are the kinds of edges as well.
pub(super) const ODOMETRY: &str = "odometry";
pub(super) const RANGE: &str = "range";

/// Forward-backward passes at most; each linearises about the last one's beliefs.
const PASSES: usize = 10;
/// Change of a message (standard deviations) below which the passes end: what draws are weighed by is exact anyway.
const TOLERANCE: f64 = 1e-3;
/// Variance of the trajectory's start, which only gives the first pass a point to linearise at.
const START_VARIANCE: f64 = 1.0;

/// One step as a graph.
pub(super) struct StepGraph {
    pub(super) graph: FactorGraph<AnyMessage>,
    trajectory: VariableId,
    cliques: Vec<VariableId>,
}

/// Beliefs at a step.
pub(super) struct Beliefs {
    /// Over the poses, one after the other.
    pub(super) trajectory: DynamicGaussian,
    /// Over positions and landmark, in the order of the landmarks seen.
    pub(super) cliques: Vec<Mixture>,
}

impl StepGraph {
    /// The graph at `step`, the edges of its ranges in `form`.
    ///
    /// # Errors
    ///
    /// As [`FactorGraph::factor`], and where a factor cannot be made.
    pub(super) fn new(
        growing: &Growing,
        step: usize,
        seen: &[Seen],
        form: AnyForm,
        seed: u64,
    ) -> Result<Self, PositioningError> {
        let cluster = growing.odometry(step)?;
        let names = growing.graph();
        let build = || {
            let mut graph = FactorGraph::<AnyMessage>::new();
            let space = Growing::trajectory_space(step);
            let trajectory = graph.variable("trajectory", space.clone())?;
            let start = growing.start(step);
            graph.set_start(trajectory, around(&space, start, START_VARIANCE)?)?;
            graph.set_belief_form(trajectory, AnyForm::gaussian())?;
            graph.add_cluster(ODOMETRY, cluster, trajectory)?;
            let mut cliques = Vec::with_capacity(seen.len());
            for Seen { landmark, clique } in seen {
                let space = Space::real(clique.dimensions()[1]);
                let name = format!("positions and {}", names.landmarks[*landmark].name);
                let variable = graph.variable(name, space.clone())?;
                if let AnyForm::Gaussian(_) = form {
                    let positions = clique.positions().iter().map(|&coordinate| start[coordinate]);
                    let guess = guess(clique.ring(start), *landmark, seed);
                    let point: Vec<f64> = positions.chain(guess).collect();
                    graph.set_start(variable, around(&space, &point, START_VARIANCE)?)?;
                }
                let factor = graph.factor(RANGE, Box::new(Model(clique.clone())), &[trajectory, variable])?;
                graph.set_edge_form(factor, 0, form)?;
                graph.set_edge_form(factor, 1, form)?;
                cliques.push(variable);
            }
            Ok(Self { graph, trajectory, cliques })
        };
        build().map_err(|error: GraphError| PositioningError::method(RANGE, error))
    }

    /// Runs forward-backward until the linearisation stands.
    ///
    /// # Errors
    ///
    /// Where a message or belief cannot be computed.
    pub(super) fn solve(&self, seed: u64) -> Result<Beliefs, GraphError> {
        let options = Options { seed, tolerance: TOLERANCE, parallel: false, ..Options::default() };
        let mut engine = Engine::new(&self.graph, options)?;
        engine.run(&mut ForwardBackward::iterated(PASSES))?;
        let (trajectory, _) = engine.belief(self.trajectory).to_gaussian().map_err(failed)?;
        let cliques: Result<Vec<Mixture>, MessageError> = self
            .cliques
            .iter()
            .map(|&variable| {
                let belief = engine.belief(variable);
                match belief.mixture() {
                    Some(mixture) => mixture.to_density(),
                    None => Mixture::from_gaussian(self.graph.space(variable), &belief.to_gaussian()?.0),
                }
            })
            .collect();
        Ok(Beliefs { trajectory, cliques: cliques.map_err(failed)? })
    }
}

/// A point of a landmark's shortest ring, in a direction that the seed and the landmark choose.
fn guess(ring: ([f64; 2], f64), landmark: usize, seed: u64) -> [f64; 2] {
    let ([x, y], radius) = ring;
    let mut random = Stream::new(seed, 0, Purpose::User(GUESS), landmark as u64).fast();
    let (sine, cosine) = (TAU * random.random::<f64>()).sin_cos();
    [x + radius * cosine, y + radius * sine]
}

/// Streams of a Gaussian's guesses, and of draws.
const GUESS: u16 = 1;
pub(super) const DRAWS: u16 = 2;

fn around(space: &Space, mean: &[f64], variance: f64) -> Result<AnyMessage, GraphError> {
    let d = mean.len();
    let mut covariance = vec![0.0; d * d];
    (0..d).for_each(|k| covariance[k * (d + 1)] = variance);
    AnyMessage::gaussian(space, mean, &covariance).map_err(failed)
}

fn failed(error: MessageError) -> GraphError {
    GraphError::Schedule(error.to_string())
}

/// Number of coordinates of the trajectory at a step.
pub(super) fn dimension(step: usize) -> usize {
    POSE * (step + 1)
}
