//! Figures 2 to 6 of the knowledge-board paper (Wang, Wang, Zou, Qian 2014) as SVG. The picture comes back, and what it
//! is taken for does not: the paper's wide interval covers less than it says, and the exact one is narrower.

use sumprod::positioning::campaign::Campaign;
use sumprod::positioning::kcpf::{growth::Growth, turn::Turn};
use sumprod::positioning::metrics::Report;
use sumprod::positioning::results::{Estimate, MethodRun, RunResult};
use sumprod::positioning::scenario::Scenario;

const METHODS: &str = r#"{"ekf": {"algorithm": "extended-kalman"},
    "kcpf-literal": {"algorithm": "knowledge-board", "board": {"form": "literal", "iterations": 8, "enough": 0.5}},
    "kcpf": {"algorithm": "knowledge-board"}}"#;
const GROWTH: &str = r#""world": {"steps": 50}"#;
const TURN: &str = r#""world": {"steps": 180, "speed": 300, "turn_first": 67, "turn_last": 85, "turn_acceleration": 50},
    "sensor": {"range_variance": 2500, "bearing_variance": 1e-4},
    "model": {"acceleration_variance": 4, "turn_rate_variance": 9e-4, "start_variances": [40000, 900, 4e-4]}"#;

type Curve<'a> = (&'a str, &'a str, Vec<[f64; 2]>);

/// Curves (name, colour, points) in a box of 600 by 400.
fn draw(file: &str, curves: &[Curve<'_>]) -> std::io::Result<()> {
    let scale = |axis: usize, size: f64| {
        let values = || curves.iter().flat_map(|(.., points)| points).map(|point| point[axis]);
        let (low, high) = (values().fold(f64::MAX, f64::min), values().fold(f64::MIN, f64::max));
        move |value: f64| size * (value - low) / (high - low)
    };
    let (x, y) = (scale(0, 600.0), scale(1, 400.0));
    let mut svg = String::from("<svg xmlns='http://www.w3.org/2000/svg' viewBox='-10 -10 740 420'>\n");
    for (k, (name, colour, points)) in curves.iter().enumerate() {
        let path: String = points.iter().map(|p| format!("{:.1},{:.1} ", x(p[0]), 400.0 - y(p[1]))).collect();
        svg += &format!("<polyline points='{path}' fill='none' stroke='{colour}'/>\n");
        svg += &format!("<text x='620' y='{}' fill='{colour}'>{name}</text>\n", 20 * (k + 1));
    }
    println!("{}", std::env::temp_dir().join(file).display());
    std::fs::write(std::env::temp_dir().join(file), svg + "</svg>\n")
}

fn simulate<S: Scenario<Prepared = ()>>(
    world: &str,
    runs: u32,
) -> Result<Vec<RunResult>, Box<dyn std::error::Error>> {
    let scenario: S = serde_json::from_str(&format!(r#"{{{world}, "method": {METHODS}}}"#))?;
    Ok(Campaign::new(&scenario, &(), 1, runs, &[])?.run(None, &|_, _| {})?)
}

/// Draws the figures; prints coverage and width of the growth model's intervals.
pub fn main() -> Result<(), Box<dyn std::error::Error>> {
    let (growth, turn) = (simulate::<Growth>(GROWTH, 10)?, simulate::<Turn>(TURN, 1)?);
    let curve = |of: &MethodRun, point: fn(Estimate<'_>) -> [f64; 2]| of.estimates().map(point).collect();
    for (file, of) in ["figure-2-ekf.svg", "figure-3-kcpf-literal.svg", "figure-3-kcpf.svg"]
        .into_iter()
        .zip(&growth[0].methods)
    {
        let truth = ("truth", "#d55e00", curve(of, |e| [e.time, e.truth[0]]));
        let low = ("2.5 %", "#0072b2", curve(of, |e| [e.time, e.intervals[0][0]]));
        draw(file, &[truth, low, ("97.5 %", "#0072b2", curve(of, |e| [e.time, e.intervals[0][1]]))])?;
    }
    let [ekf, .., valid] = &turn[0].methods[..] else { return Err("three methods were asked for".into()) };
    let track = |of| curve(of, |e| [e.mean[0], e.mean[2]]);
    let truth = ("truth", "#333", curve(ekf, |e| [e.truth[0], e.truth[2]]));
    draw("figure-4.svg", &[truth, ("ekf", "#d55e00", track(ekf)), ("kcpf", "#0072b2", track(valid))])?;
    for (file, of) in [("figure-5.svg", valid), ("figure-6.svg", ekf)] {
        let x = ("error of x", "#0072b2", curve(of, |e| [e.time, e.mean[0] - e.truth[0]]));
        draw(file, &[x, ("error of y", "#d55e00", curve(of, |e| [e.time, e.mean[2] - e.truth[2]]))])?;
    }
    let report = Report::new("growth", 1, &growth)?;
    let interval = |id: &str| report.method(id).map(|m| (m.summary.coverage95, m.summary.width95));
    report.methods.iter().for_each(|(id, _)| println!("{id:12} {:?}", interval(id)));
    let covered = |id: &str| interval(id).and_then(|(coverage, _)| coverage);
    let order = ["ekf", "kcpf-literal", "kcpf"].map(covered);
    order.is_sorted().then_some(()).ok_or("the order of the coverages is another".into())
}
