//! The simulated network: agents that drift through the plane, anchors, and ranges among those within reach.
//!
//! State `[x, vx, y, vy]`, x' = F x + G w, w ~ N(0, q I), G = [T²/2; T] per axis; ranges z = |p_i - p_j| + v,
//! v ~ N(0, r), one draw per unordered pair and slice. Every agent knows its start as truth + N(0, P).

use rand_distr::{Distribution, StandardNormal, Uniform};
use serde::{Deserialize, Serialize};
use sumprod_graph::{Purpose, Stream};

use super::links::Reach;
use crate::error::PositioningError;
use crate::form::at_least_one;

/// An agent's state `[x, vx, y, vy]` (m, m/s).
pub type State = [f64; 4];

/// The keys `[world]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct World {
    /// Number of agents.
    pub agents: usize,
    /// Number of time slices with measurements.
    pub steps: u32,
    /// Time from slice to slice (s).
    #[serde(default = "one")]
    pub interval: f64,
    /// Where agents start, uniformly: `[[west, east], [south, north]]` (m).
    pub area: [[f64; 2]; 2],
    /// Variance of each axis of the velocity at the start (m²/s²).
    pub speed_variance: f64,
    /// Variance of each axis of the acceleration, held over an interval (m²/s⁴).
    pub process_variance: f64,
    /// Positions of the anchors (m).
    pub anchors: Vec<[f64; 2]>,
    /// Distance up to which nodes measure each other (m); without it all do.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub radius: Option<f64>,
    /// Variance of a range (m²).
    pub range_variance: f64,
    /// Whether each agent knows roughly where it starts. If not, the measurements alone must fix the network, and
    /// estimates start from the mean and spread of the area.
    #[serde(default = "yes")]
    pub prior: bool,
    /// Variance of each axis of the known start (m²).
    #[serde(default = "known_position")]
    pub prior_position_variance: f64,
    /// Variance of each axis of the known velocity at the start (m²/s²).
    #[serde(default = "one")]
    pub prior_velocity_variance: f64,
}

fn one() -> f64 {
    1.0
}

fn yes() -> bool {
    true
}

fn known_position() -> f64 {
    25.0
}

/// A range between two agents.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ranging {
    /// The agents, the smaller index first.
    pub agents: [usize; 2],
    /// The measured range (m).
    pub measured: f64,
}

/// A range from an agent to an anchor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AnchorRanging {
    /// The agent.
    pub agent: usize,
    /// The anchor.
    pub anchor: usize,
    /// The measured range (m).
    pub measured: f64,
}

/// The measurements of one slice, in the order of the agents.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Slice {
    /// Time (s).
    pub time: f64,
    /// Ranges among agents.
    pub ranges: Vec<Ranging>,
    /// Ranges to anchors.
    pub anchor_ranges: Vec<AnchorRanging>,
}

/// One draw of the world.
#[derive(Clone, Debug, PartialEq)]
pub struct Draw {
    /// True states: `truth[k][agent]`, k = 0 the start and k ≥ 1 slice k - 1.
    pub truth: Vec<Vec<State>>,
    /// Mean of what each agent knows of its start.
    pub start: Vec<State>,
    /// Variances of what each agent knows of its start, per component.
    pub start_variances: State,
    /// The measurements.
    pub slices: Vec<Slice>,
}

/// Entities of the streams; agents' and pairs' streams are derived from these.
const MOVES: u64 = 0;
const KNOWS: u64 = 1;
const HEARS: u64 = 2;
const HEARS_ANCHORS: u64 = 3;

impl World {
    /// A network of any size as dense as the built-in `coop-c100`: 100 agents and 16 anchors on 300 m by 300 m, radius
    /// 50 m. Anchors stand on a lattice of 100 m.
    pub fn at_density(agents: usize, steps: u32) -> Self {
        let side = 30.0 * (agents as f64).sqrt();
        let lattice: Vec<f64> = (0..=(side / 100.0).round() as u32).map(|k| 100.0 * f64::from(k)).collect();
        let anchors = lattice.iter().flat_map(|&x| lattice.iter().map(move |&y| [x, y])).collect();
        Self {
            agents,
            steps,
            interval: 1.0,
            area: [[0.0, side]; 2],
            speed_variance: 1.0,
            process_variance: 0.5,
            anchors,
            radius: Some(50.0),
            range_variance: 1.0,
            prior: true,
            prior_position_variance: 25.0,
            prior_velocity_variance: 1.0,
        }
    }

