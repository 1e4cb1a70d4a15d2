//! Conversions between families, and what they cost.

use super::held::Held;
use crate::kernel::floor_diagonal;
use crate::mixture::{MixtureFamily, MixtureForm, MixtureMessage, drawn_loss};
use crate::particles::{Role, Support};
use crate::{DynamicGaussian, Moments, Particles};
use rand_distr::{Distribution, StandardNormal};
use smallvec::SmallVec;
use std::f64::consts::TAU;
use std::sync::Arc;
use sumprod_graph::{Coordinate, Message, MessageError, Quality, Space, Stream};

pub(super) fn no_distribution() -> MessageError {
    let reason = "particles that are no sample (empty, or values of a likelihood) have no moments; hold this \
                  belief in particles";
    MessageError::Unsupported(reason.into())
}

/// A sample's moments; the loss is its negentropy. The expansion that finds it means nothing for a collapsed cloud; n
/// points cannot tell more than log n nats.
pub(super) fn particles_to_gaussian(particles: &Particles) -> Result<(DynamicGaussian, f64), MessageError> {
    if particles.is_empty() {
        return Ok((DynamicGaussian::flat(particles.dimension()), 0.0));
    }
    if particles.role() == Role::Likelihood {
        return Err(no_distribution());
    }
    let mut moments = particles.moments();
    let d = moments.dimension();
    widen_collapsed(particles, &mut moments);
    floor_diagonal(&mut moments.covariance, d);
    let gaussian = DynamicGaussian::from_moments(&moments.mean, &moments.covariance)?;
    let loss = particles.cumulants(&moments)?.negentropy();
    Ok((gaussian, loss.min((particles.len() as f64).ln())))
}

/// Fewer effective particles n than directions and one leave a covariance that is singular but for rounding, and a
/// Gaussian of it certain of what nobody measured. It is made unbiased, P / (1 - 1/n), and no coordinate is taken to
/// be known finer than the mean distance between neighbouring points.
fn widen_collapsed(particles: &Particles, moments: &mut Moments) {
    let (n, d) = (particles.effective_sample_size(), moments.dimension());
    if n >= (d + 1) as f64 {
        return;
    }
    let unbiased = 1.0 / (1.0 - 1.0 / n).max(1e-6);
    moments.covariance.iter_mut().for_each(|entry| *entry *= unbiased);
    let count = particles.len() as f64;
    let mut offset = vec![0.0; d];
    let (mut sums, mut squares) = (vec![0.0; d], vec![0.0; d]);
    for point in particles.points().chunks_exact(d) {
        particles.offset(point, &moments.mean, &mut offset);
        for (k, x) in offset.iter().enumerate() {
            sums[k] += x;
            squares[k] += x * x;
        }
    }
    for k in 0..d {
        let spread = squares[k] / count - (sums[k] / count).powi(2);
        moments.covariance[k * d + k] += spread.max(0.0) / (count * count);
    }
}

/// Draws from a Gaussian; the loss is the divergence from it to the Gaussian with the sample's moments.
pub(super) fn drawn_from_gaussians(
    gaussian: &DynamicGaussian,
    coordinates: &Arc<[Coordinate]>,
    count: usize,
    stream: &mut Stream,
) -> Result<(Particles, f64), MessageError> {
    if gaussian.is_flat() {
        return Ok((Particles::vacuous(&Space::new(coordinates.to_vec())), 0.0));
    }
    let particles = draw(gaussian, coordinates, count, stream)?;
    let loss = drawn_loss(&gaussian.moments()?, &particles)?;
    Ok((particles, loss))
}

fn draw(
    gaussian: &DynamicGaussian,
    coordinates: &Arc<[Coordinate]>,
    count: usize,
    stream: &mut Stream,
) -> Result<Particles, MessageError> {
    let d = gaussian.dimension();
    let information = gaussian.factor()?;
    let mut mean = gaussian.information_vector().to_vec();
    information.solve(&mut mean);
    let space = Space::new(coordinates.to_vec());
    let log_normaliser = 0.5 * (information.log_determinant() - d as f64 * TAU.ln());
    let mut random = stream.fast();
    let mut points = Vec::with_capacity(count * d);
    let mut log_proposal = Vec::with_capacity(count);
    let mut z: SmallVec<[f64; 6]> = SmallVec::from_elem(0.0, d);
    for _ in 0..count {
        z.iter_mut().for_each(|z| *z = StandardNormal.sample(&mut random));
        log_proposal.push(log_normaliser - 0.5 * z.iter().map(|z| z * z).sum::<f64>());
        // With Λ = L L', L'⁻¹ z has covariance Λ⁻¹.
        information.solve_upper(&mut z);
        let start = points.len();
        points.extend(mean.iter().zip(&z).map(|(mean, offset)| mean + offset));
        space.wrap(&mut points[start..]);
    }
    let support = Support { coordinates: coordinates.to_vec(), points, log_proposal: Some(log_proposal) };
    let log_weights = vec![-(count as f64).ln(); count];
    Ok(Particles { support: Arc::new(support), log_weights, role: Role::Sample })
}

impl Held for DynamicGaussian {
    fn to_gaussian(&self) -> Result<(Self, f64), MessageError> {
        Ok((self.clone(), 0.0))
    }

    fn to_particles(
        &self,
        coordinates: &Arc<[Coordinate]>,
        count: usize,
        stream: &mut Stream,
    ) -> Result<(Particles, f64), MessageError> {
        drawn_from_gaussians(self, coordinates, count, stream)
    }

