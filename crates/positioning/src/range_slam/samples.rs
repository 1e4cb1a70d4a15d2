//! Joint draws as text: one line a scalar marginal, `variable,dimension,draw,draw,…`; column j of all lines is one draw.

use std::fmt::Write;

use super::draws::Draws;
use super::file::RangeGraph;
use super::solve::dimension;
use super::steps::{POSE, Seen};

/// The CSV text of the draws at `step`.
pub(super) fn csv(graph: &RangeGraph, step: usize, seen: &[Seen], draws: &Draws) -> String {
    let poses = (0..=step).flat_map(|pose| {
        ["x", "y", "theta"]
            .into_iter()
            .enumerate()
            .map(move |(k, axis)| (&graph.poses[pose].name, axis, POSE * pose + k))
    });
    let landmarks = seen.iter().enumerate().flat_map(|(j, seen)| {
        let name = &graph.landmarks[seen.landmark].name;
        ["x", "y"].into_iter().enumerate().map(move |(k, axis)| (name, axis, dimension(step) + 2 * j + k))
    });
    let mut text = String::new();
    for (name, axis, coordinate) in poses.chain(landmarks) {
        text.push_str(name);
        text.push(',');
        text.push_str(axis);
        for value in draws.coordinate(coordinate) {
            // Writing to a string does not fail.
            let _ = write!(text, ",{value:.6}");
        }
        text.push('\n');
    }
    text
}
