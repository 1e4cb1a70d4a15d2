//! System `seafloor`: an instrument at the bottom of the sea, located by the pings of a ship that sails around it.
//!
//! The position and the speed of sound are unknown together: depth, speed and the transponder's turn-around time are
//! nearly one direction of the state, so the last is held, and the first two have wide priors, the one at the drop
//! point. A robust kernel bears the pings that answer something else. Rays are straight, which a speed of sound averaged
//! along them absorbs; the ship stands still while a ping is under way.
//!
//! Method `joint` is the minimum of the whole graph. Data: J. B. Russell, Z. Eilon, S. G. Mosher, "OBSrange: A new tool for
//! the precise remote location of ocean-bottom seismometers", Seismological Research Letters 90(4), 2019.

mod frame;
pub mod recording;
mod solve;

use std::fmt::Write;
use std::path::Path;

use serde::{Deserialize, Serialize};
use sumprod_exact::Kernel;

use crate::error::PositioningError;
use crate::results::{MethodRun, OutputFile, RunResult, StateLayout};
use crate::robots::numbers::positive;
use crate::scenario::{FormUse, GraphSummary, Methods, RunRequest, Scenario};
use recording::Recording;
use solve::{Found, Network, PING, PRIOR};

/// Residuals beyond this many standard deviations are counted as outliers.
const OUTLIER: f64 = 5.0;
/// Pings that fit worse than this many times their standard deviation are noted.
const MISFIT: f64 = 3.0;

/// A scenario of system `seafloor`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Seafloor {
    /// The station, and what is known of the water.
    pub world: WorldSettings,
    /// The methods to compare.
    pub method: Methods<MethodSettings>,
}

/// The `[world]` table.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WorldSettings {
    /// Name of the station, whose pings are in the file of this name.
    pub station: String,
    /// Speed of sound (m/s) that is held instead of estimated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fixed_sound_speed: Option<f64>,
    /// Time that the transponder takes to answer (s).
    pub turn_around_s: f64,
    /// Variance of a travel time (s²).
    pub time_variance: f64,
    /// Variance of the instrument's place about the drop point, along each horizontal axis (m²).
    pub drop_variance: f64,
    /// Variance of its depth about the water's depth there (m²).
    pub depth_variance: f64,
    /// Mean of the speed of sound before any ping (m/s).
    pub sound_speed: f64,
    /// Its variance (m²/s²).
    pub sound_speed_variance: f64,
}

/// One `[method.ID]` table.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MethodSettings {
    /// How a ping that does not fit is judged, its width in standard deviations.
    pub kernel: Kernel,
}

impl MethodSettings {
    fn validate(&self, id: &str) -> Result<(), PositioningError> {
        let (Kernel::Huber(width)
        | Kernel::Cauchy(width)
        | Kernel::GemanMcclure(width)
        | Kernel::Tukey(width)) = self.kernel
        else {
            return Ok(());
        };
        positive(&format!("method.{id}.kernel"), width)
    }
}

impl WorldSettings {
    fn validate(&self) -> Result<(), PositioningError> {
        let plain = |letter: char| letter.is_ascii_alphanumeric() || "-_.".contains(letter);
        if self.station.is_empty() || self.station.starts_with('.') || !self.station.chars().all(plain) {
            let problem =
                format!("is {:?}; a station is named by letters and digits, for instance CC03", self.station);
            return Err(PositioningError::setting("world.station", problem));
        }
        if !self.turn_around_s.is_finite() {
            let problem = format!("is {} s; it must be finite", self.turn_around_s);
            return Err(PositioningError::setting("world.turn_around_s", problem));
        }
        let fixed = self.fixed_sound_speed.map(|speed| ("fixed_sound_speed", speed));
        [
            ("time_variance", self.time_variance),
            ("drop_variance", self.drop_variance),
            ("depth_variance", self.depth_variance),
            ("sound_speed", self.sound_speed),
            ("sound_speed_variance", self.sound_speed_variance),
        ]
        .into_iter()
        .chain(fixed)
        .try_for_each(|(key, value)| positive(&format!("world.{key}"), value))
    }
}

