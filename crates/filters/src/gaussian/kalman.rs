//! The Kalman filter of `D` coordinates, and its extended and iterated forms.
//!
//! Predict: m ← f(m), P ← F P F' + B B'. Correct, with r the residual at m and J its Jacobian: S = J P J' + R,
//! K = P J' S⁻¹, m ← m - K r, P ← (I - K J) P (I - K J)' + K R K'. Source: Kalman 1960; the form of P is Joseph's.

use smallvec::SmallVec;
use sumprod_graph::{MessageError, wrap_angle};
use sumprod_messages::Moments;
use sumprod_models::moments::{
    Line, SigmaMoments, SigmaPoints, correct, correct_by_regression, correction_storage, linearise_motion,
    linearise_residual, noise_against, propagate, semidefinite_factor, sigma_moments, sigma_storage,
    symmetrise,
};
use sumprod_models::{Motion, Residual};

use super::{Approximation, checks, rts};
use crate::{Correct, Correction, Filter, FilterError, Predict, Run, Smooth};

/// A square matrix, row by row.
pub type Square<const D: usize> = [[f64; D]; D];

/// Gauss-Newton has converged where a step is this small against the standard deviations.
const CONVERGED: f64 = 1e-10;

/// A filter whose belief is the mean and covariance of `D` coordinates.
///
/// ```
/// use sumprod_filters::{Correct, Filter, Kalman, Predict};
/// use sumprod_messages::Moments;
/// use sumprod_models::Noise;
/// use sumprod_models::library::{AnchorRange, ConstantVelocity};
///
/// let prior = Moments::diagonal(&[0.0, 1.0, 0.0, 1.0], &[25.0, 1.0, 25.0, 1.0]);
/// let mut filter = Kalman::<4>::new(&prior)?;
/// filter.predict(&ConstantVelocity::white_acceleration(2, 1.0, 0.1)?)?;
/// let range = AnchorRange::new(100.0, [60.0, -80.0], 4, [0, 2], Noise::isotropic(1, 1.0)?)?;
/// let correction = filter.correct(&range)?;
/// assert!(correction.innovation[0].abs() < 1.0);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Kalman<const D: usize> {
    mean: [f64; D],
    covariance: Square<D>,
    prediction: Prediction<D>,
    approximation: Approximation,
    step: u64,
}

/// What a correction makes of the moments.
struct Posterior<const D: usize> {
    mean: [f64; D],
    covariance: Square<D>,
}

/// How far a posterior's mean is from a point, in standard deviations of the worst coordinate.
fn moved<const D: usize>(posterior: &Posterior<D>, at: &[f64; D]) -> f64 {
    let moved = (0..D).map(|k| {
        let (distance, variance) = ((posterior.mean[k] - at[k]).abs(), posterior.covariance[k][k]);
        if distance == 0.0 { 0.0 } else { distance / variance.sqrt() }
    });
    moved.fold(0.0, f64::max)
}

/// A prediction as smoothing needs it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prediction<const D: usize> {
    /// The predicted mean.
    pub mean: [f64; D],
    /// The predicted covariance.
    pub covariance: Square<D>,
    /// Cross-covariance of the predicted state with the one before.
    pub cross: Square<D>,
}

/// A step of a Gaussian filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GaussianRecord<const D: usize> {
    /// What was predicted.
    pub prediction: Prediction<D>,
    /// The mean after the step's corrections.
    pub mean: [f64; D],
    /// The covariance after the step's corrections.
    pub covariance: Square<D>,
}

impl<const D: usize> GaussianRecord<D> {
    /// The moments after the step's corrections.
    pub fn moments(&self) -> Moments {
        Moments { mean: self.mean.to_vec(), covariance: self.covariance.as_flattened().to_vec() }
    }
}

impl<const D: usize> Kalman<D> {
    /// A filter that starts from a prior, of which any direction may be known exactly.
    ///
    /// # Errors
    ///
    /// Where the prior has not `D` coordinates, or is no distribution.
    pub fn new(prior: &Moments) -> Result<Self, FilterError> {
        checks::distribution(prior, D)?;
        let (mut mean, mut covariance) = ([0.0; D], [[0.0; D]; D]);
        mean.copy_from_slice(&prior.mean);
        covariance.as_flattened_mut().copy_from_slice(&prior.covariance);
        let prediction = Prediction { mean, covariance, cross: covariance };
        Ok(Self { mean, covariance, prediction, approximation: Approximation::default(), step: 0 })
    }

    /// Treats what is not linear otherwise than by first-order expansion at the mean.
    #[must_use]
    pub fn approximated(self, approximation: Approximation) -> Self {
        Self { approximation, ..self }
    }

    /// The mean.
    pub fn mean(&self) -> &[f64; D] {
        &self.mean
    }

    /// The covariance.
    pub fn covariance(&self) -> &Square<D> {
        &self.covariance
    }

