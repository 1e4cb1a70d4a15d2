//! Share of position errors below each length.

use sumprod_positioning::metrics::Report;
use sumprod_positioning::results::{MethodRun, RunResult};

use super::curves::Plot;
use super::scale::Scale;
use super::style::{self, Key, Pen};
use super::{DrawError, page};

const SIZE: (u32, u32) = (860, 520);
/// Points of a curve: one for each quarter percent.
const LEVELS: usize = 400;

/// One curve a method, or nothing if no method has positions.
pub fn draw(report: &Report, runs: &[RunResult]) -> Result<Option<String>, DrawError> {
    let curves: Vec<(String, Vec<(f64, f64)>)> =
        report.methods.iter().map(|(id, _)| (id.clone(), curve(&mut errors(id, runs)))).collect();
    let reach = |level: f64| {
        let place = (level * LEVELS as f64) as usize;
        curves.iter().filter_map(move |(_, curve)| curve.get(place).map(|point| point.0))
    };
    let high = reach(0.98).fold(0.0, f64::max);
    let medians: Vec<f64> = reach(0.5).collect();
    if medians.is_empty() || high <= 0.0 {
        return Ok(None);
    }
    let best = medians.iter().copied().fold(f64::INFINITY, f64::min);
    // Methods of one quality compare best from zero; one that is far worse would squeeze the others flat.
    let x = match high / best.max(f64::MIN_POSITIVE) {
        ..12.0 => Scale::linear(0.0, high),
        _ => Scale::logarithmic(reach(0.05).fold(high, f64::min).max(1e-3 * high), high),
    };
    let entries: Vec<(Key, String)> = report
        .methods
        .iter()
        .enumerate()
        .map(|(i, (id, _))| (Key::Line(Pen::layered(i, curves.len())), id.clone()))
        .collect();
    let svg = page(SIZE, |area| {
        let runs = if report.runs == 1 { "1 run".to_owned() } else { format!("{} runs", report.runs) };
        let subtitle = format!("Share of position errors below a length; {runs}, all nodes and steps pooled");
        let body = style::heading(area, &format!("{}: error distribution", report.scenario), &subtitle)?;
        let (plot, side) = body.split_horizontally(SIZE.0 - style::legend_width(&entries));
        let mut plot = Plot::new(&plot, x, Scale::shares(), ("position error [m]", "share of errors"))?;
        let mut layers: Vec<_> =
            curves.iter().enumerate().map(|(i, c)| (Pen::layered(i, curves.len()), c)).collect();
        layers.sort_by_key(|(pen, _)| pen.drawing_order());
        for (pen, (_, curve)) in layers {
            plot.line(curve, pen)?;
        }
        style::legend(&side, &entries)
    })?;
    Ok(Some(svg))
}

fn errors(id: &str, runs: &[RunResult]) -> Vec<f64> {
    let of_method = |method: &MethodRun| -> Vec<f64> {
        let layout = &method.layout;
        let length = |errors: &[usize], error_at: &dyn Fn(usize) -> f64| {
            errors.iter().map(|&i| error_at(i).powi(2)).sum::<f64>().sqrt()
        };
        if layout.position.is_empty() {
            return Vec::new();
        }
        method.estimates().map(|e| length(&layout.position, &|i| e.error_at(i, layout))).collect()
    };
    runs.iter().flat_map(|run| &run.methods).filter(|method| method.id == id).flat_map(of_method).collect()
}

fn curve(errors: &mut [f64]) -> Vec<(f64, f64)> {
    if errors.is_empty() {
        return Vec::new();
    }
    errors.sort_by(f64::total_cmp);
    (0..=LEVELS)
        .map(|level| {
            let share = level as f64 / LEVELS as f64;
            (errors[(share * (errors.len() - 1) as f64).round() as usize], share)
        })
        .collect()
}
