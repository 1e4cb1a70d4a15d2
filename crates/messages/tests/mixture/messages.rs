//! Mixtures on edges: the laws of the family, conversions, and what is refused.

use sumprod_graph::schedule::Flooding;
use sumprod_graph::{
    Coordinate, Engine, FactorGraph, Incoming, Message, MessageError, Messages, Options, Port, Purpose,
    Space, Stream,
};
use sumprod_messages::{
    AnyForm, AnyMessage, DynamicGaussian, Mixture, MixtureForm, MixtureMessage, Particles, Potential,
};

fn stream(entity: u64) -> Stream {
    Stream::new(7, 0, Purpose::User(4), entity)
}

fn product(messages: &[MixtureMessage], components: usize) -> Result<MixtureMessage, MessageError> {
    let edges: Vec<u32> = (0..messages.len() as u32).collect();
    MixtureMessage::product(Messages::new(messages, &edges), &MixtureForm::new(components), &mut stream(0))
}

/// A density of three components on a position and a velocity.
fn density() -> MixtureMessage {
    let means = vec![0.0, 1.0, 3.0, -1.0, -2.0, 0.5];
    let covariances = vec![1.0, 0.3, 0.3, 0.6, 0.5, 0.0, 0.0, 1.0, 2.0, -0.4, -0.4, 0.5];
    Mixture::new(&Space::real(2), vec![0.0, 0.5, -0.5], means, covariances).unwrap().into()
}

/// Two strips that read the position alone.
fn open(at: [f64; 2]) -> MixtureMessage {
    let mut potential = Potential::new(&[Coordinate::Real; 2]);
    for (k, x) in at.into_iter().enumerate() {
        potential.push(-0.3 * k as f64, &[x, 9.0], &[0.2, 0.0], &[2.0, 0.0, 0.0, 0.0]);
    }
    potential.checked("a strip").unwrap().into()
}

const POINTS: [[f64; 2]; 4] = [[0.3, 0.4], [2.0, -1.5], [-2.5, 1.0], [1.0, 1.0]];

/// Differences of log values from the first point's, where constants cancel.
fn shape(message: impl Fn(&[f64]) -> f64) -> Vec<f64> {
    POINTS.iter().map(|x| message(x) - message(&POINTS[0])).collect()
}

#[track_caller]
fn same(a: &[f64], b: &[f64]) {
    assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-8), "{a:?} {b:?}");
}

#[test]
fn products_are_pointwise_whatever_the_rank_and_the_order() {
    let flat = MixtureMessage::vacuous(&Space::real(2));
    let gaussian = DynamicGaussian::from_information(&[0.0, 0.0, 0.0, 0.7], &[0.0, 0.2]).unwrap();
    let gaussian = MixtureMessage::from_gaussian(&[Coordinate::Real; 2], &gaussian);
    let factors = [density(), open([0.0, 2.0]), flat, open([-1.0, 1.5]), gaussian];
    let exact = shape(|x| factors.iter().map(|factor| factor.log_value(x).unwrap()).sum());
    for order in [[0, 1, 2, 3, 4], [4, 3, 2, 1, 0], [2, 1, 4, 0, 3]] {
        let messages: Vec<MixtureMessage> = order.iter().map(|&k| factors[k].clone()).collect();
        let found = product(&messages, 1000).unwrap();
        assert!(found.density().is_some());
        // Kept components are merged up to a thousandth of a nat.
        let shape = shape(|x| found.log_value(x).unwrap());
        assert!(shape.iter().zip(&exact).all(|(a, b)| (a - b).abs() < 0.02), "{shape:?} {exact:?}");
    }
    // Without a prior the product stays open, and is still pointwise.
    let strips = product(&factors[1..4], 1000).unwrap();
    assert!(strips.density().is_none() && strips.potential().is_some());
    let exact = shape(|x| factors[1..4].iter().map(|factor| factor.log_value(x).unwrap()).sum());
    same(&shape(|x| strips.log_value(x).unwrap()), &exact);
}

