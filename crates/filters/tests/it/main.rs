//! Filters against chains of the graph, against each other, and against what users may do wrong.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests fail the test")]

mod driven;
mod gaussian;
mod kalman;
mod misuse;
mod particle;
mod support;
mod variants;
