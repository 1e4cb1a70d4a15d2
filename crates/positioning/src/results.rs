//! What one run returns: each method's estimates beside the truth, and what is known about the run.
//!
//! Estimates are held by columns, since a recording scores hundreds of thousands of them.

use std::time::Instant;

use serde::{Deserialize, Serialize};

use crate::error::PositioningError;

/// Which components of a state vector are positions, velocities, angles and a clock.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct StateLayout {
    /// Name of each component with its unit, as column names: `x_m`, `vx_mps`, `heading_rad`.
    pub names: Vec<String>,
    /// Indices of the position's axes (m), at least one where position metrics are wanted.
    pub position: Vec<usize>,
    /// Indices of the velocity's axes (m/s); empty where the state has no velocity.
    pub velocity: Vec<usize>,
    /// Indices of angles (rad), whose errors are wrapped to (−π, π].
    pub angular: Vec<usize>,
    /// Indices of a clock's offset (s) and of its skew (ppm); empty where the state has no clock.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub clock: Vec<usize>,
}

impl StateLayout {
    /// Position in the plane: `[x, y]`.
    pub fn planar_position() -> Self {
        Self::of(&["x_m", "y_m"], &[0, 1], &[], &[])
    }

    /// Position and velocity in the plane: `[x, vx, y, vy]`.
    pub fn planar_velocity() -> Self {
        Self::of(&["x_m", "vx_mps", "y_m", "vy_mps"], &[0, 2], &[1, 3], &[])
    }

    /// Pose in the plane: `[x, y, heading]`.
    pub fn planar_pose() -> Self {
        Self::of(&["x_m", "y_m", "heading_rad"], &[0, 1], &[], &[2])
    }

    fn of(names: &[&str], position: &[usize], velocity: &[usize], angular: &[usize]) -> Self {
        Self {
            names: names.iter().map(|&name| name.to_owned()).collect(),
            position: position.to_vec(),
            velocity: velocity.to_vec(),
            angular: angular.to_vec(),
            clock: Vec::new(),
        }
    }

    /// Position and velocity in space: `[x, vx, y, vy, z, vz]`.
    pub fn spatial_velocity() -> Self {
        Self::of(&["x_m", "vx_mps", "y_m", "vy_mps", "z_m", "vz_mps"], &[0, 2, 4], &[1, 3, 5], &[])
    }

    /// The same state followed by a clock's offset (s) and skew (ppm).
    #[must_use]
    pub fn with_clock(mut self) -> Self {
        let first = self.dimension();
        self.names.extend(["clock_offset_s", "clock_skew_ppm"].map(str::to_owned));
        self.clock = vec![first, first + 1];
        self
    }

    /// Number of components.
    pub fn dimension(&self) -> usize {
        self.names.len()
    }

    /// The components that errors and intervals are judged on: the position's axes, else all of them.
    pub fn scored(&self) -> Vec<usize> {
        if self.position.is_empty() { (0..self.dimension()).collect() } else { self.position.clone() }
    }

    /// Largest index used by any role, plus one.
    fn reach(&self) -> usize {
        let roles = [&self.position, &self.velocity, &self.angular, &self.clock];
        roles.into_iter().flatten().map(|&i| i + 1).max().unwrap_or(0)
    }
}

/// Everything that one run returns.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RunResult {
    /// Index of the run, from 0.
    pub run: u32,
    /// Names of the nodes; estimates refer to them by index.
    pub nodes: Vec<String>,
    /// Places known beforehand: anchors, landmarks, beacons. Drawn, not scored.
    pub anchors: Vec<Anchor>,
    /// Named stretches of time that are judged by themselves.
    pub segments: Vec<Segment>,
    /// Lower bound of the position error, empty where none is known.
    pub bound: Vec<BoundStep>,
    /// The methods, in the order in which they were asked for.
    pub methods: Vec<MethodRun>,
    /// Files of the system's own, written to the output folder beside the estimates; those of run 0 alone.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub files: Vec<OutputFile>,
}

/// A file that a system writes besides the estimates: samples, marginals.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct OutputFile {
    /// Its name within the output folder.
    pub name: String,
    /// Its text.
    pub contents: String,
}

/// A place known beforehand.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Anchor {
    /// Its name.
    pub name: String,
    /// Coordinates (m), in the order of the layouts' position axes.
    pub position: Vec<f64>,
}

/// A named stretch of scored steps.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Segment {
    /// Its name, for instance `turn`.
    pub name: String,
    /// First step.
    pub first: u32,
    /// Last step, included.
    pub last: u32,
}

