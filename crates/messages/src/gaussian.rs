//! Gaussian messages of a dimension fixed at compile time, in information form.
//!
//! A message is exp(-½ x'Λx + η'x), with information Λ and information vector η. Λ may have any rank: a message
//! that says nothing of some directions is legal, and only asking for its moments is an error. Products add,
//! quotients subtract.

use crate::Moments;
use crate::dense::pivot_floor;
use crate::moments::improper;
use nalgebra::{SMatrix, SVector};
use serde::{Deserialize, Serialize};
use smallvec::SmallVec;
use sumprod_graph::{Message, MessageError, Messages, Space, Stream};

/// How a nonlinear factor is made linear for a Gaussian message.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Linearisation {
    /// First-order expansion at the means of the beliefs, renewed whenever the message is.
    #[default]
    Jacobian,
    /// Statistical linear regression over sigma points of the beliefs.
    SigmaPoints,
}

/// How an edge holds Gaussian messages.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GaussianForm {
    /// How nonlinear factors are made linear.
    #[serde(default)]
    pub linearisation: Linearisation,
}

/// A family whose messages can be read and written as Gaussians in information form.
pub trait GaussianFamily: Message {
    /// How an edge of this form makes nonlinear factors linear.
    fn gaussian_form(form: &Self::Form) -> GaussianForm;

    /// Number of coordinates.
    fn dimension(&self) -> usize;

    /// Adds nothing and writes the information (row-major, d by d) and the information vector (d); returns the
    /// divergence (nats) that reading this message as a Gaussian costs.
    ///
    /// # Errors
    ///
    /// Where the message cannot be read as a Gaussian.
    fn read_information(&self, information: &mut [f64], vector: &mut [f64]) -> Result<f64, MessageError>;

    /// Becomes the Gaussian of this information and information vector on the space of `like`, having cost `loss`
    /// nats.
    ///
    /// # Errors
    ///
    /// Where the dimension does not suit the family.
    fn write_information(
        &mut self,
        like: &Self,
        information: &[f64],
        vector: &[f64],
        loss: f64,
    ) -> Result<(), MessageError>;
}

/// A Gaussian message over `D` coordinates.
///
/// ```
/// use nalgebra::{Matrix2, Vector2};
/// use sumprod_messages::Gaussian;
///
/// let gps = Gaussian::from_moments(Vector2::new(3.0, 4.0), Matrix2::identity() * 25.0)?;
/// let (mean, covariance) = gps.moments()?;
/// assert!((mean - Vector2::new(3.0, 4.0)).norm() < 1e-12);
/// assert!((covariance[(0, 0)] - 25.0).abs() < 1e-12);
/// # Ok::<(), sumprod_graph::MessageError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Gaussian<const D: usize> {
    information: SMatrix<f64, D, D>,
    vector: SVector<f64, D>,
}

impl<const D: usize> Default for Gaussian<D> {
    fn default() -> Self {
        Self { information: SMatrix::zeros(), vector: SVector::zeros() }
    }
}

impl<const D: usize> Gaussian<D> {
    /// The message of this information matrix (symmetric, any rank) and information vector.
    #[inline]
    pub fn from_information(information: SMatrix<f64, D, D>, vector: SVector<f64, D>) -> Self {
        Self { information, vector }
    }

    /// The message of this mean and covariance.
    ///
    /// # Errors
    ///
    /// Where the mean is not finite, or the covariance is not positive definite: a direction known exactly has no
    /// information form.
    pub fn from_moments(mean: SVector<f64, D>, covariance: SMatrix<f64, D, D>) -> Result<Self, MessageError> {
        if let Some(&value) = mean.iter().find(|value| !value.is_finite()) {
            return Err(MessageError::NotFinite { what: "an entry of the mean", value });
        }
        let information = invert(&covariance, "the covariance")?;
        Ok(Self { information, vector: information * mean })
    }

    /// The information matrix Λ.
    #[inline]
    pub fn information(&self) -> &SMatrix<f64, D, D> {
        &self.information
    }

    /// The information vector η = Λ times the mean.
    #[inline]
    pub fn information_vector(&self) -> &SVector<f64, D> {
        &self.vector
    }

