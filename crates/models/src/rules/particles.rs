//! Particle messages: values at the receiver's particles, and draws through a motion.

use crate::cloud::{self, BLOCK, Cloud, Mover, Source};
use crate::residual::ResidualModel;
use crate::rules::exponential::{sum_of_exponentials, sum_of_gaussians};
use crate::rules::selection::select;
use crate::rules::{GaussianDraft, GaussianView, MixtureView, ParticleView, Rules, linearised, mixture};
use crate::small::{Matrix, Vector, multiply, multiply_add, symmetrise, transpose, zero_vector, zeros};
use crate::{Expansion, Linearised, Motion, ProcessNoise, Residual};
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use smallvec::SmallVec;
use sumprod_graph::{Coordinate, MessageError, Port, Space, Stream, wrap_angle};
use sumprod_messages::vector::log_sum;
use sumprod_messages::{
    Cholesky, DynamicGaussian, MixtureForm, MixtureMessage, Particles, ParticlesForm, Proposal, Role,
};

impl<R: Residual> Rules for ResidualModel<R> {
    fn dimensions(&self) -> &[usize] {
        self.0.dimensions()
    }

    fn gaussian(&self, to: Port, view: &dyn GaussianView) -> Result<GaussianDraft, MessageError> {
        if self.0.degrees_of_freedom() != self.0.dimensions() {
            let reason = "a pose in space has no Gaussian over its quaternion; solve the graph jointly, or pass \
                          messages on its linear form (exact::Problem::linear_graph)";
            return Err(MessageError::Unsupported(reason.into()));
        }
        linearised::message(self, to, view)
    }

    fn expand(&self, question: &mut Expansion) -> Result<(), MessageError> {
        ResidualModel::expand(self, question)
    }

    /// At the receiver's particles xₙ, the log of Σₘ wₘ p(r(xₙ, yₘ)) over the senders' particles yₘ (particle
    /// belief propagation); where the receiver has none yet, draws from the port's sampler.
    fn particles(
        &self,
        to: Port,
        view: &dyn ParticleView,
        form: &ParticlesForm,
        stream: &mut Stream,
        out: &mut Particles,
    ) -> Result<f64, MessageError> {
        let (senders, mut loss) = self.senders(to, view, form, stream)?;
        let drawn;
        let carrier = match (view.particles(to), self.0.sampler(to), view.gaussian(to)) {
            (Some(particles), ..) => particles,
            (None, Some(_), _) => return self.sample(to, view, form, &senders, stream, out).map(|()| loss),
            (None, None, Some(belief)) if !belief.is_flat() => {
                let space = Space::new(view.coordinates(to).to_vec());
                let belief = sumprod_messages::AnyMessage::from_gaussian(&space, belief.clone())?;
                let (particles, cost) = belief.to_particles(form.count, stream)?;
                loss += cost;
                drawn = particles;
                &drawn
            }
            _ => {
                let reason = "the receiver has no particles to evaluate at and this port has no sampler; give the \
                              variable a prior, or this edge a Gaussian form";
                return Err(MessageError::Unsupported(reason.into()));
            }
        };
        out.become_likelihood(carrier, |log_values| {
            self.evaluate_at(to, carrier, &senders, log_values);
            Ok(())
        })?;
        Ok(loss)
    }

    fn mixture(
        &self,
        to: Port,
        view: &dyn MixtureView,
        form: &MixtureForm,
        stream: &mut Stream,
    ) -> Result<(MixtureMessage, f64), MessageError> {
        mixture::message(self, self.0.ring(to), to, view, form, stream)
    }
}

/// Equally weighted draws of all senders, one joint draw after the other; no draws where there is no sender.
struct Senders {
    draws: usize,
    /// Per port: the draws, point by point; empty at the receiving port.
    points: SmallVec<[Vec<f64>; 3]>,
}

