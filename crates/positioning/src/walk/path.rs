//! The true path, which scores and is nothing that the tracker reads.

use std::path::Path;

use super::WorldSettings;
use crate::error::PositioningError;
use crate::robots::table::{Separator, Table, only};

/// Points that the walker goes through at constant intervals, straight and at constant speed between them.
pub struct TruePath {
    points: Vec<[f64; 2]>,
    start: f64,
    leg: f64,
}

impl TruePath {
    /// Reads the points from `pivot_coords*.txt` and their order from `path*.txt`.
    ///
    /// # Errors
    /// [`PositioningError::Data`] naming file, line and field.
    pub fn read(folder: &Path, world: &WorldSettings) -> Result<Self, PositioningError> {
        let pivots = only(folder, "pivot_coords", ".txt")?;
        let pivots = Table::<2>::read(&pivots, Separator::Blank, ["x m", "y m"])?;
        let order = Table::<1>::read(&only(folder, "path", ".txt")?, Separator::Blank, ["pivot"])?;
        let points = order
            .records()
            .iter()
            .map(|record| {
                let index = order.whole(record, 0)? as usize;
                pivots.records().get(index).map(|pivot| pivot.values).ok_or_else(|| {
                    let count = pivots.records().len();
                    order.wrong(record, format!("pivot {index} does not exist; there are {count}, from 0"))
                })
            })
            .collect::<Result<_, _>>()?;
        Ok(Self { points, start: world.empty_until, leg: world.leg })
    }

    /// Where the walker is at a time (s); none before the walk and after it.
    pub fn at(&self, time: f64) -> Option<[f64; 2]> {
        let legs = (time - self.start) / self.leg;
        if legs < 0.0 {
            return None;
        }
        let share = legs.fract();
        let from = self.points.get(legs as usize)?;
        match self.points.get(legs as usize + 1) {
            Some(to) => Some([0, 1].map(|k| from[k] + share * (to[k] - from[k]))),
            None => (share == 0.0).then_some(*from),
        }
    }
}
