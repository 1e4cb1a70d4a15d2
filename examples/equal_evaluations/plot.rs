//! A row of panels a problem: error and coverage over the budget, a line an optimizer.

use plotters::coord::ranged1d::{KeyPointHint, NoDefaultFormatting, Ranged, ValueFormatter};
use plotters::prelude::*;

use super::{BUDGETS, ENTRIES, Failure, Row};

const SIZE: (u32, u32) = (1240, 1700);
const LEGEND: u32 = 170;

/// A logarithmic axis that is labelled at given values alone.
struct Levels {
    ends: (f64, f64),
    labels: Vec<f64>,
}

impl Ranged for Levels {
    type FormatOption = NoDefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, limit: (i32, i32)) -> i32 {
        let share = (value.ln() - self.ends.0.ln()) / (self.ends.1.ln() - self.ends.0.ln());
        limit.0 + (f64::from(limit.1 - limit.0) * share).round() as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, _: Hint) -> Vec<f64> {
        self.labels.clone()
    }

    fn range(&self) -> std::ops::Range<f64> {
        self.ends.0..self.ends.1
    }
}

impl ValueFormatter<f64> for Levels {
    fn format(value: &f64) -> String {
        value.to_string()
    }
}

impl Levels {
    fn budgets() -> Self {
        let labels: Vec<f64> = BUDGETS.iter().map(|&budget| budget as f64).collect();
        Self { ends: (labels[0], labels[labels.len() - 1]), labels }
    }

    /// From `low` to `high`, labelled at round numbers between.
    fn round(low: f64, high: f64) -> Self {
        let decades = -3..=5;
        let fine = high / low < 4.0;
        let digits: &[f64] =
            if fine { &[1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0] } else { &[1.0, 2.0, 5.0] };
        let all = decades.flat_map(|decade| digits.iter().map(move |digit| digit * 10_f64.powi(decade)));
        let labels =
            all.map(|value| (value * 1e6).round() / 1e6).filter(|value| (low..=high).contains(value));
        Self { ends: (low, high), labels: labels.collect() }
    }
}

/// The SVG.
pub fn draw(rows: &[Row]) -> Result<String, Failure> {
    let mut text = String::new();
    {
        let root = SVGBackend::with_string(&mut text, SIZE).into_drawing_area();
        root.fill(&WHITE)?;
        let (panels, legend) = root.split_vertically(SIZE.1 - LEGEND);
        let mut problems: Vec<&str> = rows.iter().map(|row| row.problem).collect();
        problems.dedup();
        let areas = panels.split_evenly((problems.len(), 2));
        for (problem, pair) in problems.iter().zip(areas.chunks(2)) {
            let mine: Vec<&Row> = rows.iter().filter(|row| row.problem == *problem).collect();
            let errors = || mine.iter().map(|row| row.tally.rmse().0);
            let (low, high) = (errors().fold(f64::INFINITY, f64::min), errors().fold(0.0, f64::max));
            // A diverging optimizer leaves the panel rather than flattening the others.
            let top = high.min(20.0 * low) * 1.1;
            let error = Levels::round(0.95 * low, top);
            panel(&pair[0], (problem, "RMSE"), error, &mine, |row| row.tally.rmse().0.min(top))?;
            let least = mine.iter().map(|row| row.tally.coverage()).fold(0.9, f64::min).max(0.05);
            let share = Levels { ends: (0.95 * least, 1.0), labels: vec![0.1, 0.2, 0.4, 0.6, 0.8, 0.95] };
            let labels = share.labels.iter().copied().filter(|&label| label >= 0.95 * least).collect();
            let share = Levels { labels, ..share };
            panel(&pair[1], (problem, "share inside the 95 % interval"), share, &mine, |row| {
                row.tally.coverage().max(0.95 * least)
            })?;
        }
        for (number, entry) in ENTRIES.iter().enumerate() {
            let (x, y) = (60 + (number % 3) as i32 * 380, 15 + (number / 3) as i32 * 28);
            legend.draw(&Rectangle::new([(x, y), (x + 24, y + 6)], colour(number).filled()))?;
            legend.draw(&Text::new(entry.name, (x + 32, y - 5), ("sans-serif", 15)))?;
        }
        root.present()?;
    }
    Ok(text)
}

fn panel(
    area: &DrawingArea<SVGBackend<'_>, plotters::coord::Shift>,
    (problem, what): (&str, &str),
    y: Levels,
    rows: &[&Row],
    value: impl Fn(&Row) -> f64,
) -> Result<(), Failure> {
    let mut chart = ChartBuilder::on(area)
        .caption(format!("{problem}: {what}"), ("sans-serif", 17))
        .margin(10)
        .x_label_area_size(38)
        .y_label_area_size(48)
        .build_cartesian_2d(Levels::budgets(), y)?;
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .bold_line_style(BLACK.mix(0.12))
        .x_desc("likelihood evaluations a step")
        .label_style(("sans-serif", 13))
        .draw()?;
    for (number, entry) in ENTRIES.iter().enumerate() {
        let line = rows.iter().filter(|row| row.name == entry.name);
        let points: Vec<(f64, f64)> = line.map(|row| (row.budget as f64, value(row))).collect();
        chart.draw_series(LineSeries::new(points.iter().copied(), colour(number).stroke_width(2)))?;
        chart.draw_series(points.iter().map(|&at| Circle::new(at, 3, colour(number).filled())))?;
    }
    Ok(())
}

fn colour(number: usize) -> HSLColor {
    HSLColor(number as f64 / ENTRIES.len() as f64, 0.75, if number.is_multiple_of(2) { 0.4 } else { 0.55 })
}
