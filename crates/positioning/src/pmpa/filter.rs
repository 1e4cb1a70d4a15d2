//! Every method of the paper as one chain of scans: a window of one slice under a sliced schedule.
//!
//! Prediction, the target's measurement of itself and the neighbours' are factors; methods differ in the state, in
//! which factors they have, and in the forms of their edges. A Gaussian chain is the Kalman filter, or with ranges
//! the iterated extended one; a chain of particles the bootstrap filter. With particles on the motion's edges,
//! Gaussians on the measurements', and the proposal `optimal`, it is the sound P-MPA: the measurements' product,
//! improper in the velocity, guides the prediction, and the weights come out equal.

use std::sync::Arc;

use sumprod_graph::schedule::Sliced;
use sumprod_graph::{Factor, Message, MessageError, Options, Purpose, Space, Stream, Window, WindowVariable};
use sumprod_messages::{AnyForm, AnyMessage};
use sumprod_models::library::{AnchorOffset, AnchorRange, ConstantVelocity};
use sumprod_models::{Model, Motion, Noise, ProcessNoise, Real, ResidualModel, Transition};
use sumprod_optimizers::Reselection;

use super::method::{KernelRule, MethodSettings, StateModel};
use super::world::{Measured, World, WorldSettings};
use crate::costs::Costs;
use crate::error::PositioningError;
use crate::form::{FormSpec, unused_products};
use crate::results::{MethodRun, StateLayout};

type SharedFactor = Arc<dyn Factor<AnyMessage>>;
type Failure = Box<dyn std::error::Error + Send + Sync>;

/// Kinds of edge, by which factors are named.
const PREDICTION: &str = "prediction";
const OWN: &str = "self";

const UNGUIDED: &str = "measurements held by particles need the predicted ones to be weighed at, so they cannot \
                        guide where these are drawn; the proposal is \"prediction\" instead";

/// One coordinate moved by a known displacement: x' = x + d + w.
struct Drift {
    displacement: f64,
    noise: ProcessNoise,
}

impl Motion for Drift {
    fn dimension(&self) -> usize {
        1
    }

    fn step<T: Real>(&self, state: &[T], next: &mut [T]) {
        next[0] = state[0] + self.displacement;
    }

    fn noise(&self, _state: &[f64]) -> ProcessNoise {
        self.noise.clone()
    }
}

/// One state that is predicted from scan to scan by itself.
struct Chain {
    /// Axes of the plane that the state has.
    axes: Vec<usize>,
    /// The position's coordinates within the state, one per axis.
    position: Vec<usize>,
    start: Vec<f64>,
    space: Space,
    motion: SharedFactor,
    /// Noise of one measurement of the position.
    noise: Noise,
}

/// What the window holds of the scan that was opened last, by chain.
pub(super) type Scan = Vec<WindowVariable>;

/// One method on one draw of the world.
pub(super) struct Filter<'a> {
    settings: &'a WorldSettings,
    method: &'a MethodSettings,
    world: &'a World,
    seed: u64,
    chains: Vec<Chain>,
    pub(super) window: Window<AnyMessage, SharedFactor>,
    previous: Scan,
    range_noise: Noise,
}

impl<'a> Filter<'a> {
    pub(super) fn new(
        settings: &'a WorldSettings,
        method: &'a MethodSettings,
        world: &'a World,
        seed: u64,
    ) -> Result<Self, Failure> {
        let chains = chains(settings, method)?;
        let options = Options { seed, parallel: false, ..Options::default() };
        let mut window = Window::new(1, options)?;
        window.begin(0.0)?;
        let mut previous = Vec::with_capacity(chains.len());
        for chain in &chains {
            let variable = window.variable("the start", chain.space.clone())?;
            let d = chain.start.len();
            let mut covariance = vec![0.0; d * d];
            (0..d).for_each(|k| covariance[k * d + k] = settings.start_variance);
            window.set_prior(variable, AnyMessage::gaussian(&chain.space, &chain.start, &covariance)?)?;
            previous.push(variable);
        }
        let range_noise = Noise::isotropic(1, settings.measurement_variance)?;
        Ok(Self { settings, method, world, seed, chains, window, previous, range_noise })
    }

