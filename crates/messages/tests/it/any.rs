//! Messages of mixed families: products, conversions, and what these cost.

use rand_distr::{Distribution, StandardNormal};
use sumprod_graph::schedule::Flooding;
use sumprod_graph::{
    Coordinate, Engine, Factor, FactorGraph, Incoming, Message, MessageError, Messages, Options, Port,
    Purpose, Space, Stream,
};
use sumprod_messages::{AnyForm, AnyMessage, AnyValue, DynamicGaussian, Moments, Particles};

fn stream(entity: u64) -> Stream {
    Stream::new(23, 0, Purpose::User(2), entity)
}

fn plane() -> Space {
    Space::real(2)
}

fn product(messages: &[AnyMessage], form: &AnyForm, entity: u64) -> Result<AnyMessage, MessageError> {
    let edges: Vec<u32> = (0..messages.len() as u32).collect();
    AnyMessage::product(Messages::new(messages, &edges), form, &mut stream(entity))
}

fn gaussian(mean: [f64; 2], covariance: [f64; 4]) -> AnyMessage {
    AnyMessage::gaussian(&plane(), &mean, &covariance).unwrap()
}

/// Three Gaussian messages, the last of rank one.
fn three() -> [AnyMessage; 3] {
    let ray = DynamicGaussian::from_information(&[2.0, -1.0, -1.0, 0.5], &[3.0, -1.5]).unwrap();
    [
        gaussian([1.0, -1.0], [2.0, 0.5, 0.5, 1.0]),
        gaussian([0.0, 0.5], [1.0, -0.3, -0.3, 3.0]),
        AnyMessage::from_gaussian(&plane(), ray).unwrap(),
    ]
}

fn exact(messages: &[AnyMessage]) -> Moments {
    product(messages, &AnyForm::gaussian(), 0).unwrap().moments().unwrap()
}

/// A sample of `count` points of a Gaussian, without the density it was drawn from.
fn sample(message: &AnyMessage, count: usize, entity: u64) -> AnyMessage {
    let (drawn, _) = message.to_particles(count, &mut stream(entity)).unwrap();
    let plain = Particles::equally_weighted(&plane(), drawn.points().to_vec()).unwrap();
    AnyMessage::from_particles(plain)
}

/// The mean within four Monte Carlo standard errors, by the effective sample size: for both coordinates together
/// a failure once in 8,000 seeds. Variances within four of theirs, sqrt(2 / n) relative for a Gaussian.
fn assert_moments(message: &AnyMessage, exact: &Moments) {
    let found = message.moments().unwrap();
    let n = message.quality().effective_sample_size.unwrap();
    assert!(n > 100.0, "too few effective particles to compare: {n}");
    for k in 0..2 {
        let variance = exact.covariance_at(k, k);
        let error = (found.mean[k] - exact.mean[k]).abs() / (variance / n).sqrt();
        assert!(error < 4.0, "mean {k} is {error} standard errors off");
        let error = (found.covariance_at(k, k) / variance - 1.0).abs() / (2.0 / n).sqrt();
        assert!(error < 4.0, "variance {k} is {error} standard errors off");
    }
}

#[test]
fn gaussian_messages_obey_the_laws() {
    let [a, b, c] = three();
    let form = AnyForm::gaussian();
    let all = product(&[a.clone(), b.clone(), c.clone()], &form, 0).unwrap();
    let close = |x: &AnyMessage, y: &AnyMessage| assert!(x.change(y) < 1e-7, "{}", x.change(y));
    close(&product(&[c.clone(), a.clone(), b.clone()], &form, 0).unwrap(), &all);
    close(&all.quotient(&c).unwrap(), &product(&[a.clone(), b.clone()], &form, 0).unwrap());
    let vacuous = AnyMessage::vacuous(&plane());
    assert_eq!(product(&[vacuous.clone(), a.clone()], &form, 0).unwrap(), a);
    assert_eq!(product(&[a.clone(), vacuous], &form, 0).unwrap(), a);
    assert_eq!(all.change(&all), 0.0);
    assert_eq!(all.quality().conversion_loss, None, "nothing was converted");
    // Against the family alone.
    let of = |message: &AnyMessage| message.to_gaussian().unwrap().0;
    let sum = DynamicGaussian::product(
        Messages::new(&[of(&a), of(&b), of(&c)], &[0, 1, 2]),
        &Default::default(),
        &mut stream(0),
    );
    assert_eq!(all.value(), &AnyValue::Gaussian(sum.unwrap()));
    let mut damped = a.clone();
    assert!(damped.damp(&b, 0.5));
    let (x, y, z) = (of(&a), of(&b), of(&damped));
    for k in 0..2 {
        let middle = 0.5 * (x.information_vector()[k] + y.information_vector()[k]);
        assert!((z.information_vector()[k] - middle).abs() < 1e-14);
    }
}

