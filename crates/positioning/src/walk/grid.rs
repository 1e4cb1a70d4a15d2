//! The exact filter and smoother of a random walk on a grid.
//!
//! A prediction convolves with a Gaussian, axis by axis. Mass that leaves the area is lost: the walker is inside.

use super::area::Area;
use super::links::Calibration;
use super::recording::Sweep;

/// A density over the cells of an area, which sums to one.
pub struct Density {
    counts: [usize; 2],
    cell: f64,
    values: Vec<f64>,
}

impl Density {
    /// A Gaussian about the middle of the area, as wide as a point anywhere in it.
    pub fn start(area: &Area) -> Self {
        let (middle, variances) = area.moments();
        let values = (0..area.len()).map(|cell| {
            let point = area.middle(cell);
            (0..2).map(|k| -0.5 * (point[k] - middle[k]).powi(2) / variances[k]).sum::<f64>().exp()
        });
        let mut density = Self { counts: area.counts(), cell: area.cell(), values: values.collect() };
        density.normalise();
        density
    }

    fn normalise(&mut self) -> f64 {
        let total: f64 = self.values.iter().sum();
        self.values.iter_mut().for_each(|value| *value /= total);
        total
    }

    /// A step of this variance along each axis (m²).
    pub fn predict(&mut self, variance: f64) {
        blur(&mut self.values, self.counts, self.cell, variance);
    }

    /// Multiplies by a likelihood given by its logs, and returns the log of the evidence; none where no cell has mass
    /// left.
    pub fn correct(&mut self, logs: &[f64]) -> Option<f64> {
        let largest = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        self.values.iter_mut().zip(logs).for_each(|(value, log)| *value *= (log - largest).exp());
        let total = self.normalise();
        (total > 0.0 && total.is_finite()).then(|| total.ln() + largest)
    }

    /// Mean (m) and covariance (row-major, m²), that of a cell included.
    pub fn moments(&self, area: &Area) -> ([f64; 2], [f64; 4]) {
        let mut mean = [0.0; 2];
        let mut covariance = [0.0; 4];
        let cells = || self.values.iter().enumerate().map(|(cell, mass)| (mass, area.middle(cell)));
        for (mass, point) in cells() {
            (0..2).for_each(|k| mean[k] += mass * point[k]);
        }
        for (mass, point) in cells() {
            for row in 0..2 {
                for column in 0..2 {
                    covariance[2 * row + column] +=
                        mass * (point[row] - mean[row]) * (point[column] - mean[column]);
                }
            }
        }
        covariance[0] += area.cell().powi(2) / 12.0;
        covariance[3] += area.cell().powi(2) / 12.0;
        (mean, covariance)
    }
}

/// Convolves with a Gaussian along both axes.
fn blur(values: &mut [f64], counts: [usize; 2], cell: f64, variance: f64) {
    let [rows, columns] = counts;
    let mut line = vec![0.0; rows.max(columns)];
    let taps = taps(rows.max(columns), cell, variance);
    for row in values.chunks_exact_mut(columns) {
        convolve(row.iter().copied(), &taps, &mut line[..columns]);
        row.copy_from_slice(&line[..columns]);
    }
    for column in 0..columns {
        convolve(values.iter().skip(column).step_by(columns).copied(), &taps, &mut line[..rows]);
        values.iter_mut().skip(column).step_by(columns).zip(&line).for_each(|(value, new)| *value = *new);
    }
}

/// The Gaussian at whole cells, the middle first; both sides to infinity sum to one.
fn taps(count: usize, cell: f64, variance: f64) -> Vec<f64> {
    let value = |k: usize| (-0.5 * (k as f64 * cell).powi(2) / variance).exp();
    let beyond = ((8.0 * variance.sqrt() / cell).ceil() as usize).min(1_000_000);
    let total = 1.0 + 2.0 * (1..=beyond).map(value).sum::<f64>();
    (0..count.min(beyond + 1)).map(|k| value(k) / total).collect()
}

fn convolve(values: impl Iterator<Item = f64>, taps: &[f64], out: &mut [f64]) {
    out.fill(0.0);
    for (at, value) in values.enumerate().filter(|(_, value)| *value > 0.0) {
        out[at..].iter_mut().zip(taps).for_each(|(out, tap)| *out += value * tap);
        out[..at].iter_mut().rev().zip(taps.iter().skip(1)).for_each(|(out, tap)| *out += value * tap);
    }
}

/// Log likelihoods of a sweep over the cells.
pub fn cell_logs(calibration: &Calibration, area: &Area, sweep: &Sweep) -> Vec<f64> {
    let logs = calibration.sweep(sweep);
    (0..area.len()).map(|cell| calibration.log_likelihood(&logs, &area.middle(cell))).collect()
}

/// Each position's density given all sweeps.
pub struct Smoothed(Vec<Vec<f64>>);

impl Smoothed {
    /// Forward, then backward: S_t = F_t ∘ blur(S_{t+1} / P_{t+1}), P the predicted density.
    pub fn of(calibration: &Calibration, area: &Area, sweeps: &[Sweep], wander_variance: f64) -> Self {
        let mut density = Density::start(area);
        let mut predicted: Vec<Vec<f64>> = Vec::with_capacity(sweeps.len());
        let mut filtered: Vec<Vec<f64>> = Vec::with_capacity(sweeps.len());
        let steps: Vec<f64> =
            sweeps.windows(2).map(|pair| wander_variance * (pair[1].time - pair[0].time)).collect();
        for (index, sweep) in sweeps.iter().enumerate() {
            if let Some(variance) = index.checked_sub(1).map(|step| steps[step]) {
                density.predict(variance);
            }
            predicted.push(density.values.clone());
            // Logs are finite at every cell, so that some mass is left.
            density.correct(&cell_logs(calibration, area, sweep));
            filtered.push(density.values.clone());
        }
        for index in (0..sweeps.len().saturating_sub(1)).rev() {
            let mut ratio: Vec<f64> = filtered[index + 1]
                .iter()
                .zip(&predicted[index + 1])
                .map(|(smoothed, predicted)| smoothed / predicted.max(f64::MIN_POSITIVE))
                .collect();
            blur(&mut ratio, area.counts(), area.cell(), steps[index]);
            let mut total = 0.0;
            for (value, ratio) in filtered[index].iter_mut().zip(&ratio) {
                *value *= ratio;
                total += *value;
            }
            filtered[index].iter_mut().for_each(|value| *value /= total);
        }
        Self(filtered)
    }

    /// The densities, sweep by sweep.
    pub fn densities(&self) -> impl Iterator<Item = &[f64]> {
        self.0.iter().map(Vec::as_slice)
    }
}
