//! Many residuals on blocks of one large variable.
//!
//! A joint state (all agents of a slice, say) is one variable; the measurements among its parts form one factor,
//! whose message is the sum of theirs. This is a clique of the junction tree: what loopy messages approximate, a
//! cluster has exactly.

use crate::Expansion;
use crate::cloud::{Likelihood, Residuals, each_point};
use crate::residual::{Chart, Linearised, Residual, ResidualModel};
use crate::rules::{GaussianDraft, GaussianView, ParticleView, Rules};
use crate::small::{Matrix, Vector, multiply, transpose, zero_vector, zeros};
use sumprod_graph::{MessageError, Port, Stream};
use sumprod_messages::{Cholesky, Particles, ParticlesForm};

/// A run of consecutive coordinates of the joint variable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Block {
    /// The first coordinate.
    pub start: usize,
    /// The number of coordinates.
    pub length: usize,
}

impl Block {
    /// `length` coordinates from `start`.
    pub fn new(start: usize, length: usize) -> Self {
        Self { start, length }
    }
}

struct Part {
    model: Box<dyn Linearised>,
    /// The coordinates of the joint variable that the model's stacked ports read.
    coordinates: Vec<usize>,
}

/// Residuals on blocks of one joint variable, as one factor with a single port.
pub struct Cluster {
    dimension: [usize; 1],
    parts: Vec<Part>,
}

impl Cluster {
    /// A factor of a joint variable of this dimension, without any residual yet.
    pub fn new(dimension: usize) -> Self {
        Self { dimension: [dimension], parts: Vec::new() }
    }

    /// Adds a residual, one block per port.
    ///
    /// # Errors
    ///
    /// Where the blocks do not match the residual's ports or leave the joint variable.
    pub fn add<R: Residual + 'static>(&mut self, residual: R, blocks: &[Block]) -> Result<(), MessageError> {
        let dimensions = residual.dimensions();
        if dimensions.len() != blocks.len() {
            let (found, expected) = (blocks.len(), dimensions.len());
            return Err(MessageError::Dimension { what: "the list of blocks", found, expected });
        }
        for (block, &expected) in blocks.iter().zip(dimensions) {
            if block.length != expected {
                return Err(MessageError::Dimension { what: "a block", found: block.length, expected });
            }
            let end = block.start.saturating_add(block.length);
            if end > self.dimension[0] {
                let (found, expected) = (end, self.dimension[0]);
                return Err(MessageError::Dimension { what: "the end of a block", found, expected });
            }
        }
        let coordinates = blocks.iter().flat_map(|block| block.start..block.start + block.length).collect();
        self.parts.push(Part { model: Box::new(ResidualModel(residual)), coordinates });
        Ok(())
    }

    /// Sum of the residuals' log densities at a point.
    fn log_value(&self, point: &[f64]) -> f64 {
        self.parts.iter().map(|part| part.log_value(point)).sum()
    }

    /// Number of residuals.
    pub fn len(&self) -> usize {
        self.parts.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.parts.is_empty()
    }
}

impl Rules for Cluster {
    fn dimensions(&self) -> &[usize] {
        &self.dimension
    }

    /// The sum of the residuals' linearised messages, each of which touches its own blocks alone.
    fn gaussian(&self, _to: Port, view: &dyn GaussianView) -> Result<GaussianDraft, MessageError> {
        let d = self.dimension[0];
        let (mut information, mut mean) = (zeros(d * d), zero_vector(d));
        view.belief(0, &mut information, &mut mean)?;
        let belief = Cholesky::new(&information, d, "the joint belief").map_err(|_| {
            let reason = "a cluster needs a point to linearise at, but the joint belief has no mean; give the \
                          variable a prior or a start";
            MessageError::Unsupported(reason.into())
        })?;
        belief.solve(&mut mean);
        let heavy = self.parts.iter().any(|part| part.model.noise().degrees_of_freedom().is_some());
        let covariance = heavy.then(|| {
            let mut covariance = zeros(d * d);
            belief.inverse(&mut covariance);
            covariance
        });
        information.iter_mut().for_each(|entry| *entry = 0.0);
        let mut vector = zero_vector(d);
        for part in &self.parts {
            part.accumulate(&mean, covariance.as_deref(), &mut information, &mut vector);
        }
        Ok(GaussianDraft { information, vector, loss: 0.0 })
    }

