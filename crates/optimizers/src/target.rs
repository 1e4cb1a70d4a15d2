//! What particles are moved towards: a prior that they sample, times a likelihood that can be evaluated.
//!
//! π(x) ∝ p(x) ℓ(x). The prior p is known by a weighted sample, for instance what a motion predicts, and sometimes by
//! its density as well; a motion whose noise is singular has none. The likelihood ℓ is a function. It is what costs
//! in a filter, so a [`Target`] counts each point at which it is evaluated, and optimizers are compared at equal
//! counts.

use sumprod_graph::{Coordinate, FastStream, Space, wrap_angle};
use sumprod_messages::{Particles, Role};

use crate::error::OptimizerError;

/// The logarithm of a positive function of points, known up to a constant.
///
/// A function or closure of one point is one.
pub trait LogDensity: Sync {
    /// Writes the log value at each row of `points` (row-major, `values.len()` rows): finite, or −∞ where the
    /// function is zero.
    ///
    /// # Errors
    ///
    /// Where the function cannot be evaluated.
    fn log_values(&self, points: &[f64], values: &mut [f64]) -> Result<(), OptimizerError>;
}

impl<F: Fn(&[f64]) -> f64 + Sync> LogDensity for F {
    fn log_values(&self, points: &[f64], values: &mut [f64]) -> Result<(), OptimizerError> {
        let dimension = points.len() / values.len().max(1);
        for (point, value) in points.chunks_exact(dimension.max(1)).zip(values) {
            *value = self(point);
        }
        Ok(())
    }
}

/// The normalised density that the particles of a prior are a sample of.
pub trait PriorDensity: LogDensity {
    /// `count` new points of that density (row-major).
    ///
    /// # Errors
    ///
    /// Where the density cannot be drawn from.
    fn draw(&self, count: usize, random: &mut FastStream) -> Result<Vec<f64>, OptimizerError>;
}

/// A prior known by a sample, times a likelihood whose evaluations are counted.
pub struct Target<'a> {
    prior: &'a Particles,
    prior_density: Option<&'a dyn PriorDensity>,
    likelihood: &'a dyn LogDensity,
    evaluations: u64,
}

impl<'a> Target<'a> {
    /// The product of what `prior` samples and of `likelihood`.
    ///
    /// # Errors
    ///
    /// Where there are no particles, or they hold a likelihood.
    pub fn new(prior: &'a Particles, likelihood: &'a dyn LogDensity) -> Result<Self, OptimizerError> {
        if prior.is_empty() {
            return Err(OptimizerError::Empty { what: "the number of particles" });
        }
        if prior.role() == Role::Likelihood {
            return Err(OptimizerError::Likelihood);
        }
        Ok(Self { prior, prior_density: None, likelihood, evaluations: 0 })
    }

    /// The same, with the density that the prior's particles are a sample of.
    #[must_use]
    pub fn with_prior_density(mut self, density: &'a dyn PriorDensity) -> Self {
        self.prior_density = Some(density);
        self
    }

