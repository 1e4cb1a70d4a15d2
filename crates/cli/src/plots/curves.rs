//! Axes, and curves that end at the plot's edge.

use plotters::chart::ChartContext;
use plotters::coord::cartesian::Cartesian2d;
use plotters::element::DashedPathElement;
use plotters::prelude::*;

use super::scale::Scale;
use super::style::{GRID, INK, Pen, text};
use super::{Area, DrawError};

type Chart<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<Scale, Scale>>;

/// Space (px) left of and below a plot for labels, and around it.
pub const LABEL_SPACE: (u32, u32) = (62, 48);
/// Space (px) above, right and left of a plot.
pub const MARGIN: u32 = 14;

/// Curves longer than this are thinned, so that a long recording's plot stays a small file.
const MOST_POINTS: usize = 1500;

/// A plot with its axes drawn.
pub struct Plot<'a, 'b> {
    chart: Chart<'a, 'b>,
    x: Scale,
    y: Scale,
}

impl<'a, 'b> Plot<'a, 'b> {
    /// Draws axes with their names and units on `area`.
    pub fn new(area: &'a Area<'b>, x: Scale, y: Scale, names: (&str, &str)) -> Result<Self, DrawError> {
        let mut chart = ChartBuilder::on(area)
            .margin_top(MARGIN)
            .margin_right(MARGIN)
            .margin_left(MARGIN)
            .x_label_area_size(LABEL_SPACE.1)
            .y_label_area_size(LABEL_SPACE.0)
            .build_cartesian_2d(x.clone(), y.clone())?;
        chart
            .configure_mesh()
            .light_line_style(TRANSPARENT)
            .bold_line_style(GRID)
            .axis_style(INK.mix(0.6))
            .x_desc(names.0)
            .y_desc(names.1)
            .label_style(text(14, INK))
            .axis_desc_style(text(15, INK))
            .draw()?;
        Ok(Self { chart, x, y })
    }

    /// Draws a curve through `points` (values, not coordinates), cut at the plot's edges.
    pub fn line(&mut self, points: &[(f64, f64)], pen: Pen) -> Result<(), DrawError> {
        let coordinates: Vec<(f64, f64)> =
            thinned(points).map(|(x, y)| (self.x.at(x), self.y.at(y))).collect();
        for piece in clipped(&coordinates, &self.x, &self.y) {
            self.piece(piece, pen)?;
        }
        Ok(())
    }

    fn piece(&mut self, points: Vec<(f64, f64)>, pen: Pen) -> Result<(), DrawError> {
        let (stroke, dash) = (pen.stroke(), pen.dash);
        match dash {
            None => self.chart.draw_series([PathElement::new(points, stroke)])?,
            Some((dash, gap)) => {
                self.chart.draw_series([DashedPathElement::new(points, dash, gap, stroke)])?
            }
        };
        Ok(())
    }

    /// Shades the region between two curves over the same abscissae.
    pub fn region(
        &mut self,
        low: &[(f64, f64)],
        high: &[(f64, f64)],
        style: ShapeStyle,
    ) -> Result<(), DrawError> {
        let place = |&(x, y): &(f64, f64)| {
            let (xs, ys) = (self.x.range(), self.y.range());
            (self.x.at(x).clamp(xs.start, xs.end), self.y.at(y).clamp(ys.start, ys.end))
        };
        let outline: Vec<(f64, f64)> = low.iter().map(place).chain(high.iter().rev().map(place)).collect();
        self.chart.draw_series([Polygon::new(outline, style)])?;
        Ok(())
    }

    /// Draws a closed outline with a pale filling, unless it reaches over the edge; then the part inside is outlined.
    /// One that is larger than the plot is left out: nothing of its shape would show.
    pub fn outline(&mut self, points: &[(f64, f64)], pen: Pen) -> Result<(), DrawError> {
        let (xs, ys) = (self.x.range(), self.y.range());
        let extent = |of: fn(&(f64, f64)) -> f64| {
            let ends =
                points.iter().map(of).fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
                    (low.min(value), high.max(value))
                });
            ends.1 - ends.0
        };
        if extent(|point| point.0) > xs.end - xs.start || extent(|point| point.1) > ys.end - ys.start {
            return Ok(());
        }
        if points.iter().all(|&(x, y)| xs.contains(&x) && ys.contains(&y)) {
            self.chart.draw_series([Polygon::new(points.to_vec(), pen.colour.mix(0.14).filled())])?;
        }
        for piece in clipped(points, &self.x, &self.y) {
            self.chart
                .draw_series([PathElement::new(piece, pen.colour.mix(0.75).stroke_width(pen.width))])?;
        }
        Ok(())
    }

    /// Draws a marker at each point inside the plot.
    pub fn triangles(&mut self, points: &[(f64, f64)], colour: RGBColor) -> Result<(), DrawError> {
        let inside = self.inside(points);
        self.chart
            .draw_series(inside.into_iter().map(|point| TriangleMarker::new(point, 4, colour.filled())))?;
        Ok(())
    }

    /// Draws a dot at each point inside the plot.
    pub fn dots(&mut self, points: &[(f64, f64)], colour: RGBColor) -> Result<(), DrawError> {
        let inside = self.inside(points);
        self.chart.draw_series(inside.into_iter().map(|point| Circle::new(point, 4, colour.filled())))?;
        Ok(())
    }

    fn inside(&self, points: &[(f64, f64)]) -> Vec<(f64, f64)> {
        let (xs, ys) = (self.x.range(), self.y.range());
        points.iter().copied().filter(|(x, y)| xs.contains(x) && ys.contains(y)).collect()
    }
}

