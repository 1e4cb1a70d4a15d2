//! What a lattice rule reads of the sender, and how it writes to the receiver.

use smallvec::SmallVec;
use std::sync::Arc;
use sumprod_graph::{Message, MessageError};
use sumprod_messages::{Cell, Lattice, LatticeMessage, LatticeValue};

/// Share of a sender's weight below which a cell of it is not heard.
const FAINT: f64 = 1e-6;
/// Share of its peak down to which a ring is written to a receiver without cells.
const RING_EDGE: f64 = 1e-6;
/// The most cells that are searched for a ring.
const SEARCHED: i64 = 4_000_000;

/// The other end of a range.
#[allow(
    clippy::large_enum_variant,
    reason = "it lives as long as one message, for which a box would allocate"
)]
pub(super) enum Sender {
    /// Nothing is known of it, or too little.
    Unknown,
    /// One place, with what is known of it.
    Place {
        /// Its mean (m).
        mean: [f64; 2],
        /// Its covariance (m²): xx, xy, yy.
        covariance: [f64; 3],
    },
    /// Weighted cells.
    Cells(Kernels),
}

/// Weighted cells of one width, by columns, rows and weights.
pub(super) struct Kernels {
    columns: SmallVec<[i32; 256]>,
    rows: SmallVec<[i32; 256]>,
    weights: SmallVec<[f64; 256]>,
}

impl Sender {
    /// The message in cells of `width`, or the place it names; a Gaussian wider than `widest` (m) counts as nothing.
    pub(super) fn new(message: &LatticeMessage, width: f64, widest: f64) -> Self {
        match message.value() {
            LatticeValue::Gaussian(gaussian) => {
                let Some((mean, covariance)) =
                    gaussian.is_proper().then(|| gaussian.moments().ok()).flatten()
                else {
                    return Self::Unknown;
                };
                if covariance[(0, 0)].max(covariance[(1, 1)]) > widest * widest {
                    return Self::Unknown;
                }
                let covariance = [covariance[(0, 0)], covariance[(0, 1)], covariance[(1, 1)]];
                Self::Place { mean: [mean[0], mean[1]], covariance }
            }
            LatticeValue::Lattice(lattice) => Self::Cells(Kernels::new(lattice, width)),
        }
    }

    /// A known place.
    pub(super) fn anchor(at: [f64; 2]) -> Self {
        Self::Place { mean: at, covariance: [0.0; 3] }
    }

    /// The least and greatest coordinates (m) of what is known of it.
    pub(super) fn bounds(&self, width: f64) -> [[f64; 2]; 2] {
        match self {
            Self::Unknown => [[f64::NEG_INFINITY; 2], [f64::INFINITY; 2]],
            Self::Place { mean, .. } => [*mean; 2],
            Self::Cells(kernels) => {
                let extent = |indices: &[i32]| {
                    let (least, greatest) = (indices.iter().min(), indices.iter().max());
                    let low = f64::from(least.copied().unwrap_or(0)) * width;
                    (low, (f64::from(greatest.copied().unwrap_or(0)) + 1.0) * width)
                };
                let (west, east) = extent(&kernels.columns);
                let (south, north) = extent(&kernels.rows);
                [[west, south], [east, north]]
            }
        }
    }
}

impl Kernels {
    fn new(lattice: &Lattice, width: f64) -> Self {
        let mut all: SmallVec<[f64; 256]> = SmallVec::new();
        lattice.weights_into(&mut all);
        let mut kernels = Self { columns: SmallVec::new(), rows: SmallVec::new(), weights: SmallVec::new() };
        // A wide cell is heard as its parts, a narrow one as the wider cell that holds it.
        let parts = ((lattice.width() / width).round() as i32).max(1);
        let share = 1.0 / f64::from(parts * parts);
        let heard = lattice.cells().iter().zip(&all).filter(|&(_, &weight)| weight > FAINT);
        for (&cell, &weight) in heard {
            if lattice.width() == width {
                kernels.push(cell, weight);
            } else if parts > 1 {
                let [i, j] = cell.map(|index| index.saturating_mul(parts));
                for part in 0..parts * parts {
                    let cell = [i.saturating_add(part / parts), j.saturating_add(part % parts)];
                    kernels.push(cell, weight * share);
                }
            } else {
                kernels.push(lattice.centre(cell).map(|x| (x / width).floor() as i32), weight);
            }
        }
        kernels
    }

    fn push(&mut self, [column, row]: Cell, weight: f64) {
        self.columns.push(column);
        self.rows.push(row);
        self.weights.push(weight);
    }

    /// Σ w · table[(i - iₖ)² + (j - jₖ)²], zero beyond the table.
    #[inline]
    pub(super) fn sum(&self, [column, row]: Cell, table: &[f64]) -> f64 {
        let mut sum = 0.0;
        for ((&i, &j), &weight) in self.columns.iter().zip(&self.rows).zip(&self.weights) {
            let (di, dj) = (i64::from(column) - i64::from(i), i64::from(row) - i64::from(j));
            if let Some(value) = table.get((di * di + dj * dj) as usize) {
                sum += weight * value;
            }
        }
        sum
    }
}

/// Where a message is evaluated: at the cells of the receiver's belief.
pub(super) fn receiver(belief: &LatticeMessage, width: f64) -> Option<Arc<[Cell]>> {
    belief.lattice().map(|lattice| lattice.support_at(width))
}

/// The cells within `reach` (m) of `bounds` where `value` is above a share of its largest, ascending.
///
/// # Errors
///
/// Where the cells are too narrow for the reach.
pub(super) fn ring(
    [low, high]: [[f64; 2]; 2],
    reach: f64,
    width: f64,
    mut value: impl FnMut(Cell) -> f64,
) -> Result<Arc<[Cell]>, MessageError> {
    let first = low.map(|x| ((x - reach) / width).floor());
    let last = high.map(|x| ((x + reach) / width).floor());
    let count = (last[0] - first[0] + 1.0) * (last[1] - first[1] + 1.0);
    let far = first.iter().chain(&last).any(|x| x.abs() > f64::from(i32::MAX / 2));
    if far || count.is_nan() || count > SEARCHED as f64 {
        return Err(MessageError::Unsupported(format!(
            "cells of {width} m are too narrow for a range that reaches {reach:.0} m: {count:.0} of them would be \
             searched; choose wider cells"
        )));
    }
    let mut found: Vec<(Cell, f64)> = Vec::new();
    let mut largest: f64 = 0.0;
    for column in first[0] as i32..=last[0] as i32 {
        for row in first[1] as i32..=last[1] as i32 {
            let value = value([column, row]);
            if value > RING_EDGE {
                largest = largest.max(value);
                found.push(([column, row], value));
            }
        }
    }
    Ok(found.into_iter().filter(|(_, value)| *value > RING_EDGE * largest).map(|(cell, _)| cell).collect())
}