    /// Adds scan `step` (from 1) to the window: the state, its prediction, and what is measured.
    pub(super) fn open(&mut self, step: usize) -> Result<Scan, Failure> {
        self.window.begin(step as f64 * self.settings.interval)?;
        let mut scan = Vec::with_capacity(self.chains.len());
        let prediction = self.method.prediction_form();
        for (chain, &before) in self.chains.iter().zip(&self.previous) {
            let state = self.window.variable(format!("the state of scan {step}"), chain.space.clone())?;
            let edges = [(before, prediction), (state, prediction)];
            self.window.factor(PREDICTION, chain.motion.clone(), &edges)?;
            scan.push(state);
        }
        if self.method.z_self {
            let form = self.method.own_form();
            let fix = self.world.fixes[step - 1];
            for (chain, &state) in self.chains.iter().zip(&scan) {
                self.window.factor(OWN, chain.fix(&fix, &[0.0; 2])?, &[(state, form)])?;
            }
        }
        if self.method.neighbours {
            self.hear(step, &scan)?;
        }
        Ok(scan)
    }

    fn hear(&mut self, step: usize, scan: &[WindowVariable]) -> Result<(), Failure> {
        let measurement = self.settings.neighbour_measurement;
        let form = self.method.neighbour_form(measurement);
        for hearing in &self.world.hearings[step - 1] {
            let node = self.world.nodes[hearing.node];
            for (chain, &state) in self.chains.iter().zip(scan) {
                let factor = match hearing.measured {
                    Measured::Relative(offset) => chain.fix(&offset, &node)?,
                    Measured::Range(range) => chain.range(range, node, &self.range_noise)?,
                };
                let name = format!("{} {}", measurement.kind(), hearing.node + 1);
                self.window.factor(name, factor, &[(state, form)])?;
            }
        }
        Ok(())
    }

    /// Runs all scans and scores each.
    pub(super) fn run(mut self, out: &mut MethodRun) -> Result<(), PositioningError> {
        let id = out.id.clone();
        let failed = |error: Failure| PositioningError::method(&id, error);
        let rounds = self.method.rounds(self.settings.neighbour_measurement);
        let mut schedule = Sliced::new(rounds);
        if self.method.is_guided() {
            if self.method.is_heard_first(self.settings.neighbour_measurement) {
                schedule = schedule.evidence_first();
            } else {
                out.notes.push(UNGUIDED.to_owned());
            }
        }
        let kinds = [
            (PREDICTION, self.method.prediction_form()),
            (OWN, self.method.own_form()),
            ("neighbour", self.method.neighbour_form(self.settings.neighbour_measurement)),
        ];
        let carried = AnyMessage::belief_form(kinds.iter().map(|(_, form)| form));
        out.notes.extend(unused_products(&carried, &kinds));
        let mut costs = Costs::default();
        for step in 1..=self.settings.steps as usize {
            let scan = self.open(step).map_err(failed)?;
            self.window.run(&mut schedule).map_err(|error| failed(error.into()))?;
            self.score(step, &scan, out)?;
            self.weigh(&scan, &mut costs);
            self.reselect(step, &scan).map_err(failed)?;
            self.previous = scan;
        }
        costs.report(out);
        Ok(())
    }

    fn weigh(&self, scan: &[WindowVariable], costs: &mut Costs) {
        scan.iter().filter_map(|&state| self.window.belief(state)).for_each(|belief| costs.belief(belief));
        for (name, state, message) in self.window.messages() {
            // Factors of neighbours are named by their kind and node; only what was sent to this scan counts.
            let kind = name.split(' ').next().unwrap_or(name);
            if scan.contains(&state) {
                costs.message(kind, message);
            }
        }
    }

    /// The moments of the beliefs, chain after chain, beside the truth.
    fn score(
        &self,
        step: usize,
        scan: &[WindowVariable],
        out: &mut MethodRun,
    ) -> Result<(), PositioningError> {
        let d: usize = self.chains.iter().map(|chain| chain.start.len()).sum();
        let (mut mean, mut covariance) = (Vec::with_capacity(d), vec![0.0; d * d]);
        for &state in scan {
            let Some(belief) = self.window.belief(state) else { continue };
            let moments = belief.moments().map_err(|error| PositioningError::method(&out.id, error))?;
            let first = mean.len();
            for row in 0..moments.dimension() {
                for column in 0..moments.dimension() {
                    covariance[(first + row) * d + first + column] = moments.covariance_at(row, column);
                }
            }
            mean.extend_from_slice(&moments.mean);
        }
        let state = self.world.truth[step];
        let position = [state[0], state[2]];
        let truth: &[f64] = if d == state.len() { &state } else { &position };
        out.push(step as u32, step as f64 * self.settings.interval, 0, truth, &mean, &covariance)
    }

