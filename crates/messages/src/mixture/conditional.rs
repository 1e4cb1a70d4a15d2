//! Some coordinates of a mixture given the others, and the mixture of some alone.
//!
//! With x = (a, b) and component i of weight wᵢ, mean (αᵢ, βᵢ) and blocks Aᵢ, Bᵢ, Gᵢ = cov(b, a) Aᵢ⁻¹:
//!
//! p(b | a) ∝ Σᵢ wᵢ N(a; αᵢ, Aᵢ) N(b; βᵢ + Gᵢ (a - αᵢ), Bᵢ - Gᵢ cov(a, b)).

use super::small::{Small, difference, root, whitener, wrap_point};
use super::{Mixture, size};
use crate::vector::exp;
use crate::vector::log_sum;
use rand_distr::{Distribution, StandardNormal};
use std::f64::consts::TAU;
use sumprod_graph::{Coordinate, FastStream, MessageError};

/// The last coordinates of a mixture given its first; made by [`Mixture::given_first`].
#[derive(Clone, Debug)]
pub struct Conditional {
    coordinates: Vec<Coordinate>,
    given: usize,
    parts: Vec<Part>,
    /// What one call works in: log shares, offsets of the given coordinates, conditional means.
    shares: Vec<f64>,
    offset: Small,
    means: Vec<f64>,
}

/// What a component says of the last coordinates.
#[derive(Clone, Debug)]
struct Part {
    /// Log weight less half the log determinant of A.
    log_weight: f64,
    mean: Small,
    /// The inverse of the lower Cholesky factor of A.
    whitener: Small,
    /// G, row-major.
    gain: Small,
    /// Lower Cholesky factor of the conditional covariance, its inverse, and the log determinant.
    root: Small,
    inverse: Small,
    log_determinant: f64,
}

/// A draw from a [`Conditional`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConditionalDraw {
    /// The component that it came from.
    pub component: usize,
    /// Its log density under all components, given the first coordinates.
    pub log_density: f64,
}

impl Mixture {
    /// The mixture of these coordinates alone, in this order. O(N d²).
    ///
    /// # Errors
    ///
    /// Where there is none of them, or the mixture lacks one.
    pub fn marginal(&self, coordinates: &[usize]) -> Result<Self, MessageError> {
        let d = self.dimension();
        if let Some(&index) = coordinates.iter().find(|&&index| index >= d) {
            return Err(MessageError::Coordinate { what: "the marginal of a mixture", index, dimension: d });
        }
        if coordinates.is_empty() {
            return Err(MessageError::Unsupported("a marginal needs at least one coordinate".into()));
        }
        let rows = self.covariances.chunks_exact(d * d);
        let covariances = rows
            .flat_map(|matrix| {
                let pairs =
                    coordinates.iter().flat_map(|row| coordinates.iter().map(move |column| (row, column)));
                pairs.map(|(row, column)| matrix[row * d + column])
            })
            .collect();
        let means = self.means.chunks_exact(d);
        Ok(Self {
            coordinates: coordinates.iter().map(|&index| self.coordinates[index]).collect(),
            log_weights: self.log_weights.clone(),
            means: means.flat_map(|mean| coordinates.iter().map(|&index| mean[index])).collect(),
            covariances,
            shared: self.shared,
        })
    }

    /// The coordinates after the first `given`, given those. O(N d³) once; a draw is O(N d²).
    ///
    /// # Errors
    ///
    /// Where either side would have no coordinate.
    pub fn given_first(&self, given: usize) -> Result<Conditional, MessageError> {
        let d = self.dimension();
        if given == 0 || given >= d {
            let reason = format!("a conditional needs coordinates on both sides: {given} of {d} are given");
            return Err(MessageError::Unsupported(reason));
        }
        let parts: Result<Vec<Part>, MessageError> = (0..self.len()).map(|i| self.part(i, given)).collect();
        Ok(Conditional {
            coordinates: self.coordinates.clone(),
            given,
            parts: parts?,
            shares: Vec::with_capacity(self.len()),
            offset: Small::from_elem(0.0, d),
            means: Vec::with_capacity(self.len() * (d - given)),
        })
    }

