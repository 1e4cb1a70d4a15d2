//! Mixture messages and the beliefs they make, against grids and against Gaussian rules where these are exact.

use crate::support::{Draw, moments_of, rows, send};
use std::f64::consts::{PI, TAU};
use sumprod_graph::schedule::{Flooding, ForwardBackward};
use sumprod_graph::{Coordinate, Engine, Factor, FactorGraph, Message, Options, Space, wrap_angle};
use sumprod_messages::{
    AnyForm, AnyMessage, DynamicGaussian, Mixture, MixtureForm, MixtureMessage, Moments, ProductChoice,
};
use sumprod_models::library::{AnchorRange, ConstantVelocity, Range, RelativePosition};
use sumprod_models::{AddModel, Model, Noise, Real, Residual, ResidualModel, Transition};

/// The sum of half the differences of two functions on a grid, both made to sum to one.
fn total_variation(found: &[f64], exact: &[f64]) -> f64 {
    let normal = |logs: &[f64]| {
        let top = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let values: Vec<f64> = logs.iter().map(|log| (log - top).exp()).collect();
        let sum: f64 = values.iter().sum();
        values.iter().map(|value| value / sum).collect::<Vec<f64>>()
    };
    let (found, exact) = (normal(found), normal(exact));
    0.5 * found.iter().zip(&exact).map(|(a, b)| (a - b).abs()).sum::<f64>()
}

/// Points of a square grid about a centre.
fn plane_grid(centre: [f64; 2], half: f64, side: usize) -> Vec<[f64; 2]> {
    let step = 2.0 * half / side as f64;
    let at = |k: usize, middle: f64| middle - half + (k as f64 + 0.5) * step;
    (0..side * side).map(|k| [at(k % side, centre[0]), at(k / side, centre[1])]).collect()
}

fn planar(mean: [f64; 2], variance: f64) -> MixtureMessage {
    let gaussian = DynamicGaussian::from_moments(&mean, &[variance, 0.0, 0.0, variance]).unwrap();
    MixtureMessage::from_gaussian(&[Coordinate::Real; 2], &gaussian)
}

fn flat(space: &Space) -> MixtureMessage {
    MixtureMessage::vacuous(space)
}

fn noise(variance: f64) -> Noise {
    Noise::isotropic(1, variance).unwrap()
}

/// A range nobody has a belief for is a ring whose profile is the factor's own.
#[test]
fn a_range_to_an_anchor_is_a_ring() {
    let plane = Space::real(2);
    for (range, variance) in [(30.0, 1.0), (12.0, 0.25), (100.0, 4.0), (5.0, 1.0), (1.5, 1.0), (0.3, 1.0)] {
        let model = AnchorRange::new(range, [3.0, -2.0], 2, [0, 1], noise(variance)).unwrap();
        let factor = Model(ResidualModel(model));
        let form = MixtureForm::new(2_000);
        let ring = send(&factor, 0, &[flat(&plane)], &[flat(&plane)], &form).unwrap();
        let grid = plane_grid([3.0, -2.0], range + 5.0 * f64::sqrt(variance), 150);
        let found: Vec<f64> = grid.iter().map(|x| ring.log_value(x).unwrap()).collect();
        let exact: Vec<f64> =
            grid.iter().map(|x| -0.5 * ((x[0] - 3.0).hypot(x[1] + 2.0) - range).powi(2) / variance).collect();
        let distance = total_variation(&found, &exact);
        println!("range {range}, variance {variance}: {} kernels, distance {distance:.4}", ring.len());
        // Below a few standard deviations there is no ring, and windows cover a disc.
        let allowed = if range < 4.0 * f64::sqrt(variance) { 0.05 } else { 0.03 };
        assert!(distance < allowed, "{range} {variance}: {distance}");
    }
}

