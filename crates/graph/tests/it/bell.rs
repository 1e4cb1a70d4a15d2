//! A family outside the workspace's own: Gaussians of one coordinate in information form, and factors for it.

use serde::{Deserialize, Serialize};
use std::sync::atomic::{AtomicU64, Ordering};
use sumprod_graph::{
    Engine, Factor, FactorGraph, Incoming, Message, MessageError, Messages, Options, Port, Schedule, Space,
    Stream, VariableId,
};

/// exp(-½ precision x² + shift x); `DIVIDES` says whether the family has a quotient.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Bell<const DIVIDES: bool = true> {
    pub precision: f64,
    pub shift: f64,
}

impl<const DIVIDES: bool> Bell<DIVIDES> {
    pub fn new(mean: f64, variance: f64) -> Self {
        Self { precision: 1.0 / variance, shift: mean / variance }
    }

    pub fn mean(&self) -> f64 {
        self.shift / self.precision
    }

    pub fn variance(&self) -> f64 {
        1.0 / self.precision
    }
}

/// The only form this family refuses.
pub const BAD_FORM: u8 = 99;

impl<const DIVIDES: bool> Message for Bell<DIVIDES> {
    type Form = u8;
    const ALWAYS_DIVIDES: bool = DIVIDES;

    fn vacuous(_space: &Space) -> Self {
        Self::default()
    }

    fn product(incoming: Messages<'_, Self>, _form: &u8, _stream: &mut Stream) -> Result<Self, MessageError> {
        let mut product = Self::default();
        for message in incoming.iter() {
            product.precision += message.precision;
            product.shift += message.shift;
        }
        if product.precision < 0.0 {
            let value = product.precision;
            return Err(MessageError::NotPositiveDefinite { what: "the product", pivot: 0, value });
        }
        Ok(product)
    }

    fn quotient(&self, incoming: &Self) -> Option<Self> {
        let (precision, shift) = (self.precision - incoming.precision, self.shift - incoming.shift);
        DIVIDES.then_some(Self { precision, shift })
    }

    fn change(&self, previous: &Self) -> f64 {
        let scale = self.precision.max(previous.precision);
        if scale == 0.0 {
            return (self.shift - previous.shift).abs();
        }
        let shift = (self.shift - previous.shift).abs() / scale.sqrt();
        let change = (self.precision - previous.precision).abs() / scale + shift;
        // Sums and differences leave a rounding residue that never settles.
        if change < 1e-13 { 0.0 } else { change }
    }

    fn damp(&mut self, previous: &Self, damping: f64) -> bool {
        self.precision += damping * (previous.precision - self.precision);
        self.shift += damping * (previous.shift - self.shift);
        true
    }

    fn check_form(form: &u8, _space: &Space) -> Result<(), String> {
        if *form == BAD_FORM { Err(format!("a bell has no form {form}")) } else { Ok(()) }
    }

    fn is_proper(&self) -> bool {
        self.precision > 0.0
    }
}

/// Σ aₖ xₖ = offset + noise of this variance, and the odd behaviours that tests need.
pub struct Linear {
    pub coefficients: Vec<f64>,
    pub offset: f64,
    pub variance: f64,
    pub behaviour: Behaviour,
    dimensions: Vec<usize>,
    /// Number of messages computed.
    pub calls: AtomicU64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Behaviour {
    Exact,
    /// Says that its message never changes.
    Constant,
    /// Adds a draw from the stream to every message.
    Drawing,
    /// Sends NaN to this port.
    NotANumber(Port),
    /// Sends what it receives at the other port.
    Echo,
    /// Its k-th message has precision k².
    Growing,
    /// Sends a negative precision.
    Negative,
}

impl Linear {
    pub fn new(coefficients: &[f64], offset: f64, variance: f64) -> Self {
        let dimensions = vec![1; coefficients.len()];
        let (coefficients, calls) = (coefficients.to_vec(), AtomicU64::new(0));
        Self { coefficients, offset, variance, behaviour: Behaviour::Exact, dimensions, calls }
    }

    /// x = mean + noise.
    pub fn prior(mean: f64, variance: f64) -> Self {
        Self::new(&[1.0], mean, variance)
    }

    /// x₁ - x₀ = offset + noise.
    pub fn step(offset: f64, variance: f64) -> Self {
        Self::new(&[-1.0, 1.0], offset, variance)
    }

    pub fn behaving(mut self, behaviour: Behaviour) -> Self {
        self.behaviour = behaviour;
        self
    }

    pub fn with_dimensions(mut self, dimensions: &[usize]) -> Self {
        self.dimensions = dimensions.to_vec();
        self
    }