    /// The sample of the prior.
    pub fn prior(&self) -> &'a Particles {
        self.prior
    }

    /// Number of coordinates.
    pub fn dimension(&self) -> usize {
        self.prior.dimension()
    }

    /// The space of the points.
    pub fn space(&self) -> Space {
        Space::new(self.prior.coordinates())
    }

    /// Brings the angles of every row of `points` into (−π, π].
    pub fn wrap(&self, points: &mut [f64]) {
        let coordinates = self.prior.coordinates();
        if coordinates.contains(&Coordinate::Angle) {
            for (x, coordinate) in points.iter_mut().zip(coordinates.iter().cycle()) {
                if *coordinate == Coordinate::Angle {
                    *x = wrap_angle(*x);
                }
            }
        }
    }

    /// Writes the log likelihood of each row of `points`, and counts the rows.
    ///
    /// # Errors
    ///
    /// Where the numbers of points and values differ, the likelihood cannot be evaluated, or a value is NaN or +∞.
    pub fn log_likelihood(&mut self, points: &[f64], values: &mut [f64]) -> Result<(), OptimizerError> {
        self.evaluations += values.len() as u64;
        self.checked(self.likelihood, "log likelihood", points, values)
    }

    /// Writes the log density of the prior at each row of `points`; returns false, and writes nothing, where it is
    /// known by its sample alone.
    ///
    /// # Errors
    ///
    /// As [`log_likelihood`](Self::log_likelihood).
    pub fn log_prior(&self, points: &[f64], values: &mut [f64]) -> Result<bool, OptimizerError> {
        match self.prior_density {
            Some(density) => self.checked(density, "log density of the prior", points, values).map(|()| true),
            None => Ok(false),
        }
    }

    /// The prior's density, where it is known.
    pub fn prior_density(&self) -> Option<&'a dyn PriorDensity> {
        self.prior_density
    }

    /// Number of points at which the likelihood has been evaluated.
    pub fn evaluations(&self) -> u64 {
        self.evaluations
    }

    fn checked(
        &self,
        density: &dyn LogDensity,
        what: &'static str,
        points: &[f64],
        values: &mut [f64],
    ) -> Result<(), OptimizerError> {
        let dimension = self.dimension();
        if points.len() != values.len() * dimension {
            let (points, values) = (points.len(), values.len());
            return Err(OptimizerError::Rows { points, values, dimension });
        }
        density.log_values(points, values)?;
        match values.iter().position(|value| value.is_nan() || *value == f64::INFINITY) {
            Some(row) => {
                let point = points[row * dimension..(row + 1) * dimension].to_vec();
                Err(OptimizerError::Density { what, value: values[row], point })
            }
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Second;

    impl LogDensity for Second {
        fn log_values(&self, points: &[f64], values: &mut [f64]) -> Result<(), OptimizerError> {
            values.iter_mut().zip(points.chunks_exact(3)).for_each(|(value, x)| *value = x[1]);
            Ok(())
        }
    }

    impl PriorDensity for Second {
        fn draw(&self, count: usize, _: &mut FastStream) -> Result<Vec<f64>, OptimizerError> {
            Ok(vec![0.0; 3 * count])
        }
    }

    fn prior() -> Particles {
        Particles::equally_weighted(&Space::pose2(), vec![0.0, 1.0, 3.0, 2.0, 3.0, -3.0]).unwrap()
    }

    #[test]
    fn evaluations_of_the_likelihood_are_counted_and_those_of_the_prior_are_not() {
        let (prior, likelihood) = (prior(), |x: &[f64]| -x[0]);
        let mut target = Target::new(&prior, &likelihood).unwrap();
        let mut values = [0.0; 2];
        assert!(!target.log_prior(prior.points(), &mut values).unwrap());
        target.log_likelihood(prior.points(), &mut values).unwrap();
        target.log_likelihood(prior.point(1), &mut values[..1]).unwrap();
        assert_eq!((values, target.evaluations()), ([-2.0, -2.0], 3));
        let target = Target::new(&prior, &likelihood).unwrap().with_prior_density(&Second);
        assert!(target.log_prior(prior.points(), &mut values).unwrap());
        assert_eq!((values, target.evaluations()), ([1.0, 3.0], 0));
    }

    #[test]
    fn a_value_that_is_no_density_is_refused_with_its_point() {
        let prior = prior();
        for wrong in [f64::NAN, f64::INFINITY] {
            let likelihood = |x: &[f64]| if x[0] > 1.0 { wrong } else { f64::NEG_INFINITY };
            let mut target = Target::new(&prior, &likelihood).unwrap();
            let error = target.log_likelihood(prior.points(), &mut [0.0; 2]).unwrap_err().to_string();
            assert!(error.contains("[2.0, 3.0, -3.0]") && error.contains(&wrong.to_string()), "{error}");
            assert!(target.log_likelihood(prior.point(0), &mut [0.0]).is_ok());
            let error = target.log_likelihood(&[0.0; 4], &mut [0.0]).unwrap_err().to_string();
            assert!(error.contains("4 numbers"), "{error}");
        }
    }

    #[test]
    fn angles_are_wrapped_in_every_row() {
        let (prior, likelihood) = (prior(), |_: &[f64]| 0.0);
        let target = Target::new(&prior, &likelihood).unwrap();
        let mut points = [9.0, 9.0, 4.0, 9.0, 9.0, -4.0];
        target.wrap(&mut points);
        assert_eq!(points[..2], [9.0; 2]);
        assert!(points[2] < -2.0 && points[5] > 2.0);
    }
}