/// Posterior Cramér–Rao bound at one step.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct BoundStep {
    /// The scored step.
    pub step: u32,
    /// Time (s).
    pub time: f64,
    /// Trace of the position block of the bound (m²), averaged over the nodes.
    pub position_variance: f64,
}

/// A number that a method reports about itself.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Diagnostic {
    /// Its name; a dot groups, as in `conversion_loss.range`.
    pub name: String,
    /// Its value, finite.
    pub value: f64,
}

/// Numbers that a method reports about itself as one array.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DiagnosticList {
    /// Its name; a dot groups.
    pub name: String,
    /// Its finite values, as many in every run.
    pub values: Vec<f64>,
}

/// A number that a method reports about itself at every step.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DiagnosticSeries {
    /// Its name; a dot groups.
    pub name: String,
    /// Scored steps, ascending.
    pub steps: Vec<u32>,
    /// One finite value a step.
    pub values: Vec<f64>,
}

/// One method's estimates in one run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MethodRun {
    /// The method's id.
    pub id: String,
    /// Wall-clock time of the method alone (s).
    pub seconds: f64,
    /// Meaning of the state's components.
    pub layout: StateLayout,
    /// Named numbers, averaged over the runs by the metrics; `n_eff` is the effective sample size.
    pub diagnostics: Vec<Diagnostic>,
    /// Named arrays, averaged over the runs entry by entry.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub lists: Vec<DiagnosticList>,
    /// Named numbers by step.
    pub series: Vec<DiagnosticSeries>,
    /// Sentences for the reader, each shown once.
    pub notes: Vec<String>,
    steps: Vec<u32>,
    times: Vec<f64>,
    nodes: Vec<u32>,
    truth: Vec<f64>,
    mean: Vec<f64>,
    covariance: Vec<f64>,
    /// Low and high end of each scored component, estimate by estimate; empty where there are none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    intervals: Vec<[f64; 2]>,
}

impl MethodRun {
    /// A method without estimates yet.
    pub fn new(id: &str, layout: StateLayout) -> Self {
        Self {
            id: id.to_owned(),
            seconds: 0.0,
            layout,
            diagnostics: Vec::new(),
            lists: Vec::new(),
            series: Vec::new(),
            notes: Vec::new(),
            steps: Vec::new(),
            times: Vec::new(),
            nodes: Vec::new(),
            truth: Vec::new(),
            mean: Vec::new(),
            covariance: Vec::new(),
            intervals: Vec::new(),
        }
    }

    /// Runs `work` on a new method and notes how long it took.
    ///
    /// # Errors
    /// Whatever `work` returns.
    pub fn timed<E>(
        id: &str,
        layout: StateLayout,
        work: impl FnOnce(&mut Self) -> Result<(), E>,
    ) -> Result<Self, E> {
        let mut method = Self::new(id, layout);
        let start = Instant::now();
        work(&mut method)?;
        method.seconds = start.elapsed().as_secs_f64();
        Ok(method)
    }

    /// Adds the estimate of one node at one scored step.
    ///
    /// `truth` and `mean` have d entries; `covariance` has d·d, of which the symmetric part is kept (so row-major
    /// and column-major are the same). `time` is in seconds. O(d²).
    ///
    /// # Errors
    /// [`PositioningError::Estimate`] if a length is not the layout's, a number is not finite, or a variance is
    /// negative.
    pub fn push(
        &mut self,
        step: u32,
        time: f64,
        node: u32,
        truth: &[f64],
        mean: &[f64],
        covariance: &[f64],
    ) -> Result<(), PositioningError> {
        let d = self.layout.dimension();
        if let Some(problem) = self.problem(time, truth, mean, covariance) {
            return Err(PositioningError::Estimate { method: self.id.clone(), step, node, problem });
        }
        self.steps.push(step);
        self.times.push(time);
        self.nodes.push(node);
        self.truth.extend_from_slice(truth);
        self.mean.extend_from_slice(mean);
        for i in 0..d {
            for j in 0..=i {
                self.covariance.push(0.5 * (covariance[i * d + j] + covariance[j * d + i]));
            }
        }
        Ok(())
    }