impl<R: Residual> ResidualModel<R> {
    fn senders(
        &self,
        to: Port,
        view: &dyn ParticleView,
        form: &ParticlesForm,
        stream: &mut Stream,
    ) -> Result<(Senders, f64), MessageError> {
        let arity = self.0.dimensions().len();
        let draws = form.senders.unwrap_or(form.count).min(form.count);
        let mut points = SmallVec::new();
        let mut loss = 0.0;
        let mut random = stream.fast();
        for port in 0..arity {
            if port == to {
                points.push(Vec::new());
                continue;
            }
            let (sample, cost) = view.message(port, draws, stream)?;
            loss += cost;
            if sample.is_empty() || sample.role() == Role::Likelihood {
                let reason = match sample.is_empty() {
                    true => "a sender says nothing of its variable yet; give it a prior",
                    false => "a sender has values of a function, but no distribution; give it a prior",
                };
                return Err(MessageError::Unsupported(reason.into()));
            }
            let mut chosen = select(sample.log_weights(), draws, &mut random);
            if arity > 2 {
                // Systematic draws come in the order of the particles: two senders' must not be paired by it.
                for last in (1..chosen.len()).rev() {
                    chosen.swap(last, random.random_range(0..=last));
                }
            }
            points.push(
                chosen.iter().flat_map(|&index| sample.point(index as usize).iter().copied()).collect(),
            );
        }
        Ok((Senders { draws: if arity == 1 { 1 } else { draws }, points }, loss))
    }

    fn evaluate_at(&self, to: Port, carrier: &Particles, senders: &Senders, log_values: &mut [f64]) {
        if self.0.dimensions().len() == 1 {
            cloud::log_values(&self.0, carrier.points(), log_values);
            return;
        }
        let noise = self.noise();
        let scalar = noise.dimension() == 1 && noise.degrees_of_freedom().is_none();
        let mut values = vec![0.0; senders.draws];
        let offset = noise.log_peak() - (senders.draws as f64).ln();
        for (log_value, point) in
            log_values.iter_mut().zip(carrier.points().chunks_exact(carrier.dimension()))
        {
            if scalar {
                self.each_sender(to, point, senders, &mut values, |residual| residual[0]);
                *log_value = offset + log_sum_of_gaussians(&values, noise.information()[0]);
            } else {
                self.each_sender(to, point, senders, &mut values, |residual| noise.log_density(residual));
                *log_value = offset + log_sum_below(&values, noise.log_peak());
            }
        }
    }

    /// Writes, per draw of the senders, what `read` makes of the residual at the receiver's `point`.
    #[inline(always)]
    fn each_sender(
        &self,
        to: Port,
        point: &[f64],
        senders: &Senders,
        values: &mut [f64],
        read: impl Fn(&[f64]) -> f64,
    ) {
        let dimensions = self.0.dimensions();
        let mut storage = [0.0; 4];
        let mut long;
        let residual = match storage.get_mut(..self.noise().dimension()) {
            Some(short) => short,
            None => {
                long = zero_vector(self.noise().dimension());
                &mut long[..]
            }
        };
        if let &[first, second] = dimensions {
            // Two ports, as most measurements have: nothing is looked up per draw.
            let draws = senders.points[1 - to].chunks_exact(if to == 0 { second } else { first });
            for (value, draw) in values.iter_mut().zip(draws) {
                let x = if to == 0 { [point, draw] } else { [draw, point] };
                self.residual_at(&x, residual);
                *value = read(residual);
            }
            return;
        }
        let mut x: SmallVec<[&[f64]; 3]> = SmallVec::from_elem(point, dimensions.len());
        for (draw, value) in values.iter_mut().enumerate() {
            for (port, &d) in dimensions.iter().enumerate().filter(|(port, _)| *port != to) {
                x[port] = &senders.points[port][draw * d..][..d];
            }
            self.residual_at(&x, residual);
            *value = read(residual);
        }
    }

