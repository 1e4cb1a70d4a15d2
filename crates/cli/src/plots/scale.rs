//! An axis's range, its ticks and their labels; linear, or logarithmic where values span decades.

use std::ops::Range;

use plotters::coord::ranged1d::{KeyPointHint, NoDefaultFormatting, Ranged, ValueFormatter};

/// Beyond this ratio of largest to smallest a positive axis is logarithmic.
const DECADES_FROM: f64 = 8.0;
/// About this many ticks on a linear axis.
const TICKS: f64 = 6.0;

/// One axis. Its coordinates are the values, or their decimal logarithms.
#[derive(Clone, Debug)]
pub struct Scale {
    low: f64,
    high: f64,
    ticks: Vec<f64>,
    logarithmic: bool,
    percent: bool,
}

impl Scale {
    /// A linear axis that holds `low` to `high`, widened to whole ticks.
    pub fn linear(low: f64, high: f64) -> Self {
        let mut scale = Self::exact(low, high);
        let step = step(high - low);
        scale.low = (low / step).floor() * step;
        scale.high = (high / step).ceil() * step;
        scale.ticks = ticks(scale.low, scale.high, step);
        scale
    }

    /// A linear axis from `low` to `high` and no further.
    pub fn exact(low: f64, high: f64) -> Self {
        let high = if high > low { high } else { low + 1.0 };
        let ticks = ticks(low, high, step(high - low));
        Self { low, high, ticks, logarithmic: false, percent: false }
    }

    /// An axis of shares from 0 to 1, with the levels that the tables give.
    pub fn shares() -> Self {
        let ticks = vec![0.0, 0.2, 0.5, 0.8, 0.95, 1.0];
        Self { low: 0.0, high: 1.0, ticks, logarithmic: false, percent: true }
    }

    /// An axis for positive values from `low` to `high`: logarithmic if they span enough, else linear from 0.
    pub fn positive(low: f64, high: f64) -> Self {
        if low > 0.0 && high / low > DECADES_FROM {
            Self::logarithmic(low, high)
        } else {
            Self::linear(0.0, high)
        }
    }

    /// A logarithmic axis that holds `low` to `high`, both positive, widened to its ticks at 1, 2 and 5.
    pub fn logarithmic(low: f64, high: f64) -> Self {
        let levels: Vec<f64> = (-12..=12)
            .flat_map(|decade| [1.0, 2.0, 5.0].map(|digit: f64| digit.log10() + f64::from(decade)))
            .collect();
        let below = levels.iter().copied().rfind(|&level| level <= low.log10() + 1e-9);
        let above = levels.iter().copied().find(|&level| level >= high.log10() - 1e-9);
        let (low, high) = (below.unwrap_or(low.log10()), above.unwrap_or(high.log10()));
        let inside = |level: &f64| (low - 1e-9..=high + 1e-9).contains(level);
        let mut ticks: Vec<f64> = levels.into_iter().filter(inside).collect();
        if ticks.len() > 12 {
            ticks.retain(|tick| (tick - tick.round()).abs() < 1e-9);
        }
        Self { low, high, ticks, logarithmic: true, percent: false }
    }

    /// The range of coordinates.
    pub fn range(&self) -> Range<f64> {
        self.low..self.high
    }

    /// The coordinate of a value; a value that a logarithmic axis cannot show lies below it.
    pub fn at(&self, value: f64) -> f64 {
        match self.logarithmic {
            false => value,
            true if value > 0.0 => value.log10(),
            true => self.low - 1.0,
        }
    }

    /// The text at a tick's coordinate.
    fn label(&self, tick: f64) -> String {
        let value = if self.logarithmic { 10f64.powf(tick) } else { tick };
        if self.percent {
            return format!("{:.0} %", 100.0 * value);
        }
        let step = if self.logarithmic { value } else { step(self.high - self.low) };
        let decimals = (-step.log10() - 1e-9).ceil().clamp(0.0, 12.0) as usize;
        let value = if value.abs() < 1e-9 * step { 0.0 } else { value };
        format!("{value:.decimals$}").replace('-', "−")
    }
}

impl Ranged for Scale {
    type FormatOption = NoDefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, limit: (i32, i32)) -> i32 {
        let share = (value - self.low) / (self.high - self.low);
        let pixels = f64::from(limit.1 - limit.0);
        limit.0 + (share * pixels).round() as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, hint: Hint) -> Vec<f64> {
        if hint.weight().allow_light_points() { Vec::new() } else { self.ticks.clone() }
    }

    fn range(&self) -> Range<f64> {
        self.range()
    }
}

impl ValueFormatter<f64> for Scale {
    fn format_ext(&self, tick: &f64) -> String {
        self.label(*tick)
    }
}

/// 1, 2 or 5 times a power of ten that divides a span into about [`TICKS`] parts.
fn step(span: f64) -> f64 {
    let raw = (span / TICKS).max(f64::MIN_POSITIVE);
    let power = 10f64.powf(raw.log10().floor());
    let digit = raw / power;
    power
        * if digit < 1.5 {
            1.0
        } else if digit < 3.5 {
            2.0
        } else if digit < 7.5 {
            5.0
        } else {
            10.0
        }
}

fn ticks(low: f64, high: f64, step: f64) -> Vec<f64> {
    let first = (low / step - 1e-9).ceil();
    let last = (high / step + 1e-9).floor();
    (0..=(last - first).clamp(0.0, 50.0) as u32).map(|i| (first + f64::from(i)) * step).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(scale: &Scale) -> Vec<String> {
        scale.ticks.iter().map(|&tick| scale.label(tick)).collect()
    }

    #[test]
    fn linear_ticks_are_round() {
        assert_eq!(labels(&Scale::linear(0.0, 9.7)), ["0", "2", "4", "6", "8", "10"]);
        assert_eq!(labels(&Scale::linear(-0.21, 0.3)), ["−0.3", "−0.2", "−0.1", "0.0", "0.1", "0.2", "0.3"]);
        assert_eq!(labels(&Scale::exact(3.0, 3.0)).first().map(String::as_str), Some("3.0"));
    }

    #[test]
    fn wide_spans_are_logarithmic() {
        let scale = Scale::positive(0.7, 90.0);
        assert_eq!(labels(&scale), ["0.5", "1", "2", "5", "10", "20", "50", "100"]);
        assert!((scale.at(10.0) - 1.0).abs() < 1e-12);
        assert!(scale.at(0.0) < scale.range().start);
        assert_eq!(Scale::positive(5.0, 10.0).range().start, 0.0);
    }
}
