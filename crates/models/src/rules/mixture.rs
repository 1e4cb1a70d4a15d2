//! Mixture messages: every component made linear by itself.
//!
//! For components yᵢ ~ N(mᵢ, Pᵢ) of the senders, of weights wᵢ, the message near a point c is
//!
//! Σᵢ wᵢ N(r(c, mᵢ) + J δ; 0, Sᵢ),   Sᵢ = R + Jᵧ Pᵢ Jᵧ',   δ = x - c.
//!
//! Where the line serves all of the receiver's belief, one c is enough, and one component each: a Gaussian sum filter
//! (Alspach and Sorenson 1972). Where it does not, points c cover the belief, and a Gaussian window keeps each line to
//! its surroundings ([`windows`]); a range is covered by a ring of kernels ([`ring`]), which needs no belief.

pub(crate) mod motion;
mod ring;
mod senders;
mod windows;

use super::{GaussianDraft, MixtureView, Rules};
use crate::small::{Matrix, Vector, multiply, transpose, zero_vector, zeros};
use crate::{Linearised, Ring};
use rand::RngExt;
use senders::{Combination, Senders, combinations};
use std::f64::consts::PI;
use sumprod_graph::{Coordinate, MessageError, Port, Stream, wrap_angle};
use sumprod_messages::{Cholesky, Mixture, MixtureForm, MixtureMessage, Moments, Potential};

/// Deviation from the line, in standard deviations of the residual two of the belief's away, up to which one line
/// serves all of the belief.
const LINEAR: f64 = 0.15;

/// Components that weigh e to minus this of the heaviest are left out.
const NEGLIGIBLE: f64 = 20.0;

/// The message of a residual to port `to`, and what reading its senders cost (nats).
pub(crate) fn message<T: Rules + Linearised>(
    model: &T,
    ring: Option<Ring>,
    to: Port,
    view: &dyn MixtureView,
    form: &MixtureForm,
    stream: &mut Stream,
) -> Result<(MixtureMessage, f64), MessageError> {
    let coordinates = MixtureView::coordinates(view, to);
    let (combinations, loss) = match combinations(model, ring.as_ref(), to, view, form)? {
        Senders::Distributions(combinations, loss) => (combinations, loss),
        Senders::Flat => return Ok((MixtureMessage::flat(coordinates), 0.0)),
        Senders::Open => return gaussian(model, to, view),
    };
    let target = Target { model, coordinates };
    if let Some(Moments { mean, covariance }) = view.moments(to)
        && target.deviation(&combinations, &mean, &covariance)?.line_serves()
    {
        return target.linear(&combinations, &mean, form, loss);
    }
    if let (Some(ring), None) = (&ring, model.noise().degrees_of_freedom()) {
        let guide = view.guide(to, Some(&ring.position));
        let phase = stream.fast().random();
        if let Some(potential) = ring::kernels(&target, ring, &combinations, guide.as_ref(), phase)? {
            return finish(potential, loss, form);
        }
    }
    match view.guide(to, None) {
        Some(guide) => finish(windows::kernels(&target, &combinations, &guide, form)?, loss, form),
        None => match ring.as_ref().map(|ring| ring::surroundings(&target, ring, &combinations)) {
            Some(around) => finish(windows::kernels(&target, &combinations, &around?, form)?, loss, form),
            None => gaussian(model, to, view),
        },
    }
}

/// The Gaussian rule's message, as a mixture of one.
pub(crate) fn gaussian<T: Rules + ?Sized>(
    rules: &T,
    to: Port,
    view: &dyn MixtureView,
) -> Result<(MixtureMessage, f64), MessageError> {
    let GaussianDraft { information, vector, loss } = rules.gaussian(to, view)?;
    let gaussian = sumprod_messages::DynamicGaussian::from_information(&information, &vector)?;
    Ok((MixtureMessage::from_gaussian(view.coordinates(to), &gaussian), loss))
}

/// Components with how much each matters to the receiver, where that is known.
struct Weighed {
    potential: Potential,
    log_masses: Option<Vec<f64>>,
}

