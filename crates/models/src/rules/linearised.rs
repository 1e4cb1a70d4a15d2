//! Gaussian messages from a linearised residual.
//!
//! At the means x̄ of the beliefs, r(x) ≈ r(x̄) + Σₖ Jₖ (xₖ - x̄ₖ). The other ports' messages add to the noise,
//! S = R + Σ Jₖ Pₖ Jₖ', and shift the residual, e = r(x̄) + Σ Jₖ (mₖ - x̄ₖ); the message to port t is
//!
//! Λ = Jₜ' S⁻¹ Jₜ,   η = Λ x̄ₜ - Jₜ' S⁻¹ e.
//!
//! Where a message from another port is improper, or nearly so, that port is summed out in information form instead.

use super::{GaussianDraft, GaussianView};
use crate::Linearised;
use crate::moments::{SigmaPoints, semidefinite_factor, sigma_moments, sigma_storage};
use crate::small::{
    Matrix, Proper, Vector, WELL_CONDITIONED, generalised_inverse, multiply, multiply_add, proper,
    symmetrise, transpose, zero_vector, zeros,
};
use smallvec::SmallVec;
use std::ops::Range;
use sumprod_graph::{MessageError, Port};
use sumprod_messages::{Cholesky, Linearisation};

/// A residual made linear: value and Jacobian at a point, and the covariance of what the line leaves out.
pub(crate) struct Line {
    /// All ports' variables, one after the other.
    point: Vector,
    value: Vector,
    jacobian: Matrix,
    /// Noise covariance, regression error included.
    noise: Matrix,
}

/// Moments of a belief at a port, where it has any.
struct Belief {
    mean: Vector,
    covariance: Option<Matrix>,
}

/// Where each port's coordinates lie in the stacked point.
fn ranges(dimensions: &[usize]) -> SmallVec<[Range<usize>; 4]> {
    let mut start = 0;
    dimensions
        .iter()
        .map(|&dimension| {
            start += dimension;
            start - dimension..start
        })
        .collect()
}

/// The message to port `to`.
pub(crate) fn message(
    model: &dyn Linearised,
    to: Port,
    view: &dyn GaussianView,
) -> Result<GaussianDraft, MessageError> {
    let dimensions = model.dimensions();
    let parts = ranges(dimensions);
    let mut beliefs: SmallVec<[Belief; 3]> = SmallVec::new();
    let mut receiver_proper = true;
    for (port, &dimension) in dimensions.iter().enumerate() {
        let belief = read_belief(view, port, dimension)?;
        if port == to {
            receiver_proper = belief.covariance.is_some();
        }
        beliefs.push(belief);
    }
    let mut draft = at_beliefs(model, to, view, &beliefs, &parts)?;
    if receiver_proper {
        return Ok(draft);
    }
    settle(model, to, view, &mut beliefs, &parts, &mut draft)?;
    Ok(draft)
}

/// The receiver's belief has no mean to linearise at: the message's own mean is taken, until it stands still. A
/// message that stays improper is right only if the residual is linear in the receiver.
fn settle(
    model: &dyn Linearised,
    to: Port,
    view: &dyn GaussianView,
    beliefs: &mut [Belief],
    parts: &[Range<usize>],
    draft: &mut GaussianDraft,
) -> Result<(), MessageError> {
    const STEPS: usize = 20;
    for _ in 0..STEPS {
        let Some(Proper { mean, .. }) = proper(&draft.information, &draft.vector) else {
            return linear_in_receiver(model, to, beliefs, parts);
        };
        let step: f64 =
            mean.iter().zip(&beliefs[to].mean).map(|(new, old)| (new - old).abs()).fold(0.0, f64::max);
        let size: f64 = mean.iter().map(|x| x.abs()).fold(1.0, f64::max);
        beliefs[to].mean = mean;
        *draft = at_beliefs(model, to, view, beliefs, parts)?;
        if step <= 1e-12 * size {
            break;
        }
    }
    Ok(())
}

