//! Stratified reselection: one uniform draw in each of N equal strata.
//!
//! Source: Kitagawa, "Monte Carlo filter and smoother for non-Gaussian nonlinear state space models" (1996).

use rand::RngExt;
use sumprod_graph::FastStream;

use crate::reselection::{Reselection, invert};

/// One uniform draw in each of N equal strata of the cumulative weight.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Stratified;

impl Reselection for Stratified {
    fn choose(&self, shares: &[f64], count: usize, random: &mut FastStream) -> Vec<usize> {
        let strata = (0..count).map(|stratum| (stratum as f64 + random.random::<f64>()) / count as f64);
        invert(shares, strata)
    }
}
