//! Pointwise particle messages against grids and closed forms.

use crate::support::{Draw, rows, send};
use nalgebra::{DMatrix, DVector};
use sumprod_graph::schedule::Flooding;
use sumprod_graph::{Engine, FactorGraph, MessageError, Options, Space};
use sumprod_messages::{AnyForm, AnyMessage, Particles, ParticlesForm, Role};
use sumprod_models::library::{AnchorRange, LinearGaussian, Prior, Range};
use sumprod_models::{AddModel, Model, Noise, Real, Residual, ResidualModel};

fn sample(draw: &mut Draw, mean: &[f64], covariance: &DMatrix<f64>, count: usize) -> Particles {
    let lower = covariance.clone().cholesky().unwrap().l();
    let centre = DVector::from_column_slice(mean);
    let points = (0..count).flat_map(|_| (&centre + &lower * draw.vector(mean.len())).as_slice().to_vec());
    Particles::equally_weighted(&Space::real(mean.len()), points.collect()).unwrap()
}

fn normal_density(x: &[f64], mean: &[f64], variance: f64) -> f64 {
    let squared: f64 = x.iter().zip(mean).map(|(x, mean)| (x - mean).powi(2)).sum();
    (-0.5 * squared / variance).exp() / (std::f64::consts::TAU * variance).powf(0.5 * x.len() as f64)
}

/// At 12 points, each wrong with probability 6.4e-5.
#[test]
fn a_range_from_particles_is_the_integral_over_the_sender() {
    let mut draw = Draw::new(1000);
    let (centre, variance, z, spread) = ([3.0, -1.0], 0.8, 6.0, 0.25);
    let count = 4000;
    let sender = sample(&mut draw, &centre, &(DMatrix::identity(2, 2) * variance), count);
    let angles = (0..12).map(|k| f64::from(k) * 0.5);
    let points = angles.flat_map(|a| {
        let radius = 4.5 + 0.5 * a;
        [centre[0] + radius * a.cos(), centre[1] + radius * a.sin()]
    });
    let carrier = Particles::equally_weighted(&Space::real(2), points.collect()).unwrap();
    let noise = Noise::isotropic(1, spread).unwrap();
    let range = Model(ResidualModel(Range::new(z, [2, 2], [[0, 1], [0, 1]], noise).unwrap()));
    for to in 0..2 {
        let mut messages = [sender.clone(), sender.clone()];
        messages[to] = carrier.clone();
        let message = send(&range, to, &messages, &messages, &ParticlesForm::new(count)).unwrap();
        assert!(message.role() == Role::Likelihood && message.same_support(&carrier));
        for (point, log) in carrier.points().chunks(2).zip(message.log_weights()) {
            let (mut first, mut second) = (0.0, 0.0);
            let step = 0.05;
            for i in -100..=100 {
                for j in -100..=100 {
                    let y = [centre[0] + step * f64::from(i), centre[1] + step * f64::from(j)];
                    let mass = normal_density(&y, &centre, variance) * step * step;
                    let distance = (y[0] - point[0]).hypot(y[1] - point[1]);
                    let value = normal_density(&[distance], &[z], spread);
                    first += mass * value;
                    second += mass * value * value;
                }
            }
            let error = ((second - first * first) / count as f64).sqrt();
            assert!((log.exp() - first).abs() < 4.0 * error, "{} for {first} ± {error}", log.exp());
        }
    }
}

/// Two senders whose particles come sorted: pairing them by rank would double the spread of their sum. Within 4
/// standard errors at 9 points, each wrong with probability 6.4e-5.
#[test]
fn two_senders_are_independent() {
    let mut draw = Draw::new(1001);
    let count = 20_000;
    let (variances, noise) = ([2.0, 3.0], 0.5);
    let sorted = variances.map(|variance: f64| {
        let mut points: Vec<f64> = (0..count).map(|_| variance.sqrt() * draw.normal()).collect();
        points.sort_by(f64::total_cmp);
        Particles::equally_weighted(&Space::real(1), points).unwrap()
    });
    let carrier = Particles::equally_weighted(&Space::real(1), (-4..5).map(f64::from).collect()).unwrap();
    let factor =
        LinearGaussian::new(&[&[1.0], &[-1.0], &[-1.0]], &[0.0], Noise::isotropic(1, noise).unwrap())
            .unwrap();
    let messages = [carrier.clone(), sorted[0].clone(), sorted[1].clone()];
    let message =
        send(&Model(ResidualModel(factor)), 0, &messages, &messages, &ParticlesForm::new(count)).unwrap();
    for (x, log) in carrier.points().iter().zip(message.log_weights()) {
        let first = normal_density(&[*x], &[0.0], 5.0 + noise);
        let second =
            normal_density(&[*x], &[0.0], 5.0 + 0.5 * noise) / (4.0 * std::f64::consts::PI * noise).sqrt();
        let error = ((second - first * first) / count as f64).sqrt();
        assert!((log.exp() - first).abs() < 4.0 * error, "at {x}: {} for {first} ± {error}", log.exp());
    }
}

