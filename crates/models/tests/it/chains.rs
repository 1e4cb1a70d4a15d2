//! Chains with singular process noise against a dense solve in the noise's own space, and Kalman and RTS formulas.

use crate::support::{Draw, HasMoments, assert_moments, rows, square};
use nalgebra::{DMatrix, DVector};
use sumprod_graph::schedule::ForwardBackward;
use sumprod_graph::{Engine, Factor, FactorGraph, Options, Space};
use sumprod_messages::{AnyMessage, DynamicGaussian};
use sumprod_models::library::{AnchorOffset, ConstantVelocity, Prior};
use sumprod_models::{AddModel, Model, Motion, Noise, ResidualModel, Transition};

/// Position fixes of a state [x, vx, y, vy] at some steps of a chain.
struct Chain {
    steps: usize,
    prior: Option<(DVector<f64>, DMatrix<f64>)>,
    motion: ConstantVelocity,
    /// Step, measured offset from the anchor, covariance.
    fixes: Vec<(usize, DVector<f64>, DMatrix<f64>)>,
}

const ANCHOR: [f64; 2] = [7.0, -3.0];
const STEP: f64 = 0.3;

impl Chain {
    fn new(entity: u64, steps: usize, with_prior: bool, every: usize, held: bool) -> Self {
        let mut draw = Draw::new(entity);
        let prior = with_prior.then(|| (draw.vector(4) * 3.0, draw.covariance(4)));
        let motion = if held {
            ConstantVelocity::held_acceleration(2, STEP, 1.7).unwrap()
        } else {
            ConstantVelocity::white_acceleration(2, STEP, 1.7).unwrap()
        };
        let fixes = (0..steps)
            .filter(|k| k % every == 0 || k + 1 == steps)
            .map(|k| (k, draw.vector(2) * 2.0, draw.covariance(2)))
            .collect();
        Self { steps, prior, motion, fixes }
    }

    fn pick() -> DMatrix<f64> {
        DMatrix::from_row_slice(2, 4, &[1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0])
    }

    fn step_matrix() -> DMatrix<f64> {
        let mut f = DMatrix::identity(4, 4);
        (f[(0, 1)], f[(2, 3)]) = (STEP, STEP);
        f
    }

    fn position(fix: &DVector<f64>) -> DVector<f64> {
        fix + DVector::from_column_slice(&ANCHOR)
    }

    /// Beliefs by forward-backward passes.
    fn beliefs<M: HasMoments>(&self) -> Vec<sumprod_messages::Moments>
    where
        Model<Transition<ConstantVelocity>>: Factor<M>,
        Model<ResidualModel<Prior>>: Factor<M>,
        Model<ResidualModel<AnchorOffset>>: Factor<M>,
    {
        let mut graph = FactorGraph::<M>::new();
        let x: Vec<_> = (0..self.steps).map(|_| graph.unnamed_variable(Space::real(4))).collect();
        if let Some((mean, covariance)) = &self.prior {
            let noise = Noise::gaussian(&rows(covariance)).unwrap();
            graph
                .add("prior", Prior::new(&Space::real(4), mean.as_slice(), noise).unwrap(), &[x[0]])
                .unwrap();
        }
        for pair in x.windows(2) {
            graph.add_motion("motion", self.motion.clone(), pair[0], pair[1]).unwrap();
        }
        for (k, fix, covariance) in &self.fixes {
            let noise = Noise::gaussian(&rows(covariance)).unwrap();
            let fix = AnchorOffset::new(fix.as_slice(), &ANCHOR, 4, &[0, 2], noise).unwrap();
            graph.add("fix", fix, &[x[*k]]).unwrap();
        }
        let mut engine = Engine::new(&graph, Options::default()).unwrap();
        engine.run(&mut ForwardBackward::new()).unwrap();
        x.iter().map(|&x| engine.belief(x).belief_moments()).collect()
    }