    /// Checks every value.
    ///
    /// # Errors
    /// [`PositioningError::Setting`] naming the key.
    pub fn validate(&self) -> Result<(), PositioningError> {
        at_least_one("world.agents", self.agents, "agent")?;
        at_least_one("world.steps", self.steps as usize, "step")?;
        for (key, value, unit) in [
            ("interval", self.interval, "s; an interval"),
            ("process_variance", self.process_variance, "m²/s⁴; a variance"),
            ("range_variance", self.range_variance, "m²; a variance"),
            ("prior_position_variance", self.prior_position_variance, "m²; a variance"),
            ("prior_velocity_variance", self.prior_velocity_variance, "m²/s²; a variance"),
            ("radius", self.radius.unwrap_or(1.0), "m; a radius"),
        ] {
            if !(value > 0.0 && value.is_finite()) {
                let problem = format!("is {value} {unit} must be positive and finite");
                return Err(PositioningError::setting(format!("world.{key}"), problem));
            }
        }
        if !(self.speed_variance >= 0.0 && self.speed_variance.is_finite()) {
            let problem =
                format!("is {} m²/s²; a variance must be finite and not negative", self.speed_variance);
            return Err(PositioningError::setting("world.speed_variance", problem));
        }
        for (axis, [low, high]) in self.area.iter().enumerate() {
            if !(low < high && low.is_finite() && high.is_finite()) {
                let problem = format!(
                    "spans {low} m to {high} m along axis {axis}; write [[west, east], [south, north]], each \
                     pair ascending and finite"
                );
                return Err(PositioningError::setting("world.area", problem));
            }
        }
        if let Some(anchor) = self.anchors.iter().find(|anchor| anchor.iter().any(|x| !x.is_finite())) {
            let problem = format!("holds [{}, {}] m; coordinates must be finite", anchor[0], anchor[1]);
            return Err(PositioningError::setting("world.anchors", problem));
        }
        Ok(())
    }

    /// Draws run `run`: near-linear time in the number of agents where a radius bounds the links.
    ///
    /// # Errors
    /// As [`World::validate`] for an area without extent.
    pub fn draw(&self, seed: u64, run: u32) -> Result<Draw, PositioningError> {
        let stream = |entity: u64| Stream::new(seed, u64::from(run), Purpose::World, entity);
        let truth = self.trajectories(&stream(MOVES))?;
        let start_variances = self.start_variances();
        let knows = stream(KNOWS);
        let start = truth[0].iter().enumerate().map(|(agent, state)| {
            let mut random = knows.derive(agent as u64);
            let mut mean = *state;
            for (mean, variance) in mean.iter_mut().zip(start_variances) {
                *mean += variance.sqrt() * normal(&mut random);
            }
            mean
        });
        let start = if self.prior { start.collect() } else { vec![self.centre(); self.agents] };
        let anchors = Reach::new(&self.anchors, self.radius);
        let sources = [stream(HEARS), stream(HEARS_ANCHORS)];
        let slices =
            truth[1..].iter().enumerate().map(|(k, states)| self.measure(k, states, &anchors, &sources));
        Ok(Draw { start, start_variances, slices: slices.collect(), truth })
    }

    fn trajectories(&self, stream: &Stream) -> Result<Vec<Vec<State>>, PositioningError> {
        let uniform = |[low, high]: [f64; 2]| {
            Uniform::new(low, high)
                .map_err(|error| PositioningError::setting("world.area", format!("cannot be used: {error}")))
        };
        let area = [uniform(self.area[0])?, uniform(self.area[1])?];
        let mut truth = vec![Vec::with_capacity(self.agents); self.steps as usize + 1];
        let (t, held) = (self.interval, self.process_variance.sqrt());
        for agent in 0..self.agents {
            let mut random = stream.derive(agent as u64);
            let mut state = [0.0; 4];
            for axis in 0..2 {
                state[2 * axis] = area[axis].sample(&mut random);
                state[2 * axis + 1] = self.speed_variance.sqrt() * normal(&mut random);
            }
            truth[0].push(state);
            for states in &mut truth[1..] {
                for axis in state.chunks_exact_mut(2) {
                    let acceleration = held * normal(&mut random);
                    axis[0] += t * axis[1] + 0.5 * t * t * acceleration;
                    axis[1] += t * acceleration;
                }
                states.push(state);
            }
        }
        Ok(truth)
    }

    fn measure(
        &self,
        k: usize,
        states: &[State],
        anchors: &Reach<'_>,
        [pairs, to_anchors]: &[Stream; 2],
    ) -> Slice {
        let positions: Vec<[f64; 2]> = states.iter().map(|state| [state[0], state[2]]).collect();
        let others = Reach::new(&positions, self.radius);
        let deviation = self.range_variance.sqrt();
        let noisy = |distance: f64, stream: &Stream, own: usize, other: usize| {
            let mut random = stream.derive(own as u64).derive(other as u64).derive(k as u64);
            distance + deviation * normal(&mut random)
        };
        let (mut ranges, mut anchor_ranges) = (Vec::new(), Vec::new());
        for (agent, &position) in positions.iter().enumerate() {
            for (other, distance) in others.within(position).filter(|&(other, _)| other > agent) {
                let measured = noisy(distance, pairs, agent, other);
                ranges.push(Ranging { agents: [agent, other], measured });
            }
            for (anchor, distance) in anchors.within(position) {
                let measured = noisy(distance, to_anchors, agent, anchor);
                anchor_ranges.push(AnchorRanging { agent, anchor, measured });
            }
        }
        Slice { time: (k + 1) as f64 * self.interval, ranges, anchor_ranges }
    }

