//! Ranges: between two points, to an anchor, and with a sensor's scale and offset as a variable.
//!
//! Variables may be larger than a position (a state, a pose): a range reads the coordinates it is told to.

use super::checks::{coordinates, finite, size};
use crate::packed::is_packed;
use crate::{Noise, PortSampler, Real, Residual, Ring, RingCentre};
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use std::f64::consts::TAU;
use sumprod_graph::{FastStream, MessageError, Port};

/// Shortest distance whose direction is taken as known (m): below it a range has no gradient.
pub(super) const TOUCHING: f64 = 1e-9;

/// The length of the vector (x, y), for residuals of points in the plane: its derivatives are finite everywhere.
#[inline(always)]
pub fn distance<T: Real>(x: T, y: T) -> T {
    length([x, y])
}

/// The length of a vector; its derivatives are finite everywhere.
#[inline]
pub(super) fn length<T: Real, const N: usize>(offset: [T; N]) -> T {
    let squared = offset.into_iter().fold(T::from(0.0), |sum, x| sum + x * x);
    // At coincident points the derivative of the root does not exist; the direction is left open.
    // Particles need no derivative.
    if !is_packed::<T>() && squared.re() < TOUCHING * TOUCHING { squared } else { squared.sqrt() }
}

/// The measured distance z between two positions, in the plane or in `N` dimensions: r = |p₁ - p₀| - z.
#[derive(Clone, Debug)]
pub struct Range<const N: usize = 2> {
    measured: f64,
    dimensions: [usize; 2],
    positions: [[usize; N]; 2],
    noise: Noise,
}

impl<const N: usize> Range<N> {
    /// A range (m) between two variables of these dimensions, whose positions are at these coordinates.
    ///
    /// # Errors
    ///
    /// Where the range is not finite, a variable lacks a coordinate, or the noise has not one component.
    pub fn new(
        measured: f64,
        dimensions: [usize; 2],
        positions: [[usize; N]; 2],
        noise: Noise,
    ) -> Result<Self, MessageError> {
        finite("the measured range", &[measured])?;
        coordinates("the range's position at port 0", &positions[0], dimensions[0])?;
        coordinates("the range's position at port 1", &positions[1], dimensions[1])?;
        size("the noise of the range", noise.dimension(), 1)?;
        Ok(Self { measured, dimensions, positions, noise })
    }
}

impl<const N: usize> Residual for Range<N> {
    fn dimensions(&self) -> &[usize] {
        &self.dimensions
    }

    fn noise(&self) -> &Noise {
        &self.noise
    }

    #[inline]
    fn residual<T: Real>(&self, x: &[&[T]], out: &mut [T]) {
        let [a, b] = self.positions;
        out[0] = length(std::array::from_fn::<T, N, _>(|k| x[1][b[k]] - x[0][a[k]])) - self.measured;
    }

    fn ring(&self, port: Port) -> Option<Ring> {
        // A ring is one of the plane.
        let position = <[usize; 2]>::try_from(self.positions.get(port)?.as_slice()).ok()?;
        let centre = <[usize; 2]>::try_from(self.positions.get(1 - port)?.as_slice()).ok()?;
        Some(Ring { radius: self.measured, position, centre: RingCentre::Port(1 - port, centre) })
    }
}

/// Refuses what no range to an anchor can be made of.
fn check_anchor_range<const N: usize>(
    measured: f64,
    anchor: [f64; N],
    dimension: usize,
    position: [usize; N],
    noise: &Noise,
) -> Result<(), MessageError> {
    finite("the measured range", &[measured])?;
    finite("the anchor's position", &anchor)?;
    coordinates("the range's position", &position, dimension)?;
    size("the noise of the range", noise.dimension(), 1)
}

/// The measured distance z to an anchor at a known position, in the plane or in `N` dimensions: r = |p - a| - z.
#[derive(Clone, Debug)]
pub struct AnchorRange<const N: usize = 2> {
    measured: f64,
    anchor: [f64; N],
    dimensions: [usize; 1],
    position: [usize; N],
    noise: Noise,
}

impl<const N: usize> AnchorRange<N> {
    /// A range (m) from a variable of this dimension, its position at these coordinates, to an anchor (m).
    ///
    /// # Errors
    ///
    /// Where the range or the anchor is not finite, the variable lacks a coordinate, or the noise has not one
    /// component.
    pub fn new(
        measured: f64,
        anchor: [f64; N],
        dimension: usize,
        position: [usize; N],
        noise: Noise,
    ) -> Result<Self, MessageError> {
        check_anchor_range(measured, anchor, dimension, position, &noise)?;
        Ok(Self { measured, anchor, dimensions: [dimension], position, noise })
    }
}

impl<const N: usize> Residual for AnchorRange<N> {
    fn dimensions(&self) -> &[usize] {
        &self.dimensions
    }

    fn noise(&self) -> &Noise {
        &self.noise
    }

    fn known_place(&self) -> Option<&[f64]> {
        Some(&self.anchor)
    }

    #[inline]
    fn residual<T: Real>(&self, x: &[&[T]], out: &mut [T]) {
        let offset = std::array::from_fn::<T, N, _>(|k| x[0][self.position[k]] - self.anchor[k]);
        out[0] = length(offset) - self.measured;
    }

    fn sampler(&self, _port: Port) -> Option<&dyn PortSampler> {
        // A ring or sphere determines a position alone.
        (self.dimensions[0] == N).then_some(self)
    }

    fn ring(&self, _port: Port) -> Option<Ring> {
        // A ring is one of the plane.
        let centre = RingCentre::Fixed(<[f64; 2]>::try_from(self.anchor.as_slice()).ok()?);
        let position = <[usize; 2]>::try_from(self.position.as_slice()).ok()?;
        Some(Ring { radius: self.measured, position, centre })
    }
}

