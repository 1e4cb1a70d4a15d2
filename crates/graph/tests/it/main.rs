//! The graph and its engine, tested with a family of one real coordinate that is defined here.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests fail the test")]

mod bell;
mod building;
mod checkpoint;
mod engine;
mod forms;
mod order;
mod reproducible;
mod schedules;
mod window;
