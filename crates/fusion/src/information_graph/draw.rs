//! The drawing: time to the right, one lane a node, redundant paths marked.

use std::collections::BTreeMap;
use std::fmt::Write;

use petgraph::visit::EdgeRef;

use super::{EventKind, InformationGraph, Link};

/// Between events (px).
const COLUMN: f64 = 46.0;
/// Between lanes (px).
const LANE: f64 = 64.0;
/// Left of the first event, for names (px).
const MARGIN: f64 = 120.0;
/// Below the lanes, for the legend (px).
const LEGEND: f64 = 56.0;

const PLAIN: &str = "#333333";
const MEMORY: &str = "#bbbbbb";
const REMOVED: &str = "#0072b2";
const LOOPED: &str = "#d55e00";

impl InformationGraph {
    /// The graph as SVG: circles are states, squares observations; communications that bring nothing twice are
    /// thin, redundant ones thick, in blue where the receiver can divide out what it holds and in orange and dashed
    /// where it cannot.
    pub fn svg(&self) -> String {
        let places = self.places();
        let width = MARGIN + COLUMN * (places.iter().map(|place| place.0).fold(0.0, f64::max) + 1.0);
        let height = LANE * self.names.len() as f64 + LEGEND;
        let at = |event: usize| {
            let (column, lane) = places[event];
            (MARGIN + COLUMN * column, LANE * (lane + 0.6))
        };
        let mut out = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width:.0} {height:.0}\" \
             font-family=\"sans-serif\" font-size=\"12\">\n<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n"
        );
        // Writing to a string cannot fail.
        for (lane, name) in self.names.iter().enumerate() {
            let y = LANE * (lane as f64 + 0.6) + 4.0;
            let _ = writeln!(out, "<text x=\"8\" y=\"{y:.1}\">{}</text>", escaped(name));
        }
        let marks: BTreeMap<(usize, usize), bool> =
            self.redundancies().into_iter().map(|r| ((r.from.0, r.to.0), r.removable)).collect();
        for edge in self.graph.edge_references() {
            let ends = (edge.source().index(), edge.target().index());
            let ((x1, y1), (x2, y2)) = (at(ends.0), at(ends.1));
            let (colour, stroke) = match (edge.weight(), marks.get(&ends)) {
                (Link::Memory | Link::Observation, _) => (MEMORY, "1"),
                (Link::Communication, None) => (PLAIN, "1"),
                (Link::Communication, Some(true)) => (REMOVED, "2.5"),
                (Link::Communication, Some(false)) => (LOOPED, "2.5\" stroke-dasharray=\"6 3"),
            };
            let _ = writeln!(
                out,
                "<line x1=\"{x1:.1}\" y1=\"{y1:.1}\" x2=\"{x2:.1}\" y2=\"{y2:.1}\" stroke=\"{colour}\" \
                 stroke-width=\"{stroke}\"/>"
            );
            if *edge.weight() == Link::Communication {
                out += &arrow((x1, y1), (x2, y2), colour);
            }
        }
        for (event, content) in self.events() {
            let (x, y) = at(event.0);
            let held = escaped(&format!("{}: {}", self.names[content.node], content.information));
            let shape = match content.kind {
                EventKind::State => format!("<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"5\" fill=\"{PLAIN}\">"),
                EventKind::Observation(_) => {
                    let (left, top) = (x - 4.0, y - 4.0);
                    format!(
                        "<rect x=\"{left:.1}\" y=\"{top:.1}\" width=\"8\" height=\"8\" fill=\"white\" stroke=\"{PLAIN}\">"
                    )
                }
            };
            let tag = if matches!(content.kind, EventKind::State) { "circle" } else { "rect" };
            let _ = writeln!(out, "{shape}<title>{held}</title></{tag}>");
        }
        out += &legend(height - LEGEND + 24.0);
        out.push_str("</svg>\n");
        out
    }

    /// Column and lane of every event: states of one time share columns, in the order in which they came about.
    fn places(&self) -> Vec<(f64, f64)> {
        let mut depths: Vec<f64> = Vec::with_capacity(self.len());
        for index in self.graph.node_indices() {
            let parents = self.graph.neighbors_directed(index, petgraph::Direction::Incoming);
            let after = parents
                .filter(|parent| self.graph[*parent].kind == EventKind::State)
                .map(|parent| depths[parent.index()] + 1.0);
            depths.push(after.fold(0.0, f64::max));
        }
        let observed = self.graph.edge_references().filter(|edge| *edge.weight() == Link::Observation);
        let state_of: BTreeMap<usize, usize> =
            observed.map(|edge| (edge.source().index(), edge.target().index())).collect();
        self.events()
            .map(|(event, content)| {
                let lane = content.node as f64;
                // An observation hangs above the state that it enters.
                state_of
                    .get(&event.0)
                    .map_or((depths[event.0], lane), |state| (depths[*state] - 0.3, lane - 0.33))
            })
            .collect()
    }
}

fn arrow(from: (f64, f64), to: (f64, f64), colour: &str) -> String {
    let (dx, dy) = (to.0 - from.0, to.1 - from.1);
    let length = dx.hypot(dy).max(1.0);
    let (ux, uy) = (dx / length, dy / length);
    let tip = (to.0 - 6.0 * ux, to.1 - 6.0 * uy);
    let base = (tip.0 - 8.0 * ux, tip.1 - 8.0 * uy);
    let corner = |side: f64| (base.0 - side * uy, base.1 + side * ux);
    let ((ax, ay), (bx, by)) = (corner(3.5), corner(-3.5));
    format!(
        "<polygon points=\"{:.1},{:.1} {ax:.1},{ay:.1} {bx:.1},{by:.1}\" fill=\"{colour}\"/>\n",
        tip.0, tip.1
    )
}

fn legend(y: f64) -> String {
    let entries = [
        (PLAIN, "1", "brings nothing twice"),
        (REMOVED, "2.5", "redundant, divided out"),
        (LOOPED, "2.5\" stroke-dasharray=\"6 3", "redundant, came by a loop"),
    ];
    let mut out = String::new();
    for (k, (colour, stroke, words)) in entries.iter().enumerate() {
        let (x, row) = (8.0, y + 14.0 * (k as f64 - 1.0));
        let (end, text, base) = (x + 28.0, x + 36.0, row + 4.0);
        let _ = writeln!(
            out,
            "<line x1=\"{x}\" y1=\"{row}\" x2=\"{end}\" y2=\"{row}\" stroke=\"{colour}\" stroke-width=\"{stroke}\"/>\
             <text x=\"{text}\" y=\"{base}\">{words}</text>"
        );
    }
    out
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