/// Two points with Gaussian priors and a range: posterior means by a grid over all four coordinates. 24 runs, within
/// 5 standard errors of their mean: for each of four numbers wrong with probability below 5e-5.
#[test]
fn posteriors_of_two_points_equal_the_grid() {
    let priors = [([0.0, 0.0], 1.0), ([5.0, 1.0], 0.5)];
    let (z, spread) = (4.0, 0.09);
    let cells = |mean: [f64; 2], variance: f64| -> Vec<([f64; 2], f64)> {
        let step = 0.2 * f64::sqrt(variance);
        let offsets = || (-22..=22).map(move |k| step * f64::from(k));
        offsets()
            .flat_map(|i| offsets().map(move |j| [mean[0] + i, mean[1] + j]))
            .map(|x| (x, normal_density(&x, &mean, variance)))
            .collect()
    };
    let (first, second) = (cells(priors[0].0, priors[0].1), cells(priors[1].0, priors[1].1));
    let (mut total, mut exact) = (0.0, [0.0; 4]);
    for (x, own) in &first {
        for (y, other) in &second {
            let distance = (x[0] - y[0]).hypot(x[1] - y[1]);
            let mass = own * other * (-0.5 * (distance - z).powi(2) / spread).exp();
            total += mass;
            for (sum, value) in exact.iter_mut().zip([x[0], x[1], y[0], y[1]]) {
                *sum += mass * value;
            }
        }
    }
    let exact = exact.map(|sum| sum / total);

    let mut graph = FactorGraph::<AnyMessage>::new();
    let space = Space::real(2);
    let x = priors.map(|(mean, variance)| {
        let x = graph.unnamed_variable(space.clone());
        let covariance = [variance, 0.0, 0.0, variance];
        graph.set_prior(x, AnyMessage::gaussian(&space, &mean, &covariance).unwrap()).unwrap();
        x
    });
    let range = Range::new(z, [2, 2], [[0, 1], [0, 1]], Noise::isotropic(1, spread).unwrap()).unwrap();
    let factor = graph.add("range", range, &x).unwrap();
    for port in 0..2 {
        graph.set_edge_form(factor, port, AnyForm::particles(1000)).unwrap();
    }
    let runs: Vec<[f64; 4]> = (0..24)
        .map(|seed| {
            let options = Options { seed, max_iterations: 2, ..Options::default() };
            let mut engine = Engine::new(&graph, options).unwrap();
            engine.run(&mut Flooding).unwrap();
            let [a, b] = x.map(|x| engine.belief(x).moments().unwrap().mean);
            [a[0], a[1], b[0], b[1]]
        })
        .collect();
    for (k, exact) in exact.iter().enumerate() {
        let count = runs.len() as f64;
        let mean = runs.iter().map(|run| run[k]).sum::<f64>() / count;
        let variance = runs.iter().map(|run| (run[k] - mean).powi(2)).sum::<f64>() / (count - 1.0);
        let error = (variance / count).sqrt();
        assert!((mean - exact).abs() < 5.0 * error, "{mean} ± {error} for {exact}");
    }
}

#[test]
fn a_unary_factor_is_its_density_at_the_particles() {
    let mut draw = Draw::new(1002);
    let covariance = draw.covariance(2);
    let carrier = sample(&mut draw, &[0.0, 0.0], &covariance, 50);
    for heavy in [false, true] {
        let noise = Noise::gaussian(&rows(&covariance)).unwrap();
        let noise = if heavy { noise.student_t(3.0).unwrap() } else { noise };
        let prior = Model(ResidualModel(Prior::new(&Space::real(2), &[0.5, -0.2], noise.clone()).unwrap()));
        let one = [carrier.clone()];
        let message: Particles = send(&prior, 0, &one, &one, &ParticlesForm::new(50)).unwrap();
        for (point, log) in carrier.points().chunks(2).zip(message.log_weights()) {
            let exact = noise.log_density(&[point[0] - 0.5, point[1] + 0.2]);
            assert!((log - exact).abs() < 1e-12 * (1.0 + exact.abs()), "{log} {exact}");
        }
    }
}