    /// The residuals one below the other.
    fn expand(&self, question: &mut Expansion) -> Result<(), MessageError> {
        let d = self.dimension[0];
        question.expect(d)?;
        question.residual.clear();
        question.jacobian.clear();
        question.chart = Chart::Coordinates;
        let mut own = Expansion::default();
        for part in &self.parts {
            own.ask(question.derivative);
            own.point.extend(part.coordinates.iter().map(|&coordinate| question.point[coordinate]));
            own.residual.resize(part.model.noise().dimension(), 0.0);
            if own.derivative {
                own.jacobian.resize(own.residual.len() * own.point.len(), 0.0);
                part.model.linearise(&own.point, &mut own.residual, &mut own.jacobian);
            } else {
                part.model.evaluate(&own.point, &mut own.residual);
            }
            own.close(part.model.noise());
            question.loss += own.loss;
            question.log_peak += own.log_peak;
            question.residual.extend_from_slice(&own.residual);
            if question.derivative {
                for row in own.jacobian.chunks_exact(own.point.len()) {
                    let start = question.jacobian.len();
                    question.jacobian.resize(start + d, 0.0);
                    for (&coordinate, entry) in part.coordinates.iter().zip(row) {
                        question.jacobian[start + coordinate] += entry;
                    }
                }
            }
        }
        Ok(())
    }

    fn particles(
        &self,
        to: Port,
        view: &dyn ParticleView,
        _form: &ParticlesForm,
        _stream: &mut Stream,
        out: &mut Particles,
    ) -> Result<f64, MessageError> {
        let Some(carrier) = view.particles(to) else {
            let reason =
                "a cluster is evaluated at the joint variable's particles, but it has none; give it a prior";
            return Err(MessageError::Unsupported(reason.into()));
        };
        out.become_likelihood(carrier, |log_values| {
            for (value, point) in log_values.iter_mut().zip(carrier.points().chunks_exact(self.dimension[0]))
            {
                *value = self.log_value(point);
            }
            Ok(())
        })?;
        Ok(0.0)
    }
}

impl Likelihood for Cluster {
    fn dimension(&self) -> Result<Option<usize>, MessageError> {
        Ok(Some(self.dimension[0]))
    }

    fn components(&self) -> usize {
        0
    }

    fn add_log(&self, block: &[f64], log_values: &mut [f64], _residuals: &mut Residuals) -> f64 {
        each_point(block, log_values, |point| self.log_value(point));
        f64::INFINITY
    }
}

impl Part {
    fn log_value(&self, joint: &[f64]) -> f64 {
        let point: Vector = self.coordinates.iter().map(|&coordinate| joint[coordinate]).collect();
        let mut residual = zero_vector(self.model.noise().dimension());
        self.model.evaluate(&point, &mut residual);
        self.model.noise().log_density(&residual)
    }

    fn accumulate(
        &self,
        mean: &[f64],
        covariance: Option<&[f64]>,
        information: &mut [f64],
        vector: &mut [f64],
    ) {
        let d = mean.len();
        let (m, n) = (self.model.noise().dimension(), self.coordinates.len());
        let point: Vector = self.coordinates.iter().map(|&coordinate| mean[coordinate]).collect();
        let (mut residual, mut jacobian) = (zero_vector(m), zeros(m * n));
        self.model.linearise(&point, &mut residual, &mut jacobian);
        let noise = self.model.noise();
        let mut weight = Matrix::from_slice(noise.information());
        if let (Some(covariance), Some(_)) = (covariance, noise.degrees_of_freedom()) {
            let own: Matrix = self
                .coordinates
                .iter()
                .flat_map(|&row| self.coordinates.iter().map(move |&column| covariance[row * d + column]))
                .collect();
            let spread = multiply(&multiply(&jacobian, &own, n, n), &transpose(&jacobian, m, n), n, m);
            let share = noise.weight(noise.expected_squared_length(&residual, &spread));
            weight.iter_mut().for_each(|entry| *entry *= share);
        }
        let back = transpose(&jacobian, m, n);
        let weighted = multiply(&back, &weight, m, m);
        let own = multiply(&weighted, &jacobian, m, n);
        let at = multiply(&jacobian, &point, n, 1);
        let target: Vector = at.iter().zip(&residual).map(|(at, residual)| at - residual).collect();
        let pull = multiply(&weighted, &target, m, 1);
        for (row, &to) in self.coordinates.iter().enumerate() {
            vector[to] += pull[row];
            for (column, &from) in self.coordinates.iter().enumerate() {
                information[to * d + from] += 0.5 * (own[row * n + column] + own[column * n + row]);
            }
        }
    }
}
