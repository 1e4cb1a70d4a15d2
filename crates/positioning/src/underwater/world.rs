//! The nodes' true motion and clocks, and what is heard.
//!
//! A state is `[x, vx, y, vy, z, vz, β, α]`, the clock in metres of sound at the time of the state: see
//! [`PseudoRange`].

use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use sumprod_graph::{FastStream, MessageError, Purpose, Stream};
use sumprod_models::library::{ConstantVelocity, NodePseudoRange, PseudoRange, RoundTrip};
use sumprod_models::{Motion, Noise, Residual};

use super::settings::{Layout, WorldSettings};
use crate::PositioningError;

/// Coordinates of a state.
pub const DIMENSION: usize = 8;
/// A state.
pub type State = [f64; DIMENSION];

/// What a standing node hears of an anchor before it moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Beacon {
    /// Index of the anchor.
    pub anchor: usize,
    /// When it was sent (s).
    pub time: f64,
    /// What the node's clock read then, less that time, in metres.
    pub pseudo_range: f64,
}

/// What comes of an anchor's emission in a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Emission {
    /// Index of the anchor.
    pub anchor: usize,
    /// When it was sent (s).
    pub time: f64,
    /// What the node's clock read when it heard it, less that time, in metres.
    pub pseudo_range: f64,
    /// How far sound went to the node and, after its reply, back (m).
    pub round_trip: f64,
}

/// A node that another one hears.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hearing {
    /// Index of the node that speaks.
    pub from: usize,
    /// What the hearer's clock read less what the speaker's did, in metres.
    pub pseudo_range: f64,
}

/// One frame of one node.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// The emissions in order of time.
    pub emissions: Vec<Emission>,
    /// The nodes heard at the last emission.
    pub hearings: Vec<Hearing>,
    /// Time of the last emission (s).
    pub time: f64,
    /// The state then.
    pub truth: State,
}

/// One node's run.
#[derive(Clone, Debug, PartialEq)]
pub struct NodeDraw {
    /// The state when it begins to move.
    pub start: State,
    /// Beacons heard before.
    pub beacons: Vec<Beacon>,
    /// Stamps of an exchange with the first anchor at the start (s since then): the node's clock when it asks, the
    /// anchor's when it hears and when it replies, the node's when it hears that.
    pub exchange: [f64; 4],
    /// Frames in order.
    pub frames: Vec<Frame>,
}

/// One run of the world.
#[derive(Clone, Debug, PartialEq)]
pub struct Draw {
    /// Places of the anchors (m).
    pub anchors: Vec<[f64; 3]>,
    /// The nodes.
    pub nodes: Vec<NodeDraw>,
}

/// What a node's streams are drawn for; their number is added to eight times the node's.
#[derive(Clone, Copy)]
enum Draws {
    Start,
    Motion,
    Beacons,
    PseudoRanges,
    RoundTrips,
    Exchange,
    Hearings,
}

/// The stream of the anchors' places.
const ANCHORS: u64 = u64::MAX;

struct Simulation<'a> {
    settings: &'a WorldSettings,
    anchors: Vec<[f64; 3]>,
    noise: Noise,
    seed: u64,
    run: u32,
}

/// Draws a run. The same seed and run have the same draws whatever the epoch, the slots and the motion in flight.
///
/// # Errors
/// [`PositioningError::Setting`] where a variance makes no noise.
pub fn simulate(settings: &WorldSettings, seed: u64, run: u32) -> Result<Draw, PositioningError> {
    let noise = Noise::isotropic(1, settings.range_variance).map_err(|error| {
        PositioningError::setting("world.range_variance", format!("is unusable: {error}"))
    })?;
    let mut random = Stream::new(seed, u64::from(run), Purpose::World, ANCHORS).fast();
    let anchors = match settings.anchors {
        Layout::Cube => settings.corners()[..settings.anchor_count as usize].to_vec(),
        Layout::Random => (0..settings.anchor_count).map(|_| anywhere(settings.size, &mut random)).collect(),
    };
    let simulation = Simulation { settings, anchors, noise, seed, run };
    let wrong =
        |error: MessageError| PositioningError::setting("world", format!("cannot be simulated: {error}"));
    let nodes: Result<Vec<NodeDraw>, _> =
        (0..settings.nodes).map(|node| simulation.node(node).map_err(wrong)).collect();
    let mut draw = Draw { nodes: nodes?, anchors: Vec::new() };
    simulation.hearings(&mut draw.nodes).map_err(wrong)?;
    draw.anchors = simulation.anchors;
    Ok(draw)
}