#[test]
fn a_gaussian_can_be_taken_out_again_and_a_mixture_not() {
    let gaussian = DynamicGaussian::from_moments(&[1.0, 0.0], &[4.0, 1.0, 1.0, 3.0]).unwrap();
    let gaussian = MixtureMessage::from_gaussian(&[Coordinate::Real; 2], &gaussian);
    let both = product(&[density(), gaussian.clone()], 10).unwrap();
    let back = both.quotient(&gaussian).unwrap();
    same(&shape(|x| back.log_value(x).unwrap()), &shape(|x| density().log_value(x).unwrap()));
    assert!(both.quotient(&open([0.0, 1.0])).is_none());
    assert_eq!(density().change(&density()), 0.0);
    let mut damped = density();
    assert!(damped.damp(&both, 0.25));
    assert!(damped.change(&density()) > 0.0 && damped.change(&density()) < both.change(&density()));
}

#[test]
fn conversions_say_what_they_cost() {
    let (gaussian, loss) = density().to_gaussian().unwrap();
    let exact = density().moments().unwrap();
    same(&gaussian.moments().unwrap().mean, &exact.mean);
    // By quadrature over the plane.
    let mut divergence = 0.0;
    let height = gaussian.log_value(&exact.mean);
    let log_peak = -0.5 * (exact.covariance[0] * exact.covariance[3] - exact.covariance[1].powi(2)).ln()
        - std::f64::consts::TAU.ln();
    for k in 0..40_000 {
        let x = [-10.0 + 0.1 * f64::from(k % 200), -8.0 + 0.08 * f64::from(k / 200)];
        let p = density().log_value(&x).unwrap();
        divergence += 0.008 * p.exp() * (p - (gaussian.log_value(&x) - height + log_peak));
    }
    assert!(loss > 0.0 && (loss - divergence).abs() < 0.3 * divergence + 0.02, "{loss} {divergence}");
    let (particles, cost) = density().to_particles(4000, &mut stream(1)).unwrap();
    assert!(cost < 0.01 && particles.len() == 4000);
    let (kernels, cost) = MixtureMessage::from_particles(&particles, &MixtureForm::new(40)).unwrap();
    assert!(kernels.len() <= 40 && cost.is_finite());
    assert!((kernels.moments().unwrap().mean[0] - exact.mean[0]).abs() < 0.1);
    // A strip is a Gaussian of rank one on what it reads.
    let (strip, loss) = open([0.0, 2.0]).to_gaussian().unwrap();
    assert!(loss > 0.0 && strip.information_at(1, 1) == 0.0 && strip.information_at(0, 0) > 0.0);
    assert!(open([0.0, 2.0]).to_particles(10, &mut stream(2)).is_err());
}

#[test]
fn a_particle_belief_is_weighed_by_a_mixture() {
    let space = Space::real(2);
    let points: Vec<f64> = POINTS.concat();
    let sample = AnyMessage::from_particles(Particles::equally_weighted(&space, points).unwrap());
    let messages = [sample, AnyMessage::from_mixture(open([0.0, 2.0]))];
    let found =
        AnyMessage::product(Messages::new(&messages, &[0, 1]), &AnyForm::particles(4), &mut stream(3))
            .unwrap();
    let particles = found.particles().unwrap();
    let logs: Vec<f64> = particles.log_weights().iter().map(|log| log - particles.log_weights()[0]).collect();
    same(&logs, &shape(|x| open([0.0, 2.0]).log_value(x).unwrap()));
    let back = found.quotient(&messages[1]).unwrap();
    assert!((back.quality().effective_sample_size.unwrap() - 4.0).abs() < 1e-9);
}

#[test]
fn what_is_no_mixture_is_refused() {
    let line = Space::real(1);
    let refused = |mixture: Result<Mixture, MessageError>| mixture.unwrap_err().to_string();
    assert!(refused(Mixture::new(&line, vec![], vec![], vec![])).contains("at least one component"));
    let weightless = Mixture::new(&line, vec![f64::NEG_INFINITY], vec![0.0], vec![1.0]);
    assert!(refused(weightless).contains("every weight is zero"));
    assert!(refused(Mixture::new(&line, vec![f64::NAN], vec![0.0], vec![1.0])).contains("NaN"));
    assert!(refused(Mixture::new(&line, vec![0.0], vec![0.0], vec![0.0])).contains("not positive definite"));
    let mut potential = Potential::new(&[Coordinate::Real]);
    assert!(potential.clone().checked("it").is_err());
    potential.push(0.0, &[f64::INFINITY], &[0.0], &[1.0]);
    assert!(potential.checked("it").is_err());
    assert!(MixtureMessage::check_form(&MixtureForm::new(0), &line).unwrap_err().contains("is 0"));
    assert!(MixtureMessage::check_form(&MixtureForm::new(5), &Space::finite(3)).is_err());
}

