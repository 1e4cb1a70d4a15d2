//! What the tests share: random mixtures, and products by the textbook.

use nalgebra::{DMatrix, DVector};
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use sumprod_graph::{FastStream, Purpose, Space, Stream};
use sumprod_messages::{Mixture, Moments};

pub fn stream(entity: u64) -> Stream {
    Stream::new(41, 0, Purpose::User(7), entity)
}

pub fn normal(random: &mut FastStream) -> f64 {
    StandardNormal.sample(random)
}

/// A random covariance with standard deviations about `width`.
pub fn covariance(random: &mut FastStream, d: usize, width: f64) -> Vec<f64> {
    let root = DMatrix::from_fn(d, d, |row, column| {
        let entry = width * normal(random) / (d as f64).sqrt();
        if row == column { entry + 0.5 * width } else { entry }
    });
    let matrix = &root * root.transpose() + DMatrix::identity(d, d) * (0.1 * width * width);
    matrix.as_slice().to_vec()
}

/// A mixture of `count` components with centres of standard deviation `spread` and kernels of about `width`.
pub fn mixture(entity: u64, d: usize, count: usize, spread: f64, width: f64, shared: bool) -> Mixture {
    let mut random = stream(entity).fast();
    let log_weights = (0..count).map(|_| (0.2 + random.random::<f64>()).ln()).collect();
    let means = (0..count * d).map(|_| spread * normal(&mut random)).collect();
    let space = Space::real(d);
    if shared {
        Mixture::with_shared_covariance(&space, log_weights, means, covariance(&mut random, d, width))
            .unwrap()
    } else {
        let covariances = (0..count).flat_map(|_| covariance(&mut random, d, width)).collect();
        Mixture::new(&space, log_weights, means, covariances).unwrap()
    }
}

/// Log weight, mean and covariance of one label choice, in information form.
pub fn choice(inputs: &[&Mixture], labels: &[usize]) -> (f64, DVector<f64>, DMatrix<f64>) {
    let d = inputs[0].dimension();
    let mut information = DMatrix::zeros(d, d);
    let mut vector = DVector::zeros(d);
    let mut log = 0.0;
    for (input, &label) in inputs.iter().zip(labels) {
        let matrix = DMatrix::from_row_slice(d, d, input.covariance_of(label));
        let inverse = matrix.clone().try_inverse().unwrap();
        let mean = DVector::from_row_slice(input.mean_of(label));
        log += input.log_weights()[label] - 0.5 * (matrix * std::f64::consts::TAU).determinant().ln();
        log -= 0.5 * mean.dot(&(&inverse * &mean));
        vector += &inverse * mean;
        information += inverse;
    }
    let covariance = information.try_inverse().unwrap();
    let mean = &covariance * &vector;
    log += 0.5 * vector.dot(&mean) + 0.5 * (&covariance * std::f64::consts::TAU).determinant().ln();
    (log, mean, covariance)
}

/// All label choices, the last input's label fastest.
pub fn all_labels(inputs: &[&Mixture]) -> Vec<Vec<usize>> {
    let mut all = vec![Vec::new()];
    for input in inputs {
        all = all
            .iter()
            .flat_map(|labels: &Vec<usize>| (0..input.len()).map(|i| [labels.as_slice(), &[i]].concat()))
            .collect();
    }
    all
}

/// Log normaliser and moments of the product.
pub fn enumerated(inputs: &[&Mixture]) -> (f64, Moments) {
    let d = inputs[0].dimension();
    let choices: Vec<_> = all_labels(inputs).iter().map(|labels| choice(inputs, labels)).collect();
    let largest = choices.iter().map(|choice| choice.0).fold(f64::NEG_INFINITY, f64::max);
    let total: f64 = choices.iter().map(|choice| (choice.0 - largest).exp()).sum();
    let mut mean = DVector::zeros(d);
    for (log, centre, _) in &choices {
        mean += centre * ((log - largest).exp() / total);
    }
    let mut second = DMatrix::zeros(d, d);
    for (log, centre, kernel) in &choices {
        let offset = centre - &mean;
        second += (kernel + &offset * offset.transpose()) * ((log - largest).exp() / total);
    }
    let covariance = second.as_slice().to_vec();
    (largest + total.ln(), Moments { mean: mean.as_slice().to_vec(), covariance })
}

pub fn assert_close(found: &[f64], exact: &[f64], tolerance: f64) {
    assert_eq!(found.len(), exact.len());
    let scale = exact.iter().fold(1.0f64, |largest, x| largest.max(x.abs()));
    for (a, b) in found.iter().zip(exact) {
        assert!((a - b).abs() <= tolerance * scale, "{found:?} should be {exact:?}");
    }
}