    /// As [`push`](Self::push), with the central 95 % interval of each of the layout's
    /// [scored](StateLayout::scored) components, low and high end. Coverage is then the share of components inside
    /// their intervals instead of the share of positions inside the covariance's region: for posteriors that no
    /// ellipse describes. A method gives intervals with all of its estimates or with none.
    ///
    /// # Errors
    /// As [`push`](Self::push), and where an interval is missing, not finite or upside down.
    #[allow(clippy::too_many_arguments, reason = "a row of the columns, as push")]
    pub fn push_with_intervals(
        &mut self,
        step: u32,
        time: f64,
        node: u32,
        truth: &[f64],
        mean: &[f64],
        covariance: &[f64],
        intervals: &[[f64; 2]],
    ) -> Result<(), PositioningError> {
        let fail = |problem| PositioningError::Estimate { method: self.id.clone(), step, node, problem };
        let scored = self.layout.scored().len();
        if intervals.len() != scored {
            return Err(fail(format!("{} intervals were given for {scored} components", intervals.len())));
        }
        if let Some([low, high]) =
            intervals.iter().find(|[low, high]| !(low.is_finite() && high.is_finite() && low <= high))
        {
            return Err(fail(format!("an interval reaches from {low} to {high}")));
        }
        if self.intervals.len() != self.len() * scored {
            return Err(fail("estimates before this one came without intervals".to_owned()));
        }
        self.push(step, time, node, truth, mean, covariance)?;
        self.intervals.extend_from_slice(intervals);
        Ok(())
    }

    fn problem(&self, time: f64, truth: &[f64], mean: &[f64], covariance: &[f64]) -> Option<String> {
        let d = self.layout.dimension();
        if self.layout.reach() > d {
            return Some(format!("the layout refers to component {}, of {d}", self.layout.reach() - 1));
        }
        if truth.len() != d || mean.len() != d || covariance.len() != d * d {
            let found = [truth.len(), mean.len(), covariance.len()];
            return Some(format!(
                "truth, mean and covariance have {found:?} numbers, not [{d}, {d}, {}]",
                d * d
            ));
        }
        let parts = [
            ("time", std::slice::from_ref(&time)),
            ("truth", truth),
            ("mean", mean),
            ("covariance", covariance),
        ];
        for (part, values) in parts {
            if let Some(i) = values.iter().position(|value| !value.is_finite()) {
                return Some(format!("entry {i} of the {part} is {}", values[i]));
            }
        }
        let negative = (0..d).find(|&i| covariance[i * d + i] < 0.0)?;
        Some(format!(
            "the variance of {} is {}",
            self.layout.names[negative],
            covariance[negative * d + negative]
        ))
    }

    /// Adds a named number.
    pub fn diagnose(&mut self, name: &str, value: f64) {
        self.diagnostics.push(Diagnostic { name: name.to_owned(), value });
    }

    /// Adds a named array.
    pub fn list(&mut self, name: &str, values: Vec<f64>) {
        self.lists.push(DiagnosticList { name: name.to_owned(), values });
    }

    /// Number of estimates.
    pub fn len(&self) -> usize {
        self.steps.len()
    }

    /// Whether there is no estimate.
    pub fn is_empty(&self) -> bool {
        self.steps.is_empty()
    }

    /// The estimates in the order in which they were added.
    pub fn estimates(&self) -> impl Iterator<Item = Estimate<'_>> {
        let d = self.layout.dimension();
        let packed = d * (d + 1) / 2;
        let scored = self.layout.scored().len();
        (0..self.len()).map(move |k| Estimate {
            intervals: self.intervals.get(k * scored..(k + 1) * scored).unwrap_or_default(),
            step: self.steps[k],
            time: self.times[k],
            node: self.nodes[k],
            truth: &self.truth[k * d..(k + 1) * d],
            mean: &self.mean[k * d..(k + 1) * d],
            covariance: &self.covariance[k * packed..(k + 1) * packed],
        })
    }

    /// Whether the columns have the lengths that the layout implies: false for a damaged record.
    pub(crate) fn is_whole(&self) -> bool {
        let (n, d) = (self.steps.len(), self.layout.dimension());
        self.layout.reach() <= d
            && self.times.len() == n
            && self.nodes.len() == n
            && self.truth.len() == n * d
            && self.mean.len() == n * d
            && self.covariance.len() == n * d * (d + 1) / 2
            && (self.intervals.is_empty() || self.intervals.len() == n * self.layout.scored().len())
    }
}

/// One estimate beside the truth.
#[derive(Clone, Copy, Debug)]
pub struct Estimate<'a> {
    /// The scored step.
    pub step: u32,
    /// Time (s).
    pub time: f64,
    /// Index of the node.
    pub node: u32,
    /// True state, d entries.
    pub truth: &'a [f64],
    /// Estimated state, d entries.
    pub mean: &'a [f64],
    /// Lower triangle of the covariance by rows, d(d+1)/2 entries.
    pub covariance: &'a [f64],
    /// Central 95 % interval of each scored component; empty where the method gives none.
    pub intervals: &'a [[f64; 2]],
}

