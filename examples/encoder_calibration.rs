//! A model that has nothing to do with positions: gain and offset of a sensor whose reading wraps around.
//!
//! A torsion encoder shows gain × load + offset, but only up to whole turns. One reading leaves a family of parallel
//! lines; these two, and the prior, leave three pairs of gain and offset that differ by whole turns. The factor is eight lines and knows nothing of
//! mixtures; the edges hold what it says as mixtures, and a grid says what is exact.

use sumprod::prelude::*;

struct Reading {
    load: f64,
    shown: f64,
    noise: Noise,
}

#[rustfmt::skip]
impl Residual for Reading {
    fn dimensions(&self) -> &[usize] { &[2] }
    fn noise(&self) -> &Noise { &self.noise }
    fn angles(&self) -> &[usize] { &[0] }
    fn residual<T: Real>(&self, x: &[&[T]], out: &mut [T]) { out[0] = x[0][0] * self.load + x[0][1] - self.shown; }
}

const READINGS: [(f64, f64); 2] = [(1.0, 1.45), (6.0, 1.2)];
const SPREAD: [f64; 2] = [1.0, 1.0];

/// Log of the posterior at a gain and an offset, up to a constant.
fn log_exact(gain: f64, offset: f64) -> f64 {
    let prior = ((gain - 1.0) / SPREAD[0]).powi(2) + (offset / SPREAD[1]).powi(2);
    let turn = std::f64::consts::TAU;
    let miss = |(load, shown): (f64, f64)| {
        let away = gain * load + offset - shown;
        ((away - turn * (away / turn).round()) / 0.2).powi(2)
    };
    -0.5 * (prior + READINGS.into_iter().map(miss).sum::<f64>())
}

/// Prints what remains and how far the belief is from the exact posterior; an error where it is far.
pub fn main() -> Result<(), Box<dyn std::error::Error>> {
    let space = Space::real(2);
    let mut graph = FactorGraph::<MixtureMessage>::new();
    let calibration = graph.variable("gain and offset", space.clone())?;
    let covariance = vec![SPREAD[0].powi(2), 0.0, 0.0, SPREAD[1].powi(2)];
    let prior = Mixture::with_shared_covariance(&space, vec![0.0], vec![1.0, 0.0], covariance)?;
    graph.set_prior(calibration, prior.into())?;
    for (load, shown) in READINGS {
        let reading = Reading { load, shown, noise: Noise::isotropic(1, 0.04)? };
        let reading = graph.add("reading", reading, &[calibration])?;
        graph.set_edge_form(reading, 0, MixtureForm::new(300))?;
    }
    let mut engine = Engine::new(&graph, Options { max_iterations: 2, ..Options::default() })?;
    engine.run(&mut Sequential::default())?;
    let belief = engine.belief(calibration).to_density()?;
    let (mut found, mut exact) = (Vec::new(), Vec::new());
    for k in 0..250_000 {
        let (gain, offset) = (-1.5 + 0.01 * f64::from(k % 500), -4.0 + 0.016 * f64::from(k / 500));
        found.push(belief.log_density(&[gain, offset])?.exp());
        exact.push(log_exact(gain, offset).exp());
    }
    let (all, total) = (found.iter().sum::<f64>(), exact.iter().sum::<f64>());
    let distance = 0.5 * found.iter().zip(&exact).map(|(a, b)| (a / all - b / total).abs()).sum::<f64>();
    for mode in belief.modes(400, &mut Stream::new(1, 0, Purpose::User(0), 0))?.iter().take(4) {
        let (gain, offset) = (mode.location[0], mode.location[1]);
        println!("gain {gain:.3}, offset {offset:+.3} rad: {:.1} %", 100.0 * mode.mass);
    }
    println!("{} components, {distance:.3} from the exact posterior (total variation)", belief.len());
    (distance < 0.1).then_some(()).ok_or("the belief is far from the exact posterior".into())
}