    /// Mean and covariance.
    ///
    /// # Errors
    ///
    /// [`MessageError::Improper`] where some direction is unconstrained.
    pub fn moments(&self) -> Result<(SVector<f64, D>, SMatrix<f64, D, D>), MessageError> {
        let covariance = invert(&self.information, "the message").map_err(|_| self.improper())?;
        Ok((covariance * self.vector, covariance))
    }

    /// The mean alone, cheaper than [`Gaussian::moments`].
    ///
    /// # Errors
    ///
    /// As [`Gaussian::moments`].
    pub fn mean(&self) -> Result<SVector<f64, D>, MessageError> {
        let factor = cholesky(&self.information, "the message").map_err(|_| self.improper())?;
        let mut mean = self.vector;
        factor.solve(&mut mean);
        Ok(mean)
    }

    /// Mean and covariance as a [`Moments`].
    ///
    /// # Errors
    ///
    /// As [`Gaussian::moments`].
    pub fn to_moments(&self) -> Result<Moments, MessageError> {
        let (mean, covariance) = self.moments()?;
        Ok(Moments { mean: mean.as_slice().to_vec(), covariance: covariance.as_slice().to_vec() })
    }

    /// The product of two messages.
    #[inline]
    #[must_use]
    pub fn times(&self, other: &Self) -> Self {
        Self { information: self.information + other.information, vector: self.vector + other.vector }
    }

    /// Whether [`Message::change`] from `previous` may be more than `limit`, by its terms multiplied out: neither a
    /// division nor a root, nor a branch. A NaN may.
    #[inline]
    fn may_exceed(&self, previous: &Self, limit: f64) -> bool {
        // A little less, so that rounding lets no change through: the largest does not depend on the order of the rest.
        let square = limit * limit * (1.0 - 1e-12);
        let own: [f64; D] = std::array::from_fn(|row| self.information[(row, row)].abs());
        // By row, so that rows share a vector register. A minimum drops a NaN, a sum keeps it.
        let (mut least, mut sum) = ([f64::INFINITY; D], [0.0; D]);
        let mut see = |scale: f64, moved: [f64; D]| {
            for row in 0..D {
                let slack = square * (own[row] * scale) - moved[row] * moved[row];
                least[row] = if slack < least[row] { slack } else { least[row] };
                sum[row] += slack;
            }
        };
        see(1.0, std::array::from_fn(|row| self.vector[row] - previous.vector[row]));
        for (column, &scale) in own.iter().enumerate() {
            let entry = (self.information.column(column), previous.information.column(column));
            see(scale, std::array::from_fn(|row| entry.0[row] - entry.1[row]));
        }
        (0..D).any(|row| least[row] < 0.0 || sum[row].is_nan())
    }

    /// Raises `largest` to the change from `previous`.
    #[cold]
    fn raise(&self, previous: &Self, largest: &mut f64) {
        let change = self.change(previous);
        if change > *largest || change.is_nan() {
            *largest = change;
        }
    }

    #[inline]
    fn add(&mut self, other: &Self) {
        self.information += other.information;
        self.vector += other.vector;
    }

    fn improper(&self) -> MessageError {
        improper("the message", self.information.as_slice(), D)
    }
}

/// Lower Cholesky factor of a static matrix; the diagonal holds reciprocals.
pub(crate) struct StaticCholesky<const D: usize>(SMatrix<f64, D, D>);

#[inline]
pub(crate) fn cholesky<const D: usize>(
    matrix: &SMatrix<f64, D, D>,
    what: &'static str,
) -> Result<StaticCholesky<D>, MessageError> {
    let mut factor = *matrix;
    for column in 0..D {
        let mut pivot = factor[(column, column)];
        for k in 0..column {
            pivot -= factor[(column, k)] * factor[(column, k)];
        }
        if !(pivot > pivot_floor(D, matrix[(column, column)]) && pivot.is_finite()) {
            return Err(MessageError::NotPositiveDefinite { what, pivot: column, value: pivot });
        }
        let reciprocal = 1.0 / pivot.sqrt();
        factor[(column, column)] = reciprocal;
        for row in column + 1..D {
            let mut value = factor[(row, column)];
            for k in 0..column {
                value -= factor[(row, k)] * factor[(column, k)];
            }
            factor[(row, column)] = value * reciprocal;
        }
    }
    Ok(StaticCholesky(factor))
}

