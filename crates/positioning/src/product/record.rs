//! What a method found: as metrics, held against the recorded answer, and as files.

use std::fmt::Write;

use serde::Serialize;
use sumprod_messages::{Mode, Moments, Particles, Product, ProductQuality};

use super::file::Recorded;
use crate::error::PositioningError;
use crate::results::{MethodRun, OutputFile};

/// One method's product.
pub(super) struct Found {
    pub(super) product: Product,
    pub(super) modes: Vec<Mode>,
    /// The product as points of equal weight.
    pub(super) points: Particles,
}

/// `product-ID.json`.
#[derive(Serialize)]
struct Record<'a> {
    method: &'a str,
    chosen_method: &'a str,
    samples: usize,
    #[serde(skip_serializing_if = "Option::is_none")]
    log_normaliser: Option<f64>,
    mean: Vec<f64>,
    covariance: Vec<Vec<f64>>,
    /// Of `modes`, in their order.
    mode_masses: Vec<f64>,
    modes: Vec<RecordedPeak>,
    quality: &'a ProductQuality,
}

#[derive(Serialize)]
struct RecordedPeak {
    location: Vec<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pdf: Option<f64>,
    mass: f64,
}

impl Found {
    /// Names the numbers; errors against the record where there is one.
    pub(super) fn report(&self, recorded: Option<&Recorded>, out: &mut MethodRun) {
        let quality = &self.product.quality;
        out.diagnose("n_eff", quality.effective_sample_size);
        out.diagnose("modes", self.modes.len() as f64);
        let known = [
            ("log_evidence", self.product.log_normaliser),
            ("divergence", quality.divergence),
            ("label_change", quality.label_change),
        ];
        for (name, value) in known {
            if let Some(value) = value {
                out.diagnose(name, value);
            }
        }
        if let Some(recorded) = recorded {
            self.compare(recorded, out);
        }
    }

    fn compare(&self, recorded: &Recorded, out: &mut MethodRun) {
        let Moments { mean, covariance } = self.product.moments();
        let d = mean.len();
        let deviation = |k: usize| recorded.covariance[k][k].sqrt();
        let largest = |errors: &mut dyn Iterator<Item = f64>| errors.map(f64::abs).fold(0.0, f64::max);
        let means = &mut (0..d).map(|k| (mean[k] - recorded.mean[k]) / deviation(k));
        out.diagnose("error.mean", largest(means));
        let entries = &mut (0..d * d).map(|entry| {
            let (row, column) = (entry / d, entry % d);
            (covariance[entry] - recorded.covariance[row][column]) / (deviation(row) * deviation(column))
        });
        out.diagnose("error.covariance", largest(entries));
        if let Some(log) = self.product.log_normaliser {
            out.diagnose("error.log_evidence", (log - recorded.log_normaliser).abs());
        }
        let mut masses: Vec<f64> = recorded.modes.iter().map(|mode| -mode.mass).collect();
        for mode in &self.modes {
            let distance = |place: &[f64]| -> f64 {
                place.iter().zip(&mode.location).map(|(a, b)| (a - b) * (a - b)).sum()
            };
            let nearest = (0..masses.len()).min_by(|&a, &b| {
                distance(&recorded.modes[a].location).total_cmp(&distance(&recorded.modes[b].location))
            });
            if let Some(nearest) = nearest {
                masses[nearest] += mode.mass;
            }
        }
        if !masses.is_empty() {
            out.diagnose("error.mode_mass", largest(&mut masses.into_iter()));
        }
    }

    /// What a person should know: what was chosen and why, and the warnings.
    pub(super) fn notes(&self) -> Vec<String> {
        let quality = &self.product.quality;
        let choice = quality.reason.iter().map(|reason| format!("chose {}: {reason}", quality.method));
        choice.chain(quality.warnings.iter().cloned()).collect()
    }

    /// The method's two files.
    pub(super) fn files(&self, id: &str) -> Result<[OutputFile; 2], PositioningError> {
        let Moments { mean, covariance } = self.product.moments();
        let log_normaliser = self.product.log_normaliser;
        let peak = |mode: &Mode| RecordedPeak {
            location: mode.location.clone(),
            pdf: log_normaliser.map(|log| (mode.log_density - log).exp()),
            mass: mode.mass,
        };
        let record = Record {
            method: id,
            chosen_method: &self.product.quality.method,
            samples: self.points.len(),
            log_normaliser,
            covariance: covariance.chunks(mean.len()).map(<[f64]>::to_vec).collect(),
            mean,
            mode_masses: self.modes.iter().map(|mode| mode.mass).collect(),
            modes: self.modes.iter().map(peak).collect(),
            quality: &self.product.quality,
        };
        let json =
            serde_json::to_string_pretty(&record).map_err(|error| PositioningError::method(id, error))?;
        Ok([
            OutputFile { name: format!("product-{id}.json"), contents: json + "\n" },
            OutputFile { name: format!("samples-{id}.csv"), contents: self.csv() },
        ])
    }

    fn csv(&self) -> String {
        let d = self.points.dimension();
        let names: Vec<String> = (1..=d).map(|k| format!("x{k}")).collect();
        let mut text = names.join(",") + "\n";
        for point in self.points.points().chunks_exact(d) {
            for (k, value) in point.iter().enumerate() {
                // Writing to a string cannot fail.
                let _ = write!(text, "{}{value}", if k == 0 { "" } else { "," });
            }
            text.push('\n');
        }
        text
    }
}
