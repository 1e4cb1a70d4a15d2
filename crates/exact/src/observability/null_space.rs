//! The null space of a problem's information at a point.

use crate::cholesky::Numeric;
use crate::normal::Normal;
use crate::structure::Structure;
use crate::{ExactError, Ordering, Problem, Values};
use nalgebra::DMatrix;
use rand::RngExt;
use sumprod_graph::{Purpose, Stream};
use sumprod_models::Expansion;

/// What is added to the scaled information so that it can be factorised.
const SHIFT: f64 = 1e-10;
/// The squared length |J v|² below which a scaled unit vector v is free.
const FREE: f64 = 1e-14;
/// Inverse iterations.
const ROUNDS: usize = 6;
/// Vectors sought at first, and at most.
const VECTORS: [usize; 3] = [8, 24, 72];

/// An orthonormal basis of the free directions, in local coordinates divided by each one's scale.
pub(super) struct NullSpace {
    /// In the graph's order.
    basis: Vec<Vec<f64>>,
    /// By which a local coordinate is divided: one over the root of its information.
    scale: Vec<f64>,
}

impl NullSpace {
    pub(super) fn new(problem: &Problem<'_>, values: &Values) -> Result<Self, ExactError> {
        let structure = Structure::new(problem, Ordering::MinimumDegree)?;
        let size = structure.size();
        let mut normal = Normal::default();
        normal.fill(problem, &structure, values)?;
        let scale: Vec<f64> = structure.column_pointer[..size]
            .iter()
            .map(
                |&diagonal| {
                    if normal.lower[diagonal] > 0.0 { normal.lower[diagonal].sqrt().recip() } else { 1.0 }
                },
            )
            .collect();
        let numeric = shifted_factor(&structure, &mut normal.lower, &scale)?;
        let scale = structure.unpermuted(problem, &scale);
        for count in VECTORS {
            let count = count.min(size);
            let vectors = subspace(problem, &structure, &numeric, count)?;
            let gram = gram(problem, values, &vectors, &scale)?;
            let eigen = gram.symmetric_eigen();
            let free: Vec<usize> = (0..count).filter(|&k| eigen.eigenvalues[k].abs() < FREE).collect();
            if free.len() < count || count == size || count == VECTORS[VECTORS.len() - 1] {
                let combine = |&k: &usize| {
                    let mut out = vec![0.0; size];
                    for (weight, vector) in eigen.eigenvectors.column(k).iter().zip(&vectors) {
                        out.iter_mut().zip(vector).for_each(|(out, x)| *out += weight * x);
                    }
                    out
                };
                return Ok(Self { basis: free.iter().map(combine).collect(), scale });
            }
        }
        Ok(Self { basis: Vec::new(), scale })
    }

    pub(super) fn dimension(&self) -> usize {
        self.basis.len()
    }

    /// The scale of a local coordinate: its unit over the standard deviation that its own factors leave it.
    pub(super) fn scale(&self) -> &[f64] {
        &self.scale
    }

    /// An orthonormal basis of the free directions within some variables.
    pub(super) fn within(&self, problem: &Problem<'_>, component: &[u32]) -> Vec<Vec<f64>> {
        let mut kept: Vec<Vec<f64>> = Vec::new();
        for vector in &self.basis {
            let mut own = vec![0.0; vector.len()];
            for &variable in component {
                let range = problem.layout().freedoms(variable as usize);
                own[range.clone()].copy_from_slice(&vector[range]);
            }
            add_orthonormal(&mut kept, own, 1e-5);
        }
        kept
    }
}

/// Adds the part of a vector that a basis lacks, if it is more than `least` long; says whether it was.
pub(super) fn add_orthonormal(basis: &mut Vec<Vec<f64>>, mut vector: Vec<f64>, least: f64) -> bool {
    for _ in 0..2 {
        for other in basis.iter() {
            let share = crate::solve::dot(other, &vector);
            vector.iter_mut().zip(other).for_each(|(x, y)| *x -= share * y);
        }
    }
    let length = crate::solve::dot(&vector, &vector).sqrt();
    if length <= least {
        return false;
    }
    vector.iter_mut().for_each(|x| *x /= length);
    basis.push(vector);
    true
}

