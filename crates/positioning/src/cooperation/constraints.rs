//! What a network leaves free when no agent knows where it starts: the null space of the ranges' Jacobian.

use nalgebra::DMatrix;

use super::geometry::directions;
use super::world::{Draw, World};
use crate::error::PositioningError;

/// Eigenvalues of J'J below this share of the largest count as zero: rounding leaves about 1e-15.
const RANK_TOLERANCE: f64 = 1e-11;
/// Agents named in a sentence before the rest are counted.
const NAMED: usize = 6;

/// Agents joined by ranges.
struct Component {
    agents: Vec<usize>,
    /// Anchors that any of them reaches, ascending.
    anchors: Vec<usize>,
}

/// Refuses a network whose first slice leaves directions free that no prior constrains.
///
/// # Errors
/// [`PositioningError::Unconstrained`], which names the agents and the directions.
pub(super) fn refuse_free(world: &World, draw: &Draw) -> Result<(), PositioningError> {
    if world.prior {
        return Ok(());
    }
    let free: Vec<String> =
        components(world, draw).iter().filter_map(|component| describe(component, world, draw)).collect();
    if free.is_empty() {
        return Ok(());
    }
    let remedy = "add anchors within reach of these agents (`world.anchors`: three that are not in line fix a network), \
                  or let each agent know its start (`world.prior = true`)";
    let shown = free.len().min(3);
    let mut what = free[..shown].join("; nor ");
    if free.len() > shown {
        what.push_str(&format!("; nor the positions of {} further groups of agents", free.len() - shown));
    }
    Err(PositioningError::Unconstrained { what, remedy: remedy.into() })
}

fn components(world: &World, draw: &Draw) -> Vec<Component> {
    let mut root: Vec<usize> = (0..world.agents).collect();
    fn find(root: &mut [usize], mut agent: usize) -> usize {
        while root[agent] != agent {
            root[agent] = root[root[agent]];
            agent = root[agent];
        }
        agent
    }
    let Some(slice) = draw.slices.first() else { return Vec::new() };
    for range in &slice.ranges {
        let [a, b] = range.agents.map(|agent| find(&mut root, agent));
        root[a.max(b)] = a.min(b);
    }
    let mut components: Vec<Component> = Vec::new();
    let mut place = vec![usize::MAX; world.agents];
    for agent in 0..world.agents {
        let own = find(&mut root, agent);
        if place[own] == usize::MAX {
            place[own] = components.len();
            components.push(Component { agents: Vec::new(), anchors: Vec::new() });
        }
        components[place[own]].agents.push(agent);
    }
    for range in &slice.anchor_ranges {
        components[place[find(&mut root, range.agent)]].anchors.push(range.anchor);
    }
    for component in &mut components {
        component.anchors.sort_unstable();
        component.anchors.dedup();
    }
    components
}

/// The free directions of a component in words; none where its ranges fix it.
fn describe(component: &Component, world: &World, draw: &Draw) -> Option<String> {
    let free = free_directions(component, world, draw);
    if free == 0 {
        return None;
    }
    let names = names(&component.agents);
    let alone = component.agents.len() == 1;
    let (motion, count) = match component.anchors.as_slice() {
        [] if alone => (format!("the position of {names} along both axes"), 2),
        [] => (format!("the translation (2 directions) and rotation (1) of {names} as one body"), 3),
        [anchor] => (format!("the rotation of {names} about anchor {}", anchor + 1), 1),
        _ => {
            let directions = if free == 1 { "1 direction".into() } else { format!("{free} directions") };
            return Some(format!("{directions} of the positions of {names}"));
        }
    };
    Some(match free.saturating_sub(count) {
        0 => motion,
        1 => format!("{motion} and 1 direction of their shape"),
        more => format!("{motion} and {more} directions of their shape"),
    })
}

/// Dimension of the null space of the component's ranges, as functions of its agents' positions.
fn free_directions(component: &Component, world: &World, draw: &Draw) -> usize {
    let Some(slice) = draw.slices.first() else { return 0 };
    let n = 2 * component.agents.len();
    let place = |agent: usize| component.agents.binary_search(&agent).ok();
    let mut information = DMatrix::<f64>::zeros(n, n);
    for (own, other, direction) in directions(slice, &draw.truth[1], &world.anchors) {
        let Some(own) = place(own) else { continue };
        let mut gradient = vec![(2 * own, direction[0]), (2 * own + 1, direction[1])];
        if let Some(other) = other.and_then(place) {
            gradient.extend([(2 * other, -direction[0]), (2 * other + 1, -direction[1])]);
        }
        for &(row, a) in &gradient {
            for &(column, b) in &gradient {
                information[(row, column)] += a * b;
            }
        }
    }
    let eigenvalues = information.symmetric_eigenvalues();
    let threshold = RANK_TOLERANCE * eigenvalues.amax();
    eigenvalues.iter().filter(|&&value| value <= threshold).count()
}

/// Agents by number, the first few of many.
pub(crate) fn names(agents: &[usize]) -> String {
    let numbers: Vec<String> = agents.iter().map(|agent| (agent + 1).to_string()).collect();
    match numbers.as_slice() {
        [only] => format!("agent {only}"),
        [others @ .., last] if agents.len() <= NAMED => format!("agents {} and {last}", others.join(", ")),
        _ => {
            let rest = agents.len() - NAMED;
            format!("agents {} and {rest} more", numbers[..NAMED].join(", "))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sentence(agents: usize, anchors: &[[f64; 2]], radius: Option<f64>) -> Option<String> {
        let world = World {
            agents,
            anchors: anchors.to_vec(),
            radius,
            prior: false,
            area: [[0.0, 100.0]; 2],
            ..World::at_density(agents, 1)
        };
        refuse_free(&world, &world.draw(1, 0).unwrap()).err().map(|error| error.to_string())
    }

    #[test]
    fn a_network_without_anchors_floats() {
        let message = sentence(3, &[], None).unwrap();
        assert!(
            message.starts_with(
                "nothing constrains the translation (2 directions) and rotation (1) of agents 1, 2 and 3 as one \
                 body; add anchors"
            ),
            "{message}"
        );
        assert!(
            sentence(20, &[], None).unwrap().contains("of agents 1, 2, 3, 4, 5, 6 and 14 more as one body")
        );
    }

    #[test]
    fn a_network_on_one_anchor_turns_about_it() {
        let message = sentence(4, &[[10.0, 20.0]], None).unwrap();
        assert!(message.contains("nothing constrains the rotation of agents 1, 2, 3 and 4 about anchor 1; "));
    }

    #[test]
    fn an_agent_alone_is_named_and_what_is_fixed_is_not() {
        assert!(sentence(1, &[], None).unwrap().contains("the position of agent 1 along both axes"));
        assert_eq!(sentence(3, &[[0.0, 0.0], [100.0, 0.0]], None), None);
        // Out of reach of each other and of the anchors.
        let message = sentence(5, &[[1e4, 1e4]], Some(1e-3)).unwrap();
        assert!(message.contains("agent 1 along both axes; nor the position of agent 2"), "{message}");
        assert!(
            message.contains("; nor the positions of 2 further groups of agents; add anchors"),
            "{message}"
        );
    }

    #[test]
    fn a_known_start_constrains_everything() {
        let world = World { anchors: Vec::new(), ..World::at_density(5, 1) };
        assert!(refuse_free(&world, &world.draw(1, 0).unwrap()).is_ok());
    }
}
