//! A figure of every method over the values of a swept key.

use plotters::style::Color;
use sumprod_positioning::metrics::{MethodMetrics, Report};

use super::curves::Plot;
use super::over_time::{Curve, TWO_SIDED, layers, positive_scale};
use super::scale::Scale;
use super::style::{self, Key, Pen};
use super::{DrawError, page};

const SIZE: (u32, u32) = (860, 480);

/// A figure of a method and its standard error.
type Figure = fn(&MethodMetrics) -> Option<(f64, Option<f64>)>;

/// What is drawn: the first of these that any method has.
const FIGURES: &[(&str, Figure)] = &[
    ("position RMSE [m]", |method| {
        method.summary.position_rmse_m.as_ref().map(|statistic| (statistic.mean, statistic.se))
    }),
    ("RMSE [m]", |method| method.summary.rmse_m.as_ref().map(|statistic| (statistic.mean, statistic.se))),
    ("share of correct pairs", |method| Some((method.diagnostic("association.correct")?, None))),
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
    let entries: Vec<_> = curves.iter().map(|(id, _, pen)| (Key::Line(*pen), id.clone())).collect();
    let runs = if first.runs == 1 { "1 run".to_owned() } else { format!("{} runs", first.runs) };
    let svg = page(SIZE, |area| {
        let title = format!("{}: {name} by {key}", first.scenario);
        let subtitle = format!("{runs} at each of {} values; shaded: 95 % interval", points.len());
        let body = style::heading(area, &title, &subtitle)?;
        let (plot, side) = body.split_horizontally(SIZE.0 - style::legend_width(&entries));
        let mut plot = Plot::new(&plot, Scale::exact(low, high), y, (key, name))?;
        for (low, high, pen) in &regions {
            plot.region(low, high, pen.colour.mix(0.13).filled())?;
        }
        for (_, curve, pen) in layers(&curves) {
            plot.line(curve, *pen)?;
        }
        style::legend(&side, &entries)
    })?;
    Ok(Some(svg))
}
