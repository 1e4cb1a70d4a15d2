//! A window of frames whose states are solved for together: an incremental smoother of all nodes.
//!
//! Every node has a state at each time of emission, joined by its motion; pseudo-ranges hang on one state, and those
//! between nodes join two. What is older than the lag is integrated out. Without hearing each other the nodes are
//! graphs apart, and each is a filter that is made linear again and again.

use std::collections::VecDeque;

use sumprod_exact::Incremental;
use sumprod_graph::{FactorGraph, Space, VariableId};
use sumprod_messages::DynamicGaussian;
use sumprod_models::library::NodePseudoRange;
use sumprod_models::{AddModel, Motion, Noise};

use super::track::{Failure, Motions, View, noise};
use super::world::DIMENSION;
use crate::PositioningError;
use crate::results::MethodRun;

/// The states of one frame: all of them, and each node's last.
struct Slice {
    step: usize,
    all: Vec<VariableId>,
    last: Vec<VariableId>,
}

struct Smoother<'a> {
    view: View<'a>,
    graph: FactorGraph<DynamicGaussian>,
    solver: Incremental,
    motions: Motions,
    noise: Noise,
    /// Each node's newest state.
    newest: Vec<VariableId>,
    now: f64,
}

impl View<'_> {
    /// Runs the window over all nodes.
    ///
    /// # Errors
    /// [`PositioningError::Method`] naming the frame where a solve fails.
    pub fn smooth(&self, out: &mut MethodRun) -> Result<(), PositioningError> {
        let id = out.id.clone();
        let failed = |step: usize| {
            let id = id.clone();
            move |reason: Failure| PositioningError::method(&id, format!("frame {step}: {reason}"))
        };
        let mut smoother = Smoother::new(*self)?;
        let mut open = VecDeque::new();
        let first = smoother.begin().map_err(failed(0))?;
        open.push_back(Slice { step: 0, last: first.clone(), all: first });
        let (lag, delay) = (self.method.lag(), self.method.delay());
        let steps = self.world.steps as usize;
        for step in 1..=steps {
            open.push_back(smoother.advance(step).map_err(failed(step))?);
            if let Some(told) = open.len().checked_sub(delay + 1).and_then(|place| open.get(place)) {
                smoother.tell(told, out)?;
            }
            if open.len() > lag + 1
                && let Some(old) = open.pop_front()
            {
                smoother.forget(&old).map_err(failed(step))?;
            }
        }
        let rest = open.len().saturating_sub(delay.min(steps));
        open.iter().skip(rest).try_for_each(|slice| smoother.tell(slice, out))
    }
}

impl<'a> Smoother<'a> {
    fn new(view: View<'a>) -> Result<Self, PositioningError> {
        Ok(Self {
            view,
            graph: FactorGraph::new(),
            solver: Incremental::default(),
            motions: Motions::new(view.world, DIMENSION / 2),
            noise: noise(view.world, 1.0)?,
            newest: Vec::new(),
            now: view.world.epoch_s,
        })
    }

    /// The states at the start, with their priors.
    fn begin(&mut self) -> Result<Vec<VariableId>, Failure> {
        for start in self.view.starts {
            let state = self.graph.unnamed_variable(Space::real(DIMENSION));
            let prior = DynamicGaussian::from_moments(&start.state.mean, &start.state.covariance)?;
            self.graph.set_prior(state, prior)?;
            self.newest.push(state);
        }
        self.solver.update(&self.graph, &[])?;
        Ok(self.newest.clone())
    }

    /// Adds a frame and solves: emission by emission, those of one time together.
    fn advance(&mut self, step: usize) -> Result<Slice, Failure> {
        let mut all = Vec::new();
        let draw = self.view.draw;
        let emissions = draw.nodes.first().map_or(0, |node| node.frames[step - 1].emissions.len());
        for index in 0..emissions {
            let time = draw.nodes[0].frames[step - 1].emissions[index].time;
            if time > self.now {
                if index > 0 {
                    self.solver.update(&self.graph, &[])?;
                }
                self.predict(time)?;
                all.extend_from_slice(&self.newest);
            }
            for (node, own) in draw.nodes.iter().enumerate() {
                let emission = &own.frames[step - 1].emissions[index];
                let factor = self.view.pseudo_range(node, emission, &self.noise)?;
                self.graph.add("pseudo-range", factor, &[self.newest[node]])?;
            }
        }
        if self.view.method.cooperative {
            for (node, own) in draw.nodes.iter().enumerate() {
                for hearing in &own.frames[step - 1].hearings {
                    let references = [node, hearing.from].map(|node| self.view.starts[node].reference);
                    let measured = hearing.pseudo_range - (references[0] - references[1]);
                    let speed = self.view.world.sound_speed;
                    let factor = NodePseudoRange::new(measured, speed, self.noise.clone())?;
                    self.graph.add("node", factor, &[self.newest[hearing.from], self.newest[node]])?;
                }
            }
        }
        self.solver.update(&self.graph, &[])?;
        Ok(Slice { step, all, last: self.newest.clone() })
    }

    /// Joins each node's newest state to one at a later time, which starts where the motion takes it.
    fn predict(&mut self, time: f64) -> Result<(), Failure> {
        let motion = self.motions.over(time - self.now)?.clone();
        self.now = time;
        let mut starts = Vec::with_capacity(self.newest.len());
        for newest in &mut self.newest {
            let next = self.graph.unnamed_variable(Space::real(DIMENSION));
            let mut moved = vec![0.0; DIMENSION];
            motion.step(&self.solver.value(*newest)?, &mut moved);
            self.graph.add_motion("motion", motion.clone(), *newest, next)?;
            starts.push((next, moved));
            *newest = next;
        }
        let starts: Vec<(VariableId, &[f64])> =
            starts.iter().map(|(next, moved)| (*next, &moved[..])).collect();
        self.solver.update(&self.graph, &starts)?;
        Ok(())
    }

    fn forget(&mut self, old: &Slice) -> Result<(), Failure> {
        self.solver.forget(&self.graph, &old.all)?;
        Ok(())
    }

    /// Scores the states of a frame.
    fn tell(&self, slice: &Slice, out: &mut MethodRun) -> Result<(), PositioningError> {
        if slice.step == 0 {
            return Ok(());
        }
        for (node, &state) in slice.last.iter().enumerate() {
            let found =
                self.solver.marginal(state).map_err(|error| PositioningError::method(&out.id, error))?;
            let frame = &self.view.draw.nodes[node].frames[slice.step - 1];
            self.view.score(node, slice.step, frame, &found, out)?;
        }
        Ok(())
    }
}
