//! Relative positions: between two variables, and to an anchor whose own position may be uncertain.

use super::checks::{coordinates, finite, size};
use crate::{Chart, Noise, Real, Residual};
use sumprod_graph::MessageError;

/// A measured offset p₁ - p₀ in the world's frame: r = p₁ - p₀ - z.
#[derive(Clone, Debug)]
pub struct RelativePosition {
    measured: Vec<f64>,
    dimensions: [usize; 2],
    positions: [Vec<usize>; 2],
    noise: Noise,
}

impl RelativePosition {
    /// An offset (m) between two variables of these dimensions, whose positions are at these coordinates.
    ///
    /// # Errors
    ///
    /// Where the offset is not finite, a variable lacks a coordinate, or the positions or the noise have not as many
    /// components as the offset.
    pub fn new(
        measured: &[f64],
        dimensions: [usize; 2],
        positions: [&[usize]; 2],
        noise: Noise,
    ) -> Result<Self, MessageError> {
        finite("the measured offset", measured)?;
        size("the offset's position at port 0", positions[0].len(), measured.len())?;
        size("the offset's position at port 1", positions[1].len(), measured.len())?;
        size("the noise of the offset", noise.dimension(), measured.len())?;
        coordinates("the offset's position at port 0", positions[0], dimensions[0])?;
        coordinates("the offset's position at port 1", positions[1], dimensions[1])?;
        let (measured, positions) = (measured.to_vec(), positions.map(<[usize]>::to_vec));
        Ok(Self { measured, dimensions, positions, noise })
    }
}

impl Residual for RelativePosition {
    fn dimensions(&self) -> &[usize] {
        &self.dimensions
    }

    fn noise(&self) -> &Noise {
        &self.noise
    }

    fn residual<T: Real>(&self, x: &[&[T]], out: &mut [T]) {
        let [from, to] = &self.positions;
        for (k, out) in out.iter_mut().enumerate() {
            *out = x[1][to[k]] - x[0][from[k]] - self.measured[k];
        }
    }

    fn closed_form(&self, x: &[&[f64]], residual: &mut [f64], jacobian: &mut [f64]) -> Option<Chart> {
        self.residual(x, residual);
        let [first, second] = self.dimensions;
        jacobian.fill(0.0);
        for (row, (from, to)) in
            jacobian.chunks_exact_mut(first + second).zip(self.positions[0].iter().zip(&self.positions[1]))
        {
            row[*from] = -1.0;
            row[first + to] = 1.0;
        }
        Some(Chart::Coordinates)
    }
}

/// A measured offset p - a from an anchor at a known position: r = p - a - z. With a = 0 it is a position fix.
#[derive(Clone, Debug)]
pub struct AnchorOffset {
    target: Vec<f64>,
    dimensions: [usize; 1],
    position: Vec<usize>,
    noise: Noise,
}

impl AnchorOffset {
    /// An offset (m) of a variable of this dimension, its position at these coordinates, from an anchor (m). An
    /// anchor's own uncertainty adds to the noise.
    ///
    /// # Errors
    ///
    /// Where the offset, the anchor or their sum is not finite, the variable lacks a coordinate, or the anchor, the
    /// position or the noise have not as many components as the offset.
    pub fn new(
        measured: &[f64],
        anchor: &[f64],
        dimension: usize,
        position: &[usize],
        noise: Noise,
    ) -> Result<Self, MessageError> {
        finite("the measured offset", measured)?;
        finite("the anchor's position", anchor)?;
        size("the anchor's position", anchor.len(), measured.len())?;
        size("the offset's position", position.len(), measured.len())?;
        size("the noise of the offset", noise.dimension(), measured.len())?;
        coordinates("the offset's position", position, dimension)?;
        let target: Vec<f64> = measured.iter().zip(anchor).map(|(z, a)| a + z).collect();
        finite("the sum of anchor and offset", &target)?;
        Ok(Self { target, dimensions: [dimension], position: position.to_vec(), noise })
    }
}

impl Residual for AnchorOffset {
    fn dimensions(&self) -> &[usize] {
        &self.dimensions
    }

