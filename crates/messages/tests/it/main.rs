//! The families' laws, and graphs of them against exact answers.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests fail the test")]

mod any;
mod categorical;
mod checkpoint;
mod gaussian;
mod golden;
mod lattice;
mod linear;
mod particles;
mod reproducible;
mod tree;
mod window;