/// The same from a sender that is a mixture: the ring of each component, blurred by its covariance. The exact message
/// is a sum over the sender's own grid.
#[test]
fn a_range_from_an_uncertain_sender_is_a_sum_of_blurred_rings() {
    let plane = Space::real(2);
    let covariances = vec![4.0, 1.5, 1.5, 1.0, 1.0, 0.0, 0.0, 6.0];
    let sender =
        Mixture::new(&plane, vec![0.7f64.ln(), 0.3f64.ln()], vec![0.0, 0.0, 20.0, 10.0], covariances)
            .unwrap();
    let model = Range::new(25.0, [2, 2], [[0, 1], [0, 1]], noise(1.0)).unwrap();
    let factor = Model(ResidualModel(model));
    let belief = MixtureMessage::from(sender.clone());
    let form = MixtureForm::new(2_000);
    let messages = [belief.clone(), flat(&plane)];
    let ring = send(&factor, 1, &messages, &messages, &form).unwrap();
    let fine = plane_grid([10.0, 5.0], 22.0, 110);
    let weights: Vec<f64> = fine.iter().map(|y| sender.log_density(y).unwrap().exp()).collect();
    let kept: Vec<(&[f64; 2], f64)> = fine.iter().zip(weights).filter(|(_, w)| *w > 1e-9).collect();
    let grid = plane_grid([10.0, 5.0], 50.0, 90);
    let exact: Vec<f64> = grid
        .iter()
        .map(|x| {
            let term = |(y, w): &(&[f64; 2], f64)| {
                w * (-0.5 * ((x[0] - y[0]).hypot(x[1] - y[1]) - 25.0).powi(2)).exp()
            };
            kept.iter().map(term).sum::<f64>().max(1e-300).ln()
        })
        .collect();
    let found: Vec<f64> = grid.iter().map(|x| ring.log_value(x).unwrap()).collect();
    let distance = total_variation(&found, &exact);
    println!("{} kernels, distance {distance:.4}", ring.len());
    assert!(distance < 0.04, "{distance}");
}

/// Two anchors and a weak prior: both crossings, with the masses of the exact posterior; velocities stay as the prior
/// has them, though the ranges leave them open.
#[test]
fn two_ranges_and_a_prior_on_a_state_have_both_crossings() {
    let state = Space::real(4);
    let prior = [10.0, 1.0, 2.0, -1.0];
    let variances = [400.0, 4.0, 100.0, 9.0];
    let mut covariance = vec![0.0; 16];
    (0..4).for_each(|k| covariance[k * 5] = variances[k]);
    // Position and velocity are correlated in the prior.
    (covariance[1], covariance[4]) = (20.0, 20.0);
    let anchors = [([0.0, 0.0], 25.0), ([30.0, 0.0], 20.0)];
    for product in [ProductChoice::Auto, ProductChoice::Pairwise, ProductChoice::MultiscaleGibbs] {
        let form = AnyForm::Mixture(MixtureForm::new(100).with_product(product));
        let mut graph = FactorGraph::<AnyMessage>::new();
        let x = graph.variable("x", state.clone()).unwrap();
        graph.set_prior(x, AnyMessage::gaussian(&state, &prior, &covariance).unwrap()).unwrap();
        for (anchor, range) in anchors {
            let model = AnchorRange::new(range, anchor, 4, [0, 2], noise(1.0)).unwrap();
            let factor = graph.add("range", model, &[x]).unwrap();
            graph.set_edge_form(factor, 0, form).unwrap();
        }
        let mut engine = Engine::new(&graph, Options { max_iterations: 2, ..Options::default() }).unwrap();
        engine.run(&mut Flooding).unwrap();
        let belief = engine.belief(x).mixture().unwrap().to_density().unwrap();
        let grid = plane_grid([15.0, 0.0], 35.0, 350);
        let marginal = |x: &[f64; 2]| {
            let mut log = f64::NEG_INFINITY;
            for i in 0..belief.len() {
                let (m, c) = (belief.mean_of(i), belief.covariance_of(i));
                let (xx, xy, yy) = (c[0], c[2], c[10]);
                let (u, v) = (x[0] - m[0], x[1] - m[2]);
                let det = xx * yy - xy * xy;
                let own = belief.log_weights()[i]
                    - 0.5 * ((yy * u * u - 2.0 * xy * u * v + xx * v * v) / det + det.ln());
                log = log.max(own) + (-(log - own).abs()).exp().ln_1p();
            }
            log
        };
        let exact_log = |x: &[f64; 2]| {
            let mut log = -0.5 * ((x[0] - 10.0).powi(2) / 400.0 + (x[1] - 2.0).powi(2) / 100.0);
            for (anchor, range) in anchors {
                log -= 0.5 * ((x[0] - anchor[0]).hypot(x[1] - anchor[1]) - range).powi(2);
            }
            log
        };
        let exact: Vec<f64> = grid.iter().map(exact_log).collect();
        let found: Vec<f64> = grid.iter().map(marginal).collect();
        let distance = total_variation(&found, &exact);
        let total: f64 = exact.iter().map(|log| log.exp()).sum();
        let upper: f64 = grid.iter().zip(&exact).filter(|(x, _)| x[1] > 0.0).map(|(_, log)| log.exp()).sum();
        let mass: f64 = belief
            .weights()
            .iter()
            .enumerate()
            .filter(|(i, _)| belief.mean_of(*i)[2] > 0.0)
            .map(|(_, weight)| weight)
            .sum();
        // Given the position, the velocity's mean follows the prior's regression.
        let moments = belief.moments();
        let regression = 1.0 + 20.0 / 400.0 * (moments.mean[0] - 10.0);
        println!(
            "{product:?}: {} components, distance {distance:.4}, upper {mass:.4} of {:.4}, vx {:.4} of {regression:.4}",
            belief.len(),
            upper / total,
            moments.mean[1]
        );
        let sampled = product == ProductChoice::MultiscaleGibbs;
        // 500 draws: masses within 4.5 standard errors, shapes blurred by kernels.
        let (shape, masses) = if sampled { (0.25, 0.1) } else { (0.06, 0.02) };
        assert!(distance < shape, "{product:?}: {distance}");
        assert!((mass - upper / total).abs() < masses, "{product:?}: {mass} of {}", upper / total);
        assert!((moments.mean[1] - regression).abs() < if sampled { 0.5 } else { 0.05 });
        assert!((moments.mean[3] + 1.0).abs() < if sampled { 0.5 } else { 0.05 });
    }
}

