//! Mixtures and their products against exact answers.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests fail the test")]

mod common;
mod density;
mod family;
mod messages;
mod product_errors;
mod product_golden;
mod product_labels;
mod product_laws;
mod product_samplers;
