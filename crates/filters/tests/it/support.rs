//! A linear model with simulated data, and its chain as a graph.

use rand_distr::{Distribution, StandardNormal};
use sumprod_filters::Step;
use sumprod_graph::schedule::ForwardBackward;
use sumprod_graph::{Engine, FactorGraph, FastStream, Options, Purpose, Space, Stream};
use sumprod_messages::{DynamicGaussian, Moments};
use sumprod_models::library::{AnchorOffset, ConstantVelocity, Prior};
use sumprod_models::{AddModel, Motion, Noise};

pub fn random(entity: u64) -> FastStream {
    Stream::new(11, 0, Purpose::World, entity).fast()
}

pub fn normal(random: &mut FastStream) -> f64 {
    StandardNormal.sample(random)
}

/// A state [x, vx, y, vy] with position fixes at most steps.
pub struct Track {
    pub prior: Moments,
    pub motion: ConstantVelocity,
    pub fixes: Vec<Vec<[f64; 2]>>,
}

pub const FIX_VARIANCE: f64 = 0.5;

impl Track {
    /// Simulated steps; every fifth has no fix, every seventh two.
    pub fn simulated(entity: u64, steps: usize, held: bool) -> Self {
        let mut random = random(entity);
        let prior = Moments::diagonal(&[1.0, 0.5, -2.0, 0.3], &[4.0, 1.0, 4.0, 1.0]);
        let motion = if held {
            ConstantVelocity::held_acceleration(2, 0.5, 0.4).unwrap()
        } else {
            ConstantVelocity::white_acceleration(2, 0.5, 0.4).unwrap()
        };
        let mut state: Vec<f64> =
            (0..4).map(|k| prior.mean[k] + prior.covariance_at(k, k).sqrt() * normal(&mut random)).collect();
        let noise = motion.noise(&state);
        let mut fixes = Vec::new();
        for step in 0..steps {
            if step > 0 {
                let mut next = [0.0; 4];
                motion.step(&state, &mut next);
                for source in 0..noise.sources() {
                    let z = normal(&mut random);
                    (0..4).for_each(|row| next[row] += noise.factor()[row * noise.sources() + source] * z);
                }
                state = next.to_vec();
            }
            let count = if step % 5 == 4 { 0 } else { 1 + usize::from(step % 7 == 6) };
            let mut fix = || [0, 2].map(|k| state[k] + FIX_VARIANCE.sqrt() * normal(&mut random));
            fixes.push((0..count).map(|_| fix()).collect());
        }
        Self { prior, motion, fixes }
    }

    pub fn fix(at: &[f64; 2]) -> AnchorOffset {
        let noise = Noise::isotropic(2, FIX_VARIANCE).unwrap();
        AnchorOffset::new(at, &[0.0, 0.0], 4, &[0, 2], noise).unwrap()
    }

    pub fn steps(&self) -> Vec<Step<ConstantVelocity, AnchorOffset>> {
        let step = |(k, fixes): (usize, &Vec<[f64; 2]>)| Step {
            motion: (k > 0).then(|| self.motion.clone()),
            measurements: fixes.iter().map(Self::fix).collect(),
        };
        self.fixes.iter().enumerate().map(step).collect()
    }

    /// The chain's marginals given the fixes of the first `seen` steps, by forward-backward passes.
    pub fn marginals(&self, seen: usize) -> Vec<Moments> {
        let mut graph = FactorGraph::<DynamicGaussian>::new();
        let space = Space::real(4);
        let mut states = Vec::new();
        for (k, fixes) in self.fixes.iter().enumerate() {
            let state = graph.unnamed_variable(space.clone());
            match states.last() {
                Some(&last) => {
                    graph.add_motion("motion", self.motion.clone(), last, state).unwrap();
                }
                None => {
                    let noise = Noise::gaussian(&self.prior.covariance).unwrap();
                    let prior = Prior::new(&space, &self.prior.mean, noise).unwrap();
                    graph.add("prior", prior, &[state]).unwrap();
                }
            }
            for fix in fixes.iter().filter(|_| k < seen) {
                graph.add("fix", Self::fix(fix), &[state]).unwrap();
            }
            states.push(state);
        }
        let mut engine = Engine::new(&graph, Options::default()).unwrap();
        engine.run(&mut ForwardBackward::new()).unwrap();
        states.iter().map(|&state| engine.belief(state).moments().unwrap()).collect()
    }
}

/// The largest difference of an entry, relative to the larger of it and one.
pub fn apart(a: &Moments, b: &Moments) -> f64 {
    let pairs = a.mean.iter().chain(&a.covariance).zip(b.mean.iter().chain(&b.covariance));
    pairs.map(|(a, b)| (a - b).abs() / a.abs().max(1.0)).fold(0.0, f64::max)
}
