//! Systematic reselection: a comb of N teeth with one random offset.
//!
//! Source: Carpenter, Clifford, Fearnhead, "Improved particle filter for nonlinear problems" (1999).

use rand::RngExt;
use sumprod_graph::FastStream;

use crate::reselection::{Reselection, invert};

/// A comb of N equally spaced teeth with one uniform offset, laid over the cumulative weight. The cheapest, and
/// usually the one of least variance; an order of the particles exists for which it does not converge.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Systematic;

impl Reselection for Systematic {
    fn choose(&self, shares: &[f64], count: usize, random: &mut FastStream) -> Vec<usize> {
        let offset: f64 = random.random();
        invert(shares, (0..count).map(|tooth| (tooth as f64 + offset) / count as f64))
    }
}
