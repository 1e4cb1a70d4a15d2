//! Gaussian messages whose dimension is chosen at run time; up to five coordinates live without the heap.

use crate::gaussian::{check_gaussian_space, information_change};
use crate::moments::improper;
use crate::{Cholesky, GaussianFamily, GaussianForm, Moments};
use serde::{Deserialize, Serialize};
use smallvec::SmallVec;
use sumprod_graph::{Message, MessageError, Messages, Space, Stream};

/// Numbers kept inline: a packed triangle and a vector of five coordinates.
const INLINE: usize = 20;

/// A Gaussian message in information form, as [`crate::Gaussian`] with the dimension chosen at run time.
#[derive(Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct DynamicGaussian {
    dimension: usize,
    /// The information vector, then the lower triangle of the information matrix row by row.
    numbers: SmallVec<[f64; INLINE]>,
}

impl Clone for DynamicGaussian {
    fn clone(&self) -> Self {
        Self { dimension: self.dimension, numbers: self.numbers.clone() }
    }

    /// Reuses the storage of `self`, which a derived `clone_from` would not.
    fn clone_from(&mut self, source: &Self) {
        self.dimension = source.dimension;
        self.numbers.clear();
        self.numbers.extend_from_slice(&source.numbers);
    }
}

impl DynamicGaussian {
    /// The message that says nothing of `dimension` coordinates.
    pub fn flat(dimension: usize) -> Self {
        Self { dimension, numbers: SmallVec::from_elem(0.0, dimension + dimension * (dimension + 1) / 2) }
    }

    /// The message of this information matrix (row-major, symmetric, any rank) and information vector.
    ///
    /// # Errors
    ///
    /// Where their sizes do not agree or a number is not finite.
    pub fn from_information(information: &[f64], vector: &[f64]) -> Result<Self, MessageError> {
        let dimension = vector.len();
        if information.len() != dimension * dimension {
            let expected = dimension * dimension;
            return Err(MessageError::Dimension {
                what: "the information",
                found: information.len(),
                expected,
            });
        }
        if let Some(&value) = information.iter().chain(vector).find(|value| !value.is_finite()) {
            return Err(MessageError::NotFinite { what: "an entry of the information", value });
        }
        let mut message = Self { dimension, numbers: SmallVec::new() };
        message.fill(information, vector);
        Ok(message)
    }

    pub(crate) fn fill_from(&mut self, information: &[f64], vector: &[f64]) {
        self.dimension = vector.len();
        self.fill(information, vector);
    }

    fn fill(&mut self, information: &[f64], vector: &[f64]) {
        self.numbers.clear();
        self.numbers.extend_from_slice(vector);
        for row in 0..self.dimension {
            self.numbers.extend_from_slice(&information[row * self.dimension..][..=row]);
        }
    }

    /// The message of this mean and covariance (row-major).
    ///
    /// # Errors
    ///
    /// Where sizes do not agree, a number is not finite, or the covariance is not positive definite.
    pub fn from_moments(mean: &[f64], covariance: &[f64]) -> Result<Self, MessageError> {
        let dimension = mean.len();
        if covariance.len() != dimension * dimension {
            let expected = dimension * dimension;
            return Err(MessageError::Dimension {
                what: "the covariance",
                found: covariance.len(),
                expected,
            });
        }
        if let Some(&value) = mean.iter().find(|value| !value.is_finite()) {
            return Err(MessageError::NotFinite { what: "an entry of the mean", value });
        }
        let factor = Cholesky::new(covariance, dimension, "the covariance")?;
        let mut information = vec![0.0; dimension * dimension];
        factor.inverse(&mut information);
        let mut vector = mean.to_vec();
        factor.solve(&mut vector);
        Self::from_information(&information, &vector)
    }

    /// Number of coordinates.
    pub fn dimension(&self) -> usize {
        self.dimension
    }

    /// Entry of the information matrix.
    pub fn information_at(&self, row: usize, column: usize) -> f64 {
        let (row, column) = (row.max(column), row.min(column));
        self.numbers[self.dimension + row * (row + 1) / 2 + column]
    }

    /// The information vector.
    pub fn information_vector(&self) -> &[f64] {
        &self.numbers[..self.dimension]
    }

    /// Writes the information matrix, row-major, into `out`.
    pub fn write_matrix(&self, out: &mut [f64]) {
        let d = self.dimension;
        let mut next = d;
        for row in 0..d {
            for column in 0..=row {
                let value = self.numbers[next];
                out[row * d + column] = value;
                out[column * d + row] = value;
                next += 1;
            }
        }
    }

    /// Mean and covariance.
    ///
    /// # Errors
    ///
    /// [`MessageError::Improper`] where some direction is unconstrained.
    pub fn moments(&self) -> Result<Moments, MessageError> {
        let factor = self.factor()?;
        let mut moments = Moments {
            mean: self.information_vector().to_vec(),
            covariance: vec![0.0; self.dimension * self.dimension],
        };
        factor.solve(&mut moments.mean);
        factor.inverse(&mut moments.covariance);
        Ok(moments)
    }

    /// Writes the mean into `out` without allocating for small dimensions.
    ///
    /// # Errors
    ///
    /// As [`DynamicGaussian::moments`].
    pub fn mean_into(&self, out: &mut [f64]) -> Result<(), MessageError> {
        out.copy_from_slice(self.information_vector());
        self.factor()?.solve(out);
        Ok(())
    }

