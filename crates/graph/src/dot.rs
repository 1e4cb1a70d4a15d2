//! A drawing of the graph, for Graphviz.

use crate::graph::Kind;
use crate::{Factor, FactorGraph, Message};
use std::fmt::Write;

impl<M: Message, F: Factor<M>> FactorGraph<M, F> {
    /// The graph in Graphviz's DOT language: variables as circles, factors as squares, edges with their port.
    ///
    /// # Example
    ///
    /// `dot -Tsvg graph.dot -o graph.svg` draws what this returns.
    pub fn dot(&self) -> String {
        let mut out = String::from("graph {\n  node [fontname=\"sans-serif\"];\n");
        let escape = |label: String| label.replace('\\', "\\\\").replace('"', "\\\"");
        let structure = self.structure();
        for node in structure.node_indices() {
            let kind = structure[node];
            let shape = match kind {
                Kind::Variable(_) => "ellipse",
                Kind::Factor(_) => "box",
            };
            let label = escape(self.label(kind));
            // Writing to a string cannot fail.
            let _ = writeln!(out, "  n{} [shape={shape}, label=\"{label}\"];", node.index());
        }
        for factor in self.factor_ids() {
            let from = self.node_of(factor).index();
            for (port, edge) in self.edge_range(factor).enumerate() {
                let to = structure
                    .edge_endpoints(petgraph::graph::EdgeIndex::new(edge))
                    .map_or(0, |(_, b)| b.index());
                let _ = writeln!(out, "  n{from} -- n{to} [taillabel=\"{port}\"];");
            }
        }
        out.push_str("}\n");
        out
    }
}
