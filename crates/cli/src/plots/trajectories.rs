//! One run's paths: a panel a method, all on the same map, with 95 % ellipses.

use std::collections::BTreeMap;
use std::f64::consts::TAU;

use plotters::element::Text;
use sumprod_positioning::metrics::{Report, chi_square};
use sumprod_positioning::results::{Estimate, MethodRun, RunResult};
use sumprod_positioning::scenario::Output;

use super::curves::{LABEL_SPACE, MARGIN, Plot};
use super::scale::Scale;
use super::style::{self, GREY, INK, Key, Pen};
use super::{Area, DrawError, page};
use crate::table::number;

/// Size (px) of a panel and of its title.
const PANEL: (u32, u32) = (420, 400);
const PANEL_TITLE: u32 = 26;
const HEADING: u32 = 58;
const LEGEND: u32 = 130;
/// Ellipses of one panel, whatever the number of nodes.
const MOST_ELLIPSES: usize = 240;
/// Share of the true paths' extent that is shown around them, for estimates that stray and anchors nearby.
const SURROUNDINGS: f64 = 0.12;

/// The map, or nothing if no method has positions in the plane.
pub fn draw(report: &Report, runs: &[RunResult], wanted: &Output) -> Result<Option<String>, DrawError> {
    let Some(run) = runs.iter().find(|run| run.run == wanted.plotted_run).or(runs.first()) else {
        return Ok(None);
    };
    let methods: Vec<(usize, &MethodRun)> = run
        .methods
        .iter()
        .enumerate()
        .filter(|(_, method)| method.layout.position.len() >= 2 && !method.is_empty())
        .collect();
    let Some(view) = View::around(&methods) else {
        return Ok(None);
    };
    let columns = match methods.len() {
        1 => 1,
        2 | 4 => 2,
        _ => 3,
    };
    let rows = methods.len().div_ceil(columns);
    let size = (columns as u32 * PANEL.0 + LEGEND, rows as u32 * PANEL.1 + HEADING);
    let title = format!("{}: paths of run {}", report.scenario, run.run);
    let svg = page(size, |area| {
        let shown = "Truth and estimates with 95 % ellipses, axes in metres";
        let body = style::heading(area, &title, shown)?;
        let (maps, side) = body.split_horizontally(size.0 - LEGEND);
        for (panel, (i, method)) in maps.split_evenly((rows, columns)).iter().zip(&methods) {
            draw_panel(panel, run, method, Pen::of_method(*i), &view, wanted.ellipses)?;
        }
        let mut entries = vec![(Key::Line(truth_pen()), "truth".to_owned())];
        if !run.anchors.is_empty() {
            entries.push((Key::Marker(GREY), "anchor".to_owned()));
        }
        style::legend(&side, &entries)
    })?;
    Ok(Some(svg))
}

fn truth_pen() -> Pen {
    Pen { colour: INK, width: 1, dash: None }
}

/// The part of the plane that is shown, metres alike along both axes.
struct View {
    x: (f64, f64),
    y: (f64, f64),
}

impl View {
    fn around(methods: &[(usize, &MethodRun)]) -> Option<Self> {
        let mut low = [f64::INFINITY; 2];
        let mut high = [f64::NEG_INFINITY; 2];
        for (_, method) in methods {
            let axes = [method.layout.position[0], method.layout.position[1]];
            for estimate in method.estimates() {
                for k in 0..2 {
                    low[k] = low[k].min(estimate.truth[axes[k]]);
                    high[k] = high[k].max(estimate.truth[axes[k]]);
                }
            }
        }
        if methods.is_empty() {
            return None;
        }
        let room = (
            f64::from(PANEL.0 - LABEL_SPACE.0 - 2 * MARGIN),
            f64::from(PANEL.1 - PANEL_TITLE - LABEL_SPACE.1 - MARGIN),
        );
        let extent = (high[0] - low[0]).max(high[1] - low[1]).max(1e-3);
        let needed = [0, 1].map(|k| high[k] - low[k] + 2.0 * SURROUNDINGS * extent);
        let metres_a_pixel = (needed[0] / room.0).max(needed[1] / room.1);
        let centred = |k: usize, pixels: f64| {
            let (centre, half) = (0.5 * (low[k] + high[k]), 0.5 * metres_a_pixel * pixels);
            (centre - half, centre + half)
        };
        Some(Self { x: centred(0, room.0), y: centred(1, room.1) })
    }
}