    /// The Cholesky factor of the information matrix.
    ///
    /// # Errors
    ///
    /// As [`DynamicGaussian::moments`].
    pub fn factor(&self) -> Result<Cholesky, MessageError> {
        let mut matrix: SmallVec<[f64; 36]> = SmallVec::from_elem(0.0, self.dimension * self.dimension);
        self.write_matrix(&mut matrix);
        Cholesky::new(&matrix, self.dimension, "the message")
            .map_err(|_| improper("the message", &matrix, self.dimension))
    }

    /// Log of the message at `x`, up to a constant: -½ x'Λx + η'x.
    pub fn log_value(&self, x: &[f64]) -> f64 {
        let d = self.dimension;
        let mut next = d;
        let mut sum = 0.0;
        for row in 0..d {
            let below = self.numbers[next..].iter().zip(&x[..row]);
            let half =
                0.5 * self.numbers[next + row] * x[row] + below.map(|(entry, x)| entry * x).sum::<f64>();
            sum += x[row] * (self.numbers[row] - half);
            next += row + 1;
        }
        sum
    }

    /// Whether the message says nothing at all.
    pub fn is_flat(&self) -> bool {
        self.numbers.iter().all(|&number| number == 0.0)
    }

    pub(crate) fn add(&mut self, other: &Self) -> Result<(), MessageError> {
        if self.dimension != other.dimension {
            let (found, expected) = (other.dimension, self.dimension);
            return Err(MessageError::Dimension { what: "a message of the product", found, expected });
        }
        for (a, b) in self.numbers.iter_mut().zip(&other.numbers) {
            *a += b;
        }
        Ok(())
    }

    /// The product of two messages of one dimension.
    ///
    /// # Errors
    ///
    /// Where their dimensions differ.
    pub fn times(&self, other: &Self) -> Result<Self, MessageError> {
        let mut product = self.clone();
        product.add(other)?;
        Ok(product)
    }

    /// The message moved by `shift`: its mean plus `shift`, its information the same.
    #[must_use]
    pub fn shifted(&self, shift: &[f64]) -> Self {
        let mut shifted = self.clone();
        for row in 0..self.dimension {
            let pull: f64 =
                (0..self.dimension).map(|column| self.information_at(row, column) * shift[column]).sum();
            shifted.numbers[row] += pull;
        }
        shifted
    }

    /// This message with `other` taken out.
    #[must_use]
    pub fn over(&self, other: &Self) -> Self {
        let mut quotient = self.clone();
        for (a, b) in quotient.numbers.iter_mut().zip(&other.numbers) {
            *a -= b;
        }
        quotient
    }

    /// The message raised to the power `exponent`: its information scaled.
    #[must_use]
    pub fn power(&self, exponent: f64) -> Self {
        let mut power = self.clone();
        power.numbers.iter_mut().for_each(|number| *number *= exponent);
        power
    }
}

impl Message for DynamicGaussian {
    type Form = GaussianForm;
    const ALWAYS_DIVIDES: bool = true;

    fn vacuous(space: &Space) -> Self {
        Self::flat(space.dimension())
    }

    fn product(
        incoming: Messages<'_, Self>,
        form: &GaussianForm,
        stream: &mut Stream,
    ) -> Result<Self, MessageError> {
        let mut product = Self::default();
        Self::product_into(incoming, form, stream, &mut product)?;
        Ok(product)
    }

    fn product_into(
        incoming: Messages<'_, Self>,
        _form: &GaussianForm,
        _stream: &mut Stream,
        out: &mut Self,
    ) -> Result<(), MessageError> {
        let mut messages = incoming.iter();
        if let Some(first) = messages.next() {
            out.clone_from(first);
        }
        messages.try_for_each(|message| out.add(message))
    }

    fn quotient(&self, incoming: &Self) -> Option<Self> {
        Some(self.over(incoming))
    }

    fn quotient_into(&self, incoming: &Self, out: &mut Self) -> bool {
        out.clone_from(self);
        for (a, b) in out.numbers.iter_mut().zip(&incoming.numbers) {
            *a -= b;
        }
        true
    }

    fn change(&self, previous: &Self) -> f64 {
        let (new, old) = (self, previous);
        if new.dimension != old.dimension {
            return f64::INFINITY;
        }
        information_change(
            self.dimension,
            (|r, c| new.information_at(r, c), |r| new.numbers[r]),
            (|r, c| old.information_at(r, c), |r| old.numbers[r]),
        )
    }

    fn damp(&mut self, previous: &Self, damping: f64) -> bool {
        for (a, b) in self.numbers.iter_mut().zip(&previous.numbers) {
            *a += (b - *a) * damping;
        }
        true
    }

    fn check_form(_form: &GaussianForm, space: &Space) -> Result<(), String> {
        check_gaussian_space(space)
    }

    fn is_proper(&self) -> bool {
        self.factor().is_ok()
    }
}

impl GaussianFamily for DynamicGaussian {
    fn gaussian_form(form: &GaussianForm) -> GaussianForm {
        *form
    }

    fn dimension(&self) -> usize {
        self.dimension
    }

    fn read_information(&self, information: &mut [f64], vector: &mut [f64]) -> Result<f64, MessageError> {
        self.write_matrix(information);
        vector[..self.dimension].copy_from_slice(self.information_vector());
        Ok(0.0)
    }

    fn write_information(
        &mut self,
        _like: &Self,
        information: &[f64],
        vector: &[f64],
        _loss: f64,
    ) -> Result<(), MessageError> {
        self.fill_from(information, vector);
        Ok(())
    }
}