    fn reselect(&mut self, step: usize, scan: &[WindowVariable]) -> Result<(), Failure> {
        for (chain, &state) in scan.iter().enumerate() {
            let Some(particles) = self.window.belief(state).and_then(AnyMessage::particles) else { continue };
            let count = particles.len();
            if !self.method.trigger().fires(particles.effective_sample_size(), count) {
                continue;
            }
            let mut stream = Stream::new(self.seed, step as u64, Purpose::Optimizer, chain as u64);
            let chosen = self.method.resampling.reselect(particles, count, &mut stream)?;
            self.window.set_belief(state, AnyMessage::from_particles(chosen))?;
        }
        Ok(())
    }
}

impl Chain {
    /// A measured offset of the target from an anchor, along the chain's axes.
    fn fix(&self, measured: &[f64; 2], anchor: &[f64; 2]) -> Result<SharedFactor, MessageError> {
        let along = |point: &[f64; 2]| self.axes.iter().map(|&axis| point[axis]).collect::<Vec<f64>>();
        let offset = AnchorOffset::new(
            &along(measured),
            &along(anchor),
            self.start.len(),
            &self.position,
            self.noise.clone(),
        )?;
        Ok(Arc::new(Model(ResidualModel(offset))))
    }

    fn range(&self, measured: f64, anchor: [f64; 2], noise: &Noise) -> Result<SharedFactor, MessageError> {
        let position = [self.position[0], self.position[self.position.len() - 1]];
        let range = AnchorRange::new(measured, anchor, self.start.len(), position, noise.clone())?;
        Ok(Arc::new(Model(ResidualModel(range))))
    }
}

/// Meaning of the estimates of a method.
pub(super) fn layout(method: &MethodSettings) -> StateLayout {
    match method.state {
        StateModel::PositionVelocity => StateLayout::planar_velocity(),
        StateModel::FrozenVelocity => StateLayout::planar_position(),
    }
}

fn chains(settings: &WorldSettings, method: &MethodSettings) -> Result<Vec<Chain>, Failure> {
    let variance = settings.measurement_variance;
    match method.state {
        StateModel::PositionVelocity => {
            let motion =
                ConstantVelocity::held_acceleration(2, settings.interval, settings.process_variance)?;
            Ok(vec![Chain {
                axes: vec![0, 1],
                position: vec![0, 2],
                start: settings.start.to_vec(),
                space: Space::real(4),
                motion: Arc::new(Model(Transition::new(motion))),
                noise: Noise::isotropic(2, variance)?,
            }])
        }
        StateModel::FrozenVelocity => (0..2)
            .map(|axis| {
                let displacement = settings.start[2 * axis + 1] * settings.interval;
                let noise = ProcessNoise::diagonal(&[method.step_variance(settings)])?;
                Ok(Chain {
                    axes: vec![axis],
                    position: vec![0],
                    start: vec![settings.start[2 * axis]],
                    space: Space::real(1),
                    motion: Arc::new(Model(Transition::new(Drift { displacement, noise }))),
                    noise: Noise::isotropic(1, variance)?,
                })
            })
            .collect(),
    }
}

/// Forms of the edges of a scan by kind, in words, with their number.
pub(super) fn form_uses(
    method: &MethodSettings,
    settings: &WorldSettings,
    world: &World,
    step: usize,
) -> Vec<(&'static str, String, usize)> {
    let chains = if method.state == StateModel::FrozenVelocity { 2 } else { 1 };
    let measurement = settings.neighbour_measurement;
    let rule = method.kernel_rule(measurement);
    let count = method.kernel_count();
    let described = |form: AnyForm, known: String| match rule {
        None => FormSpec(form).to_string(),
        Some(KernelRule::Known) => known,
        Some(KernelRule::Printed) => format!("mixture {count} (product literal)"),
    };
    let product = method.kernel_product().name();
    let prediction = format!("mixture {count} (product {product})");
    let mut uses = vec![(PREDICTION, described(method.prediction_form(), prediction), 2 * chains)];
    if method.z_self {
        let own = if rule.is_some() { AnyForm::gaussian() } else { method.own_form() };
        uses.push((OWN, FormSpec(own).to_string(), chains));
    }
    if method.neighbours {
        let heard = chains * world.hearings[step - 1].len();
        let ring = format!("mixture, a ring of kernels (product {product})");
        uses.push((measurement.kind(), described(method.neighbour_form(measurement), ring), heard));
    }
    uses
}