    fn part(&self, component: usize, given: usize) -> Result<Part, MessageError> {
        let d = self.dimension();
        let rest = d - given;
        let full = self.covariance_of(component);
        let failed = |pivot: usize| MessageError::NotPositiveDefinite {
            what: "a covariance of a mixture",
            pivot,
            value: full[pivot * d + pivot],
        };
        let own: Small = (0..given).flat_map(|row| full[row * d..][..given].iter().copied()).collect();
        let (whitener, log_determinant) = self::whitener(&own, given).ok_or_else(|| failed(0))?;
        // Rows of W cov(a, b): its square is what a explains of b.
        let mut explained = Small::from_elem(0.0, given * rest);
        for row in 0..given {
            for column in 0..rest {
                explained[row * rest + column] =
                    (0..=row).map(|k| whitener[row * given + k] * full[k * d + given + column]).sum();
            }
        }
        let mut gain = Small::from_elem(0.0, rest * given);
        let mut left = Small::from_elem(0.0, rest * rest);
        for row in 0..rest {
            for column in 0..given {
                gain[row * given + column] =
                    (column..given).map(|k| explained[k * rest + row] * whitener[k * given + column]).sum();
            }
            for column in 0..rest {
                let taken: f64 =
                    (0..given).map(|k| explained[k * rest + row] * explained[k * rest + column]).sum();
                left[row * rest + column] = full[(given + row) * d + given + column] - taken;
            }
        }
        let root = root(&left, rest).ok_or_else(|| failed(given))?;
        let (inverse, left_determinant) = self::whitener(&left, rest).ok_or_else(|| failed(given))?;
        Ok(Part {
            log_weight: self.log_weights[component] - 0.5 * log_determinant,
            mean: Small::from_slice(self.mean_of(component)),
            whitener,
            gain,
            root,
            inverse,
            log_determinant: left_determinant,
        })
    }
}

impl Conditional {
    /// Draws the last coordinates into `out`, given the first. `uniform` in [0, 1) chooses the component: equally
    /// spaced values give every component its share to within one draw.
    ///
    /// # Errors
    ///
    /// Where a slice has not the expected length.
    pub fn draw(
        &mut self,
        given: &[f64],
        uniform: f64,
        random: &mut FastStream,
        out: &mut [f64],
    ) -> Result<ConditionalDraw, MessageError> {
        let rest = self.prepare(given, out.len())?;
        let mut height = uniform;
        let chosen = self.shares.iter().position(|share| {
            height -= exp(*share);
            height < 0.0
        });
        let component = chosen.unwrap_or(self.parts.len() - 1);
        out.copy_from_slice(&self.means[component * rest..][..rest]);
        let factor = &self.parts[component].root;
        for column in 0..rest {
            let z: f64 = StandardNormal.sample(random);
            for row in column..rest {
                out[row] += factor[row * rest + column] * z;
            }
        }
        wrap_point(&self.coordinates[self.given..], out);
        Ok(ConditionalDraw { component, log_density: self.prepared_density(out) })
    }

    /// Log density of the last coordinates given the first.
    ///
    /// # Errors
    ///
    /// Where a slice has not the expected length.
    pub fn log_density(&mut self, given: &[f64], last: &[f64]) -> Result<f64, MessageError> {
        self.prepare(given, last.len())?;
        Ok(self.prepared_density(last))
    }

    /// Writes each component's log share and conditional mean, and returns the number of last coordinates.
    fn prepare(&mut self, given: &[f64], last: usize) -> Result<usize, MessageError> {
        let rest = self.coordinates.len() - self.given;
        size("the given coordinates", given.len(), self.given)?;
        size("the coordinates of a conditional", last, rest)?;
        self.shares.clear();
        self.means.clear();
        for part in &self.parts {
            difference(&self.coordinates[..self.given], given, &part.mean, &mut self.offset);
            let offset = &self.offset[..self.given];
            let mut squared = 0.0;
            for (row, entries) in part.whitener.chunks_exact(self.given).enumerate() {
                let white: f64 = entries[..=row].iter().zip(offset).map(|(a, b)| a * b).sum();
                squared += white * white;
            }
            self.shares.push(part.log_weight - 0.5 * squared);
            for (row, entries) in part.gain.chunks_exact(self.given).enumerate() {
                let shift: f64 = entries.iter().zip(offset).map(|(a, b)| a * b).sum();
                self.means.push(part.mean[self.given + row] + shift);
            }
        }
        let total = log_sum(&self.shares);
        self.shares.iter_mut().for_each(|share| *share -= total);
        Ok(rest)
    }

