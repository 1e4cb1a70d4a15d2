//! The rules of every family against dense formulas, exact joints and grids.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests fail the test")]

mod acoustic;
mod angles;
mod chains;
mod clusters;
mod derivatives;
mod discrete;
mod golden;
mod guided;
mod heavy;
mod improper;
mod lattice;
mod mixtures;
mod noise;
mod pairs;
mod particles;
mod poses;
mod range_clique;
mod rigid;
mod sigma;
mod support;
mod transition;
mod trees;
