//! Error and consistency over time.

use plotters::style::Color;
use sumprod_positioning::metrics::{ByStep, Report, chi_square};

use super::curves::Plot;
use super::scale::Scale;
use super::style::{self, BAND, Key, Pen};
use super::{DrawError, page};

const SIZE: (u32, u32) = (860, 480);
/// Normal quantile of a two-sided 95 % interval.
pub(super) const TWO_SIDED: f64 = 1.96;
/// NEES per degree of freedom outside these limits is cut: what matters is that it is far out.
const NEES_LIMITS: (f64, f64) = (0.02, 200.0);

/// Points of a curve.
pub(super) type Curve = Vec<(f64, f64)>;

/// Position error over time with its 95 % interval, and the bound.
pub fn rmse(report: &Report) -> Result<Option<String>, DrawError> {
    let mut curves = Vec::new();
    let mut regions = Vec::new();
    for (i, (id, by_step)) in over_time(report) {
        let Some(statistic) = &by_step.summary.position_rmse_m else { continue };
        let curve = zipped(&by_step.time_s, &statistic.mean);
        if let Some(se) = &statistic.se {
            let shifted = |side: f64| -> Curve {
                curve
                    .iter()
                    .zip(se)
                    .map(|(&(t, mean), se)| (t, (mean + side * TWO_SIDED * se).max(0.0)))
                    .collect()
            };
            regions.push((shifted(-1.0), shifted(1.0), Pen::of_method(i)));
        }
        curves.push((id.to_owned(), curve, Pen::layered(i, report.methods.len())));
    }
    if curves.is_empty() {
        return Ok(None);
    }
    if let Some(bound) = report.bound.as_ref().filter(|bound| bound.by_step.time_s.len() > 1) {
        let curve = zipped(&bound.by_step.time_s, &bound.by_step.position_rmse_m.mean);
        curves.push(("bound (PCRB)".to_owned(), curve, Pen::reference()));
    }
    let shaded = regions.iter().flat_map(|(_, high, _)| high);
    let y = positive_scale(curves.iter().flat_map(|(_, curve, _)| curve).chain(shaded));
    let note = if regions.is_empty() { "" } else { "; shaded: 95 % interval over the runs" };
    let subtitle = format!("Root mean square over {}, nodes pooled{note}", runs(report));
    let title = format!("{}: position error over time", report.scenario);
    let axes = Axes { x: time_scale(&curves), y, names: ("time [s]", "position RMSE [m]") };
    shaded_curves(&title, &subtitle, axes, &regions, &curves).map(Some)
}

/// The scales of a plot and their names.
pub(super) struct Axes<'a> {
    pub x: Scale,
    pub y: Scale,
    pub names: (&'a str, &'a str),
}

/// A page with curves above shaded regions, and their legend.
pub(super) fn shaded_curves(
    title: &str,
    subtitle: &str,
    axes: Axes<'_>,
    regions: &[(Curve, Curve, Pen)],
    curves: &[(String, Curve, Pen)],
) -> Result<String, DrawError> {
    let entries = curves.iter().map(|(label, _, pen)| (Key::Line(*pen), label.clone())).collect::<Vec<_>>();
    page(SIZE, |area| {
        let body = style::heading(area, title, subtitle)?;
        let (plot, side) = body.split_horizontally(SIZE.0 - style::legend_width(&entries));
        let mut plot = Plot::new(&plot, axes.x, axes.y, axes.names)?;
        for (low, high, pen) in regions {
            plot.region(low, high, pen.colour.mix(0.13).filled())?;
        }
        for (_, curve, pen) in layers(curves) {
            plot.line(curve, *pen)?;
        }
        style::legend(&side, &entries)
    })
}

