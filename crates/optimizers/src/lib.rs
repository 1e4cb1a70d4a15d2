//! Reselecting and moving particles: which of a weighted sample live on, when to ask, and where they go.
//!
//! | module | holds |
//! |---|---|
//! | [`reselection`] | the trait, and the law that every implementation keeps |
//! | [`multinomial`], [`stratified`], [`systematic`], [`residual`], [`ssp`] | one resampler each |
//! | [`scheme`] | a resampler chosen by name |
//! | [`trigger`] | the effective sample size below which to reselect |
//! | [`target`] | a prior known by its particles, times a likelihood whose evaluations are counted |
//! | [`moves`] | the trait that takes particles from the prior to the posterior, and its law |
//! | [`weigh`] | the bootstrap: weighs, moves nothing |
//! | [`regularised`] | draws from a kernel around each particle, then weighs |
//! | [`markov`] | Metropolis-Hastings chains: random walk, independence |
//! | [`quantum`] | the quantum genetic algorithm: literal, importance-corrected, Metropolis-Hastings |
//! | [`frame`] | standard coordinates of a cloud, and the kernel that smooths it |
//! | [`board`] | the knowledge-board co-operative swarm, as published and as a proposal |
//! | [`error`] | the crate's error |

pub mod board;
mod chains;
pub mod error;
pub mod frame;
pub mod markov;
pub mod moves;
pub mod multinomial;
pub mod quantum;
pub mod regularised;
pub mod reselection;
pub mod residual;
pub mod scheme;
pub mod ssp;
pub mod stratified;
pub mod systematic;
pub mod target;
pub mod trigger;
pub mod weigh;

pub use board::{Board, BoardForm, BoardSettings, Knowledge, KnowledgeBoard, LifeState, Search};
pub use error::OptimizerError;
pub use frame::{CloudKernel, Frame};
pub use markov::{Independence, RandomWalk};
pub use moves::{Move, Moved, Validity};
pub use multinomial::Multinomial;
pub use quantum::{Coding, Decoding, QuantumImportance, QuantumLiteral, QuantumMetropolis, Rotation};
pub use regularised::Regularised;
pub use reselection::Reselection;
pub use residual::Residual;
pub use scheme::Scheme;
pub use ssp::Ssp;
pub use stratified::Stratified;
pub use systematic::Systematic;
pub use target::{LogDensity, PriorDensity, Target};
pub use trigger::{Trigger, effective_sample_size};
pub use weigh::Weigh;
