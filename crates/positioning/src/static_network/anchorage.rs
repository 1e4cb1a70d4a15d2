//! Which agents the anchors hold, through whatever chain of ranges.

use super::world::Draw;
use crate::cooperation::names;
use crate::error::PositioningError;

/// The agents from which no chain of ranges leads to an anchor, ascending.
pub(super) fn floating(draw: &Draw) -> Vec<usize> {
    let mut near: Vec<Vec<usize>> = vec![Vec::new(); draw.truth.len()];
    for range in &draw.ranges {
        let [a, b] = range.agents;
        near[a].push(b);
        near[b].push(a);
    }
    let mut held = vec![false; draw.truth.len()];
    let mut next: Vec<usize> = draw.anchor_ranges.iter().map(|range| range.agent).collect();
    while let Some(agent) = next.pop() {
        if !std::mem::replace(&mut held[agent], true) {
            next.extend(&near[agent]);
        }
    }
    (0..held.len()).filter(|&agent| !held[agent]).collect()
}

/// Refuses a network in which nobody measures an anchor.
///
/// # Errors
/// [`PositioningError::Unconstrained`].
pub(super) fn refuse_floating(draw: &Draw) -> Result<(), PositioningError> {
    if !draw.anchor_ranges.is_empty() {
        return Ok(());
    }
    let all: Vec<usize> = (0..draw.truth.len()).collect();
    let who = names(&all);
    let what = match all.len() {
        1 => format!("the position of {who} along both axes"),
        _ => format!(
            "the translation (2 directions) and rotation (1) of {who}, each group in reach of itself alone"
        ),
    };
    let remedy =
        "no agent measures an anchor; add anchors (`world.anchors_per_100`) or reach (`world.radius`)";
    Err(PositioningError::Unconstrained { what, remedy: remedy.into() })
}
