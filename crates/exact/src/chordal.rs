//! A start for pose graphs from the relative poses alone: rotations by a linear least squares on their matrices, brought
//! back to rotations, then positions by another (Martinec and Pajdla 2007; Carlone, Tron, Daniilidis and Dellaert 2015).

use crate::read::{GraphFile, Measurement};
use crate::{ExactError, Problem, SolveOptions, Values};
use nalgebra::{DMatrix, Matrix3, Rotation3, UnitQuaternion};
use sumprod_graph::{FactorGraph, Space, VariableId};
use sumprod_messages::DynamicGaussian;
use sumprod_models::library::LinearGaussian;
use sumprod_models::{AddModel, Noise};

/// Variance of what holds one pose of each part (relative to unit weights).
const HELD: f64 = 1e-6;

/// A relative pose as the linear systems see it.
struct Relative {
    from: usize,
    to: usize,
    rotation: DMatrix<f64>,
    translation: Vec<f64>,
    covariance: DMatrix<f64>,
    /// Mean variance of the rotation.
    spread: f64,
}

/// A start for all variables of a file; poses that no relative pose reaches, and points, keep the file's values.
///
/// # Errors
///
/// Where a pose has neither a relative pose nor a value, or the linear systems cannot be solved.
pub fn chordal_start(file: &GraphFile, problem: &Problem<'_>) -> Result<Values, ExactError> {
    let relatives = relatives(file);
    let size = if file.variables.iter().any(|v| v.space == Space::Se3) { 3 } else { 2 };
    let held = held(file, &relatives, size);
    let rotations = rotations(file, &relatives, &held, size)?;
    let positions = positions(file, &relatives, &held, &rotations, size)?;
    let mut values = problem.start();
    for (number, (variable, &handle)) in file.variables.iter().zip(problem.variables()).enumerate() {
        match (&rotations[number], &variable.value) {
            (Some(rotation), _) => values.set(handle, &stored(&positions[number], rotation))?,
            (None, Some(value)) => values.set(handle, value)?,
            (None, None) if matches!(variable.space, Space::Continuous(_)) => {}
            (None, None) => {
                let problem = format!("{} has no value and no relative pose to start from", variable.name);
                return Err(ExactError::file(&file.path, None, problem));
            }
        }
    }
    Ok(values)
}

fn rotation_of(pose: &[f64]) -> DMatrix<f64> {
    if pose.len() == 3 {
        let (sine, cosine) = pose[2].sin_cos();
        return DMatrix::from_row_slice(2, 2, &[cosine, -sine, sine, cosine]);
    }
    let quaternion = nalgebra::Quaternion::new(pose[6], pose[3], pose[4], pose[5]);
    let matrix = UnitQuaternion::from_quaternion(quaternion).to_rotation_matrix();
    DMatrix::from_fn(3, 3, |row, column| matrix[(row, column)])
}

fn stored(position: &[f64], rotation: &DMatrix<f64>) -> Vec<f64> {
    let mut out = position.to_vec();
    if rotation.nrows() == 2 {
        out.push(rotation[(1, 0)].atan2(rotation[(0, 0)]));
        return out;
    }
    let matrix = Matrix3::from_fn(|row, column| rotation[(row, column)]);
    let quaternion = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix));
    out.extend([quaternion.i, quaternion.j, quaternion.k, quaternion.w]);
    out
}

fn relatives(file: &GraphFile) -> Vec<Relative> {
    let mut found = Vec::new();
    for factor in &file.factors {
        let (Measurement::RelativePose(pose), [from, to]) =
            (&factor.measurement, factor.variables.as_slice())
        else {
            continue;
        };
        let d = factor.covariance.len().isqrt();
        let size = if d == 3 { 2 } else { 3 };
        let covariance = DMatrix::from_row_slice(d, d, &factor.covariance);
        found.push(Relative {
            from: *from,
            to: *to,
            rotation: rotation_of(pose),
            translation: pose[..size].to_vec(),
            spread: (size..d).map(|k| covariance[(k, k)]).sum::<f64>() / (d - size) as f64,
            covariance: covariance.view((0, 0), (size, size)).into_owned(),
        });
    }
    found
}

/// Per part of the graph of relative poses, a pose that is held, and where: one with a prior, else the first.
fn held(file: &GraphFile, relatives: &[Relative], size: usize) -> Vec<Option<Vec<f64>>> {
    let count = file.variables.len();
    let mut root: Vec<usize> = (0..count).collect();
    fn find(root: &mut [usize], mut x: usize) -> usize {
        while root[x] != x {
            root[x] = root[root[x]];
            x = root[x];
        }
        x
    }
    for relative in relatives {
        let (a, b) = (find(&mut root, relative.from), find(&mut root, relative.to));
        root[a.max(b)] = a.min(b);
    }
    let mut place: Vec<Option<(usize, Vec<f64>)>> = vec![None; count];
    for factor in &file.factors {
        if let (Measurement::Prior(mean), [variable]) = (&factor.measurement, factor.variables.as_slice())
            && mean.len() == if size == 2 { 3 } else { 7 }
        {
            place[find(&mut root, *variable)].get_or_insert((*variable, mean.clone()));
        }
    }
    for relative in relatives {
        let own = find(&mut root, relative.from);
        place[own].get_or_insert_with(|| {
            let origin = if size == 2 { vec![0.0; 3] } else { vec![0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0] };
            (own, file.variables[own].value.clone().unwrap_or(origin))
        });
    }
    let mut held = vec![None; count];
    for (variable, mean) in place.into_iter().flatten() {
        held[variable] = Some(mean);
    }
    held
}