    fn sample(
        &self,
        to: Port,
        view: &dyn ParticleView,
        form: &ParticlesForm,
        senders: &Senders,
        stream: &mut Stream,
        out: &mut Particles,
    ) -> Result<(), MessageError> {
        let Some(sampler) = self.0.sampler(to) else { return Ok(()) };
        let dimensions = self.0.dimensions();
        let own = zero_vector(dimensions[to]);
        let mut random = stream.fast();
        let space = Space::new(view.coordinates(to).to_vec());
        out.become_sample(view.coordinates(to), form.count, |points, _| {
            for (draw, point) in points.chunks_exact_mut(dimensions[to]).enumerate() {
                let draw = draw % senders.draws;
                let others: SmallVec<[&[f64]; 3]> = dimensions
                    .iter()
                    .enumerate()
                    .map(
                        |(port, &d)| {
                            if port == to { &own[..] } else { &senders.points[port][draw * d..][..d] }
                        },
                    )
                    .collect();
                sampler.sample(&others, point, &mut random);
                space.wrap(point);
            }
            Ok(())
        })
    }
}

/// Sums below this are taken again from the largest term: they are near the end of the number range.
const SMALL: f64 = 1e-250;

/// Log of Σ exp(log - peak), where no log is above `peak`.
fn log_sum_below(logs: &[f64], peak: f64) -> f64 {
    let sum = sum_of_exponentials(logs, peak);
    if sum > SMALL || sum.is_nan() {
        return sum.ln();
    }
    let largest = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    if largest == f64::NEG_INFINITY {
        return largest;
    }
    largest - peak + sum_of_exponentials(logs, largest).ln()
}

/// Log of Σ exp(-½ w r²) over residuals r.
fn log_sum_of_gaussians(residuals: &[f64], weight: f64) -> f64 {
    let sum = sum_of_gaussians(residuals, weight, 0.0);
    if sum > SMALL || sum.is_nan() {
        return sum.ln();
    }
    let least = residuals.iter().fold(f64::INFINITY, |least: f64, r| least.min(r.abs()));
    let largest = -0.5 * weight * least * least;
    if largest == f64::NEG_INFINITY {
        return largest;
    }
    largest + sum_of_gaussians(residuals, weight, -largest).ln()
}

/// Share of the draws that ignore the guide, which bounds every weight by its reciprocal.
const DEFENSIVE: f64 = 0.2;
/// Power of the guide: its information is halved, so that its tails are wider than the truth's.
const TEMPERING: f64 = 0.5;

/// One draw of f(x) + B z per particle, ancestors chosen systematically by weight: a particle filter's prediction.
pub(crate) fn plain<M: Motion>(
    motion: &M,
    coordinates: &[Coordinate],
    sample: &Particles,
    count: usize,
    stream: &mut Stream,
    out: &mut Particles,
) -> Result<(), MessageError> {
    if sample.is_empty() {
        return Err(nothing_to_predict());
    }
    let mut random = stream.fast();
    let ancestors = select(sample.log_weights(), count, &mut random);
    let d = sample.dimension();
    let cloud = Cloud::from_points(d, sample.points());
    let mover = Mover::new(motion, coordinates);
    let (mut draws, mut block) = (Vec::new(), vec![0.0; BLOCK * d]);
    out.become_sample(coordinates, count, |points, _| {
        for (points, ancestors) in points.chunks_mut(BLOCK * d).zip(ancestors.chunks(BLOCK)) {
            let from = Source { cloud: &cloud, first: 0, ancestors: Some(ancestors) };
            mover.advance(ancestors.len(), from, &mut random, &mut draws, &mut block);
            for (i, point) in points.chunks_exact_mut(d).enumerate() {
                point.iter_mut().enumerate().for_each(|(k, x)| *x = block[k * BLOCK + i]);
            }
        }
        Ok(())
    })
}

/// Draws of a predicted state.
pub(crate) struct Guided<'a> {
    pub(crate) step: &'a dyn Fn(&[f64], &mut [f64]),
    pub(crate) linearise: &'a dyn Fn(&[f64]) -> (Vector, Matrix),
    pub(crate) noise: &'a dyn Fn(&[f64]) -> ProcessNoise,
    pub(crate) coordinates: &'a [Coordinate],
}