#[test]
fn particle_messages_obey_the_laws() {
    let [a, b, _] = three();
    let base = sample(&a, 50, 1);
    let form = AnyForm::particles(50);
    let vacuous = AnyMessage::vacuous(&plane());
    for messages in [[base.clone(), vacuous.clone()], [vacuous.clone(), base.clone()]] {
        assert!(product(&messages, &form, 0).unwrap().change(&base) < 1e-12);
    }
    let both = product(&[base.clone(), b.clone()], &form, 0).unwrap();
    assert!(both.change(&product(&[b.clone(), base.clone()], &form, 0).unwrap()) < 1e-12);
    assert!(both.change(&base) > 0.01);
    assert!(both.quotient(&b).unwrap().change(&base) < 1e-12, "a Gaussian divides out of particles");
    assert!(both.quotient(&vacuous).unwrap().change(&both) < 1e-12);
    assert!(both.quotient(&base).is_none(), "a sample does not divide out of itself");
    let likelihood =
        Particles::likelihood(base.particles().unwrap(), (0..50).map(|k| -0.1 * f64::from(k)).collect());
    let likelihood = AnyMessage::from_particles(likelihood.unwrap());
    let all = product(&[likelihood.clone(), b.clone(), base.clone()], &form, 0).unwrap();
    assert!(all.quotient(&likelihood).unwrap().change(&both) < 1e-12);
    assert_eq!((all.change(&all), base.change(&b)), (0.0, 1.0));
    let mut damped = all.clone();
    assert!(damped.damp(&base, 0.5));
    let logs = |message: &AnyMessage| message.particles().unwrap().log_weights().to_vec();
    for ((own, new), old) in logs(&damped).iter().zip(logs(&all)).zip(logs(&base)) {
        assert!((own - 0.5 * (new + old)).abs() < 1e-12);
    }
}

#[test]
fn particles_drawn_from_gaussian_messages_have_their_product_s_moments() {
    let messages = three();
    let drawn = product(&messages, &AnyForm::particles(4000), 3).unwrap();
    assert_eq!(drawn.particles().unwrap().len(), 4000);
    assert_moments(&drawn, &exact(&messages));
    let loss = drawn.quality().conversion_loss.unwrap();
    assert!(loss > 0.0 && loss < 0.01, "{loss}");
    // An improper product cannot be drawn from: it waits as a Gaussian.
    let waiting = product(&messages[2..], &AnyForm::particles(100), 3).unwrap();
    assert!(waiting.particles().is_none() && !waiting.is_proper());
}

#[test]
fn a_sample_weighted_by_gaussian_messages_has_the_product_s_moments() {
    let [a, b, c] = three();
    let exact = exact(&[a.clone(), b.clone(), c.clone()]);
    let base = sample(&a, 20_000, 4);
    let mixed = product(&[c, base, b], &AnyForm::particles(20_000), 5).unwrap();
    // Weighted draws vary more than their effective sample size says where weights and values are tied; the
    // weights here are bounded.
    assert_moments(&mixed, &exact);
}