/// Whether each pose is reached by a relative pose.
fn reached(count: usize, relatives: &[Relative]) -> Vec<bool> {
    let mut reached = vec![false; count];
    for relative in relatives {
        (reached[relative.from], reached[relative.to]) = (true, true);
    }
    reached
}

/// A linear problem over one vector per reached pose: x(to) - B x(from) = b.
struct Linear {
    graph: FactorGraph<DynamicGaussian>,
    handles: Vec<Option<VariableId>>,
    size: usize,
}

impl Linear {
    fn new(reached: &[bool], size: usize) -> Self {
        let mut graph = FactorGraph::new();
        let handles = reached
            .iter()
            .map(|&reached| reached.then(|| graph.unnamed_variable(Space::real(size))))
            .collect();
        Self { graph, handles, size }
    }

    fn add(
        &mut self,
        ends: &[usize],
        matrices: &[&[f64]],
        target: &[f64],
        covariance: &[f64],
    ) -> Result<(), ExactError> {
        let ports: Vec<VariableId> = ends.iter().filter_map(|&end| self.handles[end]).collect();
        let refused =
            |reason: String| ExactError::Request(format!("the linear start cannot be set up: {reason}"));
        let noise = Noise::gaussian(covariance).map_err(|error| refused(error.to_string()))?;
        let factor =
            LinearGaussian::new(matrices, target, noise).map_err(|error| refused(error.to_string()))?;
        self.graph.add("", factor, &ports)?;
        Ok(())
    }

    fn hold(&mut self, pose: usize, value: &[f64], variance: f64) -> Result<(), ExactError> {
        let d = self.size;
        let (unit, covariance) = (DMatrix::<f64>::identity(d, d), DMatrix::identity(d, d) * variance);
        self.add(&[pose], &[unit.as_slice()], value, covariance.as_slice())
    }

    fn solve(&self) -> Result<Vec<Vec<f64>>, ExactError> {
        let problem = Problem::new(&self.graph)?;
        let solution = problem.solve(problem.start(), &SolveOptions::default())?;
        let of = |handle: &Option<VariableId>| {
            handle.map_or_else(Vec::new, |handle| solution.values().get(handle).to_vec())
        };
        Ok(self.handles.iter().map(of).collect())
    }
}

/// Row k of every rotation matrix: r(to) = r(from) R, one linear problem a row; in the plane the first column alone.
fn rotations(
    file: &GraphFile,
    relatives: &[Relative],
    held: &[Option<Vec<f64>>],
    size: usize,
) -> Result<Vec<Option<DMatrix<f64>>>, ExactError> {
    let reached = reached(file.variables.len(), relatives);
    let unit = DMatrix::<f64>::identity(size, size);
    let mut rows: Vec<Vec<Vec<f64>>> = Vec::new();
    for row in 0..if size == 2 { 1 } else { 3 } {
        let mut linear = Linear::new(&reached, size);
        for relative in relatives {
            // Column-major storage of R is row-major R', which is what r' is multiplied by; in the plane R itself.
            let turn = if size == 2 { relative.rotation.transpose() } else { relative.rotation.clone() };
            let turn = -turn;
            let covariance = &unit * relative.spread;
            let matrices = [turn.as_slice(), unit.as_slice()];
            linear.add(&[relative.from, relative.to], &matrices, &vec![0.0; size], covariance.as_slice())?;
        }
        for (pose, mean) in held.iter().enumerate() {
            if let Some(mean) = mean {
                let rotation = rotation_of(mean);
                let value: Vec<f64> = match size {
                    2 => rotation.column(0).iter().copied().collect(),
                    _ => rotation.row(row).iter().copied().collect(),
                };
                linear.hold(pose, &value, HELD)?;
            }
        }
        rows.push(linear.solve()?);
    }
    let matrix = |pose: usize| {
        if !reached[pose] {
            return None;
        }
        if size == 2 {
            let angle = rows[0][pose][1].atan2(rows[0][pose][0]);
            return Some(rotation_of(&[0.0, 0.0, angle]));
        }
        let found = Matrix3::from_fn(|row, column| rows[row][pose][column]);
        let parts = found.svd(true, true);
        let (u, v) = (parts.u?, parts.v_t?);
        let mut sign = Matrix3::identity();
        sign[(2, 2)] = (u.determinant() * v.determinant()).signum();
        let nearest = u * sign * v;
        Some(DMatrix::from_fn(3, 3, |row, column| nearest[(row, column)]))
    };
    Ok((0..file.variables.len()).map(matrix).collect())
}

/// Positions from t(to) - t(from) = R(from) z.
fn positions(
    file: &GraphFile,
    relatives: &[Relative],
    held: &[Option<Vec<f64>>],
    rotations: &[Option<DMatrix<f64>>],
    size: usize,
) -> Result<Vec<Vec<f64>>, ExactError> {
    let reached = reached(file.variables.len(), relatives);
    let mut linear = Linear::new(&reached, size);
    let unit = DMatrix::<f64>::identity(size, size);
    let minus = -&unit;
    for relative in relatives {
        let Some(turn) = &rotations[relative.from] else { continue };
        let step = turn * nalgebra::DVector::from_column_slice(&relative.translation);
        let covariance = turn * &relative.covariance * turn.transpose();
        let covariance = (&covariance + covariance.transpose()) * 0.5;
        let matrices = [minus.as_slice(), unit.as_slice()];
        linear.add(&[relative.from, relative.to], &matrices, step.as_slice(), covariance.as_slice())?;
    }
    for (pose, mean) in held.iter().enumerate() {
        if let Some(mean) = mean {
            linear.hold(pose, &mean[..size], HELD)?;
        }
    }
    linear.solve()
}
