//! A mowing robot among ranging radios: CMU's Plaza recordings.
//!
//! The robot has wheel odometry and a gyro with a constant bias, and a radio that measures ranges to a few beacons
//! with an unknown scale and offset. All of these are estimated along with the pose.
//!
//! The data: J. Djugash, B. Hamner, S. Roth, "Navigating with ranging radios: Five data sets with ground truth",
//! Journal of Field Robotics 26(9), 2009. Copies in MATLAB's format come with GTSAM's examples (`Plaza1_.mat`,
//! `Plaza2_.mat` with their text files); [`recording`] says how a folder must look.

pub mod model;
pub mod recording;
mod scenario;

pub use scenario::Plaza;

#[cfg(test)]
mod tests;
