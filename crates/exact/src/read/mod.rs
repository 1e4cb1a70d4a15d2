//! Graphs from files: g2o, TORO, PyFG, and JSON of linear-Gaussian factors.
//!
//! | kind | told by | holds |
//! |---|---|---|
//! | g2o | `VERTEX_SE2`, `EDGE_SE3:QUAT`, … without times | poses and points; information matrices |
//! | TORO | `VERTEX2`, `EDGE2`, `VERTEX3`, `EDGE3` | poses; information matrices, those of the plane in their own order |
//! | PyFG | the same tags as g2o, with times and named variables | poses, points, ranges; covariances |
//! | JSON | a brace | variables with a dimension, factors Σ A x ~ N(b, R) |
//!
//! Every error names the file and the line, the field, what was found and what was expected. Graphs of finitely many states
//! are read by [`TableFile`].

mod fg;
mod fields;
mod g2o;
mod json;
mod pyfg;
mod tables;
mod toro;
mod uai;

pub use fields::TextKind;
pub use tables::{TableFactor, TableFile, TableVariable};

use crate::{ExactError, Problem, Values};
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use sumprod_graph::{FactorGraph, Space, VariableId};
use sumprod_messages::DynamicGaussian;
use sumprod_models::library::{
    LinearGaussian, PointInFrame, PosePrior, PosePrior3, PoseResidual, Prior, Range, RelativePose,
    RelativePose3,
};
use sumprod_models::{AddModel, Manifold, Noise};

/// A variable of a file.
#[derive(Clone, Debug, PartialEq)]
pub struct FileVariable {
    /// Its name, or its number as text.
    pub name: String,
    /// Its space.
    pub space: Space,
    /// The value the file gives, in stored coordinates.
    pub value: Option<Vec<f64>>,
}

/// What a factor of a file says.
#[derive(Clone, Debug, PartialEq)]
pub enum Measurement {
    /// A pose in the frame of another, as it is stored.
    RelativePose(Vec<f64>),
    /// A pose or point in the world.
    Prior(Vec<f64>),
    /// A point in the frame of a pose.
    Point(Vec<f64>),
    /// A distance between two positions (m).
    Range(f64),
    /// Σ A x = b: one matrix per variable (row-major), and the target.
    Linear(Vec<Vec<f64>>, Vec<f64>),
}

/// A factor of a file.
#[derive(Clone, Debug, PartialEq)]
pub struct FileFactor {
    /// The line it is on, from 1; none in JSON.
    pub line: Option<usize>,
    /// Numbers of its variables.
    pub variables: Vec<usize>,
    /// What it says.
    pub measurement: Measurement,
    /// Its noise covariance, row-major.
    pub covariance: Vec<f64>,
}

/// What a file holds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GraphFile {
    /// Where it was read.
    pub path: PathBuf,
    /// The variables, in the order of the file.
    pub variables: Vec<FileVariable>,
    /// The factors, in the order of the file.
    pub factors: Vec<FileFactor>,
    by_name: HashMap<String, usize>,
}

impl GraphFile {
    /// Reads a file of any of these kinds.
    ///
    /// # Errors
    ///
    /// Where the file cannot be read, is of none of these kinds, or holds anything that cannot be used.
    pub fn read(path: &Path) -> Result<Self, ExactError> {
        Self::parse(path, &text(path)?)
    }

    /// Reads a file's text; `path` is for messages.
    ///
    /// # Errors
    ///
    /// As [`GraphFile::read`].
    pub fn parse(path: &Path, text: &str) -> Result<Self, ExactError> {
        let mut file = Self { path: path.to_path_buf(), ..Self::default() };
        if text.trim_start().starts_with(['{', '[']) {
            json::read(&mut file, text)?;
        } else {
            match fields::kind(path, text)? {
                TextKind::G2o => g2o::read(&mut file, text)?,
                TextKind::Toro => toro::read(&mut file, text)?,
                TextKind::PyFg => pyfg::read(&mut file, text)?,
            }
        }
        if file.variables.is_empty() {
            return Err(ExactError::file(path, None, "holds no variable"));
        }
        if file.factors.is_empty() {
            return Err(ExactError::file(path, None, "holds no factor"));
        }
        Ok(file)
    }

