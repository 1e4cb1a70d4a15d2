//! Filters of one node: a prediction to each emission, a correction by what came of it.

use std::error::Error;

use sumprod_filters::{Correct, Filter, Kalman, Predict};
use sumprod_graph::MessageError;
use sumprod_messages::Moments;
use sumprod_models::library::{AnchorRange, ConstantVelocity, PseudoRange};
use sumprod_models::{Noise, Residual};

use super::method::{Algorithm, MethodSettings};
use super::settings::WorldSettings;
use super::start::Start;
use super::world::{DIMENSION, Draw, Emission, Frame, State, round_trip};
use crate::PositioningError;
use crate::results::{MethodRun, StateLayout};
use crate::robots::marginal;

/// Coordinates of a state without its clock.
const KINEMATICS: usize = 6;
/// Places of the position in it.
const POSITION: [usize; 3] = [0, 2, 4];

/// Why a frame came to nothing.
pub type Failure = Box<dyn Error + Send + Sync>;

/// A run of the world as a method sees it.
#[derive(Clone, Copy)]
pub struct View<'a> {
    pub world: &'a WorldSettings,
    pub method: &'a MethodSettings,
    pub draw: &'a Draw,
    pub starts: &'a [Start],
}

/// Meaning of a method's estimates.
pub fn layout(method: &MethodSettings) -> StateLayout {
    let kinematics = StateLayout::spatial_velocity();
    if method.has_clock() { kinematics.with_clock() } else { kinematics }
}

/// The motion over the latest interval asked for.
pub struct Motions {
    densities: [f64; 4],
    axes: usize,
    latest: Option<(f64, ConstantVelocity)>,
}

impl Motions {
    /// Motions of the first axes of a state.
    pub fn new(world: &WorldSettings, axes: usize) -> Self {
        Self { densities: world.densities(), axes, latest: None }
    }

    /// The motion over an interval (s).
    ///
    /// # Errors
    /// Where the interval is not positive and finite.
    pub fn over(&mut self, interval: f64) -> Result<&ConstantVelocity, MessageError> {
        let known = self.latest.take().filter(|(own, _)| *own == interval);
        let (_, motion) = self.latest.insert(match known {
            Some(known) => known,
            None => {
                let densities = &self.densities[..self.axes.min(self.densities.len())];
                (interval, ConstantVelocity::white_accelerations(interval, densities)?)
            }
        });
        Ok(motion)
    }
}

/// Noise of as many times of flight as this.
pub fn noise(world: &WorldSettings, flights: f64) -> Result<Noise, PositioningError> {
    Noise::isotropic(1, flights * world.range_variance)
        .map_err(|error| PositioningError::setting("world.range_variance", format!("is unusable: {error}")))
}

