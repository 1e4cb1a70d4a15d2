//! What the tests share: seeded numbers, rules called by hand, and the dense joint.

use nalgebra::{DMatrix, DVector};
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use sumprod_graph::{
    Factor, FactorGraph, FastStream, Incoming, Message, MessageError, Port, Purpose, Space, Stream,
};
use sumprod_messages::{AnyMessage, DynamicGaussian, Moments};

pub fn stream(entity: u64) -> Stream {
    Stream::new(20_240_229, 0, Purpose::User(2), entity)
}

/// Seeded numbers and matrices.
pub struct Draw(FastStream);

impl Draw {
    pub fn new(entity: u64) -> Self {
        Self(stream(entity).fast())
    }

    pub fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.0.random::<f64>()
    }

    pub fn below(&mut self, bound: usize) -> usize {
        self.0.random_range(0..bound)
    }

    pub fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.0)
    }

    pub fn vector(&mut self, count: usize) -> DVector<f64> {
        DVector::from_fn(count, |_, _| self.normal())
    }

    pub fn matrix(&mut self, rows: usize, columns: usize) -> DMatrix<f64> {
        DMatrix::from_fn(rows, columns, |_, _| self.normal())
    }

    /// A well-conditioned covariance.
    pub fn covariance(&mut self, dimension: usize) -> DMatrix<f64> {
        let a = self.matrix(dimension, dimension);
        (&a * a.transpose()) * 0.3 + DMatrix::identity(dimension, dimension) * 0.5
    }

    /// A positive semidefinite matrix of this rank.
    pub fn semidefinite(&mut self, dimension: usize, rank: usize) -> DMatrix<f64> {
        let a = self.matrix(dimension, rank);
        &a * a.transpose()
    }
}

/// Row-major entries.
pub fn rows(matrix: &DMatrix<f64>) -> Vec<f64> {
    matrix.transpose().as_slice().to_vec()
}

pub fn square(entries: &[f64], dimension: usize) -> DMatrix<f64> {
    DMatrix::from_row_slice(dimension, dimension, entries)
}

pub fn gaussian(information: &DMatrix<f64>, vector: &DVector<f64>) -> DynamicGaussian {
    DynamicGaussian::from_information(&rows(information), vector.as_slice()).unwrap()
}

pub fn moments_of(mean: &DVector<f64>, covariance: &DMatrix<f64>) -> DynamicGaussian {
    DynamicGaussian::from_moments(mean.as_slice(), &rows(covariance)).unwrap()
}

pub fn information_of(message: &DynamicGaussian) -> (DMatrix<f64>, DVector<f64>) {
    let d = message.dimension();
    let mut information = vec![0.0; d * d];
    message.write_matrix(&mut information);
    (square(&information, d), DVector::from_column_slice(message.information_vector()))
}

/// A rule called by hand: `messages` and `beliefs` by port.
pub fn send<M: Message>(
    factor: &dyn Factor<M>,
    to: Port,
    messages: &[M],
    beliefs: &[M],
    form: &M::Form,
) -> Result<M, MessageError> {
    let variables: Vec<u32> = (0..messages.len() as u32).collect();
    factor.message(to, &Incoming::new(messages, beliefs, &variables), form, &mut stream(to as u64))
}

/// A Gaussian rule where every belief is the message itself.
pub fn send_gaussian(
    factor: &dyn Factor<DynamicGaussian>,
    to: Port,
    messages: &[DynamicGaussian],
) -> Result<DynamicGaussian, MessageError> {
    send(factor, to, messages, messages, &Default::default())
}

#[track_caller]
pub fn assert_close(found: &DMatrix<f64>, exact: &DMatrix<f64>, tolerance: f64, what: &str) {
    let scale = 1.0 + exact.amax();
    let far = (found - exact).amax();
    assert!(far <= tolerance * scale, "{what}: off by {far:e} of {scale:e}\n{found}{exact}");
}

#[track_caller]
pub fn assert_moments(found: &Moments, mean: &DVector<f64>, covariance: &DMatrix<f64>, tolerance: f64) {
    let d = found.dimension();
    let own = DMatrix::from_column_slice(d, 1, &found.mean);
    assert_close(&own, &DMatrix::from_column_slice(d, 1, mean.as_slice()), tolerance, "mean");
    assert_close(&square(&found.covariance, d), covariance, tolerance, "covariance");
}

/// Families whose beliefs have moments, so that one test runs in both.
pub trait HasMoments: Message {
    fn belief_moments(&self) -> Moments;
}

impl HasMoments for DynamicGaussian {
    fn belief_moments(&self) -> Moments {
        self.moments().unwrap()
    }
}

impl HasMoments for AnyMessage {
    fn belief_moments(&self) -> Moments {
        self.moments().unwrap()
    }
}

/// The joint of Σ Aₖ xₖ ~ N(b, R) over variables of any dimensions.
pub struct Joint {
    starts: Vec<usize>,
    information: DMatrix<f64>,
    vector: DVector<f64>,
}

impl Joint {
    pub fn new(dimensions: &[usize]) -> Self {
        let mut starts = vec![0];
        for d in dimensions {
            starts.push(starts[starts.len() - 1] + d);
        }
        let n = starts[dimensions.len()];
        Self { starts, information: DMatrix::zeros(n, n), vector: DVector::zeros(n) }
    }

    pub fn add(
        &mut self,
        variables: &[usize],
        matrices: &[DMatrix<f64>],
        target: &DVector<f64>,
        covariance: &DMatrix<f64>,
    ) {
        let mut wide = DMatrix::zeros(target.len(), self.vector.len());
        for (&variable, matrix) in variables.iter().zip(matrices) {
            let mut block = wide.columns_mut(self.starts[variable], matrix.ncols());
            block += matrix;
        }
        let weight = covariance.clone().try_inverse().unwrap();
        self.information += wide.transpose() * &weight * &wide;
        self.vector += wide.transpose() * weight * target;
    }

    /// Mean and covariance of every variable.
    pub fn marginals(&self) -> Vec<(DVector<f64>, DMatrix<f64>)> {
        let factor = self.information.clone().cholesky().unwrap();
        let (mean, covariance) = (factor.solve(&self.vector), factor.inverse());
        self.starts
            .windows(2)
            .map(|ends| {
                let (start, d) = (ends[0], ends[1] - ends[0]);
                (mean.rows(start, d).into_owned(), covariance.view((start, start), (d, d)).into_owned())
            })
            .collect()
    }
}

/// `count` unnamed variables of real coordinates.
pub fn variables<M: Message>(
    graph: &mut FactorGraph<M>,
    dimensions: &[usize],
) -> Vec<sumprod_graph::VariableId> {
    dimensions.iter().map(|&d| graph.unnamed_variable(Space::real(d))).collect()
}