/// A factor that always says the same.
struct Says(MixtureMessage);

impl sumprod_graph::Factor<MixtureMessage> for Says {
    fn dimensions(&self) -> &[usize] {
        &[1]
    }
    fn message(
        &self,
        _to: Port,
        _incoming: &Incoming<'_, MixtureMessage>,
        _form: &MixtureForm,
        _stream: &mut Stream,
    ) -> Result<MixtureMessage, MessageError> {
        Ok(self.0.clone())
    }
}

#[test]
fn a_graph_names_the_variable_whose_messages_have_disjoint_supports() {
    let line = Space::real(1);
    let around = |at: f64| -> MixtureMessage {
        Mixture::with_shared_covariance(&line, vec![0.0, 0.0], vec![at, at + 1.0], vec![1.0]).unwrap().into()
    };
    let mut graph = FactorGraph::<MixtureMessage>::new();
    let x = graph.variable("torn", line.clone()).unwrap();
    for at in [0.0, 1e4] {
        graph.factor("says", Box::new(Says(around(at))), &[x]).unwrap();
    }
    let error = Engine::new(&graph, Options::default()).unwrap().run(&mut Flooding).unwrap_err().to_string();
    assert!(error.contains("\"torn\"") && error.contains("disjoint supports"), "{error}");
}

#[test]
fn a_run_reports_the_modes_before_and_after_a_product_and_what_chose_it() {
    let line = Space::real(1);
    let around = |means: [f64; 2]| -> MixtureMessage {
        Mixture::with_shared_covariance(&line, vec![0.0, 0.0], means.to_vec(), vec![1.0]).unwrap().into()
    };
    let mut graph = FactorGraph::<MixtureMessage>::new();
    let x = graph.variable("x", line.clone()).unwrap();
    // Both have two modes, of which they share one.
    for means in [[0.0, 8.0], [-8.0, 0.1]] {
        graph.factor("says", Box::new(Says(around(means))), &[x]).unwrap();
    }
    let mut engine = Engine::new(&graph, Options::default()).unwrap();
    let report = engine.run(&mut Flooding).unwrap();
    let edges: Vec<Option<usize>> = report.quality.edges.iter().map(|(_, quality)| quality.modes).collect();
    assert_eq!(edges, [Some(2), Some(2)]);
    let product = report.quality.belief(x).unwrap().product.unwrap();
    assert_eq!((product.modes_before, product.modes_after), (Some(2), Some(1)));
    assert_eq!(
        (product.method, product.reason, product.divergence),
        ("exact", Some("few label choices"), Some(0.0))
    );
    assert!(report.to_string().contains("products are within 0.00e0 nats"), "{report}");
}

#[test]
fn a_sample_that_could_be_a_gaussians_is_read_as_one_and_two_modes_are_not() {
    let plane = Space::real(2);
    let form = MixtureForm::new(40);
    let one = Mixture::with_shared_covariance(&plane, vec![0.0], vec![1.0, -2.0], vec![2.0, 0.6, 0.6, 1.0])
        .unwrap();
    let particles = one.sample(2000, &mut stream(31)).unwrap();
    let (read, loss) = MixtureMessage::from_particles(&particles, &form).unwrap();
    assert_eq!(read.len(), 1);
    assert!(loss < 0.02);
    // Kernels would be wider than the sample.
    let (found, moments) = (read.moments().unwrap().covariance, particles.moments().covariance);
    assert!(found.iter().zip(&moments).all(|(a, b)| (a - b).abs() < 1e-6));
    // Modes two standard deviations from the middle, along a diagonal.
    let means = vec![-2.0, -2.0, 2.0, 2.0];
    let two = Mixture::with_shared_covariance(&plane, vec![0.0; 2], means, vec![2.0, 0.0, 0.0, 2.0]).unwrap();
    let (read, _) =
        MixtureMessage::from_particles(&two.sample(2000, &mut stream(32)).unwrap(), &form).unwrap();
    assert_eq!(read.density().unwrap().regions().unwrap(), Some(2));
}
