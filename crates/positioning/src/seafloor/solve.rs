//! The graph of a station's pings, and its minimum.

use sumprod_exact::{ExactError, Kernel, Problem, SolveOptions};
use sumprod_graph::{FactorGraph, Space, VariableId};
use sumprod_messages::{DynamicGaussian, Moments};
use sumprod_models::library::{Prior, TravelTime};
use sumprod_models::{AddModel, Noise, Residual};

use super::WorldSettings;
use super::frame::Frame;
use super::recording::Recording;
use crate::PositioningError;
use crate::error::unsolvable;

/// Kind of the factors of pings.
pub const PING: &str = "ping";
/// Kind of the priors.
pub const PRIOR: &str = "prior";

/// A variance (m²/s²) that holds the speed of sound where it is given.
const HELD: f64 = 1e-8;

/// The position of the instrument and the speed of sound, as variables with priors, and a factor a ping.
pub struct Network {
    /// The graph.
    pub graph: FactorGraph<DynamicGaussian>,
    position: VariableId,
    sound_speed: VariableId,
    start: [f64; 4],
    pings: Vec<TravelTime>,
}

/// What the pings say.
#[derive(Clone, Debug, PartialEq)]
pub struct Found {
    /// East, north and up of the drop point (m) and the speed of sound (m/s), with their covariance.
    pub state: Moments,
    /// Residuals of the pings: predicted less measured travel time (s).
    pub residuals: Vec<f64>,
    /// Iterations of the solve.
    pub iterations: usize,
}

impl Network {
    /// The graph of a recording.
    ///
    /// # Errors
    /// [`PositioningError::Setting`] where a variance is none, [`PositioningError::Data`] where a ping makes no factor.
    pub fn new(recording: &Recording, world: &WorldSettings) -> Result<Self, PositioningError> {
        let frame = Frame::new(recording.drop_point);
        let mut graph = FactorGraph::new();
        let build = |error: sumprod_graph::GraphError| unsolvable(ExactError::Graph(error));
        let position = graph.variable("position", Space::real(3)).map_err(build)?;
        let sound_speed = graph.variable("sound speed", Space::real(1)).map_err(build)?;
        let noise = |key: &str, variances: &[f64]| {
            Noise::diagonal(variances).map_err(|error| {
                PositioningError::setting(format!("world.{key}"), format!("is unusable: {error}"))
            })
        };
        let (speed, variance) = match world.fixed_sound_speed {
            Some(speed) => (speed, HELD),
            None => (world.sound_speed, world.sound_speed_variance),
        };
        let start = [0.0, 0.0, -recording.depth, speed];
        let wide = world.drop_variance;
        for (variable, mean, noise) in [
            (position, &start[..3], noise("drop_variance", &[wide, wide, world.depth_variance])?),
            (sound_speed, &start[3..], noise("sound_speed_variance", &[variance])?),
        ] {
            let prior = Prior::new(&Space::real(mean.len()), mean, noise);
            let prior = prior.map_err(|error| PositioningError::setting("world", error.to_string()))?;
            graph.add(PRIOR, prior, &[variable]).map_err(build)?;
        }
        let timing = noise("time_variance", &[world.time_variance])?;
        let mut pings = Vec::with_capacity(recording.pings.len());
        for ping in &recording.pings {
            let ship = frame.local(ping.place);
            let factor = TravelTime::new(ping.travel_time, ship, ship, world.turn_around_s, timing.clone());
            let factor = factor.map_err(|error| {
                PositioningError::data(&recording.path, Some(ping.line), error.to_string())
            })?;
            graph.add(PING, factor.clone(), &[position, sound_speed]).map_err(build)?;
            pings.push(factor);
        }
        Ok(Self { graph, position, sound_speed, start, pings })
    }

    /// The most probable position and speed of sound under a robust kernel, and the Gaussian about them.
    ///
    /// # Errors
    /// [`PositioningError::Unsolvable`] where the pings leave a direction free, or no minimum is found.
    pub fn solve(&self, kernel: Kernel) -> Result<Found, PositioningError> {
        let mut problem = Problem::new(&self.graph).map_err(unsolvable)?;
        problem.set_kernel(PING, kernel);
        let mut start = problem.start();
        start.set(self.position, &self.start[..3]).map_err(unsolvable)?;
        start.set(self.sound_speed, &self.start[3..]).map_err(unsolvable)?;
        let mut solution = problem.solve(start, &SolveOptions::default()).map_err(unsolvable)?;
        let state = solution.joint(&[self.position, self.sound_speed]).map_err(unsolvable)?;
        let (position, speed) = state.mean.split_at(3);
        let residual = |ping: &TravelTime| {
            let mut out = [0.0];
            ping.residual(&[position, speed], &mut out);
            out[0]
        };
        let residuals = self.pings.iter().map(residual).collect();
        Ok(Found { residuals, iterations: solution.report().iterations, state })
    }
}