    /// The number of the variable of this name.
    pub fn find(&self, name: &str) -> Option<usize> {
        self.by_name.get(name).copied()
    }

    fn add_variable(&mut self, line: Option<usize>, variable: FileVariable) -> Result<usize, ExactError> {
        let number = self.variables.len();
        if self.by_name.insert(variable.name.clone(), number).is_some() {
            let problem = format!("variable {} is given twice", variable.name);
            return Err(ExactError::file(&self.path, line, problem));
        }
        self.variables.push(variable);
        Ok(number)
    }

    /// Adds a prior that holds a variable where the file has it, or at the origin: a file of relative poses has no place
    /// in the world of its own.
    ///
    /// # Errors
    ///
    /// Where there is no such variable.
    pub fn hold(&mut self, variable: usize, translation_sd: f64, rotation_sd: f64) -> Result<(), ExactError> {
        let count = self.variables.len();
        let Some(own) = self.variables.get(variable) else {
            return Err(ExactError::Request(format!(
                "there is no variable {variable}; the file has {count}"
            )));
        };
        let mut mean = vec![0.0; own.space.dimension()];
        own.space.origin(&mut mean);
        let mean = own.value.clone().unwrap_or(mean);
        let d = own.space.degrees_of_freedom();
        let translations = match own.space {
            Space::Se2 => 2,
            Space::Se3 => 3,
            _ => d,
        };
        let mut covariance = vec![0.0; d * d];
        for k in 0..d {
            covariance[k * d + k] = if k < translations { translation_sd } else { rotation_sd }.powi(2);
        }
        let measurement = Measurement::Prior(mean);
        self.factors.push(FileFactor { line: None, variables: vec![variable], measurement, covariance });
        Ok(())
    }

    /// Whether every factor is linear and every variable real.
    pub fn is_linear(&self) -> bool {
        let linear = |factor: &FileFactor| {
            matches!(factor.measurement, Measurement::Linear(..) | Measurement::Prior(_))
        };
        !self.has_poses() && self.factors.iter().all(linear)
    }

    /// Whether a factor refers to a place of the world.
    pub fn has_priors(&self) -> bool {
        self.factors.iter().any(|factor| matches!(factor.measurement, Measurement::Prior(_)))
    }

    /// Whether the file is one of poses.
    pub fn has_poses(&self) -> bool {
        self.variables.iter().any(|v| matches!(v.space, Space::Se2 | Space::Se3))
    }

    /// The graph of this file's variables and factors, in the file's order.
    ///
    /// # Errors
    ///
    /// Where a covariance is not positive definite, named by line.
    pub fn graph(&self, residual: PoseResidual) -> Result<FactorGraph<DynamicGaussian>, ExactError> {
        let mut graph = FactorGraph::new();
        let mut handles = Vec::with_capacity(self.variables.len());
        for variable in &self.variables {
            handles.push(graph.variable(variable.name.clone(), variable.space.clone())?);
        }
        for factor in &self.factors {
            self.add_factor(&mut graph, factor, &handles, residual)?;
        }
        Ok(graph)
    }

    /// Adds one of this file's factors to a graph, of which `handles` are the variables by their number in the file.
    ///
    /// # Errors
    ///
    /// Where a covariance is not positive definite, or a variable has no handle yet.
    pub fn add_factor(
        &self,
        graph: &mut FactorGraph<DynamicGaussian>,
        factor: &FileFactor,
        handles: &[VariableId],
        residual: PoseResidual,
    ) -> Result<(), ExactError> {
        let refused = |reason: String| ExactError::file(&self.path, factor.line, reason);
        let noise = Noise::gaussian(&factor.covariance).map_err(|error| refused(error.to_string()))?;
        let handle = |&number: &usize| {
            handles
                .get(number)
                .copied()
                .ok_or_else(|| refused(format!("variable {number} is not in the graph")))
        };
        let ports = factor.variables.iter().map(handle).collect::<Result<Vec<VariableId>, _>>()?;
        self.add(graph, factor, noise, &ports, residual).map_err(refused)
    }

