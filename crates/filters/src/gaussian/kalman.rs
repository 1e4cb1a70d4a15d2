//! The Kalman filter of `D` coordinates, and its extended and iterated forms.
//!
//! Predict: m ← f(m), P ← F P F' + B B'. Correct, with r the residual at m and J its Jacobian: S = J P J' + R,
//! K = P J' S⁻¹, m ← m - K r, P ← (I - K J) P (I - K J)' + K R K'. Source: Kalman 1960; the form of P is Joseph's.

use smallvec::SmallVec;
use sumprod_graph::{MessageError, wrap_angle};
use sumprod_messages::Moments;
use sumprod_models::moments::{
    Line, SigmaMoments, SigmaPoints, correct, correct_by_regression, linearise_motion, noise_against,
    propagate, semidefinite_factor, sigma_moments, symmetrise,
};
use sumprod_models::{Linearised, Motion, Residual, ResidualModel};

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

    /// Corrects by the line that the approximation gives, from the prediction as it is.
    #[inline]
    fn corrected<R: Residual>(&self, residual: &R) -> Result<(Posterior<D>, Correction), MessageError> {
        checks::measured(residual, D)?;
        let steps = match self.approximation {
            Approximation::Iterated(most) => most.max(1),
            _ => 1,
        };
        if let Some(points) = self.approximation.points(D) {
            return self.regressed(points, residual);
        }
        let mut at = self.mean;
        let mut step = 0;
        loop {
            let (posterior, correction) = self.linearised_at(&at, residual)?;
            step += 1;
            if step >= steps || moved(&posterior, &at) < CONVERGED {
                return Ok((posterior, correction));
            }
            at = posterior.mean;
        }
    }

    /// The posterior where the residual is expanded at a point: r(x) ≈ r(x̄) + J (x - x̄).
    #[inline]
    fn linearised_at<R: Residual>(
        &self,
        at: &[f64; D],
        residual: &R,
    ) -> Result<(Posterior<D>, Correction), MessageError> {
        let m = residual.noise().dimension();
        let mut value: SmallVec<[f64; 6]> = SmallVec::from_elem(0.0, m);
        let mut jacobian: SmallVec<[f64; 36]> = SmallVec::from_elem(0.0, m * D);
        ResidualModel(residual).linearise(at, &mut value, &mut jacobian);
        if at != &self.mean {
            for (value, row) in value.iter_mut().zip(jacobian.chunks_exact(D)) {
                *value += (0..D).map(|k| row[k] * (self.mean[k] - at[k])).sum::<f64>();
            }
        }
        let covariance = self.covariance.as_flattened();
        let noise = noise_against(residual.noise(), &value, &jacobian, covariance);
        let line = Line { value: &value, jacobian: &jacobian, noise: &noise };
        let mut posterior = Posterior { mean: self.mean, covariance: self.covariance };
        let found = correct(line, &mut posterior.mean, posterior.covariance.as_flattened_mut())?;
        checks::step(&posterior.mean, posterior.covariance.as_flattened(), "the corrected covariance")?;
        value.iter_mut().for_each(|value| *value = -*value);
        let correction = Correction {
            log_likelihood: found.log_likelihood,
            innovation: value,
            innovation_covariance: found.innovation_covariance,
            recovered: false,
        };
        Ok((posterior, correction))
    }
}

impl<const D: usize> Kalman<D> {
    /// Takes other moments in the middle of a step.
    pub(crate) fn stand_at(&mut self, mean: [f64; D], covariance: Square<D>) {
        (self.mean, self.covariance) = (mean, covariance);
    }

    /// The posterior by sigma points.
    fn regressed<R: Residual>(
        &self,
        points: SigmaPoints,
        residual: &R,
    ) -> Result<(Posterior<D>, Correction), MessageError> {
        let mut lower = [[0.0; D]; D];
        let covariance = self.covariance.as_flattened();
        semidefinite_factor(covariance, D, "the covariance", lower.as_flattened_mut())?;
        let model = ResidualModel(residual);
        let angles = residual.angles();
        let SigmaMoments { mean: mut value, covariance: mut spread, cross } = sigma_moments(
            points,
            &self.mean,
            lower.as_flattened(),
            residual.noise().dimension(),
            |x, out| model.evaluate(x, out),
            |difference| angles.iter().for_each(|&k| difference[k] = wrap_angle(difference[k])),
        );
        let noise = residual.noise();
        let share = match noise.degrees_of_freedom() {
            None => 1.0,
            Some(_) => noise.weight(noise.expected_squared_length(&value, &spread)),
        };
        spread.iter_mut().zip(noise.covariance()).for_each(|(sum, own)| *sum += own / share);
        let mut posterior = Posterior { mean: self.mean, covariance: self.covariance };
        let flat = posterior.covariance.as_flattened_mut();
        let found = correct_by_regression(&value, &cross, &spread, &mut posterior.mean, flat)?;
        checks::step(&posterior.mean, posterior.covariance.as_flattened(), "the corrected covariance")?;
        value.iter_mut().for_each(|value| *value = -*value);
        let correction = Correction {
            log_likelihood: found.log_likelihood,
            innovation: value,
            innovation_covariance: found.innovation_covariance,
            recovered: false,
        };
        Ok((posterior, correction))
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
                let found = sigma_moments(points, &self.mean, lower.as_flattened(), D, step, |_| ());
                next.mean.copy_from_slice(&found.mean);
                next.cross.as_flattened_mut().copy_from_slice(&found.cross);
                next.covariance.as_flattened_mut().copy_from_slice(&found.covariance);
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
