//! Aligned tables for the terminal.

use std::fmt;

/// How a column is aligned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Align {
    Left,
    Right,
}

/// Rows of cells below a heading.
pub struct Table {
    columns: Vec<(String, Align)>,
    rows: Vec<Vec<String>>,
}

impl Table {
    pub fn new(columns: &[(&str, Align)]) -> Self {
        let columns = columns.iter().map(|&(name, align)| (name.to_owned(), align)).collect();
        Self { columns, rows: Vec::new() }
    }

    /// Adds a row; missing cells are empty.
    pub fn row(&mut self, mut cells: Vec<String>) {
        cells.resize(self.columns.len(), String::new());
        self.rows.push(cells);
    }
}

impl fmt::Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let heading: Vec<String> = self.columns.iter().map(|(name, _)| name.clone()).collect();
        let lines = || std::iter::once(&heading).chain(&self.rows);
        let used: Vec<usize> = (0..heading.len())
            .filter(|&i| self.rows.is_empty() || self.rows.iter().any(|row| !row[i].is_empty()))
            .collect();
        let widths: Vec<usize> = (0..heading.len())
            .map(|i| lines().map(|cells| cells[i].chars().count()).max().unwrap_or(0))
            .collect();
        for (number, cells) in lines().enumerate() {
            let mut line = String::new();
            for &i in &used {
                let pad = " ".repeat(widths[i] - cells[i].chars().count());
                match self.columns[i].1 {
                    Align::Left => line.extend([cells[i].as_str(), &pad, "  "]),
                    Align::Right => line.extend([&pad, cells[i].as_str(), "  "]),
                }
            }
            writeln!(f, "{}", line.trim_end())?;
            if number == 0 {
                let rules: Vec<String> = used.iter().map(|&i| "─".repeat(widths[i])).collect();
                writeln!(f, "{}", rules.join("  "))?;
            }
        }
        Ok(())
    }
}

/// A number with about four significant digits.
pub fn number(value: f64) -> String {
    let size = value.abs();
    match size {
        _ if value == 0.0 => "0".to_owned(),
        1e7.. => format!("{value:.1e}"),
        1000.0.. => format!("{value:.0}"),
        100.0.. => format!("{value:.1}"),
        1.0.. => format!("{value:.2}"),
        0.01.. => format!("{value:.3}"),
        _ => format!("{value:.1e}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_aligned_and_empty_ones_left_out() {
        let mut table = Table::new(&[("id", Align::Left), ("none", Align::Left), ("RMSE [m]", Align::Right)]);
        table.row(vec!["kf".into(), String::new(), "6.31 ± 0.19".into()]);
        table.row(vec!["pa-mpa".into(), String::new(), "38.2".into()]);
        let expected = "\
id         RMSE [m]
──────  ───────────
kf      6.31 ± 0.19
pa-mpa         38.2
";
        assert_eq!(table.to_string(), expected);
    }

    #[test]
    fn numbers_keep_their_significant_digits() {
        let shown = [0.0, 1.23e34, 12345.6, 123.45, 6.3149, 0.08127, 0.000_123].map(number);
        assert_eq!(shown, ["0", "1.2e34", "12346", "123.5", "6.31", "0.081", "1.2e-4"]);
    }
}