#[test]
fn a_belief_drawn_from_gaussians_and_weighted_by_likelihoods_has_the_right_moments() {
    let [a, b, c] = three();
    let form = AnyForm::particles(20_000);
    let drawn = product(&[a.clone(), b.clone()], &form, 6).unwrap();
    let carrier = drawn.particles().unwrap();
    // The third message as its values at the belief's points.
    let gaussian = c.to_gaussian().unwrap().0;
    let values = (0..carrier.len()).map(|k| gaussian.log_value(carrier.point(k))).collect();
    let likelihood = AnyMessage::from_particles(Particles::likelihood(carrier, values).unwrap());
    let exact = exact(&[a.clone(), b.clone(), c]);
    let belief = product(&[a.clone(), likelihood.clone(), b.clone()], &form, 7).unwrap();
    assert!(belief.particles().unwrap().same_support(carrier), "the points stay");
    assert_moments(&belief, &exact);
    // The same where one of the Gaussians has changed since the points were drawn.
    let wider = gaussian_wider();
    let exact = self::exact(&[wider.clone(), b.clone(), three()[2].clone()]);
    assert_moments(&product(&[wider, likelihood, b], &form, 8).unwrap(), &exact);
}

fn gaussian_wider() -> AnyMessage {
    gaussian([1.3, -0.8], [2.2, 0.5, 0.5, 1.1])
}

#[test]
fn conversions_say_what_they_cost() {
    let [a, ..] = three();
    assert_eq!(a.to_gaussian().unwrap().1, 0.0);
    let near = sample(&a, 4000, 9);
    assert_eq!(near.to_particles(10, &mut stream(0)).unwrap().1, 0.0);
    let (gaussian, small) = near.to_gaussian().unwrap();
    // Under a Gaussian the loss is about (d / n)(6 / 12 + 24 / 48) = 5e-4 in the mean, exponential in its tail.
    assert!((0.0..0.005).contains(&small), "{small}");
    let (found, exact) = (gaussian.moments().unwrap(), a.moments().unwrap());
    assert!((found.mean[0] - exact.mean[0]).abs() < 4.0 * (exact.covariance[0] / 4000.0).sqrt());

    let mut random = stream(10).fast();
    let mut points = Vec::new();
    for k in 0..4000 {
        let z: f64 = StandardNormal.sample(&mut random);
        points.extend([if k % 2 == 0 { 5.0 } else { -5.0 } + z, StandardNormal.sample(&mut random)]);
    }
    let split = AnyMessage::from_particles(Particles::equally_weighted(&plane(), points).unwrap());
    let (_, large) = split.to_gaussian().unwrap();
    // The excess kurtosis of two modes 5 deviations from their middle is -2 (25 / 26)² = -1.85.
    assert!((large - 1.85f64.powi(2) / 48.0).abs() < 0.01 && large > 10.0 * small, "{large}");
    let product = product(&[split, a], &AnyForm::gaussian(), 0).unwrap();
    assert_eq!(product.quality().conversion_loss, Some(large));
    assert_eq!(product.quality().effective_sample_size, None);
}

#[test]
fn a_heading_near_the_cut_costs_no_more_than_another() {
    let space = Space::new([Coordinate::Angle]);
    let loss = |mean: f64| {
        let heading = AnyMessage::gaussian(&space, &[mean], &[0.04]).unwrap();
        let (particles, loss) = heading.to_particles(2000, &mut stream(12)).unwrap();
        assert!(particles.points().iter().all(|x| x.abs() <= std::f64::consts::PI));
        loss
    };
    let plain = loss(0.0);
    for mean in [std::f64::consts::PI, 3.1, -3.1, 7.0] {
        assert!((loss(mean) - plain).abs() < 1e-9, "{} at {mean}, {plain} at 0", loss(mean));
    }
    // Weighing by a message on the other side of the cut.
    let heading = |mean: f64| AnyMessage::gaussian(&space, &[mean], &[0.04]).unwrap();
    let (drawn, _) = heading(3.1).to_particles(20_000, &mut stream(13)).unwrap();
    let drawn =
        AnyMessage::from_particles(Particles::equally_weighted(&space, drawn.points().to_vec()).unwrap());
    let mixed = product(&[drawn, heading(-3.1)], &AnyForm::particles(20_000), 0).unwrap();
    let off = sumprod_graph::wrap_angle(mixed.moments().unwrap().mean[0] - std::f64::consts::PI);
    // Four standard errors at an effective size above 10,000.
    assert!(off.abs() < 4.0 * (0.02f64 / 10_000.0).sqrt(), "{off}");
}

