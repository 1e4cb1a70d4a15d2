//! Linear-Gaussian factors of one or two variables, in information form.

use nalgebra::{Matrix2, SMatrix, SVector, Vector2};
use sumprod_graph::{Factor, Incoming, MessageError, Port, Stream};
use sumprod_messages::{DynamicGaussian, Gaussian, GaussianFamily, GaussianForm};

/// exp(-½ Σ xᵢ'Jᵢⱼxⱼ + Σ hᵢ'xᵢ) over one or two variables of `D` coordinates.
#[derive(Clone, Debug)]
pub struct Linear<const D: usize> {
    pub blocks: [[SMatrix<f64, D, D>; 2]; 2],
    pub vectors: [SVector<f64, D>; 2],
    arity: usize,
}

impl<const D: usize> Linear<D> {
    pub fn unary(information: SMatrix<f64, D, D>, vector: SVector<f64, D>) -> Self {
        let (zero, none) = (SMatrix::zeros(), SVector::zeros());
        Self { blocks: [[information, zero], [zero, zero]], vectors: [vector, none], arity: 1 }
    }

    /// A₀ x₀ + A₁ x₁ = b + noise, with `weight` the inverse of the noise's covariance.
    pub fn pair<const R: usize>(
        a: [SMatrix<f64, R, D>; 2],
        b: SVector<f64, R>,
        weight: SMatrix<f64, R, R>,
    ) -> Self {
        let block = |i: usize, j: usize| a[i].transpose() * weight * a[j];
        let vectors = [0, 1].map(|i| a[i].transpose() * weight * b);
        Self { blocks: [[block(0, 0), block(0, 1)], [block(1, 0), block(1, 1)]], vectors, arity: 2 }
    }

    /// x₁ = F x₀ + noise of covariance `q`.
    pub fn transition(f: SMatrix<f64, D, D>, q: SMatrix<f64, D, D>) -> Self {
        Self::pair([-f, SMatrix::identity()], SVector::zeros(), q.try_inverse().unwrap())
    }

    /// The message to `to` by a Schur complement; flat where the other variable is not determined.
    fn schur(
        &self,
        to: Port,
        information: SMatrix<f64, D, D>,
        vector: SVector<f64, D>,
    ) -> (SMatrix<f64, D, D>, SVector<f64, D>) {
        if self.arity == 1 {
            return (self.blocks[0][0], self.vectors[0]);
        }
        let from = 1 - to;
        let inner = self.blocks[from][from] + information;
        let Some(inverse) = inner.cholesky().map(|factor| factor.inverse()) else {
            return (SMatrix::zeros(), SVector::zeros());
        };
        let gain = self.blocks[to][from] * inverse;
        let (of_matrix, of_vector) = (gain * self.blocks[from][to], gain * (self.vectors[from] + vector));
        (self.blocks[to][to] - of_matrix, self.vectors[to] - of_vector)
    }

    fn ports(&self) -> &'static [usize] {
        // One entry per port, so that no factor owns a list.
        const PORTS: [[usize; 2]; 7] = [[0; 2], [1; 2], [2; 2], [3; 2], [4; 2], [5; 2], [6; 2]];
        &PORTS[D][..self.arity]
    }
}

impl<const D: usize> Factor<Gaussian<D>> for Linear<D> {
    fn dimensions(&self) -> &[usize] {
        self.ports()
    }

    fn message(
        &self,
        to: Port,
        incoming: &Incoming<'_, Gaussian<D>>,
        _form: &GaussianForm,
        _stream: &mut Stream,
    ) -> Result<Gaussian<D>, MessageError> {
        let other = if self.arity == 2 { *incoming.message(1 - to) } else { Gaussian::default() };
        let (information, vector) = self.schur(to, *other.information(), *other.information_vector());
        Ok(Gaussian::from_information(information, vector))
    }
}

impl<const D: usize> Factor<DynamicGaussian> for Linear<D> {
    fn dimensions(&self) -> &[usize] {
        self.ports()
    }

    fn message(
        &self,
        to: Port,
        incoming: &Incoming<'_, DynamicGaussian>,
        form: &GaussianForm,
        stream: &mut Stream,
    ) -> Result<DynamicGaussian, MessageError> {
        let mut out = DynamicGaussian::flat(D);
        self.message_into(to, incoming, form, stream, &mut out)?;
        Ok(out)
    }

    fn message_into(
        &self,
        to: Port,
        incoming: &Incoming<'_, DynamicGaussian>,
        _form: &GaussianForm,
        _stream: &mut Stream,
        out: &mut DynamicGaussian,
    ) -> Result<(), MessageError> {
        let (mut information, mut vector) = (SMatrix::<f64, D, D>::zeros(), SVector::<f64, D>::zeros());
        if self.arity == 2 {
            let other = incoming.message(1 - to);
            other.read_information(information.as_mut_slice(), vector.as_mut_slice())?;
        }
        let (information, vector) = self.schur(to, information, vector);
        out.write_information(incoming.belief(to), information.as_slice(), vector.as_slice(), 0.0)
    }
}

/// Constant velocity over `dt` (s): transition, and noise of a white acceleration of unit density.
pub fn constant_velocity(dt: f64) -> (Matrix2<f64>, Matrix2<f64>) {
    let f = Matrix2::new(1.0, dt, 0.0, 1.0);
    let q = Matrix2::new(dt.powi(3) / 3.0, dt * dt / 2.0, dt * dt / 2.0, dt);
    (f, q)
}

/// A measurement of the first of two coordinates.
pub fn position(value: f64, variance: f64) -> Linear<2> {
    Linear::unary(Matrix2::new(1.0 / variance, 0.0, 0.0, 0.0), Vector2::new(value / variance, 0.0))
}

/// A number in [-1, 1) that looks random, from two indices: test data without a generator.
pub fn noise(seed: u64, index: u64) -> f64 {
    let id = Stream::new(seed, 0, sumprod_graph::Purpose::World, index).id();
    (id >> 11) as f64 / (1u64 << 52) as f64 - 1.0
}
