//! A factor of one's own: a residual and its noise, from which every form of message follows.
//!
//! A source emits a signal, which a receiver hears later than an anchor does; the delay times its speed is a
//! difference of distances. Neither the source nor the receiver is known exactly.

use sumprod::models::check_residual;
use sumprod::prelude::*;

struct RangeDifference {
    anchor: [f64; 2],
    measured: f64,
    noise: Noise,
}

#[rustfmt::skip]
impl Residual for RangeDifference {
    fn dimensions(&self) -> &[usize] { &[2, 2] }
    fn noise(&self) -> &Noise { &self.noise }
    fn residual<T: Real>(&self, x: &[&[T]], out: &mut [T]) {
        let distance = |p: &[T]| ((x[0][0] - p[0]).powi(2) + (x[0][1] - p[1]).powi(2)).sqrt();
        out[0] = distance(x[1]) - distance(&self.anchor.map(T::from)) - self.measured;
    }
}

const ANCHORS: [[f64; 2]; 3] = [[0.0, 0.0], [0.0, 80.0], [100.0, 90.0]];
const RECEIVER: [f64; 2] = [60.0, 10.0];
const SOURCE: [f64; 2] = [40.0, 40.0];

/// Locates one source per form, all heard by the same receiver, and prints what each form costs.
pub fn main() -> Result<(), Box<dyn std::error::Error>> {
    let sigma = AnyForm::Gaussian(GaussianForm { linearisation: Linearisation::SigmaPoints });
    let (gaussian, particles) = (AnyForm::gaussian(), AnyForm::particles(1000));
    let forms = [
        ("gaussian", [gaussian, gaussian]),
        ("sigma points", [sigma, sigma]),
        ("particles", [particles, particles]),
        ("particles to the source alone", [particles, gaussian]),
    ];
    let plane = Space::real(2);
    let round = |mean, variance| AnyMessage::gaussian(&plane, mean, &[variance, 0.0, 0.0, variance]);
    let mut graph = FactorGraph::<AnyMessage>::new();
    let receiver = graph.variable("receiver", plane.clone())?;
    graph.set_prior(receiver, round(&[59.0, 11.0], 4.0)?)?;
    let mut edges = Vec::new();
    for (name, forms) in forms {
        let source = graph.variable(name, plane.clone())?;
        graph.set_prior(source, round(&[43.0, 37.0], 25.0)?)?;
        for anchor in ANCHORS {
            let to = |p: [f64; 2]| (SOURCE[0] - p[0]).hypot(SOURCE[1] - p[1]);
            let measured = to(RECEIVER) - to(anchor);
            let factor = RangeDifference { anchor, measured, noise: Noise::isotropic(1, 1.0)? };
            check_residual(&factor, &[&SOURCE, &RECEIVER], 1e-6)?;
            let factor = graph.add("range difference", factor, &[source, receiver])?;
            for (port, form) in forms.into_iter().enumerate() {
                graph.set_edge_form(factor, port, form)?;
                edges.push(graph.edge(factor, port)?);
            }
        }
    }

    let mut engine =
        Engine::new(&graph, Options { max_iterations: 20, tolerance: 0.05, ..Options::default() })?;
    println!("{}", engine.run(&mut Flooding)?);
    println!("form                           error (m)  deviation (m)  N_eff  largest loss (nats)");
    for ((name, _), edges) in forms.iter().zip(edges.chunks(2 * ANCHORS.len())) {
        let belief = engine.belief(graph.find(name).ok_or("no such variable")?);
        let answer = belief.moments()?;
        let error = (answer.mean[0] - SOURCE[0]).hypot(answer.mean[1] - SOURCE[1]);
        let deviation = (answer.covariance_at(0, 0) + answer.covariance_at(1, 1)).sqrt();
        let samples = belief.quality().effective_sample_size.map_or("-".into(), |n| format!("{n:.0}"));
        let losses = edges.iter().map(|&edge| engine.edge_quality(edge)).chain([belief.quality()]);
        let lost = losses.filter_map(|quality| quality.conversion_loss).fold(0.0, f64::max);
        println!("{name:30} {error:9.2}  {deviation:13.2}  {samples:>5}  {lost:19.4}");
        if error > 3.0 * deviation {
            return Err(format!("{name}: the error is more than three deviations").into());
        }
    }
    Ok(())
}
