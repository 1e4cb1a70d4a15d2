//! Particle filters beyond the bootstrap, held against the Kalman filter of a linear model.

use crate::support::Track;
use sumprod_filters::{Correct, Filter, Kalman, ParticleFilter, Predict, RaoBlackwellised, Smooth};
use sumprod_graph::Space;
use sumprod_models::cloud::LogLikelihood;
use sumprod_models::library::ConstantVelocity;
use sumprod_models::{Block, Cluster, Motion, Noise, ProcessNoise, Real, Residual};
use sumprod_optimizers::Trigger;

/// Mean of exp(log-evidence - exact) over runs, within 4.5 of its standard errors of one: wrong with probability below
/// 4e-5 (t with 59 degrees of freedom).
fn unbiased(track: &Track, evidence: impl Fn(u64) -> f64) {
    let exact = Kalman::<4>::new(&track.prior).unwrap().run(track.steps()).unwrap().log_evidence;
    let ratios: Vec<f64> = (0..60).map(|seed| (evidence(seed) - exact).exp()).collect();
    let n = ratios.len() as f64;
    let mean = ratios.iter().sum::<f64>() / n;
    let error = (ratios.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (n - 1.0) / n).sqrt();
    assert!((mean - 1.0).abs() < 4.5 * error && error < 0.2, "{mean} ± {error}");
}

fn particles(track: &Track, count: usize, seed: u64) -> ParticleFilter {
    ParticleFilter::new(&Space::real(4), &track.prior, count, seed).unwrap()
}

#[test]
fn the_auxiliary_filters_evidence_is_right() {
    for held in [true, false] {
        let track = Track::simulated(12, 15, held);
        unbiased(&track, |seed| {
            particles(&track, 1500, seed).looking_ahead().run(track.steps()).unwrap().log_evidence
        });
    }
}

#[test]
fn the_rao_blackwellised_filters_evidence_is_right() {
    for held in [true, false] {
        let track = Track::simulated(13, 8, held);
        unbiased(&track, |seed| {
            let filter = RaoBlackwellised::new(&track.prior, &[0, 2], 800, seed).unwrap();
            let mut filter = filter.reselecting_when(Trigger::below(0.5).unwrap());
            filter.run(track.steps()).unwrap().log_evidence
        });
    }
}

/// With the velocities sampled and the positions Gaussian, 4,000 particles come within a tenth of a deviation.
#[test]
fn the_rao_blackwellised_filters_moments_are_right() {
    let track = Track::simulated(14, 12, false);
    let mut kalman = Kalman::<4>::new(&track.prior).unwrap();
    kalman.run(track.steps()).unwrap();
    let mut filter = RaoBlackwellised::new(&track.prior, &[1, 3], 4000, 3).unwrap();
    filter.run(track.steps()).unwrap();
    let (found, exact) = (filter.moments(), kalman.moments());
    for k in 0..4 {
        let deviation = exact.covariance_at(k, k).sqrt();
        assert!((found.mean[k] - exact.mean[k]).abs() < 0.1 * deviation);
        assert!((found.covariance_at(k, k).sqrt() / deviation - 1.0).abs() < 0.1);
    }
    assert!(RaoBlackwellised::new(&track.prior, &[4], 10, 1).is_err());
    assert!(RaoBlackwellised::new(&track.prior, &[0, 0], 10, 1).is_err());
    assert!(RaoBlackwellised::new(&track.prior, &[0, 1, 2, 3], 10, 1).is_err());
    assert!(RaoBlackwellised::new(&track.prior, &[0], 0, 1).is_err());
}

/// 500 trajectories: means within a fifth of a deviation of the exact smoother's, at all steps.
#[test]
fn simulated_backwards_trajectories_have_the_smoothers_moments() {
    let track = Track::simulated(16, 12, false);
    let mut kalman = Kalman::<4>::new(&track.prior).unwrap();
    let run = kalman.run(track.steps()).unwrap();
    let exact = kalman.smooth(&run).unwrap();
    let mut filter = particles(&track, 2000, 4);
    let run = filter.run(track.steps()).unwrap();
    let smoothed = filter.smooth(&run).unwrap();
    for (found, exact) in smoothed.iter().zip(&exact) {
        let found = found.moments();
        for k in 0..4 {
            let deviation = exact.covariance_at(k, k).sqrt();
            assert!((found.mean[k] - exact.mean[k]).abs() < 0.25 * deviation);
            assert!((found.covariance_at(k, k).sqrt() / deviation - 1.0).abs() < 0.25);
        }
    }
    let held = Track::simulated(16, 3, true);
    let mut filter = particles(&held, 10, 4);
    let run = filter.run(held.steps()).unwrap();
    let error = filter.smooth(&run).unwrap_err().to_string();
    assert!(error.contains("without a density"), "{error}");
}

/// A motion and a measurement that branch on the state: some particles go one way, some the other.
struct Wall;

impl Motion for Wall {
    fn dimension(&self) -> usize {
        1
    }

    fn step<T: Real>(&self, state: &[T], next: &mut [T]) {
        next[0] = if state[0].re() > 0.0 { state[0] * 0.5 } else { -state[0] };
    }

    fn noise(&self, _state: &[f64]) -> ProcessNoise {
        ProcessNoise::from_factor(1, &[])
    }
}

struct Beyond(Noise);

impl Residual for Beyond {
    fn dimensions(&self) -> &[usize] {
        &[1]
    }

