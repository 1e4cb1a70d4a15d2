//! Products and quotients on lattices.

use super::{Cell, Lattice, LatticeMessage, LatticeValue};
use crate::Gaussian;
use std::sync::Arc;
use sumprod_graph::{Message, MessageError, Messages};

/// Cells of a belief this far (nats) below its highest are given up.
const GIVEN_UP: f64 = -40.0;

/// The product in Gaussian form; lattices are read by their moments, at the divergence that costs.
pub(super) fn gaussian(
    incoming: Messages<'_, LatticeMessage>,
    out: &mut LatticeMessage,
) -> Result<(), MessageError> {
    let mut product = Gaussian::default();
    let mut loss = None;
    for message in incoming.iter() {
        match &message.value {
            LatticeValue::Gaussian(gaussian) => product = product.times(gaussian),
            LatticeValue::Lattice(lattice) => {
                let (gaussian, cost) = to_gaussian(lattice)?;
                product = product.times(&gaussian);
                loss = Some(loss.unwrap_or(0.0) + cost);
            }
        }
    }
    out.value = LatticeValue::Gaussian(product);
    out.loss = loss;
    Ok(())
}

/// The Gaussian of a lattice's moments, and the divergence to it (nats).
pub(super) fn to_gaussian(lattice: &Lattice) -> Result<(Gaussian<2>, f64), MessageError> {
    let (mean, covariance) = lattice.moments();
    Ok((Gaussian::from_moments(mean, covariance)?, lattice.divergence_to_gaussian(&covariance)))
}

/// The product on cells of this width: those of the belief as it was, else those of the message that has fewest. Until
/// a message has cells the product stays Gaussian.
pub(super) fn lattice(
    incoming: Messages<'_, LatticeMessage>,
    width: f64,
    most: usize,
    out: &mut LatticeMessage,
) -> Result<(), MessageError> {
    let fewest = || {
        let lattices = incoming.iter().filter_map(LatticeMessage::lattice);
        lattices.min_by_key(|lattice| lattice.cells().len())
    };
    let Some(cells) = out.lattice().or_else(fewest).map(|lattice| lattice.support_at(width)) else {
        return gaussian(incoming, out);
    };
    out.write_lattice(|product| {
        product.fill(width, &cells, 0.0, |_| 0.0)?;
        incoming.iter().for_each(|message| multiply(product, message, 1.0));
        product.scale()?;
        product.prune(GIVEN_UP, most);
        Ok(())
    })
}

/// Adds `sign` times the message's log values to the lattice's.
fn multiply(lattice: &mut Lattice, message: &LatticeMessage, sign: f64) {
    match &message.value {
        LatticeValue::Lattice(other) if lattice.shares_support(other) => {
            for (value, other) in lattice.log_values.iter_mut().zip(other.log_values()) {
                *value += sign * other;
            }
            lattice.outside += sign * other.outside();
        }
        LatticeValue::Lattice(other) => {
            let (cells, width) = (lattice.cells().clone(), lattice.width());
            let values = &mut lattice.log_values;
            Lattice::each_of(&cells, width, other, |place, value| values[place] += sign * value);
            lattice.outside += sign * other.outside();
        }
        LatticeValue::Gaussian(gaussian) if *gaussian == Gaussian::default() => {}
        LatticeValue::Gaussian(gaussian) => {
            let (information, vector) = (gaussian.information(), gaussian.information_vector());
            let cells: Arc<[Cell]> = lattice.cells().clone();
            for (place, &cell) in cells.iter().enumerate() {
                let [x, y] = lattice.centre(cell);
                let square = information[(0, 0)] * x * x
                    + 2.0 * information[(0, 1)] * x * y
                    + information[(1, 1)] * y * y;
                lattice.log_values[place] += sign * (vector[0] * x + vector[1] * y - 0.5 * square);
            }
        }
    }
}

/// The belief without one message; false where a Gaussian belief was made of a message on cells.
pub(super) fn quotient(belief: &LatticeMessage, incoming: &LatticeMessage, out: &mut LatticeMessage) -> bool {
    match (&belief.value, &incoming.value) {
        (LatticeValue::Gaussian(whole), LatticeValue::Gaussian(part)) => {
            let mut rest = Gaussian::default();
            let divided = whole.quotient_into(part, &mut rest);
            out.value = LatticeValue::Gaussian(rest);
            out.loss = belief.loss;
            divided
        }
        (LatticeValue::Gaussian(_), LatticeValue::Lattice(_)) => false,
        (LatticeValue::Lattice(_), _) => {
            out.clone_from(belief);
            if let LatticeValue::Lattice(rest) = &mut out.value {
                multiply(rest, incoming, -1.0);
            }
            true
        }
    }
}