fn linear_in_receiver(
    model: &dyn Linearised,
    to: Port,
    beliefs: &[Belief],
    parts: &[Range<usize>],
) -> Result<(), MessageError> {
    let (m, n) = (model.noise().dimension(), parts.last().map_or(0, |part| part.end));
    let mut point: Vector = beliefs.iter().flat_map(|belief| belief.mean.iter().copied()).collect();
    let (mut value, mut here, mut there) = (zero_vector(m), zeros(m * n), zeros(m * n));
    model.linearise(&point, &mut value, &mut here);
    for (k, x) in point[parts[to].clone()].iter_mut().enumerate() {
        *x += 1.0 + 0.5 * k as f64;
    }
    model.linearise(&point, &mut value, &mut there);
    let same = here.iter().zip(&there).all(|(a, b)| (a - b).abs() <= 1e-9 * (1.0 + a.abs()));
    if same {
        return Ok(());
    }
    Err(MessageError::Unsupported(
        "a nonlinear factor needs a point to linearise at, but this variable's belief has no mean yet; give the \
         variable a prior or a start"
            .into(),
    ))
}

fn read_belief(view: &dyn GaussianView, port: Port, dimension: usize) -> Result<Belief, MessageError> {
    let mut information = zeros(dimension * dimension);
    let mut mean = zero_vector(dimension);
    view.belief(port, &mut information, &mut mean)?;
    if let Some(Proper { mean, covariance, .. }) = proper(&information, &mean) {
        return Ok(Belief { mean, covariance: Some(covariance) });
    }
    if mean.iter().any(|&x| x != 0.0) {
        let inverse = generalised_inverse(&information, dimension);
        mean = multiply(&inverse, &mean, dimension, 1).into_iter().collect();
    }
    Ok(Belief { mean, covariance: None })
}

fn at_beliefs(
    model: &dyn Linearised,
    to: Port,
    view: &dyn GaussianView,
    beliefs: &[Belief],
    parts: &[Range<usize>],
) -> Result<GaussianDraft, MessageError> {
    let sigma = view.form().linearisation == Linearisation::SigmaPoints;
    let mut line = match beliefs.iter().all(|belief| belief.covariance.is_some()) && sigma {
        true => regress(model, beliefs, parts)?,
        false => expand(model, beliefs, parts),
    };
    downweight(model, beliefs, parts, &mut line);
    eliminate(&line, to, view, parts)
}

/// First-order expansion at the means.
fn expand(model: &dyn Linearised, beliefs: &[Belief], parts: &[Range<usize>]) -> Line {
    let (m, n) = (model.noise().dimension(), parts.last().map_or(0, |part| part.end));
    let point: Vector = beliefs.iter().flat_map(|belief| belief.mean.iter().copied()).collect();
    let (mut value, mut jacobian) = (zero_vector(m), zeros(m * n));
    model.linearise(&point, &mut value, &mut jacobian);
    Line { point, value, jacobian, noise: Matrix::from_slice(model.noise().covariance()) }
}