/// Leaves out what is negligible and keeps the form's number of components.
fn finish(weighed: Weighed, loss: f64, form: &MixtureForm) -> Result<(MixtureMessage, f64), MessageError> {
    let Weighed { potential, log_masses } = weighed;
    let worth = |k: usize| log_masses.as_ref().map_or_else(|| potential.log_value_of(k), |masses| masses[k]);
    let largest = (0..potential.len()).map(worth).fold(f64::NEG_INFINITY, f64::max);
    let mut kept = Potential::new(potential.coordinates());
    let mut masses = Vec::new();
    for k in (0..potential.len()).filter(|&k| worth(k) >= largest - NEGLIGIBLE) {
        let (centre, gradient) = (potential.centre_of(k), potential.gradient_of(k));
        kept.push(potential.log_value_of(k), centre, gradient, potential.information_of(k));
        masses.push((worth(k) - largest).exp());
    }
    let kept = kept.checked("a component of the message")?;
    let (fewer, cost) = kept.reduce(form.components, log_masses.is_some().then_some(masses.as_slice()))?;
    Ok((MixtureMessage::from(fewer).costing(cost), loss))
}

/// The factor, and the coordinates of the variable that the message is for.
struct Target<'a> {
    model: &'a dyn Linearised,
    coordinates: &'a [Coordinate],
}

/// A residual made linear at a point: e + J δ, and the covariance S of e.
struct Line {
    residual: Vector,
    /// The receiver's columns, m by d.
    jacobian: Matrix,
    /// Noise and senders, m by m.
    covariance: Matrix,
}

/// How far a residual is from its line over a belief.
struct Deviation {
    /// In standard deviations of the residual, whole turns of angles apart.
    miss: f64,
    /// Of an angle, where the belief reaches beyond half a turn: the standard deviation (rad) that the coordinates
    /// other than angles give it. Its line is right only to within the turn.
    turning: f64,
}

impl Deviation {
    fn line_serves(&self) -> bool {
        self.miss <= LINEAR && self.turning == 0.0
    }
}