/// The factor of the scaled information with a shift.
fn shifted_factor(structure: &Structure, lower: &mut [f64], scale: &[f64]) -> Result<Numeric, ExactError> {
    for column in 0..structure.size() {
        let range = structure.column_pointer[column]..structure.column_pointer[column + 1];
        for (entry, &row) in lower[range.clone()].iter_mut().zip(&structure.row_index[range]) {
            *entry *= scale[row] * scale[column];
        }
    }
    let mut numeric = Numeric::new(&structure.symbolic)?;
    let mut shift = SHIFT;
    for _ in 0..4 {
        for &diagonal in &structure.column_pointer[..structure.size()] {
            lower[diagonal] += shift;
        }
        if numeric
            .factorise(&structure.symbolic, &structure.column_pointer, &structure.row_index, lower)
            .is_ok()
        {
            return Ok(numeric);
        }
        shift *= 100.0;
    }
    Err(ExactError::Sparse("the information is not positive semidefinite, which only overflow can do".into()))
}

/// An orthonormal basis near the smallest eigenvectors, in the graph's order.
fn subspace(
    problem: &Problem<'_>,
    structure: &Structure,
    numeric: &Numeric,
    count: usize,
) -> Result<Vec<Vec<f64>>, ExactError> {
    let size = structure.size();
    let mut random = Stream::new(0, 0, Purpose::User(5), 0).fast();
    let mut vectors: Vec<Vec<f64>> =
        (0..count).map(|_| (0..size).map(|_| random.random::<f64>() - 0.5).collect()).collect();
    for _ in 0..ROUNDS {
        let mut next = Vec::with_capacity(count);
        for mut vector in vectors {
            numeric.solve(&structure.symbolic, &mut vector, 1)?;
            let length = crate::solve::dot(&vector, &vector).sqrt().max(f64::MIN_POSITIVE);
            vector.iter_mut().for_each(|x| *x /= length);
            if !add_orthonormal(&mut next, vector, 1e-12) {
                add_orthonormal(&mut next, (0..size).map(|_| random.random::<f64>() - 0.5).collect(), 1e-12);
            }
        }
        vectors = next;
    }
    Ok(vectors.iter().map(|vector| structure.unpermuted(problem, vector)).collect())
}

/// Σ (J v)'(J w) over all factors, of scaled vectors.
fn gram(
    problem: &Problem<'_>,
    values: &Values,
    vectors: &[Vec<f64>],
    scale: &[f64],
) -> Result<DMatrix<f64>, ExactError> {
    let count = vectors.len();
    let mut gram = DMatrix::zeros(count, count);
    let mut images: Vec<Vec<f64>> = vec![Vec::new(); count];
    let (mut question, mut chained) = (Expansion::default(), Vec::new());
    for factor in 0..problem.factor_count() {
        problem.expand(factor, &values.numbers, true, &mut question, &mut chained)?;
        for (image, vector) in images.iter_mut().zip(vectors) {
            problem.image(factor, &question, vector, scale, image);
        }
        for (row, a) in images.iter().enumerate() {
            for (column, b) in images[..=row].iter().enumerate() {
                gram[(row, column)] += crate::solve::dot(a, b);
            }
        }
    }
    gram.fill_upper_triangle_with_lower_triangle();
    Ok(gram)
}

/// |J v|² over all factors of a vector of local coordinates, and the largest that its length allows: the sum of each
/// factor's |J|²|v|².
pub(super) fn squared_image(
    problem: &Problem<'_>,
    values: &Values,
    vector: &[f64],
) -> Result<(f64, f64), ExactError> {
    let (mut question, mut chained, mut image) = (Expansion::default(), Vec::new(), Vec::new());
    let (mut sum, mut bound) = (0.0, 0.0);
    let unit = vec![1.0; vector.len()];
    for factor in 0..problem.factor_count() {
        problem.expand(factor, &values.numbers, true, &mut question, &mut chained)?;
        problem.image(factor, &question, vector, &unit, &mut image);
        sum += crate::solve::dot(&image, &image);
        let length: f64 = problem
            .ports(factor)
            .iter()
            .map(|&v| vector[problem.layout().freedoms(v as usize)].iter().map(|x| x * x).sum::<f64>())
            .sum();
        bound += crate::solve::dot(&question.jacobian, &question.jacobian) * length;
    }
    Ok((sum, bound))
}