/// However far from the measurement, the logs stay those of the formula.
#[test]
fn far_tails_keep_their_logs() {
    let carrier = Particles::equally_weighted(&Space::real(1), vec![0.0, 30.0, 100.0, 1e4, 1e8]).unwrap();
    let sender = Particles::new(&Space::real(1), vec![0.0, 1.0], vec![0.0, 0.0]).unwrap();
    for (noise, dimension) in [(Noise::isotropic(1, 0.5).unwrap(), 1), (Noise::isotropic(2, 0.5).unwrap(), 2)]
    {
        let ones = vec![1.0; dimension];
        let back = vec![-1.0; dimension];
        let factor = LinearGaussian::new(&[&ones, &back], &vec![0.0; dimension], noise.clone()).unwrap();
        let messages = [carrier.clone(), sender.clone()];
        let message =
            send(&Model(ResidualModel(factor)), 0, &messages, &messages, &ParticlesForm::new(2)).unwrap();
        for (&x, &log) in carrier.points().iter().zip(message.log_weights()) {
            let terms = [0.0, 1.0].map(|y: f64| noise.log_density(&vec![x - y; dimension]));
            let largest = terms[0].max(terms[1]);
            let sum: f64 = terms.iter().map(|term| (term - largest).exp()).sum();
            let exact = largest + (0.5 * sum).ln();
            assert!((log - exact).abs() < 1e-12 * (1.0 + exact.abs()), "at {x}: {log} for {exact}");
        }
    }
}

/// √(x y) - 1, which does not exist for x y < 0.
struct Root {
    noise: Noise,
}

impl Residual for Root {
    fn dimensions(&self) -> &[usize] {
        &[1, 1]
    }

    fn noise(&self) -> &Noise {
        &self.noise
    }

    fn residual<T: Real>(&self, x: &[&[T]], out: &mut [T]) {
        out.fill((x[0][0] * x[1][0]).sqrt() - 1.0);
    }
}

#[test]
fn a_residual_that_is_not_a_number_is_reported() {
    let line = |points: Vec<f64>| Particles::equally_weighted(&Space::real(1), points).unwrap();
    for noise in [
        Noise::isotropic(1, 0.1).unwrap(),
        Noise::isotropic(2, 0.1).unwrap(),
        Noise::isotropic(1, 0.1).unwrap().student_t(4.0).unwrap(),
    ] {
        let root = Model(ResidualModel(Root { noise }));
        for receiver in [vec![1.0, -1.0, 2.0], vec![-1.0]] {
            let messages = [line(receiver), line(vec![0.5, 0.8])];
            let error = send(&root, 0, &messages, &messages, &ParticlesForm::new(2)).unwrap_err();
            assert!(matches!(error, MessageError::NotFinite { what: "a log likelihood", .. }), "{error}");
        }
    }
}

/// Values of a function at points are no sample: nothing may be averaged over them.
#[test]
fn a_sender_with_values_alone_is_refused() {
    let line = |points: Vec<f64>| Particles::equally_weighted(&Space::real(1), points).unwrap();
    let own = line(vec![0.0, 1.0]);
    let values = Particles::likelihood(&line(vec![2.0, 3.0, 4.0]), vec![0.0, -1.0, -2.0]).unwrap();
    let factor = LinearGaussian::new(&[&[1.0], &[-1.0]], &[0.0], Noise::isotropic(1, 1.0).unwrap()).unwrap();
    let messages = [own, values];
    let error = send(&Model(ResidualModel(factor)), 0, &messages, &messages, &ParticlesForm::new(3));
    assert!(error.unwrap_err().to_string().contains("give it a prior"));
}

/// Radius and direction of 10,000 draws within 4.5 standard errors: four numbers, each wrong with probability 7e-6.
#[test]
fn a_ring_is_drawn_where_the_receiver_has_no_particles() {
    let (z, variance, anchor, count) = (20.0, 0.25, [3.0, -4.0], 10_000);
    let noise = Noise::isotropic(1, variance).unwrap();
    let ring = Model(ResidualModel(AnchorRange::new(z, anchor, 2, [1, 0], noise).unwrap()));
    let none = [<Particles as sumprod_graph::Message>::vacuous(&Space::real(2))];
    let drawn: Particles = send(&ring, 0, &none, &none, &ParticlesForm::new(count)).unwrap();
    assert_eq!((drawn.role(), drawn.len()), (Role::Sample, count));
    let offsets: Vec<[f64; 2]> =
        drawn.points().chunks(2).map(|point| [point[1] - anchor[0], point[0] - anchor[1]]).collect();
    let n = count as f64;
    let radii: Vec<f64> = offsets.iter().map(|[x, y]| x.hypot(*y)).collect();
    let mean = radii.iter().sum::<f64>() / n;
    let spread = radii.iter().map(|radius| (radius - z).powi(2)).sum::<f64>() / n;
    assert!((mean - z).abs() < 4.5 * (variance / n).sqrt(), "{mean}");
    assert!((spread - variance).abs() < 4.5 * variance * (2.0 / n).sqrt(), "{spread}");
    for k in 0..2 {
        let direction =
            offsets.iter().zip(&radii).map(|(offset, radius)| offset[k] / radius).sum::<f64>() / n;
        assert!(direction.abs() < 4.5 * (0.5 / n).sqrt(), "{direction}");
    }
}