/// Somebody's own factor: an angle that a function of the state should have.
struct Angle<F> {
    dimension: [usize; 1],
    noise: Noise,
    function: F,
}

/// A function of dual numbers.
trait Bearing: Send + Sync {
    fn at<T: Real>(&self, x: &[T]) -> T;
}

impl<F: Bearing> Residual for Angle<F> {
    fn dimensions(&self) -> &[usize] {
        &self.dimension
    }
    fn noise(&self) -> &Noise {
        &self.noise
    }
    fn angles(&self) -> &[usize] {
        &[0]
    }
    fn residual<T: Real>(&self, x: &[&[T]], out: &mut [T]) {
        out[0] = self.function.at(x[0]);
    }
}

/// Total variation, on a grid, between the exact posterior and the belief of one variable with a prior and an angle, held
/// as a mixture of `components`.
fn distance_on_grid(
    prior: &Mixture,
    function: impl Bearing + Clone + 'static,
    variance: f64,
    components: usize,
    grid: &[Vec<f64>],
) -> f64 {
    let space = prior.space();
    let mut graph = FactorGraph::<MixtureMessage>::new();
    let x = graph.variable("x", space.clone()).unwrap();
    graph.set_prior(x, prior.clone().into()).unwrap();
    let angle = Angle { dimension: [space.dimension()], noise: noise(variance), function: function.clone() };
    let factor = graph.add("angle", angle, &[x]).unwrap();
    graph.set_edge_form(factor, 0, MixtureForm::new(components)).unwrap();
    let mut engine = Engine::new(&graph, Options { max_iterations: 1, ..Options::default() }).unwrap();
    engine.run(&mut Flooding).unwrap();
    let belief = engine.belief(x).to_density().unwrap();
    let exact: Vec<f64> = grid
        .iter()
        .map(|x| {
            let away = wrap_angle(function.at::<f64>(x));
            prior.log_density(x).unwrap() - 0.5 * away * away / variance
        })
        .collect();
    let found: Vec<f64> = grid.iter().map(|x| belief.log_density(x).unwrap()).collect();
    let distance = total_variation(&found, &exact);
    println!("{} components, distance {distance:.4}", belief.len());
    distance
}

/// The angle between two landmarks seen from a point.
#[derive(Clone)]
struct Subtended;

impl Bearing for Subtended {
    fn at<T: Real>(&self, x: &[T]) -> T {
        let (left, right) = ((x[1] - 4.0).atan2(x[0] + 3.0), (x[1] - 4.0).atan2(x[0] - 3.0));
        right - left - 1.2
    }
}

/// A factor nobody wrote mixture rules for, over a prior of two modes that no line serves.
#[test]
fn any_residual_is_covered_by_windows() {
    let prior = Mixture::new(
        &Space::real(2),
        vec![0.6f64.ln(), 0.4f64.ln()],
        vec![0.0, 0.0, 1.0, 9.0],
        vec![2.0, 0.3, 0.3, 1.5, 1.0, 0.0, 0.0, 2.0],
    )
    .unwrap();
    let grid: Vec<Vec<f64>> = plane_grid([0.5, 4.5], 11.0, 220).iter().map(|x| x.to_vec()).collect();
    let distance = distance_on_grid(&prior, Subtended, 0.01, 400, &grid);
    assert!(distance < 0.08, "{distance}");
}

