//! The expectation step: to which component a second track belongs, and how far in the tails it lies.

use super::candidates::{Candidates, squared_distance};
use super::tails::{Density, Tails};
use super::tracks::Tracks;

/// Logarithm of a share of a density that is lost in rounding.
const NEGLIGIBLE: f64 = -37.0;

/// What the second tracks say about where each first one should go.
///
/// With weights P_mn = τ_mn u_mn, of M first tracks with D coordinates each.
#[derive(Clone, Debug, Default)]
pub struct Pull {
    /// Σ_n P_mn: M numbers without unit.
    pub weight: Vec<f64>,
    /// Σ_n P_mn (x_n − y_m − v_m) at the displacement v that the step started from: M·D numbers (m).
    pub force: Vec<f64>,
}

/// What one expectation step yields besides the pull.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Sums {
    /// Σ_n ln p(x_n).
    pub log_likelihood: f64,
    /// Σ τ_mn.
    pub membership: f64,
    /// Σ P_mn |x_n − T_m|².
    pub square: f64,
    /// Σ τ_mn (ln u − u).
    pub log_scale: f64,
}

/// The mixture at one iteration.
pub(super) struct Expectation<'a> {
    pub candidates: Candidates,
    pub second: &'a Tracks,
    /// Displaced first tracks, M·D.
    pub places: Vec<f64>,
    pub tails: Tails,
    /// Variance σ² of a coordinate about its displaced track (m²).
    pub variance: f64,
    /// ln((1 − w) π_m), M.
    pub log_weights: Vec<f64>,
    /// ln(w / V), minus infinity for w = 0.
    pub log_uniform: f64,
}

impl Expectation<'_> {
    /// Fills the probabilities τ of all pairs, the pull, and Σ_n τ_mn by first track.
    ///
    /// A second track that no first one reaches, where there is no uniform density, belongs to no component and adds
    /// the same constant to the likelihood in every iteration: nothing.
    pub fn run(&self, probabilities: &mut [f64], pull: &mut Pull, memberships: &mut [f64]) -> Sums {
        let width = self.second.width();
        let density = self.density();
        let mut sums = Sums::default();
        let mut squares = Vec::new();
        pull.weight.fill(0.0);
        pull.force.fill(0.0);
        memberships.fill(0.0);
        for (n, track) in self.second.iter().enumerate() {
            let (start, members) = self.candidates.of(n);
            let row = &mut probabilities[start..start + members.len()];
            let mut largest = self.log_uniform;
            squares.clear();
            for (&m, entry) in members.iter().zip(row.iter_mut()) {
                let squared = squared_distance(self.place(m, width), track);
                squares.push(squared);
                *entry = self.log_weights[m as usize] + density.log(squared);
                largest = largest.max(*entry);
            }
            if largest == f64::NEG_INFINITY {
                row.fill(0.0);
                continue;
            }
            let mut total = (self.log_uniform - largest).exp();
            for entry in row.iter_mut() {
                let below = *entry - largest;
                *entry = if below < NEGLIGIBLE { 0.0 } else { below.exp() };
                total += *entry;
            }
            sums.log_likelihood += largest + total.ln();
            for ((&m, entry), squared) in members.iter().zip(row.iter_mut()).zip(&squares) {
                if *entry > 0.0 {
                    *entry /= total;
                    let m = m as usize;
                    memberships[m] += *entry;
                    self.add(&density, m, track, [*entry, *squared], pull, &mut sums);
                }
            }
        }
        sums
    }

    #[inline]
    fn place(&self, m: u32, width: usize) -> &[f64] {
        &self.places[m as usize * width..][..width]
    }

    #[inline]
    fn add(
        &self,
        density: &Density,
        m: usize,
        track: &[f64],
        [probability, squared]: [f64; 2],
        pull: &mut Pull,
        sums: &mut Sums,
    ) {
        let width = track.len();
        let place = self.place(m as u32, width);
        let scale = density.scale(squared);
        let weight = probability * scale;
        pull.weight[m] += weight;
        for (force, (x, t)) in pull.force[m * width..][..width].iter_mut().zip(track.iter().zip(place)) {
            *force += weight * (x - t);
        }
        sums.membership += probability;
        sums.square += weight * squared;
        if matches!(self.tails, Tails::Estimated(_)) {
            sums.log_scale += probability * (scale.ln() - scale);
        }
    }

    fn density(&self) -> Density {
        self.tails.density(self.second.width(), self.variance)
    }

    /// The pairs whose probability matters, for a field that wants its uncertainty.
    pub fn residuals<'b>(&'b self, probabilities: &'b [f64]) -> Residuals<'b> {
        Residuals { expectation: self, density: self.density(), probabilities }
    }
}

/// The pairs at the end of the iterations, as a field's uncertainty needs them.
pub struct Residuals<'a> {
    expectation: &'a Expectation<'a>,
    density: Density,
    probabilities: &'a [f64],
}

/// One pair: the first track's index, its probability τ, its scale u, 1/(ν + δ), and x − T.
pub(super) struct Residual<'a> {
    pub first: usize,
    pub probability: f64,
    pub scale: f64,
    pub slope: f64,
    pub second: &'a [f64],
    pub place: &'a [f64],
}

impl<'a> Residuals<'a> {
    /// Variance σ² of a coordinate about its displaced track (m²).
    pub fn variance(&self) -> f64 {
        self.expectation.variance
    }

    /// Displaced first tracks, M·D.
    pub fn places(&self) -> &'a [f64] {
        &self.expectation.places
    }

    /// Number of second tracks.
    pub(super) fn len(&self) -> usize {
        self.expectation.second.len()
    }

    /// The pairs of second track `n` whose probability is not negligible.
    pub(super) fn of(&self, n: usize) -> impl Iterator<Item = Residual<'a>> {
        let (step, density) = (self.expectation, self.density);
        let (start, members) = step.candidates.of(n);
        let width = step.second.width();
        let second = &step.second.coordinates()[n * width..][..width];
        let row = &self.probabilities[start..][..members.len()];
        members.iter().zip(row).filter(|(_, probability)| **probability > 1e-12).map(
            move |(&m, &probability)| {
                let place = step.place(m, width);
                let squared = squared_distance(place, second);
                Residual {
                    first: m as usize,
                    probability,
                    scale: density.scale(squared),
                    slope: density.scale_slope(squared),
                    second,
                    place,
                }
            },
        )
    }
}