/// Position NEES per degree of freedom over time, with the band that a consistent method keeps to.
pub fn nees(report: &Report) -> Result<Option<String>, DrawError> {
    let mut curves = Vec::new();
    let mut dof = 0;
    for (i, (id, by_step)) in over_time(report) {
        let Some(nees) = by_step.summary.nees.as_ref().and_then(|nees| nees.position.as_ref()) else {
            continue;
        };
        dof = nees.dof;
        let ratios: Vec<f64> = nees.mean.iter().map(|mean| mean / dof as f64).collect();
        let pen = Pen::layered(i, report.methods.len());
        curves.push((id.to_owned(), zipped(&by_step.time_s, &ratios), pen));
    }
    let Some([low, high]) = chi_square::mean_band95(dof, report.runs) else {
        return Ok(None);
    };
    let (low, high) = (low / dof as f64, high / dof as f64);
    let reached = curves.iter().flat_map(|(_, curve, _)| curve).map(|point| point.1);
    let (least, most) = reached.fold((low, high), |(least, most), value| (least.min(value), most.max(value)));
    let y = Scale::logarithmic(least.clamp(NEES_LIMITS.0, 0.5), most.clamp(2.0, NEES_LIMITS.1));
    let mut entries: Vec<(Key, String)> =
        curves.iter().map(|(label, _, pen)| (Key::Line(*pen), label.clone())).collect();
    entries.push((Key::Region(BAND), "95 % band".to_owned()));
    entries.push((Key::Line(Pen::reference()), "expected".to_owned()));
    let title = format!("{}: consistency over time", report.scenario);
    let subtitle = format!(
        "Position NEES per degree of freedom, mean over {}; above the band is over-confident",
        runs(report)
    );
    let svg = page(SIZE, |area| {
        let body = style::heading(area, &title, &subtitle)?;
        let (plot, side) = body.split_horizontally(SIZE.0 - style::legend_width(&entries));
        let x = time_scale(&curves);
        let ends = [x.range().start, x.range().end];
        let mut plot = Plot::new(&plot, x, y, ("time [s]", "NEES / degrees of freedom"))?;
        plot.region(&ends.map(|t| (t, low)), &ends.map(|t| (t, high)), BAND.mix(0.25).filled())?;
        plot.line(&ends.map(|t| (t, 1.0)), Pen::reference())?;
        for (_, curve, pen) in layers(&curves) {
            plot.line(curve, *pen)?;
        }
        style::legend(&side, &entries)
    })?;
    Ok(Some(svg))
}

/// The curves in the order of drawing.
fn layers(curves: &[(String, Curve, Pen)]) -> Vec<&(String, Curve, Pen)> {
    let mut layers: Vec<_> = curves.iter().collect();
    layers.sort_by_key(|(_, _, pen)| pen.drawing_order());
    layers
}

/// The methods that have figures over time, with their place.
fn over_time(report: &Report) -> impl Iterator<Item = (usize, (&str, &ByStep))> {
    report
        .methods
        .iter()
        .enumerate()
        .filter_map(|(i, (id, metrics))| metrics.by_step.as_ref().map(|by_step| (i, (id.as_str(), by_step))))
}

fn runs(report: &Report) -> String {
    if report.runs == 1 { "1 run".to_owned() } else { format!("{} runs", report.runs) }
}

fn zipped(times: &[f64], values: &[f64]) -> Curve {
    times.iter().copied().zip(values.iter().copied()).collect()
}

fn time_scale(curves: &[(String, Curve, Pen)]) -> Scale {
    let times = curves.iter().flat_map(|(_, curve, _)| curve).map(|point| point.0);
    let (first, last) = times.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), t| (a.min(t), b.max(t)));
    Scale::exact(first, last)
}

/// An axis that holds the positive ordinates.
pub(super) fn positive_scale<'a>(points: impl Iterator<Item = &'a (f64, f64)>) -> Scale {
    let positive = points.map(|point| point.1).filter(|&value| value > 0.0);
    let (low, high) = positive.fold((f64::INFINITY, 0.0_f64), |(a, b), value| (a.min(value), b.max(value)));
    if high > 0.0 { Scale::positive(low, high) } else { Scale::linear(0.0, 1.0) }
}
