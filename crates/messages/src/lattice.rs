//! Functions on a lattice of the plane, and Gaussians: a family for positions that may have several modes.
//!
//! A lattice is a mixture whose kernels stand on a grid and share one covariance. With that a message between two
//! variables is a sum over integer offsets, a product is an addition, and a quotient a subtraction; no bandwidth is
//! chosen but the width of the cells. An edge may hold its messages on a lattice while the network has not decided
//! between modes, and as a Gaussian afterwards ([`sumprod_graph::Engine::set_edge_form`]).
//!
//! What the family leaves out: a belief keeps its cells, and a product of messages is taken on them. A place that a
//! belief has given up (its share fell below e⁻⁴⁰, or it was not among the `most` likely cells) does not return.

mod cells;
mod family;
mod product;

pub use cells::{Cell, Lattice};

use crate::{Gaussian, GaussianForm};
use nalgebra::{Matrix2, Vector2};
use serde::{Deserialize, Serialize};
use sumprod_graph::{Message, MessageError, Messages, Quality, Space, Stream};

/// How an edge holds its messages.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum LatticeForm {
    /// A Gaussian in information form.
    Gaussian(GaussianForm),
    /// Values on cells.
    Lattice {
        /// Width of a cell (m).
        width: f64,
        /// The most cells that a belief keeps.
        most: usize,
    },
}

impl Default for LatticeForm {
    fn default() -> Self {
        Self::Gaussian(GaussianForm::default())
    }
}

/// What a message holds.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
pub enum LatticeValue {
    /// A Gaussian of any rank; of rank zero it says nothing.
    Gaussian(Gaussian<2>),
    /// A function on cells.
    Lattice(Lattice),
}

impl Clone for LatticeValue {
    fn clone(&self) -> Self {
        match self {
            Self::Gaussian(gaussian) => Self::Gaussian(*gaussian),
            Self::Lattice(lattice) => Self::Lattice(lattice.clone()),
        }
    }

    fn clone_from(&mut self, source: &Self) {
        match (self, source) {
            (Self::Lattice(own), Self::Lattice(other)) => own.clone_from(other),
            (own, other) => *own = other.clone(),
        }
    }
}

/// A message over a position in the plane: a Gaussian, or a function on a lattice.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
pub struct LatticeMessage {
    value: LatticeValue,
    /// Divergence (nats) of the conversions that this message needed.
    loss: Option<f64>,
}

impl Clone for LatticeMessage {
    fn clone(&self) -> Self {
        Self { value: self.value.clone(), loss: self.loss }
    }

    fn clone_from(&mut self, source: &Self) {
        self.value.clone_from(&source.value);
        self.loss = source.loss;
    }
}

impl Default for LatticeMessage {
    fn default() -> Self {
        Self { value: LatticeValue::Gaussian(Gaussian::default()), loss: None }
    }
}

impl From<Gaussian<2>> for LatticeMessage {
    fn from(gaussian: Gaussian<2>) -> Self {
        Self { value: LatticeValue::Gaussian(gaussian), loss: None }
    }
}

impl From<Lattice> for LatticeMessage {
    fn from(lattice: Lattice) -> Self {
        Self { value: LatticeValue::Lattice(lattice), loss: None }
    }
}

impl LatticeMessage {
    /// What the message holds.
    pub fn value(&self) -> &LatticeValue {
        &self.value
    }

    /// The function on cells, where it is one.
    pub fn lattice(&self) -> Option<&Lattice> {
        match &self.value {
            LatticeValue::Lattice(lattice) => Some(lattice),
            LatticeValue::Gaussian(_) => None,
        }
    }

    /// Becomes the message that says nothing.
    pub fn clear(&mut self) {
        *self = Self::default();
    }

    /// Lets `fill` rewrite the message as a lattice, in storage it may reuse ([`Lattice::fill`]).
    ///
    /// # Errors
    ///
    /// Whatever `fill` returns.
    pub fn write_lattice(
        &mut self,
        fill: impl FnOnce(&mut Lattice) -> Result<(), MessageError>,
    ) -> Result<(), MessageError> {
        if self.lattice().is_none() {
            self.value = LatticeValue::Lattice(Lattice::empty());
        }
        self.loss = None;
        match &mut self.value {
            LatticeValue::Lattice(lattice) => fill(lattice),
            LatticeValue::Gaussian(_) => Ok(()),
        }
    }