    /// Corrects by what the approximation gives, from the prediction as it is, in storage of a fixed size where the
    /// residual has few components.
    #[inline]
    fn corrected<R: Residual>(&self, residual: &R) -> Result<(Posterior<D>, Correction), MessageError> {
        checks::measured(residual, D)?;
        let m = residual.noise().dimension();
        let length = storage(m, D);
        let mut few = [0.0; FEW];
        match m {
            1 if length <= FEW => self.corrected_in::<1, R>(1, residual, &mut few),
            2 if length <= FEW => self.corrected_in::<2, R>(2, residual, &mut few),
            3 if length <= FEW => self.corrected_in::<3, R>(3, residual, &mut few),
            _ => self.corrected_in::<0, R>(m, residual, &mut vec![0.0; length]),
        }
    }

    /// For a residual of `M` components, or, where `M` is 0, of `m`.
    #[inline(always)]
    fn corrected_in<const M: usize, R: Residual>(
        &self,
        m: usize,
        residual: &R,
        storage: &mut [f64],
    ) -> Result<(Posterior<D>, Correction), MessageError> {
        let m = if M > 0 { M } else { m };
        if let Some(points) = self.approximation.points(D) {
            return self.regressed(points, residual, m, storage);
        }
        let steps = match self.approximation {
            Approximation::Iterated(most) => most.max(1),
            _ => 1,
        };
        let mut at = self.mean;
        let mut step = 0;
        loop {
            let (posterior, correction) = self.linearised_at(&at, residual, m, storage)?;
            step += 1;
            if step >= steps || moved(&posterior, &at) < CONVERGED {
                return Ok((posterior, correction));
            }
            at = posterior.mean;
        }
    }

    /// The posterior where the residual of `m` components is expanded at a point: r(x) ≈ r(x̄) + J (x - x̄).
    #[inline(always)]
    fn linearised_at<R: Residual>(
        &self,
        at: &[f64; D],
        residual: &R,
        m: usize,
        storage: &mut [f64],
    ) -> Result<(Posterior<D>, Correction), MessageError> {
        let (value, storage) = storage.split_at_mut(m);
        let (jacobian, storage) = storage.split_at_mut(m * D);
        let (noise, storage) = storage.split_at_mut(m * m);
        linearise_residual(residual, at, value, jacobian);
        if at != &self.mean {
            for (value, row) in value.iter_mut().zip(jacobian.chunks_exact(D)) {
                *value += (0..D).map(|k| row[k] * (self.mean[k] - at[k])).sum::<f64>();
            }
        }
        noise_against(residual.noise(), value, jacobian, self.covariance.as_flattened(), noise);
        let line = Line { value, jacobian, noise };
        let mut posterior = Posterior { mean: self.mean, covariance: self.covariance };
        let found = correct(line, &mut posterior.mean, posterior.covariance.as_flattened_mut(), storage)?;
        checks::step(&posterior.mean, posterior.covariance.as_flattened(), "the corrected covariance")?;
        let correction = correction(found.log_likelihood, value, found.innovation_covariance);
        Ok((posterior, correction))
    }
}

/// Numbers that a correction keeps for a residual of few components.
const FEW: usize = 80;

/// How many numbers a correction keeps for a residual of `m` components.
fn storage(m: usize, d: usize) -> usize {
    let line = m + m * d + m * m + correction_storage(m, d);
    line.max(d * d + sigma_storage(m, d) + m * m + correction_storage(m, d))
}

/// What a correction by a residual of this mean tells.
#[inline(always)]
fn correction(log_likelihood: f64, residual: &[f64], innovation_covariance: &[f64]) -> Correction {
    let mut innovation: SmallVec<[f64; 6]> = SmallVec::from_slice(residual);
    innovation.iter_mut().for_each(|value| *value = -*value);
    let innovation_covariance = SmallVec::from_slice(innovation_covariance);
    Correction { log_likelihood, innovation, innovation_covariance, recovered: false }
}

impl<const D: usize> Kalman<D> {
    /// Takes other moments in the middle of a step.
    pub(crate) fn stand_at(&mut self, mean: [f64; D], covariance: Square<D>) {
        (self.mean, self.covariance) = (mean, covariance);
    }