    /// Mean of the state at the start, over all agents.
    fn centre(&self) -> State {
        let [x, y] = self.area.map(|[low, high]| 0.5 * (low + high));
        [x, 0.0, y, 0.0]
    }

    /// Variances of what an agent knows of its start; without a prior, of the area (width²/12) and the velocity.
    fn start_variances(&self) -> State {
        if self.prior {
            let (position, velocity) = (self.prior_position_variance, self.prior_velocity_variance);
            return [position, velocity, position, velocity];
        }
        let [x, y] = self.area.map(|[low, high]| (high - low).powi(2) / 12.0);
        let velocity =
            if self.speed_variance > 0.0 { self.speed_variance } else { self.prior_velocity_variance };
        [x, velocity, y, velocity]
    }
}

fn normal(random: &mut Stream) -> f64 {
    StandardNormal.sample(random)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_draw_depends_on_seed_and_run_alone() {
        let world = World::at_density(30, 4);
        let draw = world.draw(1, 3).unwrap();
        assert_eq!(draw, world.draw(1, 3).unwrap());
        assert_ne!(draw.truth, world.draw(1, 4).unwrap().truth);
        assert_ne!(draw.truth, world.draw(2, 3).unwrap().truth);
        assert_eq!((draw.truth.len(), draw.slices.len()), (5, 4));
    }

    #[test]
    fn an_agent_moves_as_it_would_among_fewer() {
        let world = World::at_density(30, 4);
        let fewer = World { agents: 7, ..world.clone() };
        let (all, some) = (world.draw(5, 0).unwrap(), fewer.draw(5, 0).unwrap());
        for (all, some) in all.truth.iter().zip(&some.truth) {
            assert_eq!(all[..7], some[..]);
        }
        let among: Vec<_> = all.slices[2].ranges.iter().filter(|range| range.agents[1] < 7).collect();
        assert_eq!(among, some.slices[2].ranges.iter().collect::<Vec<_>>());
    }

    #[test]
    fn measurements_and_priors_have_their_variances() {
        // 400 agents, 4 components: the mean square of 1600 standard normals is within 0.15 of one, 4 deviations.
        let world = World { prior_position_variance: 9.0, ..World::at_density(400, 2) };
        let draw = world.draw(11, 0).unwrap();
        let scaled = draw.start.iter().zip(&draw.truth[0]).flat_map(|(mean, truth)| {
            (0..4).map(|c| (mean[c] - truth[c]).powi(2) / draw.start_variances[c]).collect::<Vec<_>>()
        });
        assert!((scaled.sum::<f64>() / 1600.0 - 1.0).abs() < 0.15);
        let ranges = &draw.slices[1].ranges;
        let errors = ranges.iter().map(|range| {
            let [a, b] = range.agents.map(|agent| draw.truth[2][agent]);
            let distance = (a[0] - b[0]).hypot(a[2] - b[2]);
            assert!(distance <= 50.0);
            (range.measured - distance).powi(2)
        });
        let mean = errors.sum::<f64>() / ranges.len() as f64;
        // 4 deviations of a mean of n squared normals: 4 √(2 / n).
        assert!((mean - 1.0).abs() < 4.0 * (2.0 / ranges.len() as f64).sqrt(), "{mean} of {}", ranges.len());
    }

    #[test]
    fn wrong_values_are_refused_by_their_key() {
        let good = World::at_density(10, 3);
        good.validate().unwrap();
        let cases = [
            (World { agents: 0, ..good.clone() }, "`world.agents` is 0"),
            (World { steps: 0, ..good.clone() }, "`world.steps` is 0"),
            (World { range_variance: -1.0, ..good.clone() }, "`world.range_variance` is -1 m²"),
            (World { process_variance: f64::NAN, ..good.clone() }, "`world.process_variance` is NaN"),
            (World { speed_variance: -9.0, ..good.clone() }, "`world.speed_variance` is -9"),
            (World { radius: Some(0.0), ..good.clone() }, "`world.radius` is 0 m"),
            (World { area: [[0.0, 1.0], [5.0, 5.0]], ..good.clone() }, "`world.area` spans 5 m to 5 m"),
            (World { anchors: vec![[0.0, f64::INFINITY]], ..good.clone() }, "`world.anchors` holds [0, inf]"),
        ];
        for (world, part) in cases {
            let message = world.validate().unwrap_err().to_string();
            assert!(message.contains(part), "{message}");
        }
    }
}