/// A compass that reads twice the angle: two headings half a turn apart, across the seam.
#[derive(Clone)]
struct Twice;

impl Bearing for Twice {
    fn at<T: Real>(&self, x: &[T]) -> T {
        x[0] * 2.0 - 0.2
    }
}

#[test]
fn angles_are_covered_once_around() {
    let circle = Space::new([Coordinate::Angle]);
    let prior = Mixture::new(&circle, vec![0.0], vec![2.6], vec![0.8]).unwrap();
    let grid: Vec<Vec<f64>> = (0..720).map(|k| vec![-PI + (f64::from(k) + 0.5) * TAU / 720.0]).collect();
    let distance = distance_on_grid(&prior, Twice, 0.04, 200, &grid);
    assert!(distance < 0.03, "{distance}");
}

/// An angle that grows with a coordinate which is none: a prior that spans whole turns keeps every one of them.
#[derive(Clone)]
struct Turns;

impl Bearing for Turns {
    fn at<T: Real>(&self, x: &[T]) -> T {
        x[0] * 3.0 + x[1] - 0.4
    }
}

#[test]
fn a_prior_that_spans_whole_turns_of_a_linear_residual_keeps_them_all() {
    let covariance = vec![1.5, 0.4, 0.4, 0.8];
    let prior = Mixture::new(&Space::real(2), vec![0.0], vec![0.3, -0.2], covariance).unwrap();
    let grid: Vec<Vec<f64>> = plane_grid([0.3, -0.2], 6.0, 240).iter().map(|x| x.to_vec()).collect();
    let distance = distance_on_grid(&prior, Turns, 0.04, 300, &grid);
    assert!(distance < 0.08, "{distance}");
}

/// On a linear chain the mixture form is the Gaussian form, smoother included, to rounding.
#[test]
fn a_linear_chain_of_mixtures_is_exact() {
    let state = Space::real(4);
    let run = |form: AnyForm| -> Vec<Moments> {
        let mut graph = FactorGraph::<AnyMessage>::new();
        let motion = ConstantVelocity::held_acceleration(2, 1.0, 0.5).unwrap();
        let states: Vec<_> =
            (0..5).map(|k| graph.variable(format!("x{k}"), state.clone()).unwrap()).collect();
        let start = AnyMessage::gaussian(&state, &[0.0, 1.0, 0.0, -1.0], &rows(&Draw::new(5).covariance(4)));
        graph.set_prior(states[0], start.unwrap()).unwrap();
        for pair in states.windows(2) {
            let factor = graph.add_motion("motion", motion.clone(), pair[0], pair[1]).unwrap();
            graph.set_edge_form(factor, 0, form).unwrap();
            graph.set_edge_form(factor, 1, form).unwrap();
        }
        for (k, x) in states.iter().enumerate() {
            let fix = sumprod_models::library::AnchorOffset::new(
                &[k as f64 * 1.3, -(k as f64)],
                &[0.0, 0.0],
                4,
                &[0, 2],
                Noise::isotropic(2, 2.0).unwrap(),
            );
            let factor = graph.add("fix", fix.unwrap(), &[*x]).unwrap();
            graph.set_edge_form(factor, 0, form).unwrap();
        }
        let mut engine = Engine::new(&graph, Options::default()).unwrap();
        engine.run(&mut ForwardBackward::new()).unwrap();
        states.iter().map(|x| engine.belief(*x).moments().unwrap()).collect()
    };
    let (gaussian, mixture) = (run(AnyForm::gaussian()), run(AnyForm::mixture(20)));
    for (a, b) in gaussian.iter().zip(&mixture) {
        for (x, y) in a.mean.iter().chain(&a.covariance).zip(b.mean.iter().chain(&b.covariance)) {
            assert!((x - y).abs() < 1e-8, "{x} {y}");
        }
    }
}