/// Draws a line through pixels, outside any plot.
pub fn stroke_pixels(area: &Area<'_>, points: &[(i32, i32)], pen: Pen) -> Result<(), DrawError> {
    match pen.dash {
        None => area.draw(&PathElement::new(points.to_vec(), pen.stroke()))?,
        Some((dash, gap)) => area.draw(&DashedPathElement::new(points.to_vec(), dash, gap, pen.stroke()))?,
    }
    Ok(())
}

/// At most [`MOST_POINTS`] of the points, evenly, the last one included.
fn thinned(points: &[(f64, f64)]) -> impl Iterator<Item = (f64, f64)> {
    let stride = points.len().div_ceil(MOST_POINTS).max(1);
    let last = points.last().filter(|_| points.len() % stride != 1 && stride > 1);
    points.iter().step_by(stride).chain(last).copied()
}

/// The pieces of a line that lie inside the plot.
fn clipped(points: &[(f64, f64)], x: &Scale, y: &Scale) -> Vec<Vec<(f64, f64)>> {
    let mut pieces: Vec<Vec<(f64, f64)>> = Vec::new();
    let mut open = false;
    for pair in points.windows(2) {
        let Some((from, to)) = segment(pair[0], pair[1], x, y) else {
            open = false;
            continue;
        };
        match pieces.last_mut().filter(|piece| open && piece.last() == Some(&from)) {
            Some(piece) => piece.push(to),
            None => pieces.push(vec![from, to]),
        }
        open = true;
    }
    pieces
}

/// The part of a segment inside the plot (Liang and Barsky 1984).
fn segment(a: (f64, f64), b: (f64, f64), x: &Scale, y: &Scale) -> Option<((f64, f64), (f64, f64))> {
    let (dx, dy) = (b.0 - a.0, b.1 - a.1);
    let (xs, ys) = (x.range(), y.range());
    let (mut enter, mut leave) = (0.0_f64, 1.0_f64);
    for (slope, room) in
        [(-dx, a.0 - xs.start), (dx, xs.end - a.0), (-dy, a.1 - ys.start), (dy, ys.end - a.1)]
    {
        if slope == 0.0 {
            if room < 0.0 {
                return None;
            }
        } else if slope < 0.0 {
            enter = enter.max(room / slope);
        } else {
            leave = leave.min(room / slope);
        }
    }
    let at = |t: f64| (a.0 + t * dx, a.1 + t * dy);
    let start = if enter == 0.0 { a } else { at(enter) };
    let end = if leave == 1.0 { b } else { at(leave) };
    (enter <= leave).then_some((start, end))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_cut_at_the_edges() {
        let (x, y) = (Scale::exact(0.0, 10.0), Scale::exact(0.0, 10.0));
        let path = [(-5.0, 5.0), (5.0, 5.0), (5.0, 15.0), (8.0, 15.0), (8.0, 5.0), (9.0, 5.0)];
        let pieces = clipped(&path, &x, &y);
        let expected = [vec![(0.0, 5.0), (5.0, 5.0), (5.0, 10.0)], vec![(8.0, 10.0), (8.0, 5.0), (9.0, 5.0)]];
        assert_eq!(pieces, expected);
    }

    #[test]
    fn long_curves_are_thinned_to_their_ends() {
        let points: Vec<_> = (0..10_000).map(|i| (f64::from(i), 0.0)).collect();
        let kept: Vec<_> = thinned(&points).collect();
        assert!(kept.len() <= MOST_POINTS + 1);
        assert_eq!((kept[0].0, kept[kept.len() - 1].0), (0.0, 9999.0));
        assert_eq!(thinned(&points[..100]).count(), 100);
    }
}
