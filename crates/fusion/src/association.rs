//! Track-to-track association: which tracks of two sensors are the same target's, though biases displace the sets.
//!
//! The second set is taken for a sample of a mixture whose components sit at the displaced tracks of the first:
//!
//! p(x_n) = w/V + (1 − w) Σ_m π_m t_ν(x_n; y_m + v_m, σ² I)
//!
//! Tracks that have no partner are outliers: the uniform density of weight w takes those that are far from everything,
//! and the heavy tails of Student's t keep the others from pulling. What is known of the displacements v is a prior:
//!
//! | field | v | returns |
//! |---|---|---|
//! | [`BiasField`] | what the range and azimuth biases of two sensors make of each track | the biases with their covariance |
//! | [`CoherentDrift`] | any smooth field: a Gaussian process (coherent point drift) | |
//! | [`Displacement`] | one of your own | |
//!
//! [`associate`] finds both by expectation-maximisation, which is sum-product to the associations and scales and a
//! Gaussian maximum to the field, and then solves a gated assignment. [`nearest`] and [`global_nearest`] ignore biases.
//! Only pairs within reach of each other are ever looked at, so that time and memory grow with the number of tracks.
//!
//! ```
//! use sumprod_fusion::association::{BiasField, BiasPrior, Mixture, Sensors, Tracks, associate};
//!
//! // The second sensor measures 400 m too far.
//! let truth = [[20e3, 30e3], [35e3, 42e3], [50e3, 28e3], [12e3, 55e3], [41e3, 61e3]];
//! let sensors = Sensors { first: [0.0, 0.0], second: [60e3, 0.0] };
//! let seen = truth.map(|[x, y]| {
//!     let (dx, dy) = (x - 60e3, y);
//!     let stretch = 1.0 + 400.0 / f64::hypot(dx, dy);
//!     [60e3 + stretch * dx, stretch * dy]
//! });
//! let (first, second) = (Tracks::planar(&truth)?, Tracks::planar(&seen)?);
//! let mut field = BiasField::new(sensors, BiasPrior::independent(1500.0, 0.04))?;
//! let found = associate(&first, &second, &mut field, &Mixture::default())?;
//! assert!(found.pairs.iter().map(|pair| (pair.first, pair.second)).eq((0..5).map(|m| (m, m))));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! Sources: Peel, McLachlan, "Robust mixture modelling using the t distribution" (2000); Liu, Rubin (1995) for ν;
//! Myronenko, Song, "Point set registration: coherent point drift" (2010); Zhou and others (2014) for both together.

mod assign;
mod bias;
mod biased_sensors;
mod candidates;
mod drift;
mod em;
mod error;
mod expectation;
mod information;
mod settings;
mod tails;
mod tracks;

pub use assign::{Pair, global_nearest, nearest};
pub use bias::{BiasField, BiasPosterior, BiasPrior};
pub use biased_sensors::Sensors;
pub use drift::CoherentDrift;
pub use em::{Association, Displacement, MixtureReport, PairProbability, associate};
pub use error::AssociationError;
pub use expectation::{Pull, Residuals};
pub use settings::{Mixture, Start};
pub use tails::Tails;
pub use tracks::Tracks;

#[cfg(test)]
mod tests;