    fn noise(&self) -> &Noise {
        &self.0
    }

    fn residual<T: Real>(&self, x: &[&[T]], out: &mut [T]) {
        out[0] = if x[0][0] > T::from(1.0) { x[0][0] - 1.0 } else { T::from(0.0) };
    }
}

#[test]
fn code_that_branches_on_the_state_is_evaluated_one_particle_at_a_time() {
    let prior = sumprod_messages::Moments::diagonal(&[0.0], &[4.0]);
    let filter = || ParticleFilter::new(&Space::real(1), &prior, 777, 2).unwrap();
    let mut moved = filter();
    moved.predict(&Wall).unwrap();
    for particle in 0..777 {
        let x = filter().cloud().at(particle, 0);
        assert_eq!(moved.cloud().at(particle, 0), if x > 0.0 { 0.5 * x } else { -x });
    }
    let noise = Noise::isotropic(1, 0.3).unwrap();
    let peak = noise.log_density(&[0.0]);
    let (mut by_residual, mut by_closure) = (moved, filter());
    by_closure.predict(&Wall).unwrap();
    let closure = LogLikelihood(move |x: &[f64]| peak - 0.5 * (x[0] - 1.0).max(0.0).powi(2) / 0.3);
    let (a, b) = (by_residual.correct(&Beyond(noise)).unwrap(), by_closure.correct(&closure).unwrap());
    assert!((a.log_likelihood - b.log_likelihood).abs() < 1e-12);
}

/// A cluster of two residuals weighs as the two after each other, and a graph's particle chain as the filter.
#[test]
fn a_cluster_is_its_residuals() {
    let track = Track::simulated(17, 2, false);
    let (first, second) = (Track::fix(&[0.5, 0.1]), Track::fix(&[1.5, -1.0]));
    let mut one_by_one = particles(&track, 500, 1);
    let sum = one_by_one.correct(&first).unwrap().log_likelihood
        + one_by_one.correct(&second).unwrap().log_likelihood;
    let mut cluster = Cluster::new(4);
    cluster.add(first, &[Block::new(0, 4)]).unwrap();
    cluster.add(second, &[Block::new(0, 4)]).unwrap();
    let mut together = particles(&track, 500, 1);
    let found = together.correct(&cluster).unwrap().log_likelihood;
    assert!((found - sum).abs() < 1e-12);
    let motion = ConstantVelocity::white_acceleration(2, 0.5, 0.4).unwrap();
    together.predict(&motion).unwrap();
    assert_eq!(together.step(), 1);
}

/// A window of one slice on a chain of particle messages, and the particle filter: both estimate the exact mean of the
/// last step without bias. Over 40 runs the mean error is within 4.5 standard errors of zero (t with 39 degrees of
/// freedom: wrong with probability below 6e-5 each), and their spreads agree within a factor of two.
#[test]
fn the_particle_filter_is_the_particle_chain_in_law() {
    use sumprod_graph::schedule::Sliced;
    use sumprod_graph::{Factor, Options, Window};
    use sumprod_messages::{Particles, ParticlesForm, Proposal};
    use sumprod_models::{Model, ResidualModel, Transition};
    let track = Track::simulated(18, 8, false);
    let mut kalman = Kalman::<4>::new(&track.prior).unwrap();
    kalman.run(track.steps()).unwrap();
    let by_chain = |seed: u64| {
        let form = ParticlesForm { proposal: Proposal::Prediction, ..ParticlesForm::new(800) };
        let options = Options { seed, ..Options::default() };
        let mut window: Window<Particles, Box<dyn Factor<Particles>>> = Window::new(1, options).unwrap();
        for (k, fixes) in track.fixes.iter().enumerate() {
            let before = window.slice(0).first().copied();
            window.begin(k as f64).unwrap();
            let state = window.variable(format!("state {k}"), Space::real(4)).unwrap();
            match before {
                Some(before) => {
                    let motion: Box<dyn Factor<Particles>> =
                        Box::new(Model(Transition::new(track.motion.clone())));
                    window.factor("motion", motion, &[(before, form), (state, form)]).unwrap();
                }
                None => window.set_prior(state, particles(&track, 800, seed).particles().unwrap()).unwrap(),
            }
            for fix in fixes {
                let fix: Box<dyn Factor<Particles>> = Box::new(Model(ResidualModel(Track::fix(fix))));
                window.factor("fix", fix, &[(state, form)]).unwrap();
            }
            window.run(&mut Sliced::new(1)).unwrap();
        }
        window.belief(window.slice(0)[0]).unwrap().mean()
    };
    let by_filter = |seed: u64| {
        let mut filter = particles(&track, 800, seed);
        filter.run(track.steps()).unwrap();
        filter.mean()
    };
    let errors = |estimate: &dyn Fn(u64) -> Vec<f64>, k: usize| {
        let errors: Vec<f64> = (0..40).map(|seed| estimate(seed)[k] - kalman.mean()[k]).collect();
        let mean = errors.iter().sum::<f64>() / 40.0;
        let spread = (errors.iter().map(|e| (e - mean).powi(2)).sum::<f64>() / 39.0).sqrt();
        assert!(mean.abs() < 4.5 * spread / 40.0f64.sqrt(), "{mean} {spread}");
        spread
    };
    for k in 0..4 {
        let ratio = errors(&by_chain, k) / errors(&by_filter, k);
        assert!(ratio > 0.5 && ratio < 2.0, "{ratio}");
    }
}
