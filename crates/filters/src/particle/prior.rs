//! Particles drawn from a Gaussian.

use rand_distr::{Distribution, StandardNormal};
use sumprod_graph::{Coordinate, FastStream, wrap_angle};
use sumprod_messages::Moments;
use sumprod_models::ProcessNoise;
use sumprod_models::cloud::Cloud;

use crate::FilterError;
use crate::gaussian::checks;

/// Draws every particle of a cloud from moments, of which any direction may be known exactly.
///
/// # Errors
///
/// [`FilterError::Prior`] where the moments are no distribution of the cloud's dimension.
pub(crate) fn draw(
    moments: &Moments,
    coordinates: &[Coordinate],
    random: &mut FastStream,
    cloud: &mut Cloud,
) -> Result<(), FilterError> {
    for particle in 0..cloud.len() {
        (0..cloud.dimension()).for_each(|k| cloud.set(particle, k, 0.0));
    }
    add(moments, coordinates, random, cloud)
}

/// Adds a draw from moments to every particle.
///
/// # Errors
///
/// As [`draw`].
pub(crate) fn add(
    moments: &Moments,
    coordinates: &[Coordinate],
    random: &mut FastStream,
    cloud: &mut Cloud,
) -> Result<(), FilterError> {
    let d = cloud.dimension();
    checks::distribution(moments, d)?;
    let noise = ProcessNoise::from_covariance(&moments.covariance).map_err(FilterError::Prior)?;
    for particle in 0..cloud.len() {
        let z: Vec<f64> = (0..d).map(|_| StandardNormal.sample(random)).collect();
        for (k, kind) in coordinates.iter().enumerate() {
            let row = &noise.factor()[k * d..][..d];
            let x =
                cloud.at(particle, k) + moments.mean[k] + row.iter().zip(&z).map(|(b, z)| b * z).sum::<f64>();
            cloud.set(particle, k, if *kind == Coordinate::Angle { wrap_angle(x) } else { x });
        }
    }
    Ok(())
}
