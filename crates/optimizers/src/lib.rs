//! Reselecting particles: which of a weighted sample live on, and when to ask.
//!
//! | module | holds |
//! |---|---|
//! | [`reselection`] | the trait, and the law that every implementation keeps |
//! | [`multinomial`], [`stratified`], [`systematic`], [`residual`], [`ssp`] | one resampler each |
//! | [`scheme`] | a resampler chosen by name |
//! | [`trigger`] | the effective sample size below which to reselect |
//! | [`error`] | the crate's error |

pub mod error;
pub mod multinomial;
pub mod reselection;
pub mod residual;
pub mod scheme;
pub mod ssp;
pub mod stratified;
pub mod systematic;
pub mod trigger;

pub use error::OptimizerError;
pub use multinomial::Multinomial;
pub use reselection::Reselection;
pub use residual::Residual;
pub use scheme::Scheme;
pub use ssp::Ssp;
pub use stratified::Stratified;
pub use systematic::Systematic;
pub use trigger::{Trigger, effective_sample_size};
