//! The square-root Kalman filter: the covariance by a factor, P = L L', which no rounding makes indefinite.
//!
//! Predict: [F L, B] is made lower triangular by reflections from the right. Correct: so is
//! [R^½, J L; 0, L], whose result [S^½, 0; K S^½, L⁺] holds innovation, gain and posterior. Source: Kailath, Sayed,
//! Hassibi, "Linear Estimation" (2000), chapter 12.

use smallvec::SmallVec;
use sumprod_graph::MessageError;
use sumprod_messages::Moments;
use sumprod_models::moments::{linearise_motion, linearise_residual, noise_against, semidefinite_factor};
use sumprod_models::{Motion, Residual};

use super::kalman::{GaussianRecord, Prediction, Square};
use super::{checks, rts};
use crate::{Correct, Correction, Filter, FilterError, Predict, Run, Smooth};

/// A filter whose belief is the mean and a lower factor of the covariance of `D` coordinates; what is not linear is
/// expanded to first order at the mean.
#[derive(Clone, Debug, PartialEq)]
pub struct SquareRoot<const D: usize> {
    mean: [f64; D],
    factor: Square<D>,
    prediction: Prediction<D>,
    step: u64,
}

impl<const D: usize> SquareRoot<D> {
    /// A filter that starts from a prior, of which any direction may be known exactly.
    ///
    /// # Errors
    ///
    /// Where the prior has not `D` coordinates, or is no distribution.
    pub fn new(prior: &Moments) -> Result<Self, FilterError> {
        checks::distribution(prior, D)?;
        let (mut mean, mut factor, mut covariance) = ([0.0; D], [[0.0; D]; D], [[0.0; D]; D]);
        mean.copy_from_slice(&prior.mean);
        covariance.as_flattened_mut().copy_from_slice(&prior.covariance);
        semidefinite_factor(&prior.covariance, D, "the covariance", factor.as_flattened_mut())
            .map_err(FilterError::Prior)?;
        let prediction = Prediction { mean, covariance, cross: covariance };
        Ok(Self { mean, factor, prediction, step: 0 })
    }

    /// The mean.
    pub fn mean(&self) -> &[f64; D] {
        &self.mean
    }

    /// The lower factor L of the covariance L L'.
    pub fn factor(&self) -> &Square<D> {
        &self.factor
    }

    fn covariance(&self) -> Square<D> {
        squared(&self.factor)
    }
}

fn squared<const D: usize>(factor: &Square<D>) -> Square<D> {
    std::array::from_fn(|row| {
        std::array::from_fn(|column| (0..D).map(|k| factor[row][k] * factor[column][k]).sum())
    })
}

/// Makes a matrix (row-major, no fewer columns than rows) lower triangular by reflections from the right, which keep
/// A A'; the diagonal becomes not negative.
fn triangularise(a: &mut [f64], rows: usize, columns: usize) {
    for pivot in 0..rows {
        let length =
            a[pivot * columns + pivot..(pivot + 1) * columns].iter().map(|x| x * x).sum::<f64>().sqrt();
        if length == 0.0 {
            continue;
        }
        let head = a[pivot * columns + pivot];
        let image = if head > 0.0 { -length } else { length };
        let mut normal: SmallVec<[f64; 16]> =
            SmallVec::from_slice(&a[pivot * columns + pivot..(pivot + 1) * columns]);
        normal[0] -= image;
        let half = 0.5 * normal.iter().map(|x| x * x).sum::<f64>();
        for row in a.chunks_exact_mut(columns).skip(pivot) {
            let own = &mut row[pivot..];
            let share = own.iter().zip(&normal).map(|(x, n)| x * n).sum::<f64>() / half;
            own.iter_mut().zip(&normal).for_each(|(x, n)| *x -= share * n);
        }
        if image < 0.0 {
            a.chunks_exact_mut(columns).skip(pivot).for_each(|row| row[pivot] = -row[pivot]);
        }
    }
}

