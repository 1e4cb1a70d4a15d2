//! A measured distance between two positions on a lattice, or from one to an anchor.
//!
//! For positions spread uniformly over cells of width h the likelihood is close to
//!
//! N(z; d̄, σ² + s²),  d̄² = d² + s²,
//!
//! d the distance of the cells' middles, s² the variance along one axis of the difference of the two positions: h²/6
//! between two cells, h²/12 from a cell to a point. It depends on the squared offset in cells, a whole number, so that
//! a message is a sum over a table.

use super::sender::{Sender, receiver, ring};
use crate::library::{AnchorRange, Range};
use crate::rules::View;
use crate::{Noise, ResidualModel, Rules};
use smallvec::SmallVec;
use std::sync::Arc;
use sumprod_graph::{Factor, Incoming, MessageError, Port, Stream};
use sumprod_messages::{Cell, GaussianFamily, LatticeForm, LatticeMessage};

/// Likelihood, as a share of its peak, below which a message does not fall: a neighbour that has settled on a wrong
/// place cannot rule out the right one.
const FLOOR: f64 = 1e-10;
/// Standard deviations up to which a ring reaches.
const RING: f64 = 5.0;
/// Width of a Gaussian sender, in parts of the range, up to which its ring is one.
const PLACE: f64 = 0.5;

/// The measured distance z between two positions, or from one to an anchor: r = |p₁ - p₀| - z.
pub struct LatticeRange {
    measured: f64,
    variance: f64,
    anchor: Option<[f64; 2]>,
    gaussian: Box<dyn Rules>,
}

impl LatticeRange {
    /// A range (m) between two positions, with a noise of one component (m²).
    ///
    /// # Errors
    ///
    /// As [`Range::new`].
    pub fn between(measured: f64, noise: Noise) -> Result<Self, MessageError> {
        let variance = noise.covariance().first().copied().unwrap_or(0.0);
        let range = Range::new(measured, [2; 2], [[0, 1]; 2], noise)?;
        Ok(Self { measured, variance, anchor: None, gaussian: Box::new(ResidualModel(range)) })
    }

    /// A range (m) from a position to an anchor (m), with a noise of one component (m²).
    ///
    /// # Errors
    ///
    /// As [`AnchorRange::new`].
    pub fn to_anchor(measured: f64, anchor: [f64; 2], noise: Noise) -> Result<Self, MessageError> {
        let variance = noise.covariance().first().copied().unwrap_or(0.0);
        let range = AnchorRange::new(measured, anchor, 2, [0, 1], noise)?;
        Ok(Self { measured, variance, anchor: Some(anchor), gaussian: Box::new(ResidualModel(range)) })
    }

    fn write(
        &self,
        sender: &Sender,
        width: f64,
        support: Option<Arc<[Cell]>>,
        out: &mut LatticeMessage,
    ) -> Result<(), MessageError> {
        let reach = |deviation: f64| self.measured.abs() + RING * deviation;
        match sender {
            Sender::Unknown => {
                out.clear();
                Ok(())
            }
            Sender::Place { mean, covariance } => {
                let [xx, xy, yy] = *covariance;
                let spread = width * width / 12.0;
                let least = self.variance + spread;
                let likelihood = |cell: Cell| {
                    let [x, y] = cell.map(|index| (f64::from(index) + 0.5) * width);
                    let (dx, dy) = (x - mean[0], y - mean[1]);
                    let square = dx * dx + dy * dy + spread;
                    let along = (dx * dx * xx + 2.0 * dx * dy * xy + dy * dy * yy) / square;
                    let variance = least + along;
                    let error = square.sqrt() - self.measured;
                    (-0.5 * error * error / variance).exp() * (least / variance).sqrt()
                };
                let farthest = reach((least + xx.max(yy)).sqrt());
                write(out, width, support, sender, farthest, likelihood)
            }
            Sender::Cells(kernels) => {
                let spread = width * width / 6.0;
                let variance = self.variance + spread;
                let farthest = reach(variance.sqrt());
                let table = self.table(width, spread, farthest);
                write(out, width, support, sender, farthest, |cell| kernels.sum(cell, &table))
            }
        }
    }

    /// The likelihood by squared offset in cells.
    fn table(&self, width: f64, spread: f64, farthest: f64) -> SmallVec<[f64; 512]> {
        let half_precision = -0.5 / (self.variance + spread);
        let offsets = (farthest / width).powi(2).min(1e7) as usize;
        let likelihood = |offset: usize| {
            let error = (width * width * offset as f64 + spread).sqrt() - self.measured;
            (half_precision * error * error).exp()
        };
        (0..=offsets).map(likelihood).collect()
    }
}

fn write(
    out: &mut LatticeMessage,
    width: f64,
    support: Option<Arc<[Cell]>>,
    sender: &Sender,
    reach: f64,
    mut likelihood: impl FnMut(Cell) -> f64,
) -> Result<(), MessageError> {
    let cells = match support {
        Some(cells) => cells,
        None => ring(sender.bounds(width), reach, width, &mut likelihood)?,
    };
    if cells.is_empty() {
        out.clear();
        return Ok(());
    }
    out.write_lattice(|lattice| {
        lattice.fill(width, &cells, FLOOR.ln(), |cell| (likelihood(cell) + FLOOR).ln())
    })
}

impl Factor<LatticeMessage> for LatticeRange {
    fn dimensions(&self) -> &[usize] {
        self.gaussian.dimensions()
    }

    fn message(
        &self,
        to: Port,
        incoming: &Incoming<'_, LatticeMessage>,
        form: &LatticeForm,
        stream: &mut Stream,
    ) -> Result<LatticeMessage, MessageError> {
        let mut out = LatticeMessage::default();
        self.message_into(to, incoming, form, stream, &mut out)?;
        Ok(out)
    }

    fn message_into(
        &self,
        to: Port,
        incoming: &Incoming<'_, LatticeMessage>,
        form: &LatticeForm,
        _stream: &mut Stream,
        out: &mut LatticeMessage,
    ) -> Result<(), MessageError> {
        match *form {
            LatticeForm::Gaussian(form) => {
                let draft = self.gaussian.gaussian(to, &View { incoming, form, wrapped: |_| &[] })?;
                out.write_information(incoming.belief(to), &draft.information, &draft.vector, draft.loss)
            }
            LatticeForm::Lattice { width, .. } => {
                let sender = match self.anchor {
                    Some(at) => Sender::anchor(at),
                    None => Sender::new(incoming.message(1 - to), width, PLACE * self.measured.abs()),
                };
                self.write(&sender, width, receiver(incoming.belief(to), width), out)
            }
        }
    }
}