#[test]
fn what_has_no_moments_says_so() {
    let set = sample(&three()[0], 3, 14);
    let none = f64::NEG_INFINITY;
    let values = |values: Vec<f64>| {
        AnyMessage::from_particles(Particles::likelihood(set.particles().unwrap(), values).unwrap())
    };
    let likelihood = values(vec![0.0, -1.0, -2.0]);
    assert!(matches!(likelihood.moments(), Err(MessageError::Unsupported(_))));
    let error = product(&[likelihood, set.clone()], &AnyForm::gaussian(), 0).unwrap_err();
    assert!(error.to_string().contains("hold this belief in particles"), "{error}");
    let clash = [set.clone(), values(vec![0.0, none, none]), values(vec![none, 0.0, 0.0])];
    let error = product(&clash, &AnyForm::particles(3), 0).unwrap_err();
    assert!(matches!(error, MessageError::NoWeight { .. }), "{error}");
    assert!(AnyMessage::check_form(&AnyForm::particles(0), &plane()).unwrap_err().contains("is 0"));
    assert!(AnyMessage::check_form(&AnyForm::particles(5), &plane()).is_ok());
    assert!(AnyMessage::check_form(&AnyForm::gaussian(), &Space::finite(2)).is_err());
    assert!(matches!(
        AnyMessage::gaussian(&Space::real(3), &[0.0; 2], &[1.0, 0.0, 0.0, 1.0]),
        Err(MessageError::Dimension { found: 2, expected: 3, .. })
    ));
    assert!(AnyMessage::vacuous(&plane()).to_particles(5, &mut stream(0)).unwrap().0.is_empty());
}

/// Sends the same message always.
pub struct Says(pub AnyMessage);

impl Factor<AnyMessage> for Says {
    fn dimensions(&self) -> &[usize] {
        &[2]
    }

    fn message(
        &self,
        _to: Port,
        _incoming: &Incoming<'_, AnyMessage>,
        _form: &AnyForm,
        _stream: &mut Stream,
    ) -> Result<AnyMessage, MessageError> {
        Ok(self.0.clone())
    }
}

#[test]
fn flooding_multiplies_what_it_cannot_divide() {
    let [a, b, _] = three();
    let (first, second) = (sample(&a, 800, 15), sample(&b, 800, 16));
    for (edge, parallel) in [(AnyForm::gaussian(), true), (AnyForm::particles(800), false)] {
        let mut graph: FactorGraph<AnyMessage, Says> = FactorGraph::new();
        for k in 0..20 {
            let x = graph.variable(format!("x{k}"), plane()).unwrap();
            for message in [&first, &second] {
                let factor = graph.factor("says", Says(message.clone()), &[x]).unwrap();
                graph.set_edge_form(factor, 0, edge).unwrap();
            }
        }
        let options = Options { parallel, max_iterations: 4, tolerance: 0.0, ..Options::default() };
        let mut engine = Engine::new(&graph, options).unwrap();
        let report = engine.run(&mut Flooding).unwrap();
        assert_eq!(report.changes.last(), Some(&0.0));
        let expected = exact(&[a.clone(), b.clone()]);
        for x in graph.variable_ids() {
            let found = engine.belief(x).moments().unwrap();
            // Four standard errors at 400 effective particles; the messages' means are 1 and 1.5 apart.
            assert!((found.mean[0] - expected.mean[0]).abs() < 0.2, "{:?} {:?}", found.mean, expected.mean);
            assert!((found.mean[1] - expected.mean[1]).abs() < 0.2, "{:?} {:?}", found.mean, expected.mean);
        }
    }
}

#[test]
fn headings_on_either_side_of_the_cut_are_near() {
    let heading = Space::new([Coordinate::Angle]);
    let near = |mean: f64| AnyMessage::gaussian(&heading, &[mean], &[0.01]).unwrap();
    let belief = product(&[near(3.1), near(-3.1)], &AnyForm::gaussian(), 0).unwrap().moments().unwrap();
    let distance = (belief.mean[0] - std::f64::consts::PI).abs();
    assert!(distance < 1e-12, "{}", belief.mean[0]);
    assert!((belief.covariance[0] - 0.005).abs() < 1e-15);
}
