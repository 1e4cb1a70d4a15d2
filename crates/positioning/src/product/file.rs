//! Reading mixtures, and the recorded answer, from a JSON file.
//!
//! `dimension`; `mixtures`, each of `weights` (N), `means` (N of d numbers) and `covariances` (N of d rows of d
//! numbers); and, optionally, `golden`: `log_normaliser`, `mean`, `covariance` and `modes` (`location`, `mass`) of
//! the exact product. Other keys are left unread.

use std::path::Path;

use serde::Deserialize;
use sumprod_graph::Space;
use sumprod_messages::Mixture;

use crate::error::PositioningError;

/// The exact product as the file records it.
#[derive(Clone, Debug, Deserialize)]
pub(super) struct Recorded {
    pub(super) log_normaliser: f64,
    pub(super) mean: Vec<f64>,
    pub(super) covariance: Vec<Vec<f64>>,
    #[serde(default)]
    pub(super) modes: Vec<RecordedMode>,
}

/// A mode of the exact product.
#[derive(Clone, Debug, Deserialize)]
pub(super) struct RecordedMode {
    pub(super) location: Vec<f64>,
    pub(super) mass: f64,
}

#[derive(Deserialize)]
struct Contents {
    dimension: usize,
    mixtures: Vec<Components>,
    golden: Option<Recorded>,
}

#[derive(Deserialize)]
struct Components {
    weights: Vec<f64>,
    means: Vec<Vec<f64>>,
    covariances: Vec<Vec<Vec<f64>>>,
}

/// The mixtures of a file, at least one, all of one dimension; and the exact product where it is recorded.
///
/// # Errors
/// [`PositioningError::Data`] naming the file and what is wrong in it.
pub(super) fn read(path: &Path) -> Result<(Vec<Mixture>, Option<Recorded>), PositioningError> {
    let wrong = |problem: String| PositioningError::data(path, None, problem);
    if path.is_dir() {
        return Err(wrong("this is a folder; name one file of mixtures".into()));
    }
    let text = std::fs::read_to_string(path).map_err(|error| wrong(format!("cannot be read: {error}")))?;
    let contents: Contents = serde_json::from_str(&text).map_err(|error| {
        let problem = error.to_string();
        let problem = problem.split(" at line").next().unwrap_or(&problem);
        let line = Some(error.line()).filter(|&line| line > 0);
        let column = error.column();
        PositioningError::data(path, line, format!("column {column}: {problem}"))
    })?;
    let d = contents.dimension;
    if d == 0 {
        return Err(wrong("`dimension` is 0; a mixture needs at least one coordinate".into()));
    }
    if contents.mixtures.is_empty() {
        return Err(wrong("`mixtures` is empty; a product needs at least one mixture".into()));
    }
    let mixtures = (1..).zip(&contents.mixtures).map(|(number, components)| {
        components.mixture(d).map_err(|problem| wrong(format!("mixture {number}: {problem}")))
    });
    let mixtures = mixtures.collect::<Result<_, _>>()?;
    if let Some(recorded) = &contents.golden {
        recorded.check(d).map_err(wrong)?;
    }
    Ok((mixtures, contents.golden))
}

impl Components {
    fn mixture(&self, d: usize) -> Result<Mixture, String> {
        let count = self.weights.len();
        if count == 0 {
            return Err("`weights` is empty; a mixture needs at least one component".into());
        }
        for (name, found) in [("means", self.means.len()), ("covariances", self.covariances.len())] {
            if found != count {
                return Err(format!("`{name}` has {found} entries, `weights` {count}; give one a component"));
            }
        }
        for (number, &weight) in (1..).zip(&self.weights) {
            if !(weight >= 0.0 && weight.is_finite()) {
                return Err(format!("weight {number} is {weight}; a weight is finite and not negative"));
            }
        }
        if self.weights.iter().all(|&weight| weight == 0.0) {
            return Err("every weight is zero; give at least one component a positive one".into());
        }
        for (number, (mean, covariance)) in (1..).zip(self.means.iter().zip(&self.covariances)) {
            component(d, mean, covariance).map_err(|problem| format!("component {number}: {problem}"))?;
        }
        let space = Space::real(d);
        let log_weights = self.weights.iter().map(|weight| weight.ln()).collect();
        let means = self.means.concat();
        let shared = self.covariances.iter().all(|covariance| *covariance == self.covariances[0]);
        let mixture = if shared {
            Mixture::with_shared_covariance(&space, log_weights, means, self.covariances[0].concat())
        } else {
            let covariances = self.covariances.iter().flatten().flatten().copied().collect();
            Mixture::new(&space, log_weights, means, covariances)
        };
        mixture.map_err(|error| error.to_string())
    }
}

fn component(d: usize, mean: &[f64], covariance: &[Vec<f64>]) -> Result<(), String> {
    if mean.len() != d {
        return Err(format!("the mean has {} numbers, `dimension` is {d}", mean.len()));
    }
    square(d, covariance)?;
    for (row, values) in covariance.iter().enumerate() {
        for (column, value) in values[..row].iter().enumerate() {
            let other = covariance[column][row];
            if (value - other).abs() > 1e-9 * value.abs().max(other.abs()) {
                return Err(format!("the covariance is not symmetric: {value} against {other}"));
            }
        }
    }
    // One component by itself, so that a wrong one is named.
    Mixture::new(&Space::real(d), vec![0.0], mean.to_vec(), covariance.concat())
        .map(|_| ())
        .map_err(|error| error.to_string())
}

fn square(d: usize, matrix: &[Vec<f64>]) -> Result<(), String> {
    match matrix.iter().find(|row| row.len() != d) {
        Some(row) => Err(format!("a row of the covariance has {} numbers, `dimension` is {d}", row.len())),
        None if matrix.len() != d => {
            Err(format!("the covariance has {} rows, `dimension` is {d}", matrix.len()))
        }
        None => Ok(()),
    }
}

impl Recorded {
    fn check(&self, d: usize) -> Result<(), String> {
        let short = |what: &str, found: usize| Err(format!("`golden`: {what} has {found} numbers, not {d}"));
        if self.mean.len() != d {
            return short("`mean`", self.mean.len());
        }
        square(d, &self.covariance).map_err(|problem| format!("`golden`: {problem}"))?;
        if let Some(k) = (0..d).find(|&k| self.covariance[k][k] <= 0.0) {
            return Err(format!("`golden`: variance {} is {}; it is positive", k + 1, self.covariance[k][k]));
        }
        match self.modes.iter().find(|mode| mode.location.len() != d) {
            Some(mode) => short("the location of a mode", mode.location.len()),
            None => Ok(()),
        }
    }
}
