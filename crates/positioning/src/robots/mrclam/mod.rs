//! A team of robots that see landmarks and each other: the UTIAS MRCLAM recordings.
//!
//! Five robots drive among fifteen barcode tubes; a camera on each gives range and bearing to tubes and to other
//! robots, asynchronously. A slice holds the joint state of the team, so that what one robot learns of another is
//! kept with its correlations: the joint filter, as a clique of the junction tree.
//!
//! The data: K. Y. K. Leung, Y. Halpern, T. D. Barfoot, H. H. T. Liu, "The UTIAS multi-robot cooperative
//! localization and mapping dataset", International Journal of Robotics Research 30(8), 969-974, 2011; the authors
//! give it away at <http://asrl.utias.utoronto.ca/datasets/mrclam/>. [`recording`] says how a folder must look.

pub mod commands;
pub mod model;
pub mod motion;
pub mod recording;
mod scenario;
pub mod sighting;

pub use scenario::Mrclam;

#[cfg(test)]
mod tests;