    fn noise(&self) -> &Noise {
        &self.noise
    }

    fn residual<T: Real>(&self, x: &[&[T]], out: &mut [T]) {
        for ((out, &coordinate), target) in out.iter_mut().zip(&self.position).zip(&self.target) {
            *out = x[0][coordinate] - *target;
        }
    }

    #[inline]
    fn closed_form(&self, x: &[&[f64]], residual: &mut [f64], jacobian: &mut [f64]) -> Option<Chart> {
        self.residual(x, residual);
        jacobian.fill(0.0);
        for (row, &coordinate) in jacobian.chunks_exact_mut(self.dimensions[0]).zip(&self.position) {
            row[coordinate] = 1.0;
        }
        Some(Chart::Coordinates)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(components: usize) -> Noise {
        Noise::isotropic(components, 1.0).unwrap()
    }

    fn not_finite(result: Result<impl Sized, MessageError>, expected: &str) {
        let error = result.err();
        assert!(matches!(error, Some(MessageError::NotFinite { what, .. }) if what == expected), "{error:?}");
    }

    #[test]
    fn numbers_that_are_not_finite_are_refused() {
        let place: &[usize] = &[0, 1];
        let offset = RelativePosition::new(&[1.0, f64::NAN], [2, 2], [place; 2], noise(2));
        not_finite(offset, "the measured offset");
        let fix =
            |measured: [f64; 2], anchor: [f64; 2]| AnchorOffset::new(&measured, &anchor, 2, place, noise(2));
        not_finite(fix([f64::INFINITY, 0.0], [0.0; 2]), "the measured offset");
        not_finite(fix([0.0; 2], [0.0, f64::NAN]), "the anchor's position");
        not_finite(fix([f64::MAX, 0.0], [f64::MAX, 0.0]), "the sum of anchor and offset");
    }

    #[test]
    fn an_offset_between_variables_refuses_what_disagrees() {
        let error = |dimensions, from: &[usize], to: &[usize], components| {
            RelativePosition::new(&[1.0, 2.0], dimensions, [from, to], noise(components)).err()
        };
        assert_eq!(error([2, 4], &[0, 1], &[0, 2], 2), None);
        for (from, to, components, what, found) in [
            (&[0][..], &[0, 1][..], 2, "the offset's position at port 0", 1),
            (&[0, 1], &[0, 1, 2], 2, "the offset's position at port 1", 3),
            (&[0, 1], &[0, 1], 1, "the noise of the offset", 1),
        ] {
            let expected = Some(MessageError::Dimension { what, found, expected: 2 });
            assert_eq!(error([4, 4], from, to, components), expected);
        }
        for (dimensions, what, index, dimension) in [
            ([1, 4], "the offset's position at port 0", 1, 1),
            ([4, 2], "the offset's position at port 1", 2, 2),
        ] {
            let expected = Some(MessageError::Coordinate { what, index, dimension });
            assert_eq!(error(dimensions, &[0, 1], &[0, 2], 2), expected);
        }
    }

    #[test]
    fn an_offset_from_an_anchor_refuses_what_disagrees() {
        let error = |anchor: &[f64], dimension, position: &[usize], components| {
            AnchorOffset::new(&[1.0, 2.0], anchor, dimension, position, noise(components)).err()
        };
        assert_eq!(error(&[0.0; 2], 4, &[0, 2], 2), None);
        for (anchor, position, components, what, found) in [
            (&[0.0][..], &[0, 1][..], 2, "the anchor's position", 1),
            (&[0.0; 3], &[0, 1], 2, "the anchor's position", 3),
            (&[0.0; 2], &[0], 2, "the offset's position", 1),
            (&[0.0; 2], &[0, 1], 3, "the noise of the offset", 3),
        ] {
            let expected = Some(MessageError::Dimension { what, found, expected: 2 });
            assert_eq!(error(anchor, 4, position, components), expected);
        }
        let expected = MessageError::Coordinate { what: "the offset's position", index: 2, dimension: 2 };
        assert_eq!(error(&[0.0; 2], 2, &[0, 2], 2), Some(expected));
    }
}