impl Estimate<'_> {
    /// Covariance of components `i` and `j`.
    pub fn covariance_at(&self, i: usize, j: usize) -> f64 {
        let (row, column) = if i >= j { (i, j) } else { (j, i) };
        self.covariance[row * (row + 1) / 2 + column]
    }

    /// Error of component `i`, estimate minus truth, wrapped to (−π, π] if the layout calls it an angle.
    pub fn error_at(&self, i: usize, layout: &StateLayout) -> f64 {
        use std::f64::consts::{PI, TAU};
        let error = self.mean[i] - self.truth[i];
        if !layout.angular.contains(&i) {
            return error;
        }
        let wrapped = error.rem_euclid(TAU);
        if wrapped > PI { wrapped - TAU } else { wrapped }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn estimates_come_back_as_they_went_in() {
        let mut method = MethodRun::new("kf", StateLayout::planar_pose());
        let covariance = [4.0, 1.0, 0.5, 1.0, 3.0, 0.2, 0.5, 0.2, 2.0];
        method.push(3, 1.5, 1, &[0.0, 0.0, 3.0], &[1.0, -1.0, -3.0], &covariance).unwrap();
        let estimate = method.estimates().next().unwrap();
        assert_eq!((estimate.step, estimate.time, estimate.node), (3, 1.5, 1));
        for i in 0..3 {
            for j in 0..3 {
                assert_eq!(estimate.covariance_at(i, j), covariance[3 * i + j]);
            }
        }
        let text = serde_json::to_string(&method).unwrap();
        let back: MethodRun = serde_json::from_str(&text).unwrap();
        assert_eq!(back, method);
        assert!(back.is_whole());
    }

    #[test]
    fn angle_errors_are_wrapped_and_others_are_not() {
        let layout = StateLayout::planar_pose();
        let mut method = MethodRun::new("kf", layout.clone());
        let identity = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
        method.push(0, 0.0, 0, &[10.0, 0.0, 3.0], &[0.0, 0.0, -3.0], &identity).unwrap();
        let estimate = method.estimates().next().unwrap();
        assert_eq!(estimate.error_at(0, &layout), -10.0);
        assert!((estimate.error_at(2, &layout) - (std::f64::consts::TAU - 6.0)).abs() < 1e-15);
    }

    #[test]
    fn intervals_come_with_every_estimate_or_none() {
        let mut method = MethodRun::new("pf", StateLayout::planar_pose());
        let identity = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
        let intervals = [[-1.0, 1.0], [0.0, 2.0]];
        let mut push = |intervals: &[[f64; 2]]| {
            method.push_with_intervals(0, 0.0, 0, &[0.0; 3], &[0.0; 3], &identity, intervals)
        };
        push(&intervals).unwrap();
        let sentence = push(&intervals[..1]).unwrap_err().to_string();
        assert!(sentence.ends_with("1 intervals were given for 2 components"), "{sentence}");
        let sentence = push(&[[-1.0, 1.0], [2.0, 0.0]]).unwrap_err().to_string();
        assert!(sentence.ends_with("an interval reaches from 2 to 0"), "{sentence}");
        assert_eq!(method.estimates().next().unwrap().intervals, intervals);
        method.push(1, 0.0, 0, &[0.0; 3], &[0.0; 3], &identity).unwrap();
        assert!(!method.is_whole());
    }

    #[test]
    fn numbers_that_are_not_finite_are_refused_by_name() {
        let mut method = MethodRun::new("pf", StateLayout::planar_position());
        let error = method.push(7, 0.0, 2, &[0.0; 2], &[0.0, f64::NAN], &[1.0, 0.0, 0.0, 1.0]).unwrap_err();
        assert_eq!(error.to_string(), "method `pf`, step 7, node 2: entry 1 of the mean is NaN");
        let error = method.push(7, 0.0, 2, &[0.0; 2], &[0.0; 2], &[1.0, 0.0, 0.0, -1.0]).unwrap_err();
        assert!(error.to_string().contains("the variance of y_m is -1"));
        let error = method.push(7, 0.0, 2, &[0.0; 3], &[0.0; 2], &[1.0, 0.0, 0.0, 1.0]).unwrap_err();
        assert!(error.to_string().contains("not [2, 2, 4]"));
        assert!(method.is_empty());
    }
}
