//! Factors: what a user writes, the rules that follow from it, and a library.
//!
//! A user writes a [`Residual`] (a measurement or constraint: a function that should be zero, and its noise) or a
//! [`Motion`] (a state's step and its process noise). From either follow the rules of every family of messages:
//!
//! | family | residual | motion |
//! |---|---|---|
//! | Gaussian | linearised by dual numbers or sigma points, robust weights | prediction and retrodiction, singular process noise allowed |
//! | particles | values at the receiver's particles, averaged over the sender's | a draw per particle, guided by what is known of the receiver |
//! | mixture | every component made linear by itself, within windows where no line serves; rings of kernels | every component by itself, both ways |
//! | any | by the form of the edge | by the form of the edge |
//!
//! Functions of variables of finitely many states are in [`discrete`].
//!
//! What a particle filter and the particle rules have in common, many particles at a time, is in [`cloud`].
//!
//! [`AddModel`] puts them into a graph; [`check_residual`] holds a residual against finite differences.

mod add;
mod blocks;
mod check;
pub mod cloud;
mod cluster;
pub mod discrete;
mod dual;
mod expansion;
mod lattice;
pub mod library;
mod manifold;
mod model;
pub mod moments;
mod motion;
mod noise;
mod packed;
pub mod pose;
mod residual;
mod rules;
mod small;
mod switch;

pub use add::AddModel;
pub use blocks::Blocks;
pub use check::{DerivativeMismatch, check_expansion, check_residual};
pub use cluster::{Block, Cluster};
pub use dual::Real;
pub use expansion::Expansion;
pub use lattice::{LatticeRange, Silence};
pub use manifold::Manifold;
pub use model::Model;
pub use motion::{Motion, ProcessNoise, Transition};
pub use noise::{Noise, NoiseError};
pub use residual::{Chart, Linearised, PortSampler, Residual, ResidualModel, Ring, RingCentre};
pub use rules::Rules;
pub use switch::Switch;
