//! One panel a problem: error over the budget, a line an optimizer.

use plotters::prelude::*;

use super::{BUDGETS, ENTRIES, Failure, Row};

/// The SVG.
pub fn draw(rows: &[Row]) -> Result<String, Failure> {
    let mut text = String::new();
    {
        let root = SVGBackend::with_string(&mut text, (1200, 980)).into_drawing_area();
        root.fill(&WHITE)?;
        let (panels, legend) = root.split_vertically(820);
        let mut problems: Vec<&str> = rows.iter().map(|row| row.problem).collect();
        problems.dedup();
        for (problem, area) in problems.iter().zip(panels.split_evenly((2, 2))) {
            let mine: Vec<&Row> = rows.iter().filter(|row| row.problem == *problem).collect();
            let errors = || mine.iter().map(|row| row.tally.rmse().0);
            let (low, high) = (errors().fold(f64::INFINITY, f64::min), errors().fold(0.0, f64::max));
            let (first, last) = (BUDGETS[0] as f64, BUDGETS[BUDGETS.len() - 1] as f64);
            // A diverging optimizer leaves the panel rather than flattening the others.
            let top = high.min(5.0 * low) * 1.1;
            let mut chart = ChartBuilder::on(&area)
                .caption(*problem, ("sans-serif", 18))
                .margin(10)
                .x_label_area_size(35)
                .y_label_area_size(50)
                .build_cartesian_2d((first..last).log_scale(), (0.95 * low..top).log_scale())?;
            chart.configure_mesh().x_desc("likelihood evaluations a step").y_desc("RMSE").draw()?;
            for (number, entry) in ENTRIES.iter().enumerate() {
                let line = mine.iter().filter(|row| row.name == entry.name);
                let points: Vec<(f64, f64)> =
                    line.map(|row| (row.budget as f64, row.tally.rmse().0.min(top))).collect();
                chart.draw_series(LineSeries::new(points.iter().copied(), colour(number).stroke_width(2)))?;
                chart.draw_series(points.iter().map(|&at| Circle::new(at, 3, colour(number).filled())))?;
            }
        }
        for (number, entry) in ENTRIES.iter().enumerate() {
            let (x, y) = (60 + (number % 3) as i32 * 380, 15 + (number / 3) as i32 * 26);
            legend.draw(&Rectangle::new([(x, y), (x + 24, y + 6)], colour(number).filled()))?;
            legend.draw(&Text::new(entry.name, (x + 32, y - 5), ("sans-serif", 15)))?;
        }
        root.present()?;
    }
    Ok(text)
}

fn colour(number: usize) -> HSLColor {
    HSLColor(number as f64 / ENTRIES.len() as f64, 0.75, if number.is_multiple_of(2) { 0.4 } else { 0.55 })
}
