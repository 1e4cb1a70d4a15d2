//! Who did not measure whom, of those who may well have been near.

use crate::cooperation::links::Reach;

use super::world::Draw;

/// Links between two agents up to which their silence is heard.
const AGENT_LINKS: usize = 3;
/// Links between an agent and an anchor up to which its silence is heard: anchors are few and know where they are, so
/// that they speak against a whole corner of a network folded inwards.
const ANCHOR_LINKS: usize = 4;

/// Pairs between which there is no range.
pub(super) struct Silent {
    /// Two agents, the smaller index first.
    pub(super) agents: Vec<[usize; 2]>,
    /// An agent and an anchor.
    pub(super) anchors: Vec<[usize; 2]>,
}

/// The silent pairs that are few links from each other: by n links nobody is farther away than n times the reach, and
/// the fewer they are, the nearer a wrong place may bring the two. Anchors know their places, so those in reach of each
/// other count as linked.
///
/// Costs the sum over agents of the links of the nodes within four links.
pub(super) fn silent(draw: &Draw, radius: f64) -> Silent {
    let agents = draw.truth.len();
    let links = links(draw, radius);
    let mut silent = Silent { agents: Vec::new(), anchors: Vec::new() };
    // Who last met each node.
    let mut met = vec![usize::MAX; links.len()];
    let mut found: Vec<usize> = Vec::new();
    for agent in 0..agents {
        met[agent] = agent;
        found.clear();
        found.push(agent);
        // The nodes at each number of links, one after the other in `found`.
        let mut first = 0;
        for distance in 1..=ANCHOR_LINKS {
            let last = found.len();
            for place in first..last {
                for &far in &links[found[place]] {
                    if std::mem::replace(&mut met[far], agent) == agent {
                        continue;
                    }
                    found.push(far);
                    match far.checked_sub(agents) {
                        _ if distance == 1 => {}
                        Some(anchor) => silent.anchors.push([agent, anchor]),
                        None if far > agent && distance <= AGENT_LINKS => silent.agents.push([agent, far]),
                        None => {}
                    }
                }
            }
            first = last;
        }
    }
    silent
}

/// Whom each agent, and then each anchor, is linked to.
fn links(draw: &Draw, radius: f64) -> Vec<Vec<usize>> {
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
    links
}