    /// Mean and covariance (m, m²).
    ///
    /// # Errors
    ///
    /// [`MessageError::Improper`] for a Gaussian that leaves a direction free.
    pub fn moments(&self) -> Result<(Vector2<f64>, Matrix2<f64>), MessageError> {
        match &self.value {
            LatticeValue::Gaussian(gaussian) => gaussian.moments(),
            LatticeValue::Lattice(lattice) => Ok(lattice.moments()),
        }
    }
}

impl Message for LatticeMessage {
    type Form = LatticeForm;
    const EXACT_QUOTIENT: bool = true;

    fn vacuous(_space: &Space) -> Self {
        Self::default()
    }

    fn product(
        incoming: Messages<'_, Self>,
        form: &LatticeForm,
        stream: &mut Stream,
    ) -> Result<Self, MessageError> {
        let mut out = Self::default();
        Self::product_into(incoming, form, stream, &mut out)?;
        Ok(out)
    }

    fn product_into(
        incoming: Messages<'_, Self>,
        form: &LatticeForm,
        _stream: &mut Stream,
        out: &mut Self,
    ) -> Result<(), MessageError> {
        match *form {
            LatticeForm::Gaussian(_) => product::gaussian(incoming, out),
            LatticeForm::Lattice { width, most } => product::lattice(incoming, width, most, out),
        }
    }

    fn quotient(&self, incoming: &Self) -> Option<Self> {
        let mut out = Self::default();
        self.quotient_into(incoming, &mut out).then_some(out)
    }

    fn quotient_into(&self, incoming: &Self, out: &mut Self) -> bool {
        product::quotient(self, incoming, out)
    }

    /// Of Gaussians their own; of lattices on the same cells the largest change of a log value where the function is
    /// above a fiftieth of its maximum; 1 where the cells or the kind have changed.
    fn change(&self, previous: &Self) -> f64 {
        match (&self.value, &previous.value) {
            (LatticeValue::Gaussian(own), LatticeValue::Gaussian(old)) => own.change(old),
            (LatticeValue::Lattice(own), LatticeValue::Lattice(old)) if own.shares_support(old) => {
                const SEEN: f64 = -4.0;
                let (mut largest, mut sum) = (0.0, 0.0);
                for (now, before) in own.log_values().iter().zip(old.log_values()) {
                    let moved = if *now > SEEN || *before > SEEN { (now - before).abs() } else { 0.0 };
                    largest = if moved > largest { moved } else { largest };
                    sum += now - before;
                }
                if f64::is_nan(sum) { sum } else { largest }
            }
            _ => 1.0,
        }
    }

    /// Gaussians as their own, lattices in their logarithms; a message of another kind than the one before, or on other
    /// cells, has nothing to be damped with and is left whole.
    fn damp(&mut self, previous: &Self, damping: f64) -> bool {
        match (&mut self.value, &previous.value) {
            (LatticeValue::Gaussian(own), LatticeValue::Gaussian(old)) => own.damp(old, damping),
            (LatticeValue::Lattice(own), LatticeValue::Lattice(old)) if own.shares_support(old) => {
                for (now, before) in own.log_values.iter_mut().zip(&old.log_values) {
                    *now += damping * (before - *now);
                }
                own.outside += damping * (old.outside - own.outside);
                true
            }
            _ => true,
        }
    }

    fn check_form(form: &LatticeForm, space: &Space) -> Result<(), String> {
        if *space != Space::real(2) {
            return Err("a lattice of the plane holds variables of two real coordinates alone".into());
        }
        match *form {
            LatticeForm::Lattice { width, .. } if !(width > 0.0 && width.is_finite()) => {
                Err(format!("cells are {width} m wide; a width must be positive and finite"))
            }
            LatticeForm::Lattice { most: 0, .. } => Err("a belief needs at least one cell".into()),
            _ => Ok(()),
        }
    }

    /// The finest lattice, else Gaussian.
    fn belief_form<'a>(edges: impl Iterator<Item = &'a LatticeForm>) -> LatticeForm {
        let width = |form: &LatticeForm| match form {
            LatticeForm::Lattice { width, .. } => *width,
            LatticeForm::Gaussian(_) => f64::INFINITY,
        };
        edges.copied().min_by(|a, b| width(a).total_cmp(&width(b))).unwrap_or_default()
    }

    fn is_proper(&self) -> bool {
        match &self.value {
            LatticeValue::Gaussian(gaussian) => gaussian.is_proper(),
            LatticeValue::Lattice(_) => true,
        }
    }

    fn quality(&self) -> Quality {
        let effective_sample_size = self.lattice().map(Lattice::effective_cells);
        Quality { effective_sample_size, conversion_loss: self.loss, ..Quality::default() }
    }
}
