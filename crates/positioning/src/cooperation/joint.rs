//! The centralised filter: all agents' states in one variable, so that nothing that neighbours share is forgotten.

use sumprod_graph::schedule::Sliced;
use sumprod_graph::{Factor, FactorGraph, GraphError, Options, Space, Window, WindowVariable};
use sumprod_messages::{AnyForm, AnyMessage, Moments};
use sumprod_models::library::{AnchorRange, ConstantVelocity, Range};
use sumprod_models::{Block, Cluster, Model, Noise, Transition};

use super::network::{ANCHOR, DIMENSION, POSITION, PREDICTION, RANGE, invalid};
use super::world::{Draw, Slice, World};

type AnyFactor = Box<dyn Factor<AnyMessage>>;

/// An iterated extended Kalman filter over the states of all agents.
///
/// A slice costs O(rounds · n³) for n state components.
pub struct JointFilter {
    window: Window<AnyMessage, AnyFactor>,
    rounds: usize,
    motion: ConstantVelocity,
    noise: Noise,
    anchors: Vec<[f64; 2]>,
    space: Space,
    state: WindowVariable,
}

impl JointFilter {
    /// A filter at the start of a draw that linearises `rounds` times a slice.
    ///
    /// # Errors
    ///
    /// Where the world's variances are not positive.
    pub fn new(world: &World, draw: &Draw, rounds: usize, options: Options) -> Result<Self, GraphError> {
        let n = DIMENSION * draw.start.len();
        let space = Space::real(n);
        let mut covariance = vec![0.0; n * n];
        for index in 0..n {
            covariance[index * n + index] = draw.start_variances[index % DIMENSION];
        }
        let start = AnyMessage::gaussian(&space, draw.start.as_flattened(), &covariance).map_err(invalid)?;
        let mut window = Window::new(1, options)?;
        window.begin(0.0)?;
        let state = window.variable("all agents at the start", space.clone())?;
        window.set_prior(state, start)?;
        // A state of 2 n axes [x, v] is the agents' states one after the other.
        let axes = n / 2;
        Ok(Self {
            window,
            rounds,
            motion: ConstantVelocity::held_acceleration(axes, world.interval, world.process_variance)
                .map_err(invalid)?,
            noise: Noise::isotropic(1, world.range_variance)
                .map_err(|error| GraphError::Schedule(error.to_string()))?,
            anchors: world.anchors.clone(),
            space,
            state,
        })
    }

    /// Predicts to a slice and takes in its measurements.
    ///
    /// # Errors
    ///
    /// As [`Window::run`].
    pub fn step(&mut self, slice: &Slice) -> Result<(), GraphError> {
        self.extend(slice)?;
        self.window.run(&mut Sliced::new(self.rounds))?;
        Ok(())
    }

    fn extend(&mut self, slice: &Slice) -> Result<(), GraphError> {
        let form = AnyForm::gaussian();
        self.window.begin(slice.time)?;
        let next = self.window.variable(format!("all agents at {} s", slice.time), self.space.clone())?;
        let transition: AnyFactor = Box::new(Model(Transition::new(self.motion.clone())));
        self.window.factor(PREDICTION, transition, &[(self.state, form), (next, form)])?;
        self.state = next;
        let block = |agent: usize| Block::new(DIMENSION * agent, DIMENSION);
        let mut cluster = Cluster::new(self.space.dimension());
        for range in &slice.anchor_ranges {
            let at = self.anchors[range.anchor];
            let model = AnchorRange::new(range.measured, at, DIMENSION, POSITION, self.noise.clone())
                .map_err(invalid)?;
            cluster.add(model, &[block(range.agent)]).map_err(invalid)?;
        }
        for range in &slice.ranges {
            let model = Range::new(range.measured, [DIMENSION; 2], [POSITION; 2], self.noise.clone())
                .map_err(invalid)?;
            cluster.add(model, &range.agents.map(block)).map_err(invalid)?;
        }
        let name = if slice.ranges.is_empty() { ANCHOR } else { RANGE };
        self.window.factor(name, Box::new(Model(cluster)), &[(next, form)])
    }

    /// Mean and covariance of the states of all agents, one after the other; none before the first slice. O(n³).
    ///
    /// # Errors
    ///
    /// Where the belief's information is not positive definite.
    pub fn moments(&self) -> Result<Option<Moments>, GraphError> {
        self.window.belief(self.state).map(|belief| belief.moments().map_err(invalid)).transpose()
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