    fn to_mixture(
        &self,
        coordinates: &[Coordinate],
        _form: &MixtureForm,
    ) -> Result<(MixtureMessage, f64), MessageError> {
        Ok((MixtureMessage::from_gaussian(coordinates, self), 0.0))
    }

    fn to_marginal(
        &self,
        coordinates: &[Coordinate],
        read: &[usize],
        form: &MixtureForm,
    ) -> Result<Option<(MixtureMessage, f64)>, MessageError> {
        MixtureMessage::from_gaussian(coordinates, self).read_marginal(read, form)
    }

    fn add_logs(
        &self,
        coordinates: &[Coordinate],
        points: &[f64],
        power: f64,
        logs: &mut [f64],
    ) -> Result<(), MessageError> {
        for (log, point) in logs.iter_mut().zip(points.chunks_exact(coordinates.len().max(1))) {
            *log += power * log_value(self, coordinates, point);
        }
        Ok(())
    }

    fn is_vacuous(&self) -> bool {
        self.is_flat()
    }

    fn is_distribution(&self) -> bool {
        Message::is_proper(self)
    }

    fn known_quality(&self) -> Quality {
        Message::quality(self)
    }
}

impl Held for Particles {
    fn to_gaussian(&self) -> Result<(DynamicGaussian, f64), MessageError> {
        particles_to_gaussian(self)
    }

    fn to_particles(
        &self,
        _coordinates: &Arc<[Coordinate]>,
        _count: usize,
        _stream: &mut Stream,
    ) -> Result<(Self, f64), MessageError> {
        Ok((self.clone(), 0.0))
    }

    fn to_mixture(
        &self,
        coordinates: &[Coordinate],
        form: &MixtureForm,
    ) -> Result<(MixtureMessage, f64), MessageError> {
        if self.is_empty() {
            return Ok((MixtureMessage::flat(coordinates), 0.0));
        }
        MixtureMessage::from_particles(self, form)
    }

    fn to_marginal(
        &self,
        coordinates: &[Coordinate],
        read: &[usize],
        form: &MixtureForm,
    ) -> Result<Option<(MixtureMessage, f64)>, MessageError> {
        if self.is_empty() {
            let read: Vec<Coordinate> = read.iter().map(|&k| coordinates[k]).collect();
            return Ok(Some((MixtureMessage::flat(&read), 0.0)));
        }
        MixtureMessage::from_particles(&self.marginal(read), form).map(Some)
    }

    fn add_logs(&self, _: &[Coordinate], _: &[f64], _: f64, _: &mut [f64]) -> Result<(), MessageError> {
        Ok(())
    }

    fn is_vacuous(&self) -> bool {
        self.is_empty()
    }

    fn is_distribution(&self) -> bool {
        Message::is_proper(self)
    }

    fn known_quality(&self) -> Quality {
        Message::quality(self)
    }
}

/// Log value of a Gaussian message at a point, angles taken on the turn nearest the message's mean.
fn log_value(gaussian: &DynamicGaussian, coordinates: &[Coordinate], point: &[f64]) -> f64 {
    if !coordinates.contains(&Coordinate::Angle) {
        return gaussian.log_value(point);
    }
    let mut mean: SmallVec<[f64; 6]> = SmallVec::from_elem(0.0, point.len());
    let mut near: SmallVec<[f64; 6]> = SmallVec::from_slice(point);
    if gaussian.mean_into(&mut mean).is_ok() {
        for ((x, mean), kind) in near.iter_mut().zip(&mean).zip(coordinates) {
            if *kind == Coordinate::Angle {
                *x = mean + sumprod_graph::wrap_angle(*x - mean);
            }
        }
    }
    gaussian.log_value(&near)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(log_weights: Vec<f64>) -> Particles {
        let points = (0..100).flat_map(|k| [0.1 * f64::from(k), f64::from(k * 37 % 100)]).collect();
        Particles::new(&Space::real(2), points, log_weights).unwrap()
    }

    #[test]
    fn a_collapsed_cloud_is_no_more_certain_than_its_points_are_close() {
        let mut log_weights = vec![-1e3; 100];
        log_weights[40] = 0.0;
        let (gaussian, loss) = particles_to_gaussian(&sample(log_weights)).unwrap();
        let moments = gaussian.moments().unwrap();
        // 100 even points at distance 0.1 have the variance (100² - 1) / 12 · 0.01, a hundredth squared of which is left.
        assert!((moments.covariance_at(0, 0) / (9999.0 / 12.0 * 1e-6) - 1.0).abs() < 1e-6);
        assert!((moments.mean[0] - 4.0).abs() < 1e-6 && loss <= 100.0_f64.ln());
    }

    #[test]
    fn a_cloud_of_two_has_the_unbiased_variance_and_a_full_one_its_own() {
        let mut log_weights = vec![f64::NEG_INFINITY; 100];
        (log_weights[10], log_weights[30]) = (0.0, 0.0);
        let moments = particles_to_gaussian(&sample(log_weights)).unwrap().0.moments().unwrap();
        // Two points 2 apart: variance 1 about their mean, 2 unbiased.
        assert!((moments.covariance_at(0, 0) - 2.0).abs() < 1e-3, "{}", moments.covariance_at(0, 0));
        let full = sample(vec![0.0; 100]);
        let moments = particles_to_gaussian(&full).unwrap().0.moments().unwrap();
        assert!((moments.covariance_at(0, 0) / full.moments().covariance_at(0, 0) - 1.0).abs() < 1e-8);
    }
}