    fn add(
        &self,
        graph: &mut FactorGraph<DynamicGaussian>,
        factor: &FileFactor,
        noise: Noise,
        ports: &[VariableId],
        form: PoseResidual,
    ) -> Result<(), String> {
        let words = |error: sumprod_graph::MessageError| error.to_string();
        let spaces: Vec<Space> = ports.iter().map(|&port| graph.space(port).clone()).collect();
        let spatial = spaces.first() == Some(&Space::Se3);
        let added = match &factor.measurement {
            Measurement::RelativePose(z) if spatial => {
                let factor = RelativePose3::new(fixed(z)?, noise).map_err(words)?;
                graph.add("relative pose", factor.with_form(form), ports)
            }
            Measurement::RelativePose(z) => {
                let factor = RelativePose::new(fixed(z)?, noise).map_err(words)?;
                graph.add("relative pose", factor.with_form(form), ports)
            }
            Measurement::Prior(mean) => match &spaces[0] {
                Space::Se3 => graph.add("prior", PosePrior3::new(fixed(mean)?, noise).map_err(words)?, ports),
                Space::Se2 => graph.add("prior", PosePrior::new(fixed(mean)?, noise).map_err(words)?, ports),
                space => graph.add("prior", Prior::new(space, mean, noise).map_err(words)?, ports),
            },
            Measurement::Point(z) => {
                let dimension = spaces[1].dimension();
                graph.add("point in frame", PointInFrame::new(z, dimension, noise).map_err(words)?, ports)
            }
            Measurement::Range(z) => {
                let dimensions = [spaces[0].dimension(), spaces[1].dimension()];
                let in_space = |space: &Space| matches!(space.dimension(), 7) || *space == Space::real(3);
                if spaces.iter().all(in_space) {
                    let range = Range::new(*z, dimensions, [[0, 1, 2]; 2], noise).map_err(words)?;
                    graph.add("range", range, ports)
                } else {
                    graph.add("range", Range::new(*z, dimensions, [[0, 1]; 2], noise).map_err(words)?, ports)
                }
            }
            Measurement::Linear(matrices, target) => {
                let matrices: Vec<&[f64]> = matrices.iter().map(Vec::as_slice).collect();
                graph.add("linear", LinearGaussian::new(&matrices, target, noise).map_err(words)?, ports)
            }
        };
        added.map(|_| ()).map_err(|error| error.to_string())
    }

    /// The values that the file gives, where it gives them all.
    ///
    /// # Errors
    ///
    /// Where a value is none of its space.
    pub fn values(&self, problem: &Problem<'_>) -> Result<Option<Values>, ExactError> {
        let mut values = problem.start();
        for (variable, &handle) in self.variables.iter().zip(problem.variables()) {
            match &variable.value {
                Some(value) => values.set(handle, value)?,
                None if matches!(variable.space, Space::Continuous(_)) && !self.has_poses() => {}
                None => return Ok(None),
            }
        }
        Ok(Some(values))
    }
}

/// A file's text.
///
/// # Errors
///
/// Where the file cannot be read, or is no text.
pub fn text(path: &Path) -> Result<String, ExactError> {
    let bytes = std::fs::read(path)
        .map_err(|error| ExactError::file(path, None, format!("cannot be read: {error}")))?;
    String::from_utf8(bytes).map_err(|error| {
        let before = error.utf8_error().valid_up_to();
        let line = 1 + error.as_bytes()[..before].iter().filter(|&&byte| byte == b'\n').count();
        ExactError::file(path, Some(line), "is not text (UTF-8)")
    })
}

/// Numbers as an array of their own length.
fn fixed<const N: usize>(numbers: &[f64]) -> Result<[f64; N], String> {
    numbers.try_into().map_err(|_| format!("a pose of {} numbers, expected {N}", numbers.len()))
}
