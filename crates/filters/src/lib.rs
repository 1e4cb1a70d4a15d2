//! Recursive estimates of a state: chains of slices under one set of verbs.
//!
//! | verb | trait | does |
//! |---|---|---|
//! | `predict` | [`Predict`] | passes the belief through a motion |
//! | `correct` | [`Correct`] | multiplies it by a likelihood; returns log-likelihood and innovation |
//! | `run` | [`Filter`] | goes through steps and keeps what smoothing needs |
//! | `smooth` | [`Smooth`] | tells each step's state by all measurements |
//!
//! A filter is a chain graph whose window is one slice: it runs on the kernels of the factors' rules
//! ([`sumprod_models::moments`], [`sumprod_models::cloud`]) and gives the chain's marginals, without the graph.

mod error;
mod gaussian;
mod particle;
mod verbs;

pub use error::FilterError;
pub use gaussian::{Approximation, GaussianRecord, Imm, Kalman, ModeRecord, Prediction, Square, SquareRoot};
pub use particle::{DrivenFilter, ParticleFilter, ParticleRecord, RaoBlackwellised, Recovery, Told};
pub use verbs::{Correct, Correction, Filter, Predict, Run, Smooth, Step};