    /// The posterior by sigma points, for a residual of `m` components.
    #[inline(always)]
    fn regressed<R: Residual>(
        &self,
        points: SigmaPoints,
        residual: &R,
        m: usize,
        storage: &mut [f64],
    ) -> Result<(Posterior<D>, Correction), MessageError> {
        let (lower, storage) = storage.split_at_mut(D * D);
        let (spread, storage) = storage.split_at_mut(m * m);
        let (moments, storage) = storage.split_at_mut(sigma_storage(m, D));
        semidefinite_factor(self.covariance.as_flattened(), D, "the covariance", lower)?;
        let angles = residual.angles();
        let wrap = |difference: &mut [f64]| {
            angles.iter().for_each(|&k| difference[k] = wrap_angle(difference[k]));
        };
        let evaluate = |x: &[f64], out: &mut [f64]| {
            residual.residual(&[x], out);
            wrap(out);
        };
        let SigmaMoments { mean: value, covariance, cross } =
            sigma_moments(points, &self.mean, lower, m, evaluate, wrap, moments);
        let noise = residual.noise();
        let share = match noise.degrees_of_freedom() {
            None => 1.0,
            Some(_) => noise.weight(noise.expected_squared_length(value, covariance)),
        };
        for (sum, (own, noise)) in spread.iter_mut().zip(covariance.iter().zip(noise.covariance())) {
            *sum = own + noise / share;
        }
        let mut posterior = Posterior { mean: self.mean, covariance: self.covariance };
        let flat = posterior.covariance.as_flattened_mut();
        let log_likelihood = correct_by_regression(value, cross, spread, &mut posterior.mean, flat, storage)?;
        checks::step(&posterior.mean, posterior.covariance.as_flattened(), "the corrected covariance")?;
        Ok((posterior, correction(log_likelihood, value, spread)))
    }

    /// Mean, covariance and cross-covariance of f(x), without noise.
    #[inline(always)]
    fn pass_through<M: Motion>(&self, motion: &M) -> Result<Prediction<D>, MessageError> {
        let zero = [[0.0; D]; D];
        let mut next = Prediction { mean: [0.0; D], covariance: zero, cross: zero };
        let covariance = self.covariance.as_flattened();
        match self.approximation.points(D) {
            None => {
                let mut jacobian = zero;
                linearise_motion(motion, &self.mean, &mut next.mean, jacobian.as_flattened_mut());
                let (cross, predicted) = (next.cross.as_flattened_mut(), next.covariance.as_flattened_mut());
                propagate(jacobian.as_flattened(), covariance, D, cross, predicted);
            }
            Some(points) => {
                let mut lower = zero;
                semidefinite_factor(covariance, D, "the covariance", lower.as_flattened_mut())?;
                let step = |x: &[f64], out: &mut [f64]| motion.step(x, out);
                let (mut few, mut many) = ([0.0; FEW], Vec::new());
                let storage = match sigma_storage(D, D) {
                    length if length <= FEW => &mut few[..],
                    length => {
                        many.resize(length, 0.0);
                        &mut many
                    }
                };
                let found = sigma_moments(points, &self.mean, lower.as_flattened(), D, step, |_| (), storage);
                next.mean.copy_from_slice(found.mean);
                next.cross.as_flattened_mut().copy_from_slice(found.cross);
                next.covariance.as_flattened_mut().copy_from_slice(found.covariance);
            }
        }
        Ok(next)
    }
}

impl<const D: usize, M: Motion> Predict<M> for Kalman<D> {
    #[inline]
    fn predict(&mut self, motion: &M) -> Result<(), FilterError> {
        let failed = FilterError::step(self.step);
        if motion.dimension() != D {
            let (found, expected) = (motion.dimension(), D);
            return Err(failed(MessageError::Dimension { what: "the motion", found, expected }));
        }
        let mut next = self.pass_through(motion).map_err(&failed)?;
        let own;
        let noise = match motion.constant_noise() {
            Some(noise) => noise,
            None => {
                own = motion.noise(&self.mean);
                &own
            }
        };
        noise.add_covariance(next.covariance.as_flattened_mut());
        symmetrise(next.covariance.as_flattened_mut(), D);
        checks::step(&next.mean, next.covariance.as_flattened(), "the predicted covariance")
            .map_err(failed)?;
        (self.mean, self.covariance, self.prediction) = (next.mean, next.covariance, next);
        self.step += 1;
        Ok(())
    }
}

impl<const D: usize, R: Residual> Correct<R> for Kalman<D> {
    #[inline]
    fn correct(&mut self, measurement: &R) -> Result<Correction, FilterError> {
        let (posterior, correction) = self.corrected(measurement).map_err(FilterError::step(self.step))?;
        (self.mean, self.covariance) = (posterior.mean, posterior.covariance);
        Ok(correction)
    }
}

impl<const D: usize> Filter for Kalman<D> {
    type Record = GaussianRecord<D>;

    fn moments(&self) -> Moments {
        self.record().moments()
    }

    fn step(&self) -> u64 {
        self.step
    }

    fn record(&self) -> GaussianRecord<D> {
        GaussianRecord { prediction: self.prediction, mean: self.mean, covariance: self.covariance }
    }
}

impl<const D: usize, M> Smooth<M> for Kalman<D> {
    /// Each step's moments.
    type Smoothed = Vec<Moments>;

    fn smooth(&self, run: &Run<GaussianRecord<D>, M>) -> Result<Vec<Moments>, FilterError> {
        Ok(rts::smooth(run))
    }
}
