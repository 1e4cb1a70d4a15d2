//! A figure of every method over the values of a swept key.

use sumprod_positioning::metrics::{MethodMetrics, Report};

use super::DrawError;
use super::over_time::{Axes, Curve, TWO_SIDED, positive_scale, shaded_curves};
use super::scale::Scale;
use super::style::Pen;

/// A figure of a method and its standard error.
type Figure = fn(&MethodMetrics) -> Option<(f64, Option<f64>)>;

/// What is drawn: the first of these that any method has.
const FIGURES: &[(&str, Figure)] = &[
    ("position RMSE [m]", |method| {
        method.summary.position_rmse_m.as_ref().map(|statistic| (statistic.mean, statistic.se))
    }),
    ("RMSE [m]", |method| method.summary.rmse_m.as_ref().map(|statistic| (statistic.mean, statistic.se))),
    ("share of correct pairs", |method| {
        Some((method.diagnostic("association.correct")?, method.standard_error("association.correct")))
    }),
];

/// The first of the figures over the key's values, with its 95 % interval over the runs.
pub fn draw(key: &str, points: &[(f64, &Report)]) -> Result<Option<String>, DrawError> {
    let Some((_, first)) = points.first().filter(|_| points.len() > 1) else { return Ok(None) };
    let has = |figure: &Figure| first.methods.iter().any(|(_, metrics)| figure(metrics).is_some());
    let Some(&(name, figure)) = FIGURES.iter().find(|(_, figure)| has(figure)) else { return Ok(None) };

    let mut curves: Vec<(String, Curve, Pen)> = Vec::new();
    let mut regions: Vec<(Curve, Curve, Pen)> = Vec::new();
    for (i, (id, _)) in first.methods.iter().enumerate() {
        let of_method = |report: &Report| {
            report.methods.iter().find(|(other, _)| other == id).and_then(|(_, metrics)| figure(metrics))
        };
        let found: Vec<_> =
            points.iter().filter_map(|&(x, report)| of_method(report).map(|found| (x, found))).collect();
        let shifted = |side: f64| -> Curve {
            let half = |se: Option<f64>| side * TWO_SIDED * se.unwrap_or(0.0);
            found.iter().map(|&(x, (mean, se))| (x, (mean + half(se)).max(0.0))).collect()
        };
        regions.push((shifted(-1.0), shifted(1.0), Pen::of_method(i)));
        curves.push((id.clone(), shifted(0.0), Pen::layered(i, first.methods.len())));
    }
    let (Some(&(low, _)), Some(&(high, _))) = (points.first(), points.last()) else { return Ok(None) };
    let y = positive_scale(curves.iter().flat_map(|(_, curve, _)| curve));
    let runs = if first.runs == 1 { "1 run".to_owned() } else { format!("{} runs", first.runs) };
    let title = format!("{}: {name} by {key}", first.scenario);
    let subtitle = format!("{runs} at each of {} values; shaded: 95 % interval", points.len());
    let axes = Axes { x: Scale::exact(low, high), y, names: (key, name) };
    shaded_curves(&title, &subtitle, axes, &regions, &curves).map(Some)
}
