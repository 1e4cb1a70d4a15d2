//! A family of one's own: von Mises distributions of headings, and a factor that sends them.
//!
//! exp(a cos θ + b sin θ) is closed under products: (a, b) add. A heading turned by a noisy angle is not von
//! Mises again; it is matched by direction and mean resultant length. A grid says what that costs.

use sumprod::prelude::*;

#[derive(Clone, Copy)]
struct VonMises(f64, f64);

#[rustfmt::skip]
impl VonMises {
    fn new(mean: f64, kappa: f64) -> Self { Self(kappa * mean.cos(), kappa * mean.sin()) }
    fn times(self, m: &Self, power: f64) -> Self { Self(self.0 + power * m.0, self.1 + power * m.1) }
    fn mean(&self) -> f64 { self.1.atan2(self.0) }
    fn kappa(&self) -> f64 { self.0.hypot(self.1) }
    fn value(&self, t: f64) -> f64 { (self.0 * t.cos() + self.1 * t.sin() - self.kappa()).exp() }
    /// Mean resultant length I₁(κ) / I₀(κ) of concentration κ.
    fn resultant(&self) -> f64 {
        integral(|t| (t - self.mean()).cos() * self.value(t)) / integral(|t| self.value(t))
    }
}

/// The integral of a function over the circle, by the trapezoid rule.
fn integral(f: impl Fn(f64) -> f64) -> f64 {
    (0..360).map(|degree| f(f64::from(degree).to_radians())).sum::<f64>() * 1f64.to_radians()
}

#[rustfmt::skip]
impl Message for VonMises {
    type Form = ();
    fn vacuous(_: &Space) -> Self { Self(0.0, 0.0) }
    fn product(all: Messages<'_, Self>, _: &(), _: &mut Stream) -> Result<Self, MessageError> {
        Ok(all.iter().fold(Self(0.0, 0.0), |product, message| product.times(message, 1.0)))
    }
    fn quotient(&self, incoming: &Self) -> Option<Self> { Some(self.times(incoming, -1.0)) }
    fn change(&self, old: &Self) -> f64 { self.times(old, -1.0).kappa() / (1.0 + old.kappa()).sqrt() }
    fn check_form(_: &(), space: &Space) -> Result<(), String> {
        space.has_angles().then_some(()).ok_or("von Mises holds an angle".into())
    }
}

/// A turn from one heading (port 0) to the next (port 1), by an angle with this distribution.
struct Turn(VonMises);

#[rustfmt::skip]
impl Factor<VonMises> for Turn {
    fn dimensions(&self) -> &[usize] { &[1, 1] }
    fn message(&self, to: Port, x: &Incoming<'_, VonMises>, _: &(), _: &mut Stream)
        -> Result<VonMises, MessageError> {
        let (from, sign) = (x.message(1 - to), if to == 1 { 1.0 } else { -1.0 });
        let r = from.resultant() * self.0.resultant(); // whose κ is by Banerjee et al. (2005)
        Ok(VonMises::new(from.mean() + sign * self.0.mean(), r * (2.0 - r * r) / (1.0 - r * r)))
    }
}

/// Two compasses that disagree, at the ends of two turns; prints the heading between the turns.
pub fn main() -> Result<(), Box<dyn std::error::Error>> {
    let [first, last] = [VonMises::new(0.1, 4.0), VonMises::new(0.9, 2.0)];
    let [left, right] = [VonMises::new(0.9, 10.0), VonMises::new(-0.7, 6.0)];
    let mut graph = FactorGraph::<VonMises>::new();
    let mut heading = |name| graph.variable(name, Space::new([Coordinate::Angle]));
    let (start, middle, end) = (heading("start")?, heading("middle")?, heading("end")?);
    graph.set_prior(start, first)?;
    graph.set_prior(end, last)?;
    graph.factor("turn", Box::new(Turn(left)), &[start, middle])?;
    graph.factor("turn", Box::new(Turn(right)), &[middle, end])?;
    let mut engine = Engine::new(&graph, Options::default())?;
    engine.run(&mut ForwardBackward::new())?;
    let (mean, resultant) = (engine.belief(middle).mean(), engine.belief(middle).resultant());
    println!("von Mises: mean {mean:.4} rad, resultant length {resultant:.4}");
    let before = |m: f64| integral(|t| first.value(t) * left.value(m - t));
    let after = |m: f64| integral(|t| last.value(t) * right.value(t - m));
    let moment = |f: fn(f64) -> f64| integral(|m| f(m) * before(m) * after(m));
    let (total, cosine, sine) = (moment(|_| 1.0), moment(f64::cos), moment(f64::sin));
    let (exact, length) = (sine.atan2(cosine), cosine.hypot(sine) / total);
    println!("grid:      mean {exact:.4} rad, resultant length {length:.4}");
    ((mean - exact).abs() < 0.02).then_some(()).ok_or("the means are far apart".into())
}