impl View<'_> {
    /// The factor of a pseudo-range, β relative to the node's reference.
    ///
    /// # Errors
    /// Where a number is not finite.
    pub fn pseudo_range(
        &self,
        node: usize,
        emission: &Emission,
        noise: &Noise,
    ) -> Result<PseudoRange, MessageError> {
        let measured = emission.pseudo_range - self.starts[node].reference;
        let place = self.draw.anchors[emission.anchor];
        let factor = PseudoRange::new(measured, place, self.world.sound_speed, noise.clone())?;
        let still = self.method.frozen_flight || !self.world.motion_in_flight;
        Ok(if still { factor.still() } else { factor })
    }

    /// Adds the estimate of a frame, the clock in seconds and parts per million.
    ///
    /// # Errors
    /// [`PositioningError::Estimate`] where a number is not finite.
    pub fn score(
        &self,
        node: usize,
        step: usize,
        frame: &Frame,
        found: &Moments,
        out: &mut MethodRun,
    ) -> Result<(), PositioningError> {
        let d = found.dimension();
        let c = self.world.sound_speed;
        let mut truth = frame.truth;
        let (mut mean, mut covariance) = (found.mean.clone(), found.covariance.clone());
        if let [.., offset, rate] = mean.as_mut_slice()
            && d == DIMENSION
        {
            *offset = (*offset + self.starts[node].reference) / c;
            *rate *= 1e6 / c;
            truth[6] /= c;
            truth[7] *= 1e6 / c;
            let scale = |k: usize| match k {
                6 => 1.0 / c,
                7 => 1e6 / c,
                _ => 1.0,
            };
            for (place, entry) in covariance.iter_mut().enumerate() {
                *entry *= scale(place / d) * scale(place % d);
            }
        }
        let time = frame.time - self.world.epoch_s;
        out.push(step as u32, time, node as u32, &truth[..d], &mean, &covariance)
    }

    /// Runs the method's filter over every node.
    ///
    /// # Errors
    /// [`PositioningError::Method`] naming node and frame where it fails.
    pub fn filter(&self, out: &mut MethodRun) -> Result<(), PositioningError> {
        let world = self.world;
        let (one, two, half) = (noise(world, 1.0)?, noise(world, 2.0)?, noise(world, 0.5)?);
        let c = world.sound_speed;
        for node in 0..self.draw.nodes.len() {
            let start = &self.starts[node];
            let place = |emission: &Emission| self.draw.anchors[emission.anchor];
            let range = |measured: f64, emission: &Emission, noise: &Noise| {
                AnchorRange::new(measured, place(emission), KINEMATICS, POSITION, noise.clone())
            };
            match self.method.algorithm {
                Algorithm::OneWay | Algorithm::Window => {
                    self.run::<DIMENSION, _>(node, &|emission| self.pseudo_range(node, emission, &one), out)?;
                }
                Algorithm::TwoWay => {
                    let measure = |emission: &Emission| {
                        let (path, noise) = (emission.round_trip, two.clone());
                        round_trip(world, place(emission), KINEMATICS, path, noise)
                    };
                    self.run::<KINEMATICS, _>(node, &measure, out)?;
                }
                Algorithm::Jsl => {
                    let measure = |emission: &Emission| range(0.5 * emission.round_trip, emission, &half);
                    self.run::<KINEMATICS, _>(node, &measure, out)?;
                }
                Algorithm::TwoStep => {
                    let (offset, rate) = self.synchronised(node, start);
                    let measure = |emission: &Emission| {
                        let ahead = offset + rate * (emission.time - world.epoch_s);
                        range((emission.pseudo_range - ahead) / (1.0 + rate / c), emission, &one)
                    };
                    self.run::<KINEMATICS, _>(node, &measure, out)?;
                }
                Algorithm::Direct => {
                    let measure = |emission: &Emission| range(emission.pseudo_range, emission, &one);
                    self.run::<KINEMATICS, _>(node, &measure, out)?;
                }
            }
        }
        Ok(())
    }

    /// The clock's offset (m) at the start and its rate (m/s) by one anchor's beacons and one exchange with it:
    /// b = (T₁ + T₄ - a (T₂ + T₃)) / 2.
    fn synchronised(&self, node: usize, start: &Start) -> (f64, f64) {
        let c = self.world.sound_speed;
        let gain = 1.0 + start.first_rate / c;
        let [asks, hears, replies, answered] = self.draw.nodes[node].exchange;
        (0.5 * c * (asks + answered - gain * (hears + replies)), start.first_rate)
    }

    fn run<const D: usize, R: Residual>(
        &self,
        node: usize,
        measure: &dyn Fn(&Emission) -> Result<R, MessageError>,
        out: &mut MethodRun,
    ) -> Result<(), PositioningError> {
        let id = out.id.clone();
        let at = |step: usize, reason: String| {
            PositioningError::method(&id, format!("node {}, frame {step}: {reason}", node + 1))
        };
        let mut filter = Kalman::<D>::new(&marginal(&self.starts[node].state, 0, D))
            .map_err(|error| at(0, error.to_string()))?;
        let mut motions = Motions::new(self.world, D / 2);
        let mut now = self.world.epoch_s;
        for (step, frame) in (1..).zip(&self.draw.nodes[node].frames) {
            for emission in &frame.emissions {
                let time = if self.method.simultaneous { frame.time } else { emission.time };
                let mut absorb = || -> Result<(), Failure> {
                    if time > now {
                        filter.predict(motions.over(time - now)?)?;
                        now = time;
                    }
                    filter.correct(&measure(emission)?)?;
                    Ok(())
                };
                absorb().map_err(|reason| at(step, reason.to_string()))?;
            }
            self.score(node, step, frame, &filter.moments(), out)?;
        }
        Ok(())
    }

    /// Reports the error of the starts and the share of nodes that are lost at the end.
    pub fn tell(&self, out: &mut MethodRun) {
        let distance = |place: [f64; 3], truth: &State| {
            POSITION.iter().zip(place).map(|(&k, own)| (own - truth[k]).powi(2)).sum::<f64>().sqrt()
        };
        let mut refined = Vec::new();
        let mut linear = Vec::new();
        for (start, node) in self.starts.iter().zip(&self.draw.nodes) {
            refined.push(distance(POSITION.map(|k| start.state.mean[k]), &node.start));
            linear.extend(start.closed_form.map(|place| distance(place, &node.start)));
        }
        if self.method.has_clock() {
            if let Some(error) = median(refined) {
                out.diagnose("start_error_m.solved", error);
            }
            if let Some(error) = median(linear) {
                out.diagnose("start_error_m.closed_form", error);
            }
        }
        let last = self.draw.nodes.first().map_or(0, |node| node.frames.len()) as u32;
        let ends: Vec<bool> = out
            .estimates()
            .filter(|estimate| estimate.step == last)
            .map(|estimate| {
                let squares = POSITION.iter().map(|&k| (estimate.mean[k] - estimate.truth[k]).powi(2));
                squares.sum::<f64>().sqrt() > LOST * self.world.size
            })
            .collect();
        let lost = ends.iter().filter(|&&lost| lost).count();
        out.diagnose("lost_share", lost as f64 / ends.len().max(1) as f64);
    }
}

/// A node whose position is wrong by more than this share of the cube's edge is lost: its start was a mirror image, or
/// its filter diverged.
const LOST: f64 = 0.1;

fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}
