//! Figure 8 of the underwater paper (Gao, Wang, Chen, Shen 2022) as SVG: the position error of each method by sample. The
//! order of its four methods holds; a round trip whose motion is modelled beats them all.

use sumprod::positioning::campaign::Campaign;
use sumprod::positioning::metrics::Report;
use sumprod::positioning::underwater::Underwater;

const SCENARIO: &str = r#"{"world": {"motion_in_flight": true}, "method": {
    "two-way": {"algorithm": "two-way"}, "one-way": {"algorithm": "one-way"}, "jsl": {"algorithm": "jsl"},
    "two-step": {"algorithm": "two-step"}, "direct": {"algorithm": "direct"}}}"#;
const COLOURS: [&str; 5] = ["#009e73", "#0072b2", "#333", "#d55e00", "#cc79a7"];

/// Curves over the samples in a box of 600 by 400, errors from 1 to 100 m by their logarithm.
fn draw(file: &str, curves: &[(&str, &[f64])]) -> std::io::Result<()> {
    let mut svg = String::from("<svg xmlns='http://www.w3.org/2000/svg' viewBox='-10 -10 720 420'>\n");
    for (k, ((name, errors), colour)) in curves.iter().zip(COLOURS).enumerate() {
        let place = |(step, error): (usize, &f64)| {
            let (x, y) = (600.0 * step as f64 / errors.len() as f64, 400.0 - 200.0 * error.log10());
            format!("{x:.1},{y:.1} ")
        };
        let path: String = errors.iter().enumerate().map(place).collect();
        svg += &format!("<polyline points='{path}' fill='none' stroke='{colour}'/>\n");
        svg += &format!("<text x='620' y='{}' fill='{colour}'>{name}</text>\n", 20 * (k + 1));
    }
    println!("{}", std::env::temp_dir().join(file).display());
    std::fs::write(std::env::temp_dir().join(file), svg + "</svg>\n")
}

/// Draws the figure; prints the error of the last ten samples, and how a node's clock is known at the end.
pub fn main() -> Result<(), Box<dyn std::error::Error>> {
    let scenario: Underwater = serde_json::from_str(SCENARIO)?;
    let runs = Campaign::new(&scenario, &(), 1, 5, &[])?.run(None, &|_, _| {})?;
    let report = Report::new("underwater", 1, &runs)?;
    let mut curves = Vec::new();
    let mut last = Vec::new();
    for (id, metrics) in &report.methods {
        let error = metrics.final_rmse_m.as_ref().map_or(f64::NAN, |error| error.mean);
        println!("{id:9} {error:6.2} m");
        last.push(error);
        if let Some(errors) =
            metrics.by_step.as_ref().and_then(|steps| steps.summary.position_rmse_m.as_ref())
        {
            curves.push((id.as_str(), errors.mean.as_slice()));
        }
    }
    draw("figure-8.svg", &curves)?;
    let steps = report.method("one-way").and_then(|metrics| metrics.by_step.as_ref());
    let skew = steps.and_then(|steps| steps.summary.clock_skew_rmse_ppm.as_ref()?.mean.last().copied());
    println!("clock skew known to {:.1} of 400 ppm", skew.unwrap_or(f64::NAN));
    last.is_sorted().then_some(()).ok_or("the order of the methods is another".into())
}