    /// The unknowns are the first state and the noise sources: every state is linear in them, whatever the rank.
    fn augmented(&self) -> Vec<(DVector<f64>, DMatrix<f64>)> {
        let noise = self.motion.noise(&[0.0; 4]);
        let sources = noise.sources();
        let b = DMatrix::from_row_slice(4, sources, noise.factor());
        let n = 4 + sources * (self.steps - 1);
        let mut states = vec![DMatrix::zeros(4, n)];
        states[0].columns_mut(0, 4).fill_with_identity();
        for k in 1..self.steps {
            let mut next = Self::step_matrix() * &states[k - 1];
            next.columns_mut(4 + sources * (k - 1), sources).copy_from(&b);
            states.push(next);
        }
        let mut information = DMatrix::identity(n, n);
        information.view_mut((0, 0), (4, 4)).fill(0.0);
        let mut vector = DVector::zeros(n);
        if let Some((mean, covariance)) = &self.prior {
            let own = covariance.clone().try_inverse().unwrap();
            information.view_mut((0, 0), (4, 4)).copy_from(&own);
            vector.rows_mut(0, 4).copy_from(&(own * mean));
        }
        for (k, fix, covariance) in &self.fixes {
            let wide = Self::pick() * &states[*k];
            let weight = covariance.clone().try_inverse().unwrap();
            information += wide.transpose() * &weight * &wide;
            vector += wide.transpose() * weight * Self::position(fix);
        }
        let factor = information.cholesky().unwrap();
        let (mean, covariance) = (factor.solve(&vector), factor.inverse());
        states.iter().map(|state| (state * &mean, state * &covariance * state.transpose())).collect()
    }

    /// The Kalman filter (Joseph form) and the Rauch-Tung-Striebel smoother.
    fn smoothed(&self) -> Vec<(DVector<f64>, DMatrix<f64>)> {
        let (f, h) = (Self::step_matrix(), Self::pick());
        let q = square(&self.motion.noise(&[0.0; 4]).covariance(), 4);
        let (mut mean, mut covariance) = self.prior.clone().unwrap();
        let (mut predicted, mut filtered) = (Vec::new(), Vec::new());
        for k in 0..self.steps {
            if k > 0 {
                mean = &f * mean;
                covariance = &f * covariance * f.transpose() + &q;
            }
            predicted.push((mean.clone(), covariance.clone()));
            if let Some((_, fix, noise)) = self.fixes.iter().find(|fix| fix.0 == k) {
                let innovation = &h * &covariance * h.transpose() + noise;
                let gain = &covariance * h.transpose() * innovation.try_inverse().unwrap();
                mean += &gain * (Self::position(fix) - &h * &mean);
                let rest = DMatrix::identity(4, 4) - &gain * &h;
                covariance = &rest * covariance * rest.transpose() + &gain * noise * gain.transpose();
            }
            filtered.push((mean.clone(), covariance.clone()));
        }
        let mut smoothed = vec![filtered[self.steps - 1].clone()];
        for k in (0..self.steps - 1).rev() {
            let (next, (mean, covariance)) = (&smoothed[smoothed.len() - 1], &filtered[k]);
            let inverse = predicted[k + 1].1.clone().cholesky().unwrap().inverse();
            let gain = covariance * f.transpose() * inverse;
            let own_mean = mean + &gain * (&next.0 - &predicted[k + 1].0);
            let own = covariance + &gain * (&next.1 - &predicted[k + 1].1) * gain.transpose();
            smoothed.push((own_mean, own));
        }
        smoothed.reverse();
        smoothed
    }

    fn check(&self) {
        let exact = self.augmented();
        for beliefs in [self.beliefs::<DynamicGaussian>(), self.beliefs::<AnyMessage>()] {
            for (found, (mean, covariance)) in beliefs.iter().zip(&exact) {
                assert_moments(found, mean, covariance, 1e-9);
            }
        }
    }
}

#[test]
fn chains_equal_the_dense_solve() {
    for held in [true, false] {
        Chain::new(20, 30, true, 1, held).check();
        Chain::new(21, 30, true, 4, held).check();
    }
}

#[test]
fn chains_equal_kalman_and_rts() {
    for held in [true, false] {
        let chain = Chain::new(22, 40, true, 3, held);
        let exact = chain.smoothed();
        for (found, (mean, covariance)) in chain.beliefs::<DynamicGaussian>().iter().zip(&exact) {
            assert_moments(found, mean, covariance, 1e-9);
        }
    }
}

/// Nothing is known at first: messages have rank two until a second fix comes.
#[test]
fn chains_without_a_prior_equal_the_dense_solve() {
    for held in [true, false] {
        for every in 1..6 {
            for entity in 0..8 {
                Chain::new(100 + entity, 20, false, every, held).check();
            }
        }
    }
}