    fn prepared_density(&mut self, last: &[f64]) -> f64 {
        let rest = last.len();
        for (number, part) in self.parts.iter().enumerate() {
            let mean = &self.means[number * rest..][..rest];
            difference(&self.coordinates[self.given..], last, mean, &mut self.offset);
            let mut squared = part.log_determinant;
            for (row, entries) in part.inverse.chunks_exact(rest).enumerate() {
                let white: f64 = entries[..=row].iter().zip(&self.offset).map(|(a, b)| a * b).sum();
                squared += white * white;
            }
            self.shares[number] -= 0.5 * squared;
        }
        log_sum(&self.shares) - 0.5 * rest as f64 * TAU.ln()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sumprod_graph::{Purpose, Space, Stream};

    fn joint() -> Mixture {
        let space = Space::new([Coordinate::Real, Coordinate::Angle, Coordinate::Real, Coordinate::Real]);
        let means = vec![0.0, 3.1, 1.0, -1.0, 1.0, -3.0, -2.0, 0.5];
        let first = [2.0, 0.1, 0.3, 0.0, 0.1, 0.04, 0.02, 0.01, 0.3, 0.02, 1.0, 0.2, 0.0, 0.01, 0.2, 0.5];
        let second = [1.0, 0.0, -0.4, 0.1, 0.0, 0.09, 0.0, 0.05, -0.4, 0.0, 0.8, 0.0, 0.1, 0.05, 0.0, 1.5];
        Mixture::new(&space, vec![0.3f64.ln(), 0.7f64.ln()], means, [first, second].concat()).unwrap()
    }

    #[test]
    fn a_marginal_times_its_conditional_is_the_joint() {
        let joint = joint();
        let marginal = joint.marginal(&[0, 1]).unwrap();
        let mut conditional = joint.given_first(2).unwrap();
        for point in [[0.5, 3.0, 0.0, 0.0], [0.5, -3.1, 0.0, 0.3], [-4.0, 2.5, 3.0, -2.0]] {
            let together = joint.log_density(&point).unwrap();
            let apart = marginal.log_density(&point[..2]).unwrap()
                + conditional.log_density(&point[..2], &point[2..]).unwrap();
            assert!((together - apart).abs() < 1e-12, "{together} {apart}");
        }
    }

    #[test]
    fn draws_have_their_density_and_components_their_shares() {
        let joint = joint();
        let mut conditional = joint.given_first(2).unwrap();
        let mut random = Stream::new(1, 0, Purpose::User(0), 0).fast();
        let given = [0.5, -3.1];
        let count = 4_000;
        let (mut sum, mut firsts) = ([0.0; 2], 0);
        for number in 0..count {
            let mut out = [0.0; 2];
            let uniform = (f64::from(number) + 0.5) / f64::from(count);
            let draw = conditional.draw(&given, uniform, &mut random, &mut out).unwrap();
            assert!((draw.log_density - conditional.log_density(&given, &out).unwrap()).abs() < 1e-12);
            firsts += u32::from(draw.component == 0);
            sum.iter_mut().zip(out).for_each(|(sum, x)| *sum += x / f64::from(count));
        }
        conditional.prepare(&given, 2).unwrap();
        let share = conditional.shares[0].exp();
        assert!((f64::from(firsts) / f64::from(count) - share).abs() < 1e-3);
        // Each mean within six standard errors, which a normal error exceeds once in 1e9.
        for (k, sum) in sum.iter().enumerate() {
            let mean = share * conditional.means[k] + (1.0 - share) * conditional.means[2 + k];
            assert!((sum - mean).abs() < 6.0 * 1.3 / f64::from(count).sqrt(), "{sum} {mean}");
        }
    }

    #[test]
    fn what_cannot_be_split_is_refused() {
        let joint = joint();
        assert!(joint.given_first(0).is_err() && joint.given_first(4).is_err());
        assert!(joint.marginal(&[]).is_err() && joint.marginal(&[0, 4]).is_err());
        let mut conditional = joint.given_first(2).unwrap();
        assert!(conditional.log_density(&[0.0], &[0.0, 0.0]).is_err());
        assert!(conditional.log_density(&[0.0, 0.0], &[0.0]).is_err());
    }
}