    fn exact<const DIVIDES: bool>(&self, to: Port, incoming: &Incoming<'_, Bell<DIVIDES>>) -> Bell<DIVIDES> {
        let (mut mean, mut variance) = (self.offset, self.variance);
        for (port, a) in self.coefficients.iter().enumerate().filter(|(port, _)| *port != to) {
            let message = incoming.message(port);
            if message.precision <= 0.0 {
                return Bell::default();
            }
            mean -= a * message.mean();
            variance += a * a * message.variance();
        }
        let a = self.coefficients[to];
        Bell { precision: a * a / variance, shift: a * mean / variance }
    }
}

impl<const DIVIDES: bool> Factor<Bell<DIVIDES>> for Linear {
    fn dimensions(&self) -> &[usize] {
        &self.dimensions
    }

    fn message(
        &self,
        to: Port,
        incoming: &Incoming<'_, Bell<DIVIDES>>,
        _form: &u8,
        stream: &mut Stream,
    ) -> Result<Bell<DIVIDES>, MessageError> {
        use rand::RngExt;
        let call = self.calls.fetch_add(1, Ordering::Relaxed) + 1;
        let mut message = self.exact(to, incoming);
        match self.behaviour {
            Behaviour::Exact | Behaviour::Constant => {}
            Behaviour::Drawing => message.shift += 0.1 * stream.random::<f64>(),
            Behaviour::NotANumber(port) if port == to => message.shift = f64::NAN,
            Behaviour::NotANumber(_) => {}
            Behaviour::Echo => message = *incoming.message(1 - to),
            Behaviour::Growing => message = Bell { precision: (call * call) as f64, shift: 0.0 },
            Behaviour::Negative => message = Bell { precision: -1.0, shift: 0.0 },
        }
        Ok(message)
    }

    fn is_constant(&self) -> bool {
        self.behaviour == Behaviour::Constant
    }
}

pub type Graph<const DIVIDES: bool = true> = FactorGraph<Bell<DIVIDES>, Linear>;

/// A graph of these many real variables named x0, x1, ...
pub fn variables<const DIVIDES: bool>(count: usize) -> (Graph<DIVIDES>, Vec<VariableId>) {
    let mut graph = Graph::new();
    let ids = (0..count).map(|k| graph.variable(format!("x{k}"), Space::real(1)).unwrap()).collect();
    (graph, ids)
}

/// A grid with a prior on every variable and steps between neighbours; loopy and diagonally dominant.
pub fn grid<const DIVIDES: bool>(side: usize, behaviour: Behaviour) -> Graph<DIVIDES> {
    let (mut graph, ids) = variables(side * side);
    for (k, &id) in ids.iter().enumerate() {
        let (row, column) = (k / side, k % side);
        let prior = Linear::prior((k % 7) as f64, 1.0 + (k % 3) as f64);
        graph.factor("prior", prior.behaving(behaviour), &[id]).unwrap();
        let mut join = |other: usize, offset: f64| {
            let step = Linear::step(offset, 2.0 + (k % 2) as f64).behaving(behaviour);
            graph.factor("step", step, &[id, ids[other]]).unwrap();
        };
        if column + 1 < side {
            join(k + 1, 0.5);
        }
        if row + 1 < side {
            join(k + side, -0.25);
        }
    }
    graph
}

/// A chain: a prior on the first variable, a step to each next, and a measurement of every third.
pub fn chain<const DIVIDES: bool>(length: usize, behaviour: Behaviour) -> Graph<DIVIDES> {
    let (mut graph, ids) = variables(length);
    graph.factor("prior", Linear::prior(1.0, 2.0).behaving(behaviour), &ids[..1]).unwrap();
    for k in 1..length {
        graph.factor("step", Linear::step(0.5, 1.0).behaving(behaviour), &ids[k - 1..=k]).unwrap();
        if k % 3 == 0 {
            let measurement = Linear::prior(0.3 * k as f64, 0.5).behaving(behaviour);
            graph.factor("measurement", measurement, &[ids[k]]).unwrap();
        }
    }
    graph
}

/// Runs `schedule` on `graph` and returns the beliefs, in the order of variables.
pub fn beliefs<const DIVIDES: bool>(
    graph: &Graph<DIVIDES>,
    options: Options,
    schedule: &mut dyn Schedule,
) -> Vec<Bell<DIVIDES>> {
    let mut engine = Engine::new(graph, options).unwrap();
    engine.run(schedule).unwrap();
    graph.variable_ids().map(|variable| *engine.belief(variable)).collect()
}

pub fn assert_close<const A: bool, const B: bool>(a: &[Bell<A>], b: &[Bell<B>], tolerance: f64) {
    assert_eq!(a.len(), b.len());
    for (k, (a, b)) in a.iter().zip(b).enumerate() {
        let scale = 1.0 + b.mean().abs();
        assert!((a.mean() - b.mean()).abs() < tolerance * scale, "mean of x{k}: {} {}", a.mean(), b.mean());
        let relative = (a.variance() / b.variance() - 1.0).abs();
        assert!(relative < tolerance, "variance of x{k}: {} {}", a.variance(), b.variance());
    }
}
