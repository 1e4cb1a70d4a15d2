//! Robots located on recorded data: readers, models and scenarios.
//!
//! | module | holds |
//! |---|---|
//! | [`plaza`] | one robot among ranging radios whose scale and offset it learns on the way |
//! | [`mrclam`] | five robots that see landmarks and each other |
//! | [`table`] | files of numbers, read with the place of every mistake |
//! | [`chain`] | a chain of states run as a filter, a fixed-lag smoother or a smoother |
//! | [`particles`] | the same chain filtered by particles |
//!
//! A filter here is a window of one slice on the same chain that the smoother runs forward and backward.

pub mod chain;
pub mod mrclam;
pub mod plaza;
pub mod table;

pub mod particles;

pub(crate) mod numbers;
#[cfg(test)]
pub(crate) mod scratch;

use sumprod_messages::Moments;

/// Estimates are not carried across gaps longer than this (s) to be scored inside them.
pub const LONGEST_GAP_S: f64 = 0.5;

/// Mean and covariance of the pose [x, y, heading] that a state begins with.
fn pose_of(state: &Moments) -> Moments {
    marginal(state, 0, 3)
}

/// Mean and covariance of `length` coordinates from `first` on.
pub(crate) fn marginal(state: &Moments, first: usize, length: usize) -> Moments {
    let own = first..first + length;
    let rows = own.clone().flat_map(|row| own.clone().map(move |column| (row, column)));
    Moments {
        mean: state.mean[own.clone()].to_vec(),
        covariance: rows.map(|(row, column)| state.covariance_at(row, column)).collect(),
    }
}
