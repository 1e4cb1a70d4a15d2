//! Mixtures to and from Gaussians and particles, and what that costs.

use super::potential::{Potential, space_of};
use super::reduction::SAME;
use super::small::{Small, congruence, difference, multiply, root, whitener};
use super::{Evaluator, Mixture, MixtureForm, MixtureMessage};
use crate::cumulants::Cumulants;
use crate::kernel::floor_diagonal;
use crate::moments::gaussian_divergence;
use crate::particles::Role;
use crate::{DynamicGaussian, Moments, Particles};
use std::f64::consts::TAU;
use sumprod_graph::{Coordinate, Message, MessageError, Space, Stream, wrap_angle};

/// More components than this are condensed before a divergence is estimated.
const ESTIMATED: usize = 128;

/// The same, where the question is whether there is any to speak of.
const SKETCHED: usize = 32;

/// Negentropy (nats) up to which a sample is read as one Gaussian: two modes have it whose density falls to three
/// quarters between them.
const PLAIN: f64 = 0.02;

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

    /// A sample as a mixture, and the divergence (nats) that costs. One that is a Gaussian's, as far as its points can
    /// tell, becomes that Gaussian, whose width kernels would only add to. Any other becomes a kernel density, condensed
    /// to what the form holds: the loss is that from the sample's moments to the kernels', and of the components merged.
    ///
    /// # Errors
    ///
    /// Where the particles are values of a likelihood.
    pub fn from_particles(particles: &Particles, form: &MixtureForm) -> Result<(Self, f64), MessageError> {
        if particles.is_empty() {
            return Ok((Self::flat(particles.coordinates()), 0.0));
        }
        if particles.role() == Role::Sample
            && let Some((one, loss)) = one_gaussian(particles)?
        {
            return Ok((one.into(), loss));
        }
        let kernels = Mixture::from_particles(particles, &form.bandwidth.rule())?;
        let blurred = drawn_loss(&kernels.moments(), particles)?;
        // Splitting from the top takes a fiftieth of the time of merging a thousand kernels pair by pair.
        let (fewer, merged) = kernels.condense(form.components, SAME)?;
        Ok((fewer.into(), blurred + merged))
    }
}

/// The Gaussian of a sample's moments and the sample's negentropy, where that is at most [`PLAIN`] beyond doubt: with
/// two standard deviations of its estimate added, which over the draws of a Gaussian is χ² / 2n about dof / 2n.
fn one_gaussian(particles: &Particles) -> Result<Option<(Mixture, f64)>, MessageError> {
    let n = particles.effective_sample_size();
    let mut moments = particles.moments();
    let d = moments.dimension();
    let dof = Cumulants::new(d).count() as f64;
    let doubt = (2.0 * dof).sqrt() / n;
    if doubt > PLAIN {
        return Ok(None);
    }
    floor_diagonal(&mut moments.covariance, d);
    let excess = particles.cumulants(&moments)?.negentropy() - 0.5 * dof / n;
    if excess + doubt > PLAIN {
        return Ok(None);
    }
    let space = space_of(particles.coordinates());
    let one = Mixture::with_shared_covariance(&space, vec![0.0], moments.mean, moments.covariance)?;
    Ok(Some((one, excess.max(0.0))))
}

/// Divergence from `exact` to the moments of a sample; infinite where it has too few points to have any.
pub(crate) fn drawn_loss(exact: &Moments, particles: &Particles) -> Result<f64, MessageError> {
    let d = exact.dimension();
    if particles.len() <= d {
        return Ok(f64::INFINITY);
    }
    let mut drawn = particles.moments();
    floor_diagonal(&mut drawn.covariance, d);
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
    Ok((gaussian, density.gaussian_loss(&moments, ESTIMATED)?))
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
    Ok((gaussian, density.gaussian_loss(&moments, ESTIMATED)?))
}

impl Mixture {
    /// The one Gaussian that this mixture is to within `tolerance` nats, and how far it is from that.
    pub(super) fn as_one(&self, tolerance: f64) -> Result<Option<(Self, f64)>, MessageError> {
        let d = self.dimension();
        let moments = self.moments();
        let Some((whitener, _)) = whitener(&moments.covariance, d) else { return Ok(None) };
        let mut cumulants = Cumulants::new(d);
        let (mut offset, mut mean) = (Small::from_elem(0.0, d), Small::from_elem(0.0, d));
        let mut covariance = Small::from_elem(0.0, d * d);
        for (i, weight) in self.weights().iter().enumerate() {
            difference(self.coordinates(), self.mean_of(i), &moments.mean, &mut offset);
            multiply(&whitener, &offset, &mut mean);
            if i == 0 || !self.shared {
                congruence(&whitener, self.covariance_of(i), d, &mut covariance);
            }
            cumulants.add_gaussian(*weight, &mean, &covariance);
        }
        // Cumulants alone cannot tell a few spikes at the nodes of a quadrature from a Gaussian.
        if cumulants.negentropy() > 2.0 * tolerance {
            return Ok(None);
        }
        let loss = self.gaussian_loss(&moments, SKETCHED)?;
        if loss > tolerance {
            return Ok(None);
        }
        let Moments { mean, covariance } = moments;
        Ok(Some((Self::with_shared_covariance(&self.space(), vec![0.0], mean, covariance)?, loss)))
    }

    /// Divergence (nats) from this mixture p to the Gaussian q of its moments: the mean of ln p - ln q over the centre
    /// and the 2d points at √3 (beyond three coordinates, √d) standard deviations of every component, which is exact
    /// where both logarithms are cubic there. More than `most` components are condensed first.
    fn gaussian_loss(&self, moments: &Moments, most: usize) -> Result<f64, MessageError> {
        if self.len() == 1 {
            return Ok(0.0);
        }
        let condensed;
        let density = match self.len() > most {
            true => {
                condensed = self.condense(most, 0.0)?.0;
                &condensed
            }
            false => self,
        };
        let d = density.dimension();
        let Some((whitener, log_determinant)) = whitener(&moments.covariance, d) else {
            return Ok(f64::INFINITY);
        };
        let squared = (d as f64).max(3.0);
        let (mut points, mut shares) = (Vec::new(), Vec::new());
        for (i, weight) in density.weights().iter().enumerate() {
            let Some(factor) = root(density.covariance_of(i), d) else { continue };
            points.extend_from_slice(density.mean_of(i));
            shares.push(weight * (1.0 - d as f64 / squared));
            for column in 0..d {
                for sign in [squared.sqrt(), -squared.sqrt()] {
                    let mean = density.mean_of(i).iter().enumerate();
                    points.extend(mean.map(|(row, mean)| mean + sign * factor[row * d + column]));
                    shares.push(weight / (2.0 * squared));
                }
            }
        }
        let mut logs = vec![0.0; shares.len()];
        Evaluator::new(density).log_densities(&points, &mut logs)?;
        let (mut offset, mut white) = (Small::from_elem(0.0, d), Small::from_elem(0.0, d));
        let mut loss = 0.0;
        for ((share, log), point) in shares.iter().zip(&logs).zip(points.chunks_exact(d)) {
            difference(density.coordinates(), point, &moments.mean, &mut offset);
            multiply(&whitener, &offset, &mut white);
            let distance: f64 = white.iter().map(|x| x * x).sum();
            loss += share * (log + 0.5 * (distance + log_determinant + d as f64 * TAU.ln()));
        }
        Ok(loss.max(0.0))
    }
}
