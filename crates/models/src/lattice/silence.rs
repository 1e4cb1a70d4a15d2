//! No measurement between two: evidence that they are not within reach.
//!
//! Where every pair within reach R is measured but for a share m that is missed,
//!
//! P(silent | d) = 1 - (1 - m) [d ≤ R].
//!
//! It speaks against one of two mirror images whenever the other is in sight of somebody who heard nothing. Over the
//! width of the cells the step at R is smooth: a logistic function stands in for the normal distribution's, from which
//! it differs by less than 0.01.

use super::sender::{Sender, receiver};
use smallvec::SmallVec;
use sumprod_graph::{Factor, Incoming, MessageError, Port, Stream};
use sumprod_messages::{Cell, LatticeForm, LatticeMessage};

/// Slope of the logistic function nearest to the normal distribution function.
const LOGISTIC: f64 = 1.702;
/// Standard deviations of the step at R beyond which it is over.
const STEP: f64 = 4.0;
/// Probability of being within reach up to which silence is no news.
const NO_NEWS: f64 = 1e-3;

/// Two positions, or a position and an anchor, between which nothing was measured.
///
/// Messages along Gaussian edges say nothing: where a position is known to be in one place, silence has had its say.
#[derive(Clone, Debug)]
pub struct Silence {
    reach: f64,
    missed: f64,
    anchor: Option<[f64; 2]>,
}

impl Silence {
    /// Silence between two positions that measure each other up to `reach` (m), but for a share `missed` (above 0).
    ///
    /// # Errors
    ///
    /// Where the reach is not positive and finite, or the share not above 0 and at most 1.
    pub fn between(reach: f64, missed: f64) -> Result<Self, MessageError> {
        if !(reach > 0.0 && reach.is_finite()) {
            return Err(MessageError::Unsupported(format!(
                "a reach of {reach} m is not positive and finite"
            )));
        }
        if !(missed > 0.0 && missed <= 1.0) {
            let reason = format!("a share of missed links of {missed} is not above 0 and at most 1");
            return Err(MessageError::Unsupported(reason));
        }
        Ok(Self { reach, missed, anchor: None })
    }

    /// Silence between a position and an anchor (m).
    ///
    /// # Errors
    ///
    /// As [`Silence::between`], and where the anchor is not finite.
    pub fn to_anchor(reach: f64, missed: f64, anchor: [f64; 2]) -> Result<Self, MessageError> {
        if let Some(&value) = anchor.iter().find(|value| !value.is_finite()) {
            return Err(MessageError::NotFinite { what: "the anchor's position", value });
        }
        Ok(Self { anchor: Some(anchor), ..Self::between(reach, missed)? })
    }

    /// The probability that two at this distance, uncertain by this standard deviation (m), are within reach.
    fn within(&self, distance: f64, deviation: f64) -> f64 {
        let scaled = (self.reach - distance) / deviation;
        match scaled {
            STEP.. => 1.0,
            ..=-4.0 => 0.0,
            _ => 1.0 / (1.0 + (-LOGISTIC * scaled).exp()),
        }
    }

    fn write(
        &self,
        within: impl Fn(Cell) -> f64,
        width: f64,
        belief: &LatticeMessage,
        out: &mut LatticeMessage,
    ) -> Result<(), MessageError> {
        let Some(cells) = receiver(belief, width) else {
            out.clear();
            return Ok(());
        };
        let mut news = false;
        let heard = 1.0 - self.missed;
        out.write_lattice(|lattice| {
            lattice.fill(width, &cells, 0.0, |cell| {
                let within = within(cell);
                news |= within > NO_NEWS;
                // A sum of weights may exceed one by rounding.
                (1.0 - heard * within).max(self.missed).ln()
            })
        })?;
        if !news {
            out.clear();
        }
        Ok(())
    }
}

/// Whether a box is farther from a message's cells than `distance` (m).
fn apart([low, high]: [[f64; 2]; 2], belief: &LatticeMessage, distance: f64) -> bool {
    let Some(lattice) = belief.lattice() else { return false };
    let width = lattice.width();
    let mut square = 0.0;
    for axis in 0..2 {
        let (mut least, mut greatest) = (f64::INFINITY, f64::NEG_INFINITY);
        for cell in lattice.cells().iter() {
            let west = f64::from(cell[axis]) * width;
            least = least.min(west);
            greatest = greatest.max(west + width);
        }
        let gap = (low[axis] - greatest).max(least - high[axis]).max(0.0);
        square += gap * gap;
    }
    square > distance * distance
}

impl Factor<LatticeMessage> for Silence {
    fn dimensions(&self) -> &[usize] {
        if self.anchor.is_some() { &[2] } else { &[2, 2] }
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
        let LatticeForm::Lattice { width, .. } = *form else {
            out.clear();
            return Ok(());
        };
        let belief = incoming.belief(to);
        let sender = match self.anchor {
            Some(at) => Sender::anchor(at),
            None => Sender::new(incoming.message(1 - to), width, 0.5 * self.reach),
        };
        if apart(sender.bounds(width), belief, self.reach + width) {
            out.clear();
            return Ok(());
        }
        match &sender {
            Sender::Unknown => {
                out.clear();
                Ok(())
            }
            Sender::Place { mean, covariance } => {
                let spread = width * width / 12.0;
                let deviation = (spread + covariance[0].max(covariance[2])).sqrt();
                let within = |cell: Cell| {
                    let [x, y] = cell.map(|index| (f64::from(index) + 0.5) * width);
                    self.within((x - mean[0]).hypot(y - mean[1]), deviation)
                };
                self.write(within, width, belief, out)
            }
            Sender::Cells(kernels) => {
                let deviation = (width * width / 6.0).sqrt();
                let offsets = ((self.reach + STEP * deviation) / width).powi(2).min(1e7) as usize;
                let probability = |offset: usize| self.within(width * (offset as f64).sqrt(), deviation);
                let table: SmallVec<[f64; 512]> = (0..=offsets).map(probability).collect();
                self.write(|cell| kernels.sum(cell, &table), width, belief, out)
            }
        }
    }
}