impl<const D: usize> StaticCholesky<D> {
    #[inline]
    pub(crate) fn solve(&self, b: &mut SVector<f64, D>) {
        let factor = &self.0;
        for row in 0..D {
            let mut value = b[row];
            for k in 0..row {
                value -= factor[(row, k)] * b[k];
            }
            b[row] = value * factor[(row, row)];
        }
        for row in (0..D).rev() {
            let mut value = b[row];
            for k in row + 1..D {
                value -= factor[(k, row)] * b[k];
            }
            b[row] = value * factor[(row, row)];
        }
    }

    #[inline]
    pub(crate) fn inverse(&self) -> SMatrix<f64, D, D> {
        // L⁻¹ first, a triangle, then A⁻¹ = L⁻ᵀ L⁻¹: half the work of solving for every unit vector.
        let factor = &self.0;
        let mut lower = SMatrix::<f64, D, D>::zeros();
        for column in 0..D {
            lower[(column, column)] = factor[(column, column)];
            for row in column + 1..D {
                let mut value = 0.0;
                for k in column..row {
                    value -= factor[(row, k)] * lower[(k, column)];
                }
                lower[(row, column)] = value * factor[(row, row)];
            }
        }
        let mut inverse = SMatrix::<f64, D, D>::zeros();
        for row in 0..D {
            for column in 0..=row {
                let mut value = 0.0;
                for k in row..D {
                    value += lower[(k, row)] * lower[(k, column)];
                }
                inverse[(row, column)] = value;
                inverse[(column, row)] = value;
            }
        }
        inverse
    }
}

#[inline]
fn invert<const D: usize>(
    matrix: &SMatrix<f64, D, D>,
    what: &'static str,
) -> Result<SMatrix<f64, D, D>, MessageError> {
    Ok(cholesky(matrix, what)?.inverse())
}

/// Change of an information vector's entry that is rounding and no news, relative to the entry.
const ROUNDING: f64 = 16.0 * f64::EPSILON;

/// The share of a change in an information form that one row sees, squared; see [`information_change`].
#[inline]
fn shift(now: f64, before: f64, scale: f64) -> f64 {
    let moved = (now - before).abs() - ROUNDING * (now.abs() + before.abs());
    // Not a maximum with zero, which would drop a NaN.
    if moved < 0.0 { 0.0 } else { moved * moved * scale }
}

/// How far an information form moved, in standard deviations: the largest change of an entry of Λ relative to
/// the roots of its two diagonal entries, or of η relative to the root of its own. Changes at the rounding level
/// of η count as none.
pub(crate) fn information_change(
    dimension: usize,
    new: (impl Fn(usize, usize) -> f64, impl Fn(usize) -> f64),
    old: (impl Fn(usize, usize) -> f64, impl Fn(usize) -> f64),
) -> f64 {
    let mut scales: SmallVec<[f64; 6]> = SmallVec::with_capacity(dimension);
    let mut largest: f64 = 0.0;
    for row in 0..dimension {
        let own = new.0(row, row).abs().max(old.0(row, row).abs());
        scales.push(if own > 0.0 { 1.0 / own } else { 0.0 });
        largest = not_below(largest, shift(new.1(row), old.1(row), scales[row]));
        for column in 0..=row {
            let difference = new.0(row, column) - old.0(row, column);
            largest = not_below(largest, difference * difference * scales[row] * scales[column]);
        }
    }
    largest.sqrt()
}

/// The larger of two, and NaN if either is.
#[inline]
fn not_below(a: f64, b: f64) -> f64 {
    if b > a || b.is_nan() { b } else { a }
}

impl<const D: usize> Message for Gaussian<D> {
    type Form = GaussianForm;
    const ALWAYS_DIVIDES: bool = true;

    fn vacuous(_space: &Space) -> Self {
        Self::default()
    }

