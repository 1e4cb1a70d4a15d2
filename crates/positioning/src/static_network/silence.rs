//! Who did not measure whom, of those who may well have been near.

use crate::cooperation::links::Reach;

use super::world::Draw;

/// Pairs between which there is no range.
pub(super) struct Silent {
    /// Two agents, the smaller index first.
    pub(super) agents: Vec<[usize; 2]>,
    /// An agent and an anchor.
    pub(super) anchors: Vec<[usize; 2]>,
}

/// The silent pairs within two links of each other: whoever is farther away through the network is farther than two
/// reaches in truth or hidden behind a gap, and its silence says little. Anchors know their places, so those in reach of
/// each other count as linked.
///
/// Costs the sum over nodes of their number of links squared.
pub(super) fn silent(draw: &Draw, radius: f64) -> Silent {
    let agents = draw.truth.len();
    let mut links: Vec<Vec<usize>> = vec![Vec::new(); agents + draw.anchors.len()];
    let mut link = |a: usize, b: usize| {
        links[a].push(b);
        links[b].push(a);
    };
    for range in &draw.ranges {
        link(range.agents[0], range.agents[1]);
    }
    for range in &draw.anchor_ranges {
        link(range.agent, agents + range.anchor);
    }
    let known = Reach::new(&draw.anchors, Some(radius));
    for (anchor, &place) in draw.anchors.iter().enumerate() {
        for (other, _) in known.within(place).filter(|&(other, _)| other > anchor) {
            link(agents + anchor, agents + other);
        }
    }
    let mut silent = Silent { agents: Vec::new(), anchors: Vec::new() };
    // Who last met each node.
    let mut met = vec![usize::MAX; links.len()];
    let mut found = Vec::new();
    for agent in 0..agents {
        met[agent] = agent;
        links[agent].iter().for_each(|&near| met[near] = agent);
        found.clear();
        for &far in links[agent].iter().flat_map(|&near| &links[near]) {
            if met[far] != agent {
                met[far] = agent;
                found.push(far);
            }
        }
        found.sort_unstable();
        for &far in &found {
            match far.checked_sub(agents) {
                Some(anchor) => silent.anchors.push([agent, anchor]),
                None if far > agent => silent.agents.push([agent, far]),
                None => {}
            }
        }
    }
    silent
}