impl<const N: usize> PortSampler for AnchorRange<N> {
    /// A point of the ring or sphere: uniform direction, radius z + v. The density of such points falls as a power of
    /// one over the radius, which matters only where the noise is not small against the range.
    fn sample(&self, _others: &[&[f64]], out: &mut [f64], random: &mut FastStream) {
        let mut direction = [0.0; N];
        if let [x, y] = direction.as_mut_slice() {
            let angle = TAU * random.random::<f64>();
            (*x, *y) = (angle.cos(), angle.sin());
        } else {
            direction.fill_with(|| StandardNormal.sample(random));
            let size = length(direction).max(f64::MIN_POSITIVE);
            direction.iter_mut().for_each(|entry| *entry /= size);
        }
        let error: f64 = StandardNormal.sample(random);
        let radius = (self.measured + self.noise.covariance()[0].sqrt() * error).abs();
        for ((place, anchor), direction) in self.position.iter().zip(&self.anchor).zip(direction) {
            out[*place] = anchor + radius * direction;
        }
    }
}

/// A range to an anchor by a sensor with scale and offset: r = (1 + s) |p - a| + c - z, where port 0 holds the
/// position and port 1 the calibration [s, c] (dimensionless, m).
#[derive(Clone, Debug)]
pub struct CalibratedRange {
    measured: f64,
    anchor: [f64; 2],
    dimensions: [usize; 2],
    position: [usize; 2],
    noise: Noise,
}

impl CalibratedRange {
    /// A range (m) from a variable of this dimension, its position at these coordinates, to an anchor (m).
    ///
    /// # Errors
    ///
    /// Where the range or the anchor is not finite, the variable lacks a coordinate, or the noise has not one
    /// component.
    pub fn new(
        measured: f64,
        anchor: [f64; 2],
        dimension: usize,
        position: [usize; 2],
        noise: Noise,
    ) -> Result<Self, MessageError> {
        check_anchor_range(measured, anchor, dimension, position, &noise)?;
        Ok(Self { measured, anchor, dimensions: [dimension, 2], position, noise })
    }
}

impl Residual for CalibratedRange {
    fn dimensions(&self) -> &[usize] {
        &self.dimensions
    }

    fn noise(&self) -> &Noise {
        &self.noise
    }

    fn known_place(&self) -> Option<&[f64]> {
        Some(&self.anchor)
    }

    #[inline]
    fn residual<T: Real>(&self, x: &[&[T]], out: &mut [T]) {
        let [east, north] = self.position;
        let true_range = distance(x[0][east] - self.anchor[0], x[0][north] - self.anchor[1]);
        out[0] = true_range * (x[1][0] + 1.0) + x[1][1] - self.measured;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(components: usize) -> Noise {
        Noise::isotropic(components, 1.0).unwrap()
    }

    #[test]
    fn a_range_refuses_what_it_cannot_read() {
        let place = [0, 1];
        assert!(Range::new(1.0, [2, 4], [place, [0, 3]], noise(1)).is_ok());
        for measured in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            let error = Range::new(measured, [2, 2], [place; 2], noise(1)).unwrap_err();
            assert!(matches!(error, MessageError::NotFinite { what: "the measured range", .. }), "{error}");
        }
        for (dimensions, positions, what, index, dimension) in [
            ([1, 2], [place; 2], "the range's position at port 0", 1, 1),
            ([4, 4], [place, [4, 0]], "the range's position at port 1", 4, 4),
            ([2, 0], [place; 2], "the range's position at port 1", 0, 0),
            ([2, 2], [[0, usize::MAX], place], "the range's position at port 0", usize::MAX, 2),
        ] {
            let error = Range::new(1.0, dimensions, positions, noise(1)).unwrap_err();
            assert_eq!(error, MessageError::Coordinate { what, index, dimension });
        }
        assert_eq!(
            Range::new(1.0, [2, 2], [place; 2], noise(2)).unwrap_err(),
            MessageError::Dimension { what: "the noise of the range", found: 2, expected: 1 }
        );
    }

    #[test]
    fn ranges_to_anchors_refuse_what_they_cannot_read() {
        type Arguments = (f64, [f64; 2], usize, [usize; 2], Noise);
        let refusal = |(measured, anchor, dimension, position, noise): Arguments| {
            let plain = AnchorRange::new(measured, anchor, dimension, position, noise.clone()).err();
            let calibrated = CalibratedRange::new(measured, anchor, dimension, position, noise).err();
            assert_eq!(plain.as_ref().map(ToString::to_string), calibrated.map(|error| error.to_string()));
            plain
        };
        assert_eq!(refusal((1.0, [0.0, 2.0], 4, [2, 0], noise(1))), None);
        let measured = refusal((f64::NAN, [0.0; 2], 2, [0, 1], noise(1)));
        assert!(matches!(measured, Some(MessageError::NotFinite { what: "the measured range", .. })));
        let anchor = refusal((1.0, [0.0, f64::NAN], 2, [0, 1], noise(1)));
        assert!(matches!(anchor, Some(MessageError::NotFinite { what: "the anchor's position", .. })));
        assert_eq!(
            refusal((1.0, [0.0; 2], 2, [0, 2], noise(1))),
            Some(MessageError::Coordinate { what: "the range's position", index: 2, dimension: 2 })
        );
        assert_eq!(
            refusal((1.0, [0.0; 2], 2, [0, 1], noise(3))),
            Some(MessageError::Dimension { what: "the noise of the range", found: 3, expected: 1 })
        );
    }
}
