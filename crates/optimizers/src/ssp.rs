//! SSP reselection: expected counts rounded by the Srinivasan sampling process.
//!
//! Source: Gerber, Chopin, Whiteley, "Negative association, ordering and convergence of resampling methods" (2019),
//! after Srinivasan, "Distributions on level-sets with applications to approximation algorithms" (2001).

use rand::RngExt;
use sumprod_graph::FastStream;

use crate::reselection::{Reselection, repeat, split};

/// Each expected count N wᵢ is rounded up or down at random, so that the rounded ones are negatively associated:
/// as regular as [`Systematic`](crate::Systematic), and convergent in whatever order the particles come.
///
/// The fraction p carried so far and the next one, q, are merged until each is 0 or 1. Where p + q < 1, one of the
/// two takes all of p + q, the carried one with probability p / (p + q); else one becomes 1, the carried one with
/// probability (1 - q) / (2 - p - q), and the other is carried on with p + q - 1. Either way both keep their
/// expectation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Ssp;

impl Reselection for Ssp {
    fn choose(&self, shares: &[f64], count: usize, random: &mut FastStream) -> Vec<usize> {
        let mut counts = vec![0; shares.len()];
        let positive = shares.iter().position(|&share| share > 0.0);
        let (mut carried, mut p) = (positive.unwrap_or(0), 0.0);
        for (next, &share) in shares.iter().enumerate() {
            let (whole, q) = split(share, count);
            counts[next] += whole;
            if q == 0.0 {
                continue;
            }
            let u: f64 = random.random();
            if p + q < 1.0 {
                if u * (p + q) >= p {
                    carried = next;
                }
                p += q;
            } else {
                let up = if u * (2.0 - p - q) < 1.0 - q { carried } else { next };
                counts[up] += 1;
                carried = carried + next - up;
                p += q - 1.0;
            }
        }
        // The last fraction is 0 or 1 up to the rounding of the sums.
        let total: usize = counts.iter().sum();
        counts[carried] += count.saturating_sub(total);
        repeat(&counts)
    }
}
