//! The graph as the robot sees it grow: step k has the poses up to k and every factor whose variables are present.

use sumprod_graph::{Coordinate, Space};
use sumprod_models::library::pose::{between, compose};
use sumprod_models::library::{CliqueRange, PosePrior, RangeClique, RelativePose};
use sumprod_models::{Block, Cluster, Noise};

use super::file::{RangeGraph, RelativeLine};
use crate::PositioningError;

/// Coordinates of a pose.
pub(super) const POSE: usize = 3;

/// A graph whose every pose is constrained as soon as it is present.
#[derive(Clone, Debug)]
pub struct Growing {
    graph: RangeGraph,
    /// Where odometry puts each pose, from the prior on.
    starts: Vec<[f64; POSE]>,
}

/// A landmark that has been measured, with its ranges.
#[derive(Clone, Debug)]
pub(super) struct Seen {
    /// Number of the landmark.
    pub(super) landmark: usize,
    pub(super) clique: RangeClique,
}

impl Growing {
    /// Checks that each pose is tied to a prior or an earlier pose, and each landmark to a pose.
    ///
    /// # Errors
    /// [`PositioningError::Unconstrained`] naming the variable.
    pub fn new(graph: RangeGraph) -> Result<Self, PositioningError> {
        let mut starts: Vec<[f64; POSE]> = Vec::with_capacity(graph.poses.len());
        for (number, pose) in graph.poses.iter().enumerate() {
            let prior = graph.priors.iter().find(|prior| prior.pose == number).map(|prior| prior.at);
            let start =
                prior.or_else(|| graph.relative.iter().find_map(|line| reached(line, number, &starts)));
            let remedy = "give it a prior, or a relative pose to one before it";
            starts.push(start.ok_or_else(|| unconstrained(&pose.name, remedy))?);
        }
        for (number, landmark) in graph.landmarks.iter().enumerate() {
            if !graph.ranges.iter().any(|range| range.landmark == number) {
                return Err(unconstrained(&landmark.name, "give it a range from a pose"));
            }
        }
        Ok(Self { graph, starts })
    }

    /// The graph as it was read.
    pub fn graph(&self) -> &RangeGraph {
        &self.graph
    }

    /// Number of steps: that of the poses.
    pub fn steps(&self) -> usize {
        self.graph.poses.len()
    }

    /// The space of the trajectory up to `step`: its poses one after the other.
    pub(super) fn trajectory_space(step: usize) -> Space {
        let pose = [Coordinate::Real, Coordinate::Real, Coordinate::Angle];
        Space::new(pose.repeat(step + 1))
    }

    /// Where odometry puts the trajectory up to `step`.
    pub(super) fn start(&self, step: usize) -> &[f64] {
        self.starts[..=step].as_flattened()
    }

    /// Priors and relative poses up to `step`, as one factor of the trajectory.
    ///
    /// # Errors
    /// [`PositioningError::Results`] where a constructor refuses what the reader has let pass.
    pub(super) fn odometry(&self, step: usize) -> Result<Cluster, PositioningError> {
        let mut cluster = Cluster::new(POSE * (step + 1));
        self.odometry_factors(step, |factor, poses| {
            let blocks: Vec<Block> = poses.iter().map(|pose| Block::new(POSE * pose, POSE)).collect();
            match factor {
                Odometry::Prior(prior) => cluster.add(prior, &blocks),
                Odometry::Relative(relative) => cluster.add(relative, &blocks),
            }
        })?;
        Ok(cluster)
    }