impl Seafloor {
    /// What a solve says of itself, and of the authors' answer.
    fn report(&self, recording: &Recording, found: &Found, out: &mut MethodRun) {
        let [x, y, z, speed] = found.state.mean[..] else { return };
        let deviation = self.world.time_variance.sqrt();
        let fits = |residual: &&f64| residual.abs() <= OUTLIER * deviation;
        let inside: Vec<f64> = found.residuals.iter().filter(fits).copied().collect();
        let square = inside.iter().map(|residual| residual * residual).sum::<f64>();
        let rms = (square / inside.len().max(1) as f64).sqrt();
        for (name, value) in [
            ("position.x_m", x),
            ("position.y_m", y),
            ("position.z_m", z),
            ("sound_speed_mps", speed),
            ("residual_rms_ms", 1e3 * rms),
            ("pings.used", inside.len() as f64),
            ("pings.outliers", (found.residuals.len() - inside.len()) as f64),
            ("pings.unanswered", recording.skipped as f64),
            ("iterations", found.iterations as f64),
        ] {
            out.diagnose(name, value);
        }
        for (k, name) in ["x_m", "y_m", "z_m", "sound_speed_mps"].into_iter().enumerate() {
            out.diagnose(&format!("two_sigma.{name}"), 2.0 * found.state.covariance_at(k, k).sqrt());
        }
        if let Some(published) = &recording.published {
            let [east, north, up] = published.position;
            out.diagnose("to_published.horizontal_m", (x - east).hypot(y - north));
            out.diagnose("to_published.depth_m", up - z);
            out.diagnose("to_published.sound_speed_mps", speed - published.sound_speed);
        }
        if inside.len() * 2 < found.residuals.len() || rms > MISFIT * deviation {
            out.notes.push(format!(
                "{} of {} travel times fit within {:.1} ms: these may be no two-way times, or `world.time_variance` is \
                 too small",
                inside.len(),
                found.residuals.len(),
                1e3 * OUTLIER * deviation
            ));
        }
    }

    /// Position and speed of sound with twice their standard deviations, and the residual of every ping.
    fn files(&self, recording: &Recording, found: &Found) -> Vec<OutputFile> {
        let mut estimates = String::from(
            "station,x,y,z,sound_speed,two_sigma_x,two_sigma_y,two_sigma_z,two_sigma_sound_speed\n",
        );
        estimates += &self.world.station;
        // Writing to a string cannot fail.
        for value in &found.state.mean {
            let _ = write!(estimates, ",{value}");
        }
        for k in 0..found.state.dimension() {
            let _ = write!(estimates, ",{}", 2.0 * found.state.covariance_at(k, k).sqrt());
        }
        estimates.push('\n');
        let mut pings = String::from("line,time_s,travel_time_s,residual_s\n");
        for (ping, residual) in recording.pings.iter().zip(&found.residuals) {
            let _ = writeln!(pings, "{},{},{},{residual}", ping.line, ping.time, ping.travel_time);
        }
        vec![
            OutputFile { name: "estimates.csv".to_owned(), contents: estimates },
            OutputFile { name: "pings.csv".to_owned(), contents: pings },
        ]
    }
}

impl Scenario for Seafloor {
    const SYSTEM: &'static str = "seafloor";
    const READS_DATA: bool = true;
    type Prepared = Recording;

    fn validate(&self) -> Result<(), PositioningError> {
        self.world.validate()?;
        self.method.iter().try_for_each(|(id, method)| method.validate(id))
    }

    fn methods(&self) -> Vec<String> {
        self.method.ids()
    }

    fn prepare(&self, _seed: u64, data: Option<&Path>) -> Result<Recording, PositioningError> {
        Recording::read(data.unwrap_or(Path::new(".")), &self.world.station)
    }

    fn run(&self, recording: &Recording, request: RunRequest<'_>) -> Result<RunResult, PositioningError> {
        let mut methods = Vec::with_capacity(request.methods.len());
        let mut files = Vec::new();
        for id in request.methods {
            let kernel = self.method.named(id)?.kernel;
            methods.push(MethodRun::timed(id, StateLayout::default(), |out| {
                let found = Network::new(recording, &self.world)?.solve(kernel)?;
                self.report(recording, &found, out);
                if files.is_empty() {
                    files = self.files(recording, &found);
                }
                Ok::<(), PositioningError>(())
            })?);
        }
        Ok(RunResult { run: request.run, methods, files, ..RunResult::default() })
    }

    fn check(
        &self,
        recording: &Recording,
        _seed: u64,
        methods: &[String],
    ) -> Result<Vec<GraphSummary>, PositioningError> {
        let network = Network::new(recording, &self.world)?;
        let of = |kind: &str, edges| FormUse { kind: kind.to_owned(), form: "gaussian".to_owned(), edges };
        let forms = vec![of(PRIOR, 2), of(PING, 2 * recording.pings.len())];
        let summary = |id: &String| GraphSummary::new(id, "the whole file", &network.graph, forms.clone());
        Ok(methods.iter().map(summary).collect())
    }
}

#[cfg(test)]
mod tests;