impl<const D: usize, M: Motion> Predict<M> for SquareRoot<D> {
    fn predict(&mut self, motion: &M) -> Result<(), FilterError> {
        let failed = FilterError::step(self.step);
        if motion.dimension() != D {
            let (found, expected) = (motion.dimension(), D);
            return Err(failed(MessageError::Dimension { what: "the motion", found, expected }));
        }
        let (mut mean, mut jacobian) = ([0.0; D], [[0.0; D]; D]);
        linearise_motion(motion, &self.mean, &mut mean, jacobian.as_flattened_mut());
        let noise = motion.noise(&self.mean);
        let columns = D + noise.sources();
        let mut wide = vec![0.0; D * columns];
        for (row, wide) in wide.chunks_exact_mut(columns).enumerate() {
            for (column, entry) in wide[..D].iter_mut().enumerate() {
                *entry = (column..D).map(|k| jacobian[row][k] * self.factor[k][column]).sum();
            }
            wide[D..].copy_from_slice(&noise.factor()[row * noise.sources()..][..noise.sources()]);
        }
        let cross = std::array::from_fn(|row| {
            std::array::from_fn(|column| {
                (0..D).map(|k| wide[row * columns + k] * self.factor[column][k]).sum()
            })
        });
        triangularise(&mut wide, D, columns);
        let factor: Square<D> = std::array::from_fn(|row| {
            std::array::from_fn(|column| if column <= row { wide[row * columns + column] } else { 0.0 })
        });
        let covariance = squared(&factor);
        checks::step(&mean, covariance.as_flattened(), "the predicted covariance").map_err(failed)?;
        self.prediction = Prediction { mean, covariance, cross };
        (self.mean, self.factor) = (mean, factor);
        self.step += 1;
        Ok(())
    }
}

impl<const D: usize, R: Residual> Correct<R> for SquareRoot<D> {
    fn correct(&mut self, measurement: &R) -> Result<Correction, FilterError> {
        let failed = FilterError::step(self.step);
        checks::measured(measurement, D).map_err(&failed)?;
        let m = measurement.noise().dimension();
        let mut value: SmallVec<[f64; 6]> = SmallVec::from_elem(0.0, m);
        let mut jacobian = vec![0.0; m * D];
        linearise_residual(measurement, &self.mean, &mut value, &mut jacobian);
        let covariance = self.covariance();
        let mut noise = vec![0.0; m * m];
        noise_against(measurement.noise(), &value, &jacobian, covariance.as_flattened(), &mut noise);
        let size = m + D;
        let mut root = vec![0.0; m * m];
        semidefinite_factor(&noise, m, "the noise covariance", &mut root).map_err(&failed)?;
        let mut array = vec![0.0; size * size];
        for (row, entries) in array.chunks_exact_mut(size).enumerate() {
            if row < m {
                entries[..m].copy_from_slice(&root[row * m..][..m]);
                for column in 0..D {
                    entries[m + column] =
                        (column..D).map(|k| jacobian[row * D + k] * self.factor[k][column]).sum();
                }
            } else {
                entries[m..].copy_from_slice(&self.factor[row - m]);
            }
        }
        triangularise(&mut array, size, size);
        // S^½ y = r, then the mean moves by -K S^½ y.
        let mut whitened = value.clone();
        let mut log_determinant = 0.0;
        for row in 0..m {
            let pivot = array[row * size + row];
            if !(pivot > 0.0 && pivot.is_finite()) {
                let what = "the innovation covariance";
                return Err(failed(MessageError::NotPositiveDefinite {
                    what,
                    pivot: row,
                    value: pivot * pivot,
                }));
            }
            let below: f64 = (0..row).map(|k| array[row * size + k] * whitened[k]).sum();
            whitened[row] = (whitened[row] - below) / pivot;
            log_determinant += 2.0 * pivot.ln();
        }
        let mut mean = self.mean;
        for (row, mean) in mean.iter_mut().enumerate() {
            *mean -= (0..m).map(|k| array[(m + row) * size + k] * whitened[k]).sum::<f64>();
        }
        let factor: Square<D> =
            std::array::from_fn(|row| std::array::from_fn(|column| array[(m + row) * size + m + column]));
        checks::step(&mean, factor.as_flattened(), "the corrected factor").map_err(&failed)?;
        (self.mean, self.factor) = (mean, factor);
        let squared: f64 = whitened.iter().map(|x| x * x).sum();
        let innovation_covariance = (0..m * m)
            .map(|index| (0..m).map(|k| array[index / m * size + k] * array[index % m * size + k]).sum())
            .collect();
        value.iter_mut().for_each(|value| *value = -*value);
        Ok(Correction {
            log_likelihood: -0.5 * (squared + log_determinant + m as f64 * std::f64::consts::TAU.ln()),
            innovation: value,
            innovation_covariance,
            recovered: false,
        })
    }
}

impl<const D: usize> Filter for SquareRoot<D> {
    type Record = GaussianRecord<D>;

    fn moments(&self) -> Moments {
        self.record().moments()
    }

    fn step(&self) -> u64 {
        self.step
    }

    fn record(&self) -> GaussianRecord<D> {
        GaussianRecord { prediction: self.prediction, mean: self.mean, covariance: self.covariance() }
    }
}

impl<const D: usize, M> Smooth<M> for SquareRoot<D> {
    type Smoothed = Vec<Moments>;

    fn smooth(&self, run: &Run<GaussianRecord<D>, M>) -> Result<Vec<Moments>, FilterError> {
        Ok(rts::smooth(run))
    }
}
