//! Losing the target, and finding it again.
//!
//! A track is taken for lost where the readings contradict its prediction at two scans in a row: the sum of
//! (z - |p - s|)² / (h'P h + R) over the readings lies beyond a quantile of its chi-square law that a good track
//! passes once in a million scans. It is found again from the readings of one scan, three of them at least, by
//! iterated Kalman corrections of a wide prior from several places: a range alone has two sides.

use nalgebra::Matrix4;
use sumprod_filters::{Approximation, Correct, FilterError, Kalman};
use sumprod_messages::Moments;

use super::ranges::Ranges;
use super::world::{Reading, WorldSettings};
use crate::metrics::chi_square;
use crate::tracking::range_gradient;

/// How improbable readings must be to contradict a good track.
const IMPROBABLE: f64 = 1e-6;
/// Contradictions in a row that make a track lost.
const PATIENCE: u32 = 2;
/// Fewest readings that fix a position.
const FEWEST: usize = 3;
/// Places along each axis from which the position is sought.
const SEEDS: usize = 4;

/// Whether the track is believed.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Watch {
    contradictions: u32,
}

impl Watch {
    /// Takes in a scan's readings against the predicted moments, and tells whether the track is lost.
    pub(super) fn loses(
        &mut self,
        predicted: &Moments,
        settings: &WorldSettings,
        sensors: &[[f64; 2]],
        readings: &[Reading],
    ) -> bool {
        if readings.is_empty() {
            return self.contradictions >= PATIENCE;
        }
        let state: [f64; 4] = std::array::from_fn(|k| predicted.mean[k]);
        let covariance = Matrix4::from_row_slice(&predicted.covariance);
        let distance: f64 = readings
            .iter()
            .map(|reading| {
                let place = sensors[reading.sensor];
                let innovation = reading.range - (state[0] - place[0]).hypot(state[2] - place[1]);
                let spread = range_gradient(&state, place).map_or(0.0, |h| h.dot(&(covariance * h)));
                innovation * innovation / (spread + settings.measurement_variance)
            })
            .sum();
        let limit = chi_square::quantile(1.0 - IMPROBABLE, readings.len() as f64).unwrap_or(f64::INFINITY);
        self.contradictions = if distance > limit { self.contradictions + 1 } else { 0 };
        self.contradictions >= PATIENCE
    }

    /// Believes a track that has just been acquired.
    pub(super) fn trust(&mut self) {
        self.contradictions = 0;
    }
}

/// Moments of a target that nothing is known of but one scan's readings; none where these are too few.
///
/// # Errors
/// Where the readings make no measurement.
pub(super) fn acquire(
    settings: &WorldSettings,
    sensors: &[[f64; 2]],
    readings: &[Reading],
) -> Result<Option<Moments>, FilterError> {
    if readings.len() < FEWEST {
        return Ok(None);
    }
    let ranges = Ranges::new(sensors, readings, settings.measurement_variance)
        .map_err(|error| FilterError::Prior(sumprod_graph::MessageError::Unsupported(error.to_string())))?;
    let width = settings.side * settings.side;
    let speed = settings.acquisition_speed * settings.acquisition_speed;
    let misfit = |mean: &[f64; 4]| -> f64 {
        let each = readings.iter().map(|reading| {
            let place = sensors[reading.sensor];
            (reading.range - (mean[0] - place[0]).hypot(mean[2] - place[1])).powi(2)
        });
        each.sum()
    };
    let mut best: Option<(f64, Moments)> = None;
    for seed in 0..SEEDS * SEEDS {
        let along = |k: usize| settings.side * (k as f64 + 0.5) / SEEDS as f64;
        let mean = [along(seed % SEEDS), 0.0, along(seed / SEEDS), 0.0];
        let prior = Moments::diagonal(&mean, &[width, speed, width, speed]);
        let mut filter = Kalman::<4>::new(&prior)?.approximated(Approximation::Iterated(30));
        // A seed from which Gauss-Newton goes astray is no reason to give up the others.
        if filter.correct(&ranges).is_err() {
            continue;
        }
        let found = misfit(filter.mean());
        if best.as_ref().is_none_or(|(least, _)| found < *least) {
            best = Some((found, sumprod_filters::Filter::moments(&filter)));
        }
    }
    let limit = chi_square::quantile(1.0 - IMPROBABLE, readings.len() as f64).unwrap_or(f64::INFINITY);
    Ok(best.filter(|(least, _)| least / settings.measurement_variance < limit).map(|(_, moments)| moments))
}

#[cfg(test)]
mod tests {
    use super::*;

    const SENSORS: [[f64; 2]; 4] = [[0.0, 0.0], [500.0, 0.0], [0.0, 500.0], [500.0, 500.0]];

    fn readings(at: [f64; 2], count: usize) -> Vec<Reading> {
        let each = SENSORS.iter().enumerate().take(count);
        each.map(|(sensor, place)| Reading {
            sensor,
            range: (at[0] - place[0]).hypot(at[1] - place[1]) + 0.2,
        })
        .collect()
    }

    #[test]
    fn three_ranges_find_a_target_anywhere_and_two_do_not_try() {
        let settings = WorldSettings::default();
        for at in [[20.0, 470.0], [300.0, 110.0], [251.0, 249.0]] {
            let found = acquire(&settings, &SENSORS, &readings(at, 3)).unwrap().unwrap();
            assert!((found.mean[0] - at[0]).hypot(found.mean[2] - at[1]) < 2.0, "{:?}", found.mean);
            assert!(found.covariance_at(0, 0) < 2.0 && found.covariance_at(1, 1) > 100.0);
        }
        assert!(acquire(&settings, &SENSORS, &readings([20.0, 470.0], 2)).unwrap().is_none());
    }

    #[test]
    fn a_track_is_lost_after_two_contradictions_in_a_row() {
        let settings = WorldSettings::default();
        let predicted = Moments::diagonal(&[100.0, 8.0, 100.0, 8.0], &[0.5, 0.1, 0.5, 0.1]);
        let mut watch = Watch::default();
        let mut loses = |at, count| watch.loses(&predicted, &settings, &SENSORS, &readings(at, count));
        assert!(!loses([100.5, 99.5], 4));
        assert!(!loses([120.0, 100.0], 4));
        assert!(!loses([100.0, 100.0], 4));
        assert!(!loses([120.0, 100.0], 4));
        assert!(loses([140.0, 100.0], 4));
        assert!(loses([140.0, 100.0], 0));
    }
}
