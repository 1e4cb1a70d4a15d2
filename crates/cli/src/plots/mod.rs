//! The plots of a report, as SVG.

mod curves;
mod error_cdf;
mod over_time;
mod scale;
mod style;
mod sweep;
mod trajectories;

use std::fmt::Display;

use plotters::coord::Shift;
use plotters::prelude::*;
use sumprod_positioning::metrics::Report;
use sumprod_positioning::results::RunResult;
use sumprod_positioning::scenario::Output;

use crate::failure::Failure;

/// What plotters draws on.
type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// A drawing that failed inside plotters, which for SVG in memory means a bug.
#[derive(Debug)]
struct DrawError(String);

impl<E: Display> From<E> for DrawError {
    fn from(error: E) -> Self {
        Self(error.to_string())
    }
}

/// File names and contents of the plots; none for one that does not apply.
///
/// # Errors
/// A plot that cannot be drawn.
pub fn draw(
    report: &Report,
    runs: &[RunResult],
    wanted: &Output,
) -> Result<Vec<(&'static str, Option<String>)>, Failure> {
    let plots = [
        ("trajectories.svg", trajectories::draw(report, runs, wanted)),
        ("error_cdf.svg", error_cdf::draw(report, runs)),
        ("rmse.svg", over_time::rmse(report)),
        ("nees.svg", over_time::nees(report)),
    ];
    let mut drawn = Vec::new();
    for (name, plot) in plots {
        match plot {
            Ok(svg) => drawn.push((name, svg)),
            Err(error) => return Err(Failure::running(format!("cannot draw {name}: {}", error.0))),
        }
    }
    Ok(drawn)
}

/// A figure over the values of a swept key; none where the report has none.
///
/// # Errors
/// A plot that cannot be drawn.
pub fn draw_sweep(key: &str, points: &[(f64, &Report)]) -> Result<Option<String>, Failure> {
    sweep::draw(key, points).map_err(|error| Failure::running(format!("cannot draw the sweep: {}", error.0)))
}

/// Draws on a white page of this size (px) and returns the SVG text.
fn page(
    size: (u32, u32),
    draw: impl FnOnce(&Area<'_>) -> Result<(), DrawError>,
) -> Result<String, DrawError> {
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, size).into_drawing_area();
        area.fill(&WHITE)?;
        draw(&area)?;
        area.present()?;
    }
    Ok(svg)
}