impl Guided<'_> {
    fn wrap(&self, point: &mut [f64]) {
        for (x, _) in point.iter_mut().zip(self.coordinates).filter(|(_, kind)| **kind == Coordinate::Angle) {
            *x = wrap_angle(*x);
        }
    }

    /// Draws of the prediction through a guide g(x) = exp(-½ x'Λx + η'x), what is known of the receiver.
    ///
    /// The prediction is a mixture of kernels cᵢ + B z, z ~ N(0, I), of which B may have any rank. The product with
    /// the guide is Gaussian in z: precision P = I + B'ΛB, mean P⁻¹bᵢ with bᵢ = B'(η - Λcᵢ), and evidence
    /// Zᵢ = |P|^-½ g(cᵢ) exp(½ bᵢ'P⁻¹bᵢ). Ancestors are chosen by wᵢZᵢ; a share α may ignore the guide. The weight
    /// 1 / (α + (1 - α) g(x) / Z̄) makes the draws a sample of the prediction again.
    pub(crate) fn guided(
        &self,
        sample: &Particles,
        guide: &DynamicGaussian,
        form: &ParticlesForm,
        stream: &mut Stream,
        out: &mut Particles,
    ) -> Result<(), MessageError> {
        if sample.is_empty() {
            return Err(nothing_to_predict());
        }
        let (d, count) = (sample.dimension(), form.count);
        let informed = form.proposal == Proposal::Informed;
        let Kernels { centres, factor } = self.kernels(sample, guide, informed)?;
        let guide = if informed { guide.power(TEMPERING) } else { guide.clone() };
        let sources = factor.len() / d;
        let (mut information, mut eta) = (zeros(d * d), zero_vector(d));
        guide.write_matrix(&mut information);
        eta.copy_from_slice(guide.information_vector());
        let transposed = transpose(&factor, d, sources);
        let seen = multiply(&transposed, &information, d, d);
        let mut precision = multiply(&seen, &factor, d, sources);
        (0..sources).for_each(|k| precision[k * sources + k] += 1.0);
        symmetrise(&mut precision, sources);
        let posterior = Cholesky::new(&precision, sources, "the guided kernel")?;
        let half_log_determinant = 0.5 * posterior.log_determinant();
        let towards = multiply(&transposed, &eta, d, 1);
        let mut means = vec![0.0; sample.len() * sources];
        let mut chances = Vec::with_capacity(sample.len());
        let each = centres.chunks_exact(d).zip(means.chunks_exact_mut(sources)).zip(sample.log_weights());
        for ((centre, mean), log_weight) in each {
            let there = multiply(&seen, centre, d, 1);
            let mut pull: Vector = towards.iter().zip(&there).map(|(t, s)| t - s).collect();
            mean.copy_from_slice(&pull);
            posterior.solve(mean);
            let gain = posterior.squared_length(&mut pull);
            chances.push(log_weight + guide.log_value(centre) - half_log_determinant + 0.5 * gain);
        }
        let log_total = log_sum(&chances);
        if !log_total.is_finite() {
            let remedy = "the guide and the prediction do not overlap; use the proposal \"prediction\"";
            return Err(MessageError::NoWeight { what: "the guided prediction", largest: log_total, remedy });
        }

        let mut random = stream.fast();
        let plain = if informed { (DEFENSIVE * count as f64).round() as usize } else { 0 };
        let guided = select(&chances, count - plain, &mut random);
        let defensive = select(sample.log_weights(), plain, &mut random);
        let share = plain as f64 / count as f64;
        out.become_sample(self.coordinates, count, |points, log_weights| {
            let ancestors = guided
                .iter()
                .map(|&i| (i as usize, true))
                .chain(defensive.iter().map(|&i| (i as usize, false)));
            let mut z = zero_vector(sources);
            for ((point, log_weight), (ancestor, is_guided)) in
                points.chunks_exact_mut(d).zip(log_weights).zip(ancestors)
            {
                z.iter_mut().for_each(|z| *z = StandardNormal.sample(&mut random));
                if is_guided {
                    // With precision L L', L'⁻¹ z has its inverse as covariance.
                    posterior.solve_upper(&mut z);
                    z.iter_mut().zip(&means[ancestor * sources..]).for_each(|(z, mean)| *z += mean);
                }
                point.copy_from_slice(&centres[ancestor * d..][..d]);
                multiply_add(&factor, &z, sources, 1, point);
                let favour = (guide.log_value(point) - log_total).exp();
                *log_weight = -(share + (1.0 - share) * favour).ln();
                self.wrap(point);
            }
            Ok(())
        })
    }

    /// The kernels of the prediction. Smoothed ones are shrunk towards the mean so that their own width does not
    /// add to the spread (West 1993): cᵢ = f(x̄ + √(1 - h²) (xᵢ - x̄)), covariance h² F P F' + the process noise's.
    fn kernels(
        &self,
        sample: &Particles,
        guide: &DynamicGaussian,
        smoothed: bool,
    ) -> Result<Kernels, MessageError> {
        let d = sample.dimension();
        let moments = sample.moments();
        let (shrink, width) = if smoothed {
            let rule = 4.0 / ((d as f64 + 2.0) * sample.effective_sample_size());
            let width = rule.powf(1.0 / (d as f64 + 4.0)).min(1.0);
            ((1.0 - width * width).sqrt(), width)
        } else {
            (1.0, 0.0)
        };
        let reference = self.near_turn(&moments.mean, guide);
        let mut centres = vec![0.0; sample.len() * d];
        let mut pulled = zero_vector(d);
        for (centre, point) in centres.chunks_exact_mut(d).zip(sample.points().chunks_exact(d)) {
            for (k, pulled) in pulled.iter_mut().enumerate() {
                let mut offset = point[k] - moments.mean[k];
                if self.coordinates[k] == Coordinate::Angle {
                    offset = wrap_angle(offset);
                }
                *pulled = moments.mean[k] + shrink * offset;
            }
            (self.step)(&pulled, centre);
            for (k, x) in centre.iter_mut().enumerate() {
                if self.coordinates[k] == Coordinate::Angle {
                    *x = reference[k] + wrap_angle(*x - reference[k]);
                }
            }
        }
        let noise = (self.noise)(&moments.mean);
        if !smoothed {
            return Ok(Kernels { centres, factor: Matrix::from_slice(noise.factor()) });
        }
        let (_, jacobian) = (self.linearise)(&moments.mean);
        let moved = multiply(&jacobian, &moments.covariance, d, d);
        let mut shape = multiply(&moved, &transpose(&jacobian, d, d), d, d);
        shape.iter_mut().for_each(|entry| *entry *= width * width);
        shape.iter_mut().zip(&noise.covariance()).for_each(|(entry, noise)| *entry += noise);
        symmetrise(&mut shape, d);
        let factor = Matrix::from_slice(ProcessNoise::from_covariance(&shape)?.factor());
        Ok(Kernels { centres, factor })
    }

    /// The predicted mean, angles on the turn nearest the guide's mean where it has one.
    fn near_turn(&self, mean: &[f64], guide: &DynamicGaussian) -> Vector {
        let mut reference = zero_vector(mean.len());
        (self.step)(mean, &mut reference);
        let mut guided = zero_vector(mean.len());
        if guide.mean_into(&mut guided).is_ok() {
            for (k, x) in reference.iter_mut().enumerate() {
                if self.coordinates[k] == Coordinate::Angle {
                    *x = guided[k] + wrap_angle(*x - guided[k]);
                }
            }
        }
        reference
    }
}

struct Kernels {
    centres: Vec<f64>,
    /// State by sources, row-major.
    factor: Matrix,
}

fn nothing_to_predict() -> MessageError {
    MessageError::Unsupported("the state to predict from has no particles; give it a prior".into())
}