/// Statistical linear regression over the 2n cubature points of the beliefs (Arasaratnam and Haykin 2009), the
/// covariance of what the regression leaves out added to the noise.
fn regress(model: &dyn Linearised, beliefs: &[Belief], parts: &[Range<usize>]) -> Result<Line, MessageError> {
    let (m, n) = (model.noise().dimension(), parts.last().map_or(0, |part| part.end));
    let point: Vector = beliefs.iter().flat_map(|belief| belief.mean.iter().copied()).collect();
    // The joint covariance of the beliefs is block-diagonal, and so is its factor.
    let mut lower = zeros(n * n);
    for (belief, part) in beliefs.iter().zip(parts) {
        let covariance = belief.covariance.as_deref().unwrap_or_default();
        let mut own = zeros(part.len() * part.len());
        semidefinite_factor(covariance, part.len(), "the belief's covariance", &mut own)?;
        for (row, entries) in own.chunks_exact(part.len()).enumerate() {
            lower[(part.start + row) * n + part.start..][..part.len()].copy_from_slice(entries);
        }
    }
    let mut storage: SmallVec<[f64; 128]> = SmallVec::from_elem(0.0, sigma_storage(m, n));
    let found = sigma_moments(
        SigmaPoints::cubature(n),
        &point,
        &lower,
        m,
        |x, residual| model.evaluate(x, residual),
        |difference| {
            for &angle in model.angles() {
                difference[angle] = sumprod_graph::wrap_angle(difference[angle]);
            }
        },
        &mut storage,
    );
    // The slope is Ψ' P⁻¹, Ψ the cross-covariance.
    let cross = found.cross;
    let mut jacobian = zeros(m * n);
    for (belief, part) in beliefs.iter().zip(parts) {
        let covariance = belief.covariance.as_deref().unwrap_or_default();
        let factor = Cholesky::new(covariance, part.len(), "the belief's covariance")?;
        for row in 0..m {
            let mut slope = Vector::from_slice(&cross[row * n..][part.clone()]);
            factor.solve(&mut slope);
            jacobian[row * n..][part.clone()].copy_from_slice(&slope);
        }
    }
    // What the line leaves out: Φ - A Ψ, added to the noise.
    let explained = multiply(&jacobian, &transpose(cross, m, n), n, m);
    let mut noise = Matrix::from_slice(model.noise().covariance());
    for (noise, (all, explained)) in noise.iter_mut().zip(found.covariance.iter().zip(&explained)) {
        *noise += all - explained;
    }
    symmetrise(&mut noise, m);
    Ok(Line { point, value: Vector::from_slice(found.mean), jacobian, noise })
}

/// Heavy-tailed noise: the covariance is divided by the weight of the residual. Its length is the expectation over
/// the beliefs (the E-step of a variational fit), so that a belief cannot talk itself into an outlier by having
/// followed it; from a vague belief the weight grows as rounds sharpen it.
fn downweight(model: &dyn Linearised, beliefs: &[Belief], parts: &[Range<usize>], line: &mut Line) {
    let noise = model.noise();
    if noise.degrees_of_freedom().is_none() {
        return;
    }
    let mut spread = line.noise.clone();
    spread.iter_mut().zip(noise.covariance()).for_each(|(spread, noise)| *spread -= noise);
    for (belief, part) in beliefs.iter().zip(parts) {
        if let Some(covariance) = &belief.covariance {
            add_projection(&line.jacobian, part, covariance, noise.dimension(), &mut spread);
        }
    }
    let weight = noise.weight(noise.expected_squared_length(&line.value, &spread));
    line.noise.iter_mut().for_each(|entry| *entry /= weight);
}

/// Adds J P J' to `out` (m by m), J the columns of the Jacobian in `part`.
fn add_projection(jacobian: &[f64], part: &Range<usize>, covariance: &[f64], m: usize, out: &mut [f64]) {
    let block = columns(jacobian, part, m);
    let product = multiply(&block, covariance, part.len(), part.len());
    multiply_add(&product, &transpose(&block, m, part.len()), part.len(), m, out);
}

/// The Jacobian's columns of one port (m by the port's dimension).
fn columns(jacobian: &[f64], part: &Range<usize>, m: usize) -> Matrix {
    let n = jacobian.len() / m;
    (0..m).flat_map(|row| jacobian[row * n..][part.clone()].iter().copied()).collect()
}

/// Sums out all ports but `to`.
fn eliminate(
    line: &Line,
    to: Port,
    view: &dyn GaussianView,
    parts: &[Range<usize>],
) -> Result<GaussianDraft, MessageError> {
    let m = line.value.len();
    let mut loss = 0.0;
    let mut total = line.noise.clone();
    let mut shifted = line.value.clone();
    for (port, part) in parts.iter().enumerate().filter(|(port, _)| *port != to) {
        let d = part.len();
        let (mut information, mut vector) = (zeros(d * d), zero_vector(d));
        loss += view.message(port, &mut information, &mut vector)?;
        let Some(Proper { mean, covariance, inflation: ..=WELL_CONDITIONED }) = proper(&information, &vector)
        else {
            return eliminate_improper(line, to, view, parts);
        };
        add_projection(&line.jacobian, part, &covariance, m, &mut total);
        let offset: Vector = mean.iter().zip(&line.point[part.clone()]).map(|(mean, x)| mean - x).collect();
        multiply_add(&columns(&line.jacobian, part, m), &offset, d, 1, &mut shifted);
    }
    let factor = Cholesky::new(&total, m, "the residual's covariance")?;
    let mut weight = zeros(m * m);
    factor.inverse(&mut weight);
    Ok(project(&line.jacobian, &parts[to], &line.point, &weight, &shifted, loss))
}