    #[inline]
    fn product(
        incoming: Messages<'_, Self>,
        _form: &GaussianForm,
        _stream: &mut Stream,
    ) -> Result<Self, MessageError> {
        let mut product = Self::default();
        incoming.for_each(|message| product.add(message));
        Ok(product)
    }

    #[inline]
    fn update(
        incoming: Messages<'_, Self>,
        _form: &GaussianForm,
        _stream: &mut Stream,
        belief: &mut Self,
        _previous: &mut Self,
        largest: &mut f64,
    ) -> Result<(), MessageError> {
        let mut product = Self::default();
        incoming.for_each(|message| product.add(message));
        if product.may_exceed(belief, *largest) {
            product.raise(belief, largest);
        }
        *belief = product;
        Ok(())
    }

    #[inline]
    fn quotient(&self, incoming: &Self) -> Option<Self> {
        Some(Self {
            information: self.information - incoming.information,
            vector: self.vector - incoming.vector,
        })
    }

    #[inline]
    fn quotient_into(&self, incoming: &Self, out: &mut Self) -> bool {
        out.information = self.information - incoming.information;
        out.vector = self.vector - incoming.vector;
        true
    }

    /// The largest change of an entry of Λ relative to the roots of its two diagonal entries, or of η relative to
    /// the root of its own.
    #[inline]
    fn change(&self, previous: &Self) -> f64 {
        let scale: [f64; D] = std::array::from_fn(|k| {
            let (now, before) = (self.information[(k, k)].abs(), previous.information[(k, k)].abs());
            let own = if now > before { now } else { before };
            if own > 0.0 { 1.0 / own } else { 0.0 }
        });
        // A maximum drops a NaN, a sum keeps it.
        let (mut largest, mut sum) = (0.0, 0.0);
        let mut see = |moved: f64| {
            largest = if moved > largest { moved } else { largest };
            sum += moved;
        };
        for row in 0..D {
            see(shift(self.vector[row], previous.vector[row], scale[row]));
            for column in 0..=row {
                let difference = self.information[(row, column)] - previous.information[(row, column)];
                see(difference * difference * (scale[row] * scale[column]));
            }
        }
        if sum.is_nan() { sum } else { largest.sqrt() }
    }

    fn damp(&mut self, previous: &Self, damping: f64) -> bool {
        self.information += (previous.information - self.information) * damping;
        self.vector += (previous.vector - self.vector) * damping;
        true
    }

    fn check_form(_form: &GaussianForm, space: &Space) -> Result<(), String> {
        check_gaussian_space(space)?;
        if space.dimension() == D {
            return Ok(());
        }
        Err(format!(
            "a graph of {D}-dimensional Gaussians cannot hold a variable of dimension {}",
            space.dimension()
        ))
    }

    fn is_proper(&self) -> bool {
        cholesky(&self.information, "the message").is_ok()
    }
}

pub(crate) fn check_gaussian_space(space: &Space) -> Result<(), String> {
    match space {
        Space::Continuous(_) | Space::Se2 => Ok(()),
        Space::Se3 => {
            Err("a Gaussian cannot hold a pose in space by its quaternion; solve the graph jointly, or \
                           pass messages on its linear form (exact::Problem::linear_graph)"
                .into())
        }
        Space::Finite(states) => Err(format!("a Gaussian cannot hold a variable of {states} states")),
    }
}

impl<const D: usize> GaussianFamily for Gaussian<D> {
    fn gaussian_form(form: &GaussianForm) -> GaussianForm {
        *form
    }

    fn dimension(&self) -> usize {
        D
    }

    fn read_information(&self, information: &mut [f64], vector: &mut [f64]) -> Result<f64, MessageError> {
        information[..D * D].copy_from_slice(self.information.as_slice());
        vector[..D].copy_from_slice(self.vector.as_slice());
        Ok(0.0)
    }

    fn write_information(
        &mut self,
        _like: &Self,
        information: &[f64],
        vector: &[f64],
        _loss: f64,
    ) -> Result<(), MessageError> {
        if vector.len() != D {
            return Err(MessageError::Dimension { what: "the message", found: vector.len(), expected: D });
        }
        self.information = SMatrix::from_column_slice(information);
        self.vector = SVector::from_column_slice(vector);
        Ok(())
    }
}