fn draw_panel(
    area: &Area<'_>,
    run: &RunResult,
    method: &MethodRun,
    pen: Pen,
    view: &View,
    ellipses: u32,
) -> Result<(), DrawError> {
    let axes = (method.layout.position[0], method.layout.position[1]);
    let (title, body) = area.split_vertically(PANEL_TITLE);
    let label = format!("{}, RMSE {} m", method.id, number(rmse(method, axes)));
    title.draw(&Text::new(
        label,
        ((LABEL_SPACE.0 + MARGIN) as i32, 14),
        style::text_from_left(15, pen.colour),
    ))?;
    let (x, y) = (Scale::exact(view.x.0, view.x.1), Scale::exact(view.y.0, view.y.1));
    let mut plot = Plot::new(&body, x, y, ("x [m]", "y [m]"))?;

    let anchors: Vec<(f64, f64)> = run
        .anchors
        .iter()
        .filter(|anchor| anchor.position.len() >= 2)
        .map(|anchor| (anchor.position[0], anchor.position[1]))
        .collect();
    plot.triangles(&anchors, GREY)?;

    let mut nodes: BTreeMap<u32, Vec<Estimate<'_>>> = BTreeMap::new();
    for estimate in method.estimates() {
        nodes.entry(estimate.node).or_default().push(estimate);
    }
    let each = (ellipses as usize).min(MOST_ELLIPSES / nodes.len().max(1)).max(usize::from(ellipses > 0));
    for path in nodes.values() {
        let truth: Vec<_> =
            path.iter().map(|estimate| (estimate.truth[axes.0], estimate.truth[axes.1])).collect();
        let mean: Vec<_> =
            path.iter().map(|estimate| (estimate.mean[axes.0], estimate.mean[axes.1])).collect();
        plot.line(&truth, truth_pen())?;
        plot.dots(&truth[..1], INK)?;
        plot.line(&mean, pen)?;
        let stride = path.len().div_ceil(each.max(1)).max(1);
        for estimate in path.iter().rev().step_by(stride).take(each) {
            plot.outline(&ellipse(estimate, axes), Pen { width: 1, ..pen })?;
        }
    }
    Ok(())
}

fn rmse(method: &MethodRun, axes: (usize, usize)) -> f64 {
    let squared = |estimate: Estimate<'_>| {
        estimate.error_at(axes.0, &method.layout).powi(2) + estimate.error_at(axes.1, &method.layout).powi(2)
    };
    (method.estimates().map(squared).sum::<f64>() / method.len().max(1) as f64).sqrt()
}

/// Points of the ellipse that holds the truth with probability 95 % if the estimate is Gaussian: mean + √χ² L u with
/// L a square root of the position covariance and u on the unit circle.
fn ellipse(estimate: &Estimate<'_>, axes: (usize, usize)) -> Vec<(f64, f64)> {
    let (a, b, c) = (
        estimate.covariance_at(axes.0, axes.0),
        estimate.covariance_at(axes.0, axes.1),
        estimate.covariance_at(axes.1, axes.1),
    );
    let l11 = a.max(0.0).sqrt();
    let l21 = if l11 > 0.0 { b / l11 } else { 0.0 };
    let l22 = (c - l21 * l21).max(0.0).sqrt();
    let radius = chi_square::quantile(0.95, 2.0).unwrap_or(0.0).sqrt();
    (0..=48)
        .map(|i| {
            let (sin, cos) = (TAU * f64::from(i) / 48.0).sin_cos();
            let (x, y) = (estimate.mean[axes.0], estimate.mean[axes.1]);
            (x + radius * l11 * cos, y + radius * (l21 * cos + l22 * sin))
        })
        .collect()
}
