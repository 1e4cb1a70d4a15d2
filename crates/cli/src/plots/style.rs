//! The one plot style: colours that colour-blind readers tell apart, a light grid, a legend beside the plot.

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::{Area, DrawError};

/// Text and axes.
pub const INK: RGBColor = RGBColor(0x33, 0x33, 0x33);
/// Secondary text.
pub const GREY: RGBColor = RGBColor(0x70, 0x70, 0x70);
/// Grid lines.
pub const GRID: RGBColor = RGBColor(0xe4, 0xe4, 0xe4);
/// Bands of what is expected.
pub const BAND: RGBColor = RGBColor(0x9a, 0x9a, 0x9a);
/// Curves up to which widths tell them apart.
const FEW: usize = 4;
/// Font of all text.
const FONT: &str = "sans-serif";

/// The palette of Okabe and Ito without its yellow, which is too pale for lines on white.
const COLOURS: [RGBColor; 7] = [
    RGBColor(0x00, 0x72, 0xb2),
    RGBColor(0xd5, 0x5e, 0x00),
    RGBColor(0x00, 0x9e, 0x73),
    RGBColor(0xcc, 0x79, 0xa7),
    RGBColor(0xe6, 0x9f, 0x00),
    RGBColor(0x56, 0xb4, 0xe9),
    RGBColor(0x7a, 0x51, 0x2d),
];

/// How one curve is drawn.
#[derive(Clone, Copy, Debug)]
pub struct Pen {
    /// Its colour.
    pub colour: RGBColor,
    /// Its width (px).
    pub width: u32,
    /// Lengths of dash and gap (px), if it is dashed.
    pub dash: Option<(i32, i32)>,
}

impl Pen {
    /// The pen of the method at this place; beyond the palette, colours return dashed.
    pub fn of_method(index: usize) -> Self {
        let dash = match index / COLOURS.len() {
            0 => None,
            1 => Some((7, 4)),
            _ => Some((2, 3)),
        };
        Self { colour: COLOURS[index % COLOURS.len()], width: 2, dash }
    }

    /// The pen of a method's curve among `count` in one plot. Of curves that coincide each must show: a few get
    /// narrower from one to the next, so that the lower one shows at the rim; of many, every other one is dashed and
    /// drawn above the solid ones (see [`Pen::drawing_order`]).
    pub fn layered(index: usize, count: usize) -> Self {
        let pen = Self::of_method(index);
        if count > FEW {
            let dash = pen.dash.or((index % 2 == 1).then_some((7, 5)));
            return Self { dash, width: if dash.is_some() { 2 } else { 3 }, ..pen };
        }
        let above = count.saturating_sub(index + 1).min(2) as u32;
        Self { width: 2 + above, ..pen }
    }

    /// Sorts solid curves below dashed ones, and otherwise keeps their order.
    pub fn drawing_order(&self) -> bool {
        self.dash.is_some()
    }

    /// The pen of what is not a method: a bound, the expected value.
    pub fn reference() -> Self {
        Self { colour: INK, width: 2, dash: Some((5, 4)) }
    }

    /// The style of its strokes.
    pub fn stroke(&self) -> ShapeStyle {
        self.colour.stroke_width(self.width)
    }
}

/// Text of this size (px) and colour.
pub fn text(size: u32, colour: RGBColor) -> TextStyle<'static> {
    let style = TextStyle::from((FONT, size).into_font());
    TextStyle { color: colour.to_backend_color(), ..style }
}

/// Text that starts at its point, centred on it vertically.
pub fn text_from_left(size: u32, colour: RGBColor) -> TextStyle<'static> {
    text(size, colour).pos(Pos::new(HPos::Left, VPos::Center))
}

/// Writes the heading of a plot and returns what is below it.
pub fn heading<'a>(area: &Area<'a>, title: &str, subtitle: &str) -> Result<Area<'a>, DrawError> {
    let (head, body) = area.split_vertically(58);
    head.draw(&Text::new(title.to_owned(), (18, 22), text_from_left(20, INK)))?;
    head.draw(&Text::new(subtitle.to_owned(), (18, 45), text_from_left(14, GREY)))?;
    Ok(body)
}

/// An entry of a legend.
pub enum Key {
    /// A curve.
    Line(Pen),
    /// A filled region.
    Region(RGBColor),
    /// A marker.
    Marker(RGBColor),
}

/// Draws entries one below another from the top of `area`.
pub fn legend(area: &Area<'_>, entries: &[(Key, String)]) -> Result<(), DrawError> {
    for (i, (key, label)) in entries.iter().enumerate() {
        let y = 18 + 24 * i as i32;
        match key {
            Key::Line(pen) => super::curves::stroke_pixels(area, &[(8, y), (38, y)], *pen)?,
            Key::Region(colour) => {
                area.draw(&Rectangle::new([(8, y - 7), (38, y + 7)], colour.mix(0.25).filled()))?;
            }
            Key::Marker(colour) => area.draw(&TriangleMarker::new((23, y), 6, colour.filled()))?,
        }
        area.draw(&Text::new(label.clone(), (46, y), text_from_left(14, INK)))?;
    }
    Ok(())
}

/// Width (px) that a legend with these labels takes.
pub fn legend_width(entries: &[(Key, String)]) -> u32 {
    let longest = entries.iter().map(|(_, label)| label.chars().count()).max().unwrap_or(0);
    66 + 8 * longest as u32
}
