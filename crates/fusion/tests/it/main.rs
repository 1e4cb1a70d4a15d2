//! Laws of fusion: every belief is the posterior of what it says that it is made of.
#![allow(clippy::unwrap_used, clippy::panic, clippy::expect_used, reason = "helpers of tests fail the test")]

mod graphs;
mod intersections;
mod nodes;
mod sets;
mod support;
mod wrong;