/// Λ = J' W J and η = Λ x̄ - J' W e.
fn project(
    jacobian: &[f64],
    part: &Range<usize>,
    point: &[f64],
    weight: &[f64],
    residual: &[f64],
    loss: f64,
) -> GaussianDraft {
    let (m, d) = (residual.len(), part.len());
    let block = columns(jacobian, part, m);
    let weighted = multiply(&transpose(&block, m, d), weight, m, m);
    let mut information = multiply(&weighted, &block, m, d);
    symmetrise(&mut information, d);
    let mut vector: Vector = multiply(&information, &point[part.clone()], d, 1).into_iter().collect();
    let pulled = multiply(&weighted, residual, m, 1);
    vector.iter_mut().zip(&pulled).for_each(|(eta, pull)| *eta -= pull);
    GaussianDraft { information, vector, loss }
}

/// The general case, in information form: the joint information of all ports with the other ports' messages
/// added, and those ports summed out by a Schur complement with a generalised inverse, which is exact because the
/// joint's range holds its vector.
fn eliminate_improper(
    line: &Line,
    to: Port,
    view: &dyn GaussianView,
    parts: &[Range<usize>],
) -> Result<GaussianDraft, MessageError> {
    let (m, n) = (line.value.len(), line.point.len());
    let factor = Cholesky::new(&line.noise, m, "the noise covariance")?;
    let mut weight = zeros(m * m);
    factor.inverse(&mut weight);
    let all = 0..n;
    let GaussianDraft { mut information, mut vector, mut loss } =
        project(&line.jacobian, &all, &line.point, &weight, &line.value, 0.0);
    for (port, part) in parts.iter().enumerate().filter(|(port, _)| *port != to) {
        let d = part.len();
        let (mut own, mut own_vector) = (zeros(d * d), zero_vector(d));
        loss += view.message(port, &mut own, &mut own_vector)?;
        for row in 0..d {
            for column in 0..d {
                information[(part.start + row) * n + part.start + column] += own[row * d + column];
            }
            vector[part.start + row] += own_vector[row];
        }
    }
    let kept: Vec<usize> = parts[to].clone().collect();
    let others: Vec<usize> = (0..n).filter(|index| !parts[to].contains(index)).collect();
    let pick = |rows: &[usize], columns: &[usize]| -> Matrix {
        rows.iter()
            .flat_map(|&r| columns.iter().map(move |&c| (r, c)))
            .map(|(r, c)| information[r * n + c])
            .collect()
    };
    let inverse = generalised_inverse(&pick(&others, &others), others.len());
    let cross = pick(&kept, &others);
    let gain = multiply(&cross, &inverse, others.len(), others.len());
    let removed = multiply(&gain, &transpose(&cross, kept.len(), others.len()), others.len(), kept.len());
    let mut own = pick(&kept, &kept);
    let scale = own.iter().map(|x| x.abs()).fold(0.0, f64::max);
    own.iter_mut().zip(&removed).for_each(|(own, removed)| {
        *own -= removed;
        // What is left of an exact cancellation is rounding, not information.
        if own.abs() < 1e-13 * scale {
            *own = 0.0;
        }
    });
    symmetrise(&mut own, kept.len());
    let rest: Vector = others.iter().map(|&index| vector[index]).collect();
    let pulled = multiply(&gain, &rest, others.len(), 1);
    let size = kept.iter().map(|&index| vector[index].abs()).fold(0.0, f64::max);
    let own_vector = kept.iter().zip(&pulled).map(|(&index, pull)| {
        let left = vector[index] - pull;
        if left.abs() < 1e-13 * size { 0.0 } else { left }
    });
    Ok(GaussianDraft { information: own, vector: own_vector.collect(), loss })
}
