//! The first exchanges of a method as an information graph.

use sumprod_fusion::{FusionError, InformationGraph};

use super::method::MethodSettings;
use super::structure::Structure;
use super::world::WorldSettings;

/// Exchanges that are drawn: on a ring of six what came from the opposite side closes the loop by then.
const EXCHANGES: u32 = 4;

/// Who knew what when, until a few exchanges are over. Messages that get lost are drawn as if they arrived.
pub(super) fn record(
    settings: &WorldSettings,
    structure: &Structure,
    method: &MethodSettings,
) -> Result<InformationGraph, FusionError> {
    let mut graph = InformationGraph::new();
    let nodes: Vec<usize> = structure.names.iter().map(|name| graph.add_node(name)).collect();
    let phases = structure.phases(method);
    let steps = settings.steps.min(EXCHANGES * settings.exchange_interval);
    for step in 1..=steps {
        let time = f64::from(step) * settings.interval;
        for &sensor in &nodes[..structure.sensors] {
            graph.observe(sensor, time)?;
        }
        if !settings.exchanges(step) {
            continue;
        }
        for phase in &phases {
            let sent: Vec<_> = nodes.iter().map(|&node| graph.latest(node)).collect::<Result<_, _>>()?;
            for &to in &nodes {
                let heard = phase.iter().filter(|&&(from, other)| other == to && !settings.is_silent(from));
                let parents: Vec<_> = heard.map(|&(from, _)| sent[from]).collect();
                if !parents.is_empty() {
                    graph.communicate(&parents, to, time)?;
                }
            }
        }
    }
    Ok(graph)
}
