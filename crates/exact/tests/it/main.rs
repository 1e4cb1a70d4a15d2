//! Exact answers against recorded ones and against dense algebra.
#![allow(clippy::unwrap_used, clippy::panic, clippy::expect_used, reason = "helpers of tests fail the test")]

mod dense;
mod golden;
mod incremental;
mod malformed;
mod observability;
mod pose_graphs;
mod states;
mod support;