impl Simulation<'_> {
    fn stream(&self, node: u32, what: Draws) -> FastStream {
        let entity = 8 * u64::from(node) + what as u64;
        Stream::new(self.seed, u64::from(self.run), Purpose::World, entity).fast()
    }

    fn error(&self, random: &mut FastStream) -> f64 {
        self.settings.range_variance.sqrt() * normal(random)
    }

    /// What a clock reads, without noise, when a node in this state hears an anchor.
    fn heard(&self, anchor: usize, state: &State, still: bool) -> Result<f64, MessageError> {
        let factor =
            PseudoRange::new(0.0, self.anchors[anchor], self.settings.sound_speed, self.noise.clone())?;
        Ok(value(&if still { factor.still() } else { factor }, &[state]))
    }

    fn node(&self, node: u32) -> Result<NodeDraw, MessageError> {
        let WorldSettings { sound_speed, velocity, epoch_s, .. } = *self.settings;
        let place = anywhere(self.settings.size, &mut self.stream(node, Draws::Start));
        let rate = 1e-6 * self.settings.clock_skew_ppm * sound_speed;
        let offset = sound_speed * self.settings.clock_offset_s + rate * epoch_s;
        let [[x, y, z], [vx, vy, vz]] = [place, velocity];
        let start = [x, vx, y, vy, z, vz, offset, rate];
        Ok(NodeDraw {
            start,
            beacons: self.beacons(node, &start)?,
            exchange: self.exchange(node, &start)?,
            frames: self.frames(node, &start)?,
        })
    }

    /// Beacons to the node that stands at its start.
    fn beacons(&self, node: u32, start: &State) -> Result<Vec<Beacon>, MessageError> {
        let mut random = self.stream(node, Draws::Beacons);
        let count = self.settings.beacons;
        let mut beacons = Vec::with_capacity(count as usize * self.anchors.len());
        for anchor in 0..self.anchors.len() {
            for k in 0..count {
                let age = -self.settings.rest_s - f64::from(count - 1 - k) * self.settings.beacon_interval;
                let mut then = *start;
                then[6] += age * start[7];
                let pseudo_range = self.heard(anchor, &then, true)? + self.error(&mut random);
                beacons.push(Beacon { anchor, time: self.settings.epoch_s + age, pseudo_range });
            }
        }
        Ok(beacons)
    }

    fn exchange(&self, node: u32, start: &State) -> Result<[f64; 4], MessageError> {
        let mut random = self.stream(node, Draws::Exchange);
        let c = self.settings.sound_speed;
        let silent = [start[0], 0.0, start[2], 0.0, start[4], 0.0, 0.0, 0.0];
        let reaches = self.heard(0, &silent, true)? / c;
        let replies = reaches + self.settings.sync_reply_delay_s;
        let then = after(start, replies);
        let hears = replies + self.heard(0, &then, !self.settings.motion_in_flight)? / c;
        let noise = [self.error(&mut random), self.error(&mut random)];
        let read = reaches + noise[0] / c;
        Ok([start[6] / c, read, read + self.settings.sync_reply_delay_s, hears + noise[1] / c])
    }

    fn frames(&self, node: u32, start: &State) -> Result<Vec<Frame>, MessageError> {
        let WorldSettings { slot_s, epoch_s, .. } = *self.settings;
        let mut random = self.stream(node, Draws::Motion);
        let (mut heard, mut trips) =
            (self.stream(node, Draws::PseudoRanges), self.stream(node, Draws::RoundTrips));
        let interval = self.settings.frame_interval();
        let gap = (self.anchors.len() - 1) as f64 * slot_s;
        let densities = self.settings.densities();
        let long = ConstantVelocity::white_accelerations(interval - gap, &densities)?;
        let first = ConstantVelocity::white_accelerations(interval, &densities)?;
        let short = if slot_s > 0.0 {
            Some(ConstantVelocity::white_accelerations(slot_s, &densities)?)
        } else {
            None
        };
        let mut state = *start;
        let mut frames = Vec::with_capacity(self.settings.steps as usize);
        for step in 1..=self.settings.steps {
            let begin = f64::from(step) * interval;
            let mut emissions = Vec::with_capacity(self.anchors.len());
            for (anchor, &place) in self.anchors.iter().enumerate() {
                let motion = match anchor {
                    0 if step == 1 => Some(&first),
                    0 => Some(&long),
                    _ => short.as_ref(),
                };
                if let Some(motion) = motion {
                    state = moved(motion, &state, &mut random);
                }
                let still = !self.settings.motion_in_flight;
                let pseudo_range = self.heard(anchor, &state, still)? + self.error(&mut heard);
                let trip = round_trip(self.settings, place, DIMENSION, 0.0, self.noise.clone())?;
                let path = value(&trip, &[&state]) + self.error(&mut trips) + self.error(&mut trips);
                let time = epoch_s + (begin + anchor as f64 * slot_s);
                emissions.push(Emission { anchor, time, pseudo_range, round_trip: path });
            }
            let time = epoch_s + (begin + gap);
            frames.push(Frame { emissions, hearings: Vec::new(), time, truth: state });
        }
        Ok(frames)
    }

    /// Each node hears those that come after it, around the circle of all.
    fn hearings(&self, nodes: &mut [NodeDraw]) -> Result<(), MessageError> {
        let factor = NodePseudoRange::new(0.0, self.settings.sound_speed, self.noise.clone())?;
        let count = nodes.len();
        for hearer in 0..count {
            let mut random = self.stream(hearer as u32, Draws::Hearings);
            for step in 0..nodes[hearer].frames.len() {
                for next in 1..=self.settings.heard_nodes as usize {
                    let from = (hearer + next) % count;
                    let states = [&nodes[from].frames[step].truth[..], &nodes[hearer].frames[step].truth[..]];
                    let pseudo_range = value(&factor, &states) + self.error(&mut random);
                    nodes[hearer].frames[step].hearings.push(Hearing { from, pseudo_range });
                }
            }
        }
        Ok(())
    }
}