    /// Hands over each prior and relative pose up to `step` with the numbers of its poses.
    fn odometry_factors(
        &self,
        step: usize,
        mut take: impl FnMut(Odometry, &[usize]) -> Result<(), sumprod_graph::MessageError>,
    ) -> Result<(), PositioningError> {
        for line in self.graph.priors.iter().filter(|line| line.pose <= step) {
            let prior = PosePrior::new(line.at, line.noise.clone()).map_err(refused)?;
            take(Odometry::Prior(prior), &[line.pose]).map_err(refused)?;
        }
        for line in self.graph.relative.iter().filter(|line| line.from.max(line.to) <= step) {
            let relative = RelativePose::new(line.measured, line.noise.clone()).map_err(refused)?;
            take(Odometry::Relative(relative), &[line.from, line.to]).map_err(refused)?;
        }
        Ok(())
    }

    /// The landmarks measured up to `step`.
    ///
    /// # Errors
    /// As [`Growing::odometry`].
    pub(super) fn seen(&self, step: usize) -> Result<Vec<Seen>, PositioningError> {
        let mut seen = Vec::new();
        for landmark in 0..self.graph.landmarks.len() {
            let mine =
                || self.graph.ranges.iter().filter(|range| range.landmark == landmark && range.pose <= step);
            let mut poses: Vec<usize> = mine().map(|range| range.pose).collect();
            poses.sort_unstable();
            poses.dedup();
            if poses.is_empty() {
                continue;
            }
            let ranges = mine().map(|range| CliqueRange {
                position: poses.partition_point(|&pose| pose < range.pose),
                measured: range.measured,
                variance: range.variance,
            });
            let positions: Vec<[usize; 2]> =
                poses.iter().map(|pose| [POSE * pose, POSE * pose + 1]).collect();
            let clique =
                RangeClique::new(POSE * (step + 1), &positions, ranges.collect()).map_err(refused)?;
            seen.push(Seen { landmark, clique });
        }
        Ok(seen)
    }

    /// The exact factors of the trajectory up to `step`, to weigh draws by.
    ///
    /// # Errors
    /// As [`Growing::odometry`].
    pub(super) fn exact(&self, step: usize) -> Result<Exact, PositioningError> {
        let mut factors = Vec::new();
        self.odometry_factors(step, |factor, poses| {
            factors.push((factor, poses.to_vec()));
            Ok(())
        })?;
        Ok(Exact(factors))
    }
}

enum Odometry {
    Prior(PosePrior),
    Relative(RelativePose),
}

/// Priors and relative poses with the numbers of their poses.
pub(super) struct Exact(Vec<(Odometry, Vec<usize>)>);

impl Exact {
    /// Log density of a trajectory under all of them.
    pub(super) fn log_density(&self, trajectory: &[f64]) -> f64 {
        let pose = |number: usize| &trajectory[POSE * number..][..POSE];
        let each = self.0.iter().map(|(factor, poses)| match (factor, poses.as_slice()) {
            (Odometry::Prior(prior), &[at]) => log_density(prior, &[pose(at)]),
            (Odometry::Relative(relative), &[from, to]) => log_density(relative, &[pose(from), pose(to)]),
            _ => 0.0,
        });
        each.sum()
    }
}

fn log_density<R: sumprod_models::Residual>(factor: &R, poses: &[&[f64]]) -> f64 {
    let noise: &Noise = factor.noise();
    let mut residual = [0.0; POSE];
    factor.residual(poses, &mut residual);
    noise.log_density(&residual)
}

/// Where a line puts the pose `number`, if its other end is placed already.
fn reached(line: &RelativeLine, number: usize, starts: &[[f64; POSE]]) -> Option<[f64; POSE]> {
    if line.to == number {
        return starts.get(line.from).map(|from| compose(from, &line.measured));
    }
    let to = starts.get(line.to).filter(|_| line.from == number)?;
    Some(compose(to, &between(&line.measured, &[0.0; POSE])))
}

fn unconstrained(name: &str, remedy: &str) -> PositioningError {
    PositioningError::Unconstrained { what: name.to_owned(), remedy: remedy.to_owned() }
}

fn refused(error: sumprod_graph::MessageError) -> PositioningError {
    PositioningError::Results { problem: error.to_string() }
}
