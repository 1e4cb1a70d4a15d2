//! Figures 5 to 7 of the P-MPA paper (Fan, Wang, Zhou 2018) as SVG. The order of its four methods holds; filters
//! that see the same data as P-MPA (`kf-all`, `pf-all`) are as good, so the gain is the data's.

use sumprod::positioning::campaign::Campaign;
use sumprod::positioning::metrics::Report;
use sumprod::positioning::pmpa::PMpa;
use sumprod::positioning::results::{MethodRun, RunResult};

const METHODS: &str = r#"{"kf": {}, "kf-all": {"neighbours": true},
    "pf": {"proposal": "prediction", "form": {"prediction": {"particles": 1000}, "self": {"particles": 1000}}},
    "pf-all": {"neighbours": true, "proposal": "prediction", "form": {"prediction": {"particles": 1000},
        "self": {"particles": 1000}, "relative": {"particles": 1000}}},
    "pa-mpa": {"state": "frozen-velocity", "neighbours": true},
    "p-mpa": {"neighbours": true, "proposal": "optimal", "form": {"prediction": {"particles": 1000}}}}"#;

type Curve<'a> = (&'a str, Vec<[f64; 2]>);

/// Curves in a box of 600 by 400, with their names in their colours.
fn draw(file: &str, curves: &[Curve<'_>]) -> std::io::Result<()> {
    let scale = |axis: usize, size: f64| {
        let values = || curves.iter().flat_map(|(_, points)| points).map(|point| point[axis]);
        let (low, high) = (values().fold(f64::MAX, f64::min), values().fold(f64::MIN, f64::max));
        move |value: f64| size * (value - low) / (high - low)
    };
    let (x, y) = (scale(0, 600.0), scale(1, 400.0));
    let mut svg = String::from("<svg xmlns='http://www.w3.org/2000/svg' viewBox='-10 -10 720 420'>\n");
    let colours = ["#333", "#0072b2", "#d55e00", "#009e73"];
    for (k, ((name, points), colour)) in curves.iter().zip(colours).enumerate() {
        let path: String = points.iter().map(|p| format!("{:.1},{:.1} ", x(p[0]), 400.0 - y(p[1]))).collect();
        svg += &format!("<polyline points='{path}' fill='none' stroke='{colour}' stroke-width='1'/>\n");
        svg += &format!("<text x='620' y='{}' fill='{colour}'>{name}</text>\n", 20 * (k + 1));
    }
    println!("{}", std::env::temp_dir().join(file).display());
    std::fs::write(std::env::temp_dir().join(file), svg + "</svg>\n")
}

/// Twenty runs in the paper's world with this process variance (m²/s⁴).
fn simulate(variance: f64) -> Result<Vec<RunResult>, Box<dyn std::error::Error>> {
    let world = format!(r#"{{"steps": 60, "process_variance": {variance}}}"#);
    let scenario: PMpa = serde_json::from_str(&format!(r#"{{"world": {world}, "method": {METHODS}}}"#))?;
    Ok(Campaign::new(&scenario, &(), 1, 20, &[])?.run(None, &|_, _| {})?)
}

/// Draws the figures and prints the errors of all methods in the world of figures 6 and 7.
pub fn main() -> Result<(), Box<dyn std::error::Error>> {
    let (calm, rough) = (simulate(4.0)?, simulate(10.0)?);
    let at = |state: &[f64], of: &MethodRun| [0, 1].map(|axis| state[of.layout.position[axis]]);
    let figures =
        [("figure-5.svg", &calm[0], ["kf", "pa-mpa"]), ("figure-6.svg", &rough[0], ["pf", "p-mpa"])];
    for (file, run, ids) in figures {
        let mut curves: Vec<Curve<'_>> = Vec::new();
        for of in run.methods.iter().filter(|method| ids.contains(&&*method.id)) {
            curves.push(("truth", of.estimates().map(|e| at(e.truth, of)).collect()));
            curves.push((&of.id, of.estimates().map(|e| at(e.mean, of)).collect()));
        }
        curves.remove(2);
        draw(file, &curves)?;
    }
    let mut curves: Vec<Curve<'_>> = Vec::new();
    for id in ["kf", "pf", "pa-mpa", "p-mpa"] {
        let mut errors = Vec::new();
        for of in rough.iter().flat_map(|run| &run.methods).filter(|method| method.id == id) {
            let offsets =
                of.estimates().map(|e| [0, 1].map(|k| e.error_at(of.layout.position[k], &of.layout)));
            errors.extend(offsets.map(|[x, y]| x.hypot(y).min(60.0)));
        }
        errors.sort_by(f64::total_cmp);
        curves.push((
            id,
            errors.iter().enumerate().map(|(k, &e)| [e, k as f64 / errors.len() as f64]).collect(),
        ));
    }
    draw("figure-7.svg", &curves)?;
    let report = Report::new("p-mpa", 1, &rough)?;
    let rmse = |id: &str| Some(report.method(id)?.summary.position_rmse_m.as_ref()?.mean);
    report.methods.iter().for_each(|(id, _)| println!("{id:7} {:6.2} m", rmse(id).unwrap_or(f64::NAN)));
    let order = ["p-mpa", "kf", "pf", "pa-mpa"].map(rmse);
    order.is_sorted().then_some(()).ok_or("the order of the methods is another".into())
}