/// The factor of a round trip z (m) in this world.
///
/// # Errors
/// Where a number is not finite.
pub fn round_trip(
    settings: &WorldSettings,
    anchor: [f64; 3],
    dimension: usize,
    measured: f64,
    noise: Noise,
) -> Result<RoundTrip, MessageError> {
    let (speed, delay) = (settings.sound_speed, settings.reply_delay_s);
    let trip = RoundTrip::new(measured, anchor, speed, delay, dimension, noise)?;
    Ok(if settings.motion_in_flight { trip } else { trip.still_outward() })
}

fn value<R: Residual>(factor: &R, states: &[&[f64]]) -> f64 {
    let mut out = [0.0];
    factor.residual(states, &mut out);
    out[0]
}

/// A state moved on without noise.
fn after(state: &State, time: f64) -> State {
    std::array::from_fn(|k| if k.is_multiple_of(2) { state[k] + time * state[k + 1] } else { state[k] })
}

fn moved(motion: &ConstantVelocity, state: &State, random: &mut FastStream) -> State {
    let mut next = [0.0; DIMENSION];
    motion.step(state, &mut next);
    let noise = motion.noise(state);
    let draws: Vec<f64> = (0..noise.sources()).map(|_| normal(random)).collect();
    for (next, row) in next.iter_mut().zip(noise.factor().chunks_exact(draws.len())) {
        *next += row.iter().zip(&draws).map(|(entry, draw)| entry * draw).sum::<f64>();
    }
    next
}

fn anywhere(size: f64, random: &mut FastStream) -> [f64; 3] {
    std::array::from_fn(|_| size * random.random::<f64>())
}

fn normal(random: &mut FastStream) -> f64 {
    StandardNormal.sample(random)
}
