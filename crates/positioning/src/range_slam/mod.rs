//! Range-only SLAM on a small graph, step by step: landmarks that are seen through distances alone.
//!
//! One range leaves a landmark anywhere on a ring, two at two mirror modes, more at one; a Gaussian can say the last
//! alone. The poses are one variable (the trajectory), and the ranges to a landmark are one factor of it and of a
//! clique that holds the positions they were measured from and the landmark, so that the graph of every step is a
//! tree: forward-backward on mixtures, then draws from the trajectory's belief and from each clique given it, chosen by
//! the weights that the exact factors give them.
//!
//! Where no prior is given on landmarks it is flat.

mod draws;
mod file;
mod method;
mod samples;
mod scenario;
mod solve;
mod steps;
#[cfg(test)]
mod tests;

pub use file::{Named, PriorLine, RangeGraph, RangeLine, RelativeLine};
pub use scenario::RangeSlam;
pub use steps::Growing;