/// A prior of two modes, moved, measured, and smoothed: the exact answer is the mixture of two Kalman smoothers.
#[test]
fn two_modes_are_smoothed_as_two_chains() {
    let state = Space::real(2);
    let motion = ConstantVelocity::held_acceleration(1, 1.0, 0.1).unwrap();
    let forward = Model(Transition::new(motion));
    let form = MixtureForm::new(50);
    let means = [[-4.0, 1.0], [4.0, -1.0]];
    let (weights, spread) = ([0.3, 0.7], [0.5, 0.1, 0.1, 0.4]);
    let prior = Mixture::with_shared_covariance(
        &state,
        weights.iter().map(|w: &f64| w.ln()).collect(),
        means.concat(),
        spread.to_vec(),
    )
    .unwrap();
    let likelihood = DynamicGaussian::from_information(&[0.8, 0.0, 0.0, 0.0], &[0.8 * 0.5, 0.0]).unwrap();
    let seen = MixtureMessage::from_gaussian(state_coordinates(), &likelihood);
    let prior_message = MixtureMessage::from(prior.clone());
    let messages = [prior_message.clone(), seen.clone()];
    let back = send(&forward, 0, &messages, &messages, &form).unwrap();
    let edges = [0, 1];
    let all = [prior_message, back];
    let product = MixtureMessage::product(
        sumprod_graph::Messages::new(&all, &edges),
        &form,
        &mut crate::support::stream(0),
    )
    .unwrap();
    // By hand: each mode's own posterior of the first state, and evidence.
    let gaussian = Model(Transition::new(ConstantVelocity::held_acceleration(1, 1.0, 0.1).unwrap()));
    let mut logs = Vec::new();
    let mut moments = Vec::new();
    for (mean, weight) in means.iter().zip(weights) {
        let own = moments_of(
            &nalgebra::DVector::from_column_slice(mean),
            &nalgebra::DMatrix::from_row_slice(2, 2, &spread),
        );
        let back = send(
            &gaussian,
            0,
            &[own.clone(), likelihood.clone()],
            &[own.clone(), likelihood.clone()],
            &Default::default(),
        )
        .unwrap();
        moments.push(own.times(&back).unwrap().moments().unwrap());
        // z = 0.5 seen of the next position with variance 1.25.
        let variance = 0.5 + 2.0 * 0.1 + 0.4 + 0.1 * 0.25 + 1.25;
        let innovation = 0.5 - (mean[0] + mean[1]);
        logs.push(weight.ln() - 0.5 * (innovation * innovation / variance + f64::ln(variance)));
    }
    let total = (logs[0].exp() + logs[1].exp()).ln();
    let mean: Vec<f64> =
        (0..2).map(|k| (0..2).map(|i| (logs[i] - total).exp() * moments[i].mean[k]).sum()).collect();
    let found = product.moments().unwrap();
    assert!(found.mean.iter().zip(&mean).all(|(a, b)| (a - b).abs() < 1e-9), "{:?} {mean:?}", found.mean);
}

fn state_coordinates() -> &'static [Coordinate] {
    &[Coordinate::Real; 2]
}

/// Linear factors of mixtures give one component each: the sum of two mixtures.
#[test]
fn a_displacement_adds_component_by_component() {
    let line = Space::real(2);
    let sender = Mixture::new(
        &line,
        vec![0.0, 1.0],
        vec![0.0, 0.0, 5.0, 1.0],
        vec![1.0, 0.0, 0.0, 1.0, 0.5, 0.2, 0.2, 0.5],
    )
    .unwrap();
    let model =
        RelativePosition::new(&[1.0, -2.0], [2, 2], [&[0, 1], &[0, 1]], Noise::isotropic(2, 0.3).unwrap());
    let factor: Box<dyn Factor<MixtureMessage>> = Box::new(Model(ResidualModel(model.unwrap())));
    let messages = [MixtureMessage::from(sender.clone()), planar([9.0, 9.0], 1e4)];
    let sent = send(&factor, 1, &messages, &messages, &MixtureForm::new(20)).unwrap().to_density().unwrap();
    assert_eq!(sent.len(), 2);
    for (i, weight) in sent.weights().iter().enumerate() {
        let from = (0..2).min_by(|a, b| {
            let far = |k: &usize| (sender.mean_of(*k)[0] + 1.0 - sent.mean_of(i)[0]).abs();
            far(a).total_cmp(&far(b))
        });
        let from = from.unwrap();
        assert!((sent.mean_of(i)[1] - sender.mean_of(from)[1] + 2.0).abs() < 1e-9);
        assert!((weight - sender.weights()[from]).abs() < 1e-9);
        assert!((sent.covariance_of(i)[0] - sender.covariance_of(from)[0] - 0.3).abs() < 1e-9);
    }
}
