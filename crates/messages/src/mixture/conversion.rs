//! Mixtures to and from Gaussians and particles, and what that costs.

use super::potential::{Potential, space_of};
use super::small::{Small, root};
use super::{Mixture, MixtureForm, MixtureMessage};
use crate::moments::gaussian_divergence;
use crate::{DynamicGaussian, Moments, Particles};
use sumprod_graph::{Coordinate, Message, MessageError, Space, Stream, wrap_angle};

/// More components than this are condensed before a divergence is estimated.
const ESTIMATED: usize = 128;

impl MixtureMessage {
    /// The message as a Gaussian of its moments, and the divergence (nats) that costs. One component is a Gaussian
    /// already, of any rank; several need all the directions that they read.
    ///
    /// # Errors
    ///
    /// Where several components leave directions open among the coordinates that they read.
    pub fn to_gaussian(&self) -> Result<(DynamicGaussian, f64), MessageError> {
        match (self.density(), self.potential()) {
            (Some(density), _) => density_to_gaussian(density),
            (None, Some(potential)) => potential_to_gaussian(potential),
            (None, None) => Ok((DynamicGaussian::flat(self.coordinates().len()), 0.0)),
        }
    }

    /// `count` particles drawn from the message, and the divergence (nats) from its moments to theirs.
    ///
    /// # Errors
    ///
    /// Where a component leaves a direction open; what says nothing is an empty set.
    pub fn to_particles(&self, count: usize, stream: &mut Stream) -> Result<(Particles, f64), MessageError> {
        if self.is_flat() {
            return Ok((Particles::vacuous(&Space::new(self.coordinates())), 0.0));
        }
        let density = self.to_density()?;
        let particles = density.sample_systematic(count, stream)?;
        let loss = drawn_loss(&density.moments(), &particles)?;
        Ok((particles, loss))
    }

    /// A sample as a kernel density, condensed to what the form holds, and the divergence (nats) of both: from the
    /// sample's moments to the kernels', and of the components merged.
    ///
    /// # Errors
    ///
    /// Where the particles are values of a likelihood.
    pub fn from_particles(particles: &Particles, form: &MixtureForm) -> Result<(Self, f64), MessageError> {
        if particles.is_empty() {
            return Ok((Self::flat(particles.coordinates()), 0.0));
        }
        let kernels = Mixture::from_particles(particles, &form.bandwidth.rule())?;
        let blurred = drawn_loss(&kernels.moments(), particles)?;
        let (fewer, merged) = kernels.fewer(form.components, None)?;
        Ok((fewer.into(), blurred + merged))
    }
}

/// Divergence from `exact` to the moments of a sample; infinite where it has too few points to have any.
pub(crate) fn drawn_loss(exact: &Moments, particles: &Particles) -> Result<f64, MessageError> {
    let d = exact.dimension();
    if particles.len() <= d {
        return Ok(f64::INFINITY);
    }
    let mut drawn = particles.moments();
    crate::kernel::floor_diagonal(&mut drawn.covariance, d);
    for ((drawn, exact), kind) in drawn.mean.iter_mut().zip(&exact.mean).zip(particles.coordinates()) {
        if *kind == Coordinate::Angle {
            *drawn = exact + wrap_angle(*drawn - exact);
        }
    }
    gaussian_divergence(exact, &drawn)
}

fn density_to_gaussian(density: &Mixture) -> Result<(DynamicGaussian, f64), MessageError> {
    let moments = density.moments();
    let gaussian = DynamicGaussian::from_moments(&moments.mean, &moments.covariance)?;
    Ok((gaussian, density.gaussian_loss(&moments)?))
}

fn potential_to_gaussian(potential: &Potential) -> Result<(DynamicGaussian, f64), MessageError> {
    if let Some(gaussian) = potential.as_gaussian() {
        return Ok((gaussian, 0.0));
    }
    let read = potential.read();
    if read.is_empty() {
        return Ok((DynamicGaussian::flat(potential.dimension()), 0.0));
    }
    let (density, _) = potential.density_on(&read)?;
    let moments = density.moments();
    let one = Mixture::with_shared_covariance(
        &space_of(density.coordinates()),
        vec![0.0],
        moments.mean.clone(),
        moments.covariance.clone(),
    )?;
    let message = Potential::from_density_on(potential.coordinates(), &read, &one);
    let gaussian = message.as_gaussian().unwrap_or_else(|| DynamicGaussian::flat(potential.dimension()));
    Ok((gaussian, density.gaussian_loss(&moments)?))
}

impl Mixture {
    /// Divergence (nats) from this mixture p to the Gaussian q of its moments: the mean of ln p - ln q over the centre
    /// and the 2d points at √3 (beyond three coordinates, √d) standard deviations of every component, which is exact
    /// where both logarithms are cubic there.
    fn gaussian_loss(&self, moments: &Moments) -> Result<f64, MessageError> {
        if self.len() == 1 {
            return Ok(0.0);
        }
        let condensed;
        let density = match self.len() > ESTIMATED {
            true => {
                condensed = self.condense(ESTIMATED, 0.0)?.0;
                &condensed
            }
            false => self,
        };
        let d = density.dimension();
        let space = Space::new(density.coordinates());
        let (mean, covariance) = (moments.mean.clone(), moments.covariance.clone());
        let gaussian = Self::with_shared_covariance(&space, vec![0.0], mean, covariance)?;
        let squared = (d as f64).max(3.0);
        let spread = squared.sqrt();
        let mut loss = 0.0;
        let mut point = Small::from_elem(0.0, d);
        for (i, weight) in density.weights().iter().enumerate() {
            let Some(factor) = root(density.covariance_of(i), d) else { continue };
            let mean = density.mean_of(i);
            let at_centre = density.log_density(mean)? - gaussian.log_density(mean)?;
            loss += weight * (1.0 - d as f64 / squared) * at_centre;
            for column in 0..d {
                for sign in [spread, -spread] {
                    for (row, x) in point.iter_mut().enumerate() {
                        *x = mean[row] + sign * factor[row * d + column];
                    }
                    let log = density.log_density(&point)? - gaussian.log_density(&point)?;
                    loss += weight * log / (2.0 * squared);
                }
            }
        }
        Ok(loss.max(0.0))
    }
}