impl Target<'_> {
    fn dimension(&self) -> usize {
        self.coordinates.len()
    }

    fn line(&self, senders: &Combination, point: &[f64]) -> Line {
        let (d, m) = (self.dimension(), self.model.noise().dimension());
        let at = senders.stacked(point);
        let n = at.len();
        let (mut residual, mut jacobian) = (zero_vector(m), zeros(m * n));
        self.model.linearise(&at, &mut residual, &mut jacobian);
        let columns = |start: usize, count: usize| -> Matrix {
            (0..m).flat_map(|row| jacobian[row * n + start..][..count].iter().copied()).collect()
        };
        let mut covariance = Matrix::from_slice(self.model.noise().covariance());
        for part in &senders.parts {
            let own = columns(part.start, part.mean.len());
            let moved = multiply(&own, &part.covariance, part.mean.len(), part.mean.len());
            let spread = multiply(&moved, &transpose(&own, m, part.mean.len()), part.mean.len(), m);
            covariance.iter_mut().zip(&spread).for_each(|(entry, added)| *entry += added);
        }
        Line { residual, jacobian: columns(senders.receiver, d), covariance }
    }

    /// How far the residual is from its line at `mean`, in its own standard deviations, at two standard deviations
    /// of `covariance` along each column of its root, and how far its angles turn: the largest over the heaviest
    /// senders.
    fn deviation(
        &self,
        combinations: &[Combination],
        mean: &[f64],
        covariance: &[f64],
    ) -> Result<Deviation, MessageError> {
        let d = self.dimension();
        let root = Cholesky::new(covariance, d, "the belief's covariance")?;
        let mut largest = Deviation { miss: 0.0, turning: 0.0 };
        for senders in combinations.iter().take(HEAVIEST) {
            let line = self.line(senders, mean);
            let m = line.residual.len();
            let factor = Cholesky::new(&line.covariance, m, "the residual's covariance")?;
            for column in 0..d {
                for sign in [2.0, -2.0] {
                    let mut unit = zero_vector(d);
                    unit[column] = sign;
                    let mut offset = zero_vector(d);
                    root.multiply_lower(&unit, &mut offset);
                    let point: Vector = mean.iter().zip(&offset).map(|(x, o)| x + o).collect();
                    let mut value = zero_vector(m);
                    self.model.evaluate(&senders.stacked(&point), &mut value);
                    let predicted = multiply(&line.jacobian, &offset, d, 1);
                    for (k, value) in value.iter_mut().enumerate() {
                        *value -= line.residual[k] + predicted[k];
                    }
                    for &angle in self.model.angles() {
                        value[angle] = wrap_angle(value[angle]);
                    }
                    largest.miss = largest.miss.max(factor.squared_length(&mut value).sqrt());
                }
            }
            for &angle in self.model.angles() {
                // A turn that an angle of the receiver makes leads back to the same place.
                let straight: Vector = (0..d)
                    .map(|k| match self.coordinates[k] {
                        Coordinate::Angle => 0.0,
                        _ => line.jacobian[angle * d + k],
                    })
                    .collect();
                let moved = multiply(covariance, &straight, d, 1);
                let spread = straight.iter().zip(&moved).map(|(j, v)| j * v).sum::<f64>().max(0.0).sqrt();
                if line.residual[angle].abs() + 2.0 * spread > PI {
                    largest.turning = largest.turning.max(spread);
                }
            }
        }
        Ok(largest)
    }

    /// Log value, gradient and information of one combination's message at a point.
    fn component(&self, senders: &Combination, point: &[f64]) -> Result<(f64, Vector, Matrix), MessageError> {
        let d = self.dimension();
        let Line { mut residual, jacobian, covariance } = self.line(senders, point);
        let m = residual.len();
        let factor = Cholesky::new(&covariance, m, "the residual's covariance")?;
        let mut weight = zeros(m * m);
        factor.inverse(&mut weight);
        let pulled = multiply(&weight, &residual, m, 1);
        let squared = factor.squared_length(&mut residual);
        // Tails of t: the log density at the point and its gradient there, a weighted Gaussian's curvature.
        let (log, share) = match self.model.noise().degrees_of_freedom() {
            Some(freedom) => {
                let freed = freedom + m as f64;
                (-0.5 * freed * (squared / freedom).ln_1p(), freed / (freedom + squared))
            }
            None => (-0.5 * squared, 1.0),
        };
        let back = transpose(&jacobian, m, d);
        let weighted = multiply(&back, &weight, m, m);
        let mut information = multiply(&weighted, &jacobian, m, d);
        crate::small::symmetrise(&mut information, d);
        information.iter_mut().for_each(|entry| *entry *= share);
        let gradient = multiply(&back, &pulled, m, 1).iter().map(|g| -share * g).collect();
        Ok((senders.log_weight + log - 0.5 * factor.log_determinant(), gradient, information))
    }

    /// One line for all of the receiver's belief.
    fn linear(
        &self,
        combinations: &[Combination],
        point: &[f64],
        form: &MixtureForm,
        loss: f64,
    ) -> Result<(MixtureMessage, f64), MessageError> {
        let mut potential = Potential::new(self.coordinates);
        for senders in combinations {
            let (log_value, gradient, information) = self.component(senders, point)?;
            potential.push(log_value, point, &gradient, &information);
        }
        finish(Weighed { potential, log_masses: None }, loss, form)
    }

    /// The receiver's coordinates that the residual reads at any of these points.
    fn read(&self, combinations: &[Combination], points: &Mixture) -> Vec<usize> {
        let d = self.dimension();
        let mut read = vec![false; d];
        for senders in combinations.iter().take(HEAVIEST) {
            for i in 0..points.len() {
                // Beside the mean as well, where a residual may have a stationary point.
                for share in [0.0, 0.3, -0.7] {
                    let (mean, covariance) = (points.mean_of(i), points.covariance_of(i));
                    let at: Vector = (0..d).map(|k| mean[k] + share * covariance[k * d + k].sqrt()).collect();
                    for (index, entry) in self.line(senders, &at).jacobian.iter().enumerate() {
                        read[index % d] |= *entry != 0.0;
                    }
                }
            }
        }
        (0..d).filter(|&k| read[k]).collect()
    }
}

/// Combinations that questions about the factor's shape are asked of.
const HEAVIEST: usize = 3;
