//! Three stations classify one aircraft and tell each other what they believe. Their messages are repeated, late and
//! overtaken, and nothing is counted twice; without removal the common prior counts most often, and all are certain of the
//! class that the evidence speaks against. Then figures 4 and 5 of the redundant-information paper (Wang, Peng, Zhu 2018),
//! and the information graph of a ring, as SVG.

use sumprod::fusion::{Direction, FusionNode, InformationSet, Item, Known, Rule};
use sumprod::positioning::campaign::Campaign;
use sumprod::positioning::fusion::Fusion;
use sumprod::positioning::metrics::Report;
use sumprod::prelude::*;

const STAR: &str = r#"{"world": {"structure": "star", "sensors": 6, "steps": 100, "first_scored": 1, "interval": 0.015,
    "process_noise": 0.140625, "measurement_variance": 900, "start": [15, -10], "start_variance": 10,
    "exchange_interval": 1}, "method": {"centralised": {"rule": "centralised"},
    "removal-feedback": {"rule": "removal", "exchange": "collect-and-distribute"},
    "naive-feedback": {"rule": "naive", "exchange": "collect-and-distribute"}}}"#;
const RING: &str = r#"{"world": {"structure": "ring", "sensors": 6, "steps": 5, "first_scored": 1, "interval": 0.015,
    "process_noise": 0.140625, "measurement_variance": 900, "start": [15, -10], "start_variance": 10,
    "exchange_interval": 1}, "method": {"auto": {"rule": "automatic", "exchange": "neighbours", "links": "all"}}}"#;

type Curve<'a> = (&'a str, &'a str, Vec<[f64; 2]>);

/// Curves (name, colour, points) in a box of 600 by 400.
fn draw(file: &str, curves: &[Curve<'_>]) -> std::io::Result<()> {
    let largest = |axis: usize| curves.iter().flat_map(|c| &c.2).map(|p| p[axis]).fold(0.0, f64::max);
    let (width, height) = (largest(0), largest(1));
    let mut svg = String::from("<svg xmlns='http://www.w3.org/2000/svg' viewBox='-10 -10 780 420'>\n");
    for (k, (name, colour, points)) in curves.iter().enumerate() {
        let path: String = points
            .iter()
            .map(|p| format!("{:.1},{:.1} ", 600.0 * p[0] / width, 400.0 * (1.0 - p[1] / height)))
            .collect();
        svg += &format!("<polyline points='{path}' fill='none' stroke='{colour}'/>\n");
        svg += &format!("<text x='610' y='{}' fill='{colour}'>{name}</text>\n", 20 * (k + 1));
    }
    println!("{}", std::env::temp_dir().join(file).display());
    std::fs::write(std::env::temp_dir().join(file), svg + "</svg>\n")
}

/// What the middle one of three stations believes at the end, on the path a - b - c.
fn classified(rule: Rule) -> Result<Vec<f64>, Box<dyn std::error::Error>> {
    let prior = Categorical::from_probabilities(&[0.6, 0.3, 0.1])?;
    let known = Known::new(InformationSet::prior(), prior);
    let links = [(0, 1), (1, 2)];
    let mut nodes = ["a", "b", "c"].map(|name| FusionNode::new(name, Space::Finite(3), known.clone(), rule));
    for (a, b) in links {
        nodes[a].connect(b, Direction::Both, known.clone());
        nodes[b].connect(a, Direction::Both, known.clone());
    }
    let evidence = [[0.3, 0.5, 0.2], [0.3, 0.4, 0.3], [0.2, 0.5, 0.3]];
    for (source, (node, likelihood)) in nodes.iter_mut().zip(&evidence).enumerate() {
        node.observe(Item::new(source as u32, 0), &Categorical::from_probabilities(likelihood)?)?;
    }
    let mut sent = Vec::new();
    for _ in 0..3 {
        for (a, b) in links {
            for (from, to) in [(a, b), (b, a)] {
                sent.push(nodes[from].send(from, to)?);
            }
        }
        // The newest first, and every one twice.
        for message in sent.iter().rev().flat_map(|message| [message, message]) {
            nodes[message.to].receive(message, |belief, _| Ok(belief.clone()))?;
        }
    }
    Ok(nodes[1].belief().probabilities())
}

fn simulate(text: &str, runs: u32) -> Result<Report, Box<dyn std::error::Error>> {
    use sumprod::positioning::scenario::Scenario;
    let scenario: Fusion = serde_json::from_str(text)?;
    let structure = scenario.prepare(1, None)?;
    let results = Campaign::new(&scenario, &structure, 1, runs, &[])?.run(None, &|_, _| {})?;
    for file in results.iter().flat_map(|run| &run.files) {
        println!("{}", std::env::temp_dir().join(&file.name).display());
        std::fs::write(std::env::temp_dir().join(&file.name), &file.contents)?;
    }
    Ok(Report::new("fusion", 1, &results)?)
}

/// Prints the class probabilities, draws the figures and says where the files are.
pub fn main() -> Result<(), Box<dyn std::error::Error>> {
    let product: Vec<f64> = (0..3)
        .map(|k| [0.6, 0.3, 0.1][k] * [0.3, 0.5, 0.2][k] * [0.3, 0.4, 0.3][k] * [0.2, 0.5, 0.3][k])
        .collect();
    let exact: Vec<f64> = product.iter().map(|value| value / product.iter().sum::<f64>()).collect();
    let (removal, naive) = (classified(Rule::Removal)?, classified(Rule::Naive)?);
    println!("exact   {exact:.3?}\nremoval {removal:.3?}\nnaive   {naive:.3?}");
    if removal.iter().zip(&exact).any(|(a, b)| (a - b).abs() > 1e-12) || naive[0] < 0.99 {
        return Err("removal should be exact, and naive fusion certain of the wrong class".into());
    }

    let star = simulate(STAR, 20)?;
    let colours = ["#333", "#0072b2", "#d55e00"];
    let mut curves = [Vec::new(), Vec::new()];
    for ((id, method), colour) in star.methods.iter().zip(colours) {
        let by_step = method.by_step.as_ref().ok_or("nothing was scored by step")?;
        let times = &by_step.time_s;
        let rmse = by_step.summary.position_rmse_m.as_ref().ok_or("no error by step")?;
        let trace = by_step.diagnostics.get("claimed_trace").ok_or("no trace by step")?;
        for (curves, values) in curves.iter_mut().zip([&rmse.mean, trace]) {
            curves.push((id.as_str(), colour, times.iter().zip(values).map(|(t, v)| [*t, *v]).collect()));
        }
    }
    draw("figure-4-error.svg", &curves[0])?;
    draw("figure-5-claimed-trace.svg", &curves[1])?;

    let ring = simulate(RING, 1)?;
    let notes = &ring.method("auto").ok_or("the method was run")?.notes;
    notes.iter().for_each(|note| println!("{note}"));
    notes
        .iter()
        .any(|note| note.contains("noticed a loop"))
        .then_some(())
        .ok_or("the loop was not noticed".into())
}
