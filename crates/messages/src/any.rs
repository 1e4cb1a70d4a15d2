//! The sum of all families: one graph, each edge in its own form.
//!
//! A product of messages in different forms is taken in the belief's form:
//!
//! - a **Gaussian** belief reads particles by their moments, and reports what that cost;
//! - a **particle** belief keeps its points and weighs them by each Gaussian message, which costs nothing; where
//!   there are no points yet it draws them from the product of the Gaussian messages.

use crate::kernel::floor_diagonal;
use crate::moments::gaussian_divergence;
use crate::particles::{Role, Support, carrier};
use crate::{DynamicGaussian, GaussianFamily, GaussianForm, Moments, Particles, ParticlesForm};
use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};
use smallvec::SmallVec;
use std::f64::consts::TAU;
use std::sync::Arc;
use sumprod_graph::{Coordinate, Message, MessageError, Messages, Quality, Space, Stream};

/// How an edge holds its messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum AnyForm {
    /// A Gaussian in information form.
    Gaussian(GaussianForm),
    /// Weighted particles.
    Particles(ParticlesForm),
}

impl Default for AnyForm {
    fn default() -> Self {
        Self::Gaussian(GaussianForm::default())
    }
}

impl AnyForm {
    /// A Gaussian, linearised to first order.
    pub fn gaussian() -> Self {
        Self::default()
    }

    /// `count` weighted particles.
    pub fn particles(count: usize) -> Self {
        Self::Particles(ParticlesForm::new(count))
    }

    /// The name of the family.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Gaussian(_) => "gaussian",
            Self::Particles(_) => "particles",
        }
    }

    fn richness(&self) -> usize {
        match self {
            Self::Gaussian(_) => 0,
            Self::Particles(form) => form.count,
        }
    }
}

/// A message of one of the built-in families.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
pub enum AnyValue {
    /// A Gaussian in information form.
    Gaussian(DynamicGaussian),
    /// Weighted particles.
    Particles(Particles),
}

impl Clone for AnyValue {
    fn clone(&self) -> Self {
        match self {
            Self::Gaussian(gaussian) => Self::Gaussian(gaussian.clone()),
            Self::Particles(particles) => Self::Particles(particles.clone()),
        }
    }

    fn clone_from(&mut self, source: &Self) {
        match (self, source) {
            (Self::Gaussian(own), Self::Gaussian(other)) => own.clone_from(other),
            (Self::Particles(own), Self::Particles(other)) => own.clone_from(other),
            (own, other) => *own = other.clone(),
        }
    }
}

/// A message of any built-in family, with what conversions cost on the way to it.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
pub struct AnyMessage {
    value: AnyValue,
    coordinates: Arc<[Coordinate]>,
    /// Divergence (nats) of the conversions that this message needed; none where there was no conversion.
    loss: Option<f64>,
}

impl Clone for AnyMessage {
    fn clone(&self) -> Self {
        Self { value: self.value.clone(), coordinates: self.coordinates.clone(), loss: self.loss }
    }

    fn clone_from(&mut self, source: &Self) {
        self.value.clone_from(&source.value);
        self.coordinates.clone_from(&source.coordinates);
        self.loss = source.loss;
    }
}

impl AnyMessage {
    /// A Gaussian of this mean and covariance (row-major) on `space`.
    ///
    /// # Errors
    ///
    /// As [`DynamicGaussian::from_moments`], and where the dimension is not the space's.
    pub fn gaussian(space: &Space, mean: &[f64], covariance: &[f64]) -> Result<Self, MessageError> {
        Self::from_gaussian(space, DynamicGaussian::from_moments(mean, covariance)?)
    }

    /// A Gaussian message on `space`.
    ///
    /// # Errors
    ///
    /// Where the dimension is not the space's.
    pub fn from_gaussian(space: &Space, gaussian: DynamicGaussian) -> Result<Self, MessageError> {
        let coordinates = coordinates_of(space);
        if gaussian.dimension() != coordinates.len() {
            let (found, expected) = (gaussian.dimension(), coordinates.len());
            return Err(MessageError::Dimension { what: "the message", found, expected });
        }
        Ok(Self { value: AnyValue::Gaussian(gaussian), coordinates, loss: None })
    }

    /// A message held by particles.
    pub fn from_particles(particles: Particles) -> Self {
        let coordinates = particles.coordinates().into();
        Self { value: AnyValue::Particles(particles), coordinates, loss: None }
    }

    /// The message in its family.
    pub fn value(&self) -> &AnyValue {
        &self.value
    }

    /// The particles, where it is held by particles.
    pub fn particles(&self) -> Option<&Particles> {
        match &self.value {
            AnyValue::Particles(particles) => Some(particles),
            AnyValue::Gaussian(_) => None,
        }
    }

    /// Mean and covariance.
    ///
    /// # Errors
    ///
    /// Where the message has none: improper, vacuous, or a likelihood.
    pub fn moments(&self) -> Result<Moments, MessageError> {
        match &self.value {
            AnyValue::Gaussian(gaussian) => gaussian.moments(),
            AnyValue::Particles(particles) if particles.is_proper() => Ok(particles.moments()),
            AnyValue::Particles(_) => Err(no_distribution()),
        }
    }

    /// The message as a Gaussian, and the divergence (nats) that costs.
    ///
    /// # Errors
    ///
    /// Where particles are a likelihood, which has no moments of its own.
    pub fn to_gaussian(&self) -> Result<(DynamicGaussian, f64), MessageError> {
        match &self.value {
            AnyValue::Gaussian(gaussian) => Ok((gaussian.clone(), 0.0)),
            AnyValue::Particles(particles) => particles_to_gaussian(particles),
        }
    }

    /// The message as a sample of `count` particles, and the divergence (nats) that costs.
    ///
    /// # Errors
    ///
    /// Where a Gaussian is improper.
    pub fn to_particles(&self, count: usize, stream: &mut Stream) -> Result<(Particles, f64), MessageError> {
        match &self.value {
            AnyValue::Particles(particles) => Ok((particles.clone(), 0.0)),
            AnyValue::Gaussian(gaussian) => gaussian_to_particles(gaussian, &self.coordinates, count, stream),
        }
    }

    fn lose(&mut self, loss: f64) {
        if loss != 0.0 {
            *self.loss.get_or_insert(0.0) += loss;
        }
    }
}

fn coordinates_of(space: &Space) -> Arc<[Coordinate]> {
    match space {
        Space::Continuous(coordinates) => coordinates.as_slice().into(),
        Space::Finite(_) => Arc::from([]),
    }
}

fn no_distribution() -> MessageError {
    let reason = "particles that are no sample (empty, or values of a likelihood) have no moments; hold this \
                  belief in particles";
    MessageError::Unsupported(reason.into())
}

/// A sample's moments; the loss is its negentropy, by third and fourth cumulants of the whitened coordinates
/// (Hyvärinen 1998): Σ κ₃²/12 + κ₄²/48.
fn particles_to_gaussian(particles: &Particles) -> Result<(DynamicGaussian, f64), MessageError> {
    if particles.is_empty() {
        return Ok((DynamicGaussian::flat(particles.dimension()), 0.0));
    }
    if particles.role() == Role::Likelihood {
        return Err(no_distribution());
    }
    let mut moments = particles.moments();
    let d = moments.dimension();
    floor_diagonal(&mut moments.covariance, d);
    let gaussian = DynamicGaussian::from_moments(&moments.mean, &moments.covariance)?;
    let factor = crate::Cholesky::new(&moments.covariance, d, "the covariance of the particles")?;
    let mut cumulants = vec![(0.0, 0.0); d];
    let mut offset = vec![0.0; d];
    for (index, weight) in particles.weights().iter().enumerate() {
        particles.offset(particles.point(index), &moments.mean, &mut offset);
        factor.solve_lower(&mut offset);
        for ((third, fourth), z) in cumulants.iter_mut().zip(&offset) {
            *third += weight * z * z * z;
            *fourth += weight * z * z * z * z;
        }
    }
    let loss =
        cumulants.iter().map(|(third, fourth)| third * third / 12.0 + (fourth - 3.0).powi(2) / 48.0).sum();
    Ok((gaussian, loss))
}

/// Draws from a Gaussian; the loss is the divergence from it to the Gaussian with the sample's moments.
fn gaussian_to_particles(
    gaussian: &DynamicGaussian,
    coordinates: &Arc<[Coordinate]>,
    count: usize,
    stream: &mut Stream,
) -> Result<(Particles, f64), MessageError> {
    if gaussian.is_flat() {
        return Ok((Particles::vacuous(&Space::new(coordinates.to_vec())), 0.0));
    }
    let particles = draw(gaussian, coordinates, count, stream)?;
    let exact = gaussian.moments()?;
    let mut drawn = particles.moments();
    floor_diagonal(&mut drawn.covariance, exact.dimension());
    for ((drawn, exact), kind) in drawn.mean.iter_mut().zip(&exact.mean).zip(coordinates.iter()) {
        if *kind == Coordinate::Angle {
            *drawn = exact + sumprod_graph::wrap_angle(*drawn - exact);
        }
    }
    let loss = if count > exact.dimension() { gaussian_divergence(&exact, &drawn)? } else { f64::INFINITY };
    Ok((particles, loss))
}

fn draw(
    gaussian: &DynamicGaussian,
    coordinates: &Arc<[Coordinate]>,
    count: usize,
    stream: &mut Stream,
) -> Result<Particles, MessageError> {
    let d = gaussian.dimension();
    let information = gaussian.factor()?;
    let mut mean = gaussian.information_vector().to_vec();
    information.solve(&mut mean);
    let space = Space::new(coordinates.to_vec());
    let log_normaliser = 0.5 * (information.log_determinant() - d as f64 * TAU.ln());
    let mut random = stream.fast();
    let mut points = Vec::with_capacity(count * d);
    let mut log_proposal = Vec::with_capacity(count);
    let mut z: SmallVec<[f64; 6]> = SmallVec::from_elem(0.0, d);
    for _ in 0..count {
        z.iter_mut().for_each(|z| *z = StandardNormal.sample(&mut random));
        log_proposal.push(log_normaliser - 0.5 * z.iter().map(|z| z * z).sum::<f64>());
        // With Λ = L L', L'⁻¹ z has covariance Λ⁻¹.
        information.solve_upper(&mut z);
        let start = points.len();
        points.extend(mean.iter().zip(&z).map(|(mean, offset)| mean + offset));
        space.wrap(&mut points[start..]);
    }
    let support = Support { coordinates: coordinates.to_vec(), points, log_proposal: Some(log_proposal) };
    let log_weights = vec![-(count as f64).ln(); count];
    Ok(Particles { support: Arc::new(support), log_weights, role: Role::Sample })
}

impl Message for AnyMessage {
    type Form = AnyForm;

    fn vacuous(space: &Space) -> Self {
        let value = AnyValue::Gaussian(DynamicGaussian::flat(space.dimension()));
        Self { value, coordinates: coordinates_of(space), loss: None }
    }

    fn product(
        incoming: Messages<'_, Self>,
        form: &AnyForm,
        stream: &mut Stream,
    ) -> Result<Self, MessageError> {
        let Some(first) = incoming.iter().next() else {
            return Err(MessageError::Unsupported("a product needs at least one message".into()));
        };
        let mut product = first.clone();
        Self::product_into(incoming, form, stream, &mut product)?;
        Ok(product)
    }

    fn product_into(
        incoming: Messages<'_, Self>,
        form: &AnyForm,
        stream: &mut Stream,
        out: &mut Self,
    ) -> Result<(), MessageError> {
        out.loss = None;
        match form {
            AnyForm::Gaussian(_) => gaussian_product(incoming, out),
            AnyForm::Particles(form) => particle_product(incoming, form, stream, out),
        }
    }

    fn quotient(&self, incoming: &Self) -> Option<Self> {
        let mut out = self.clone();
        self.quotient_into(incoming, &mut out).then_some(out)
    }

    fn quotient_into(&self, incoming: &Self, out: &mut Self) -> bool {
        out.coordinates.clone_from(&self.coordinates);
        out.loss = self.loss;
        match (&self.value, &incoming.value) {
            (AnyValue::Gaussian(belief), AnyValue::Gaussian(message)) => {
                if let AnyValue::Gaussian(own) = &mut out.value {
                    return belief.quotient_into(message, own);
                }
                out.value = AnyValue::Gaussian(belief.over(message));
                true
            }
            (AnyValue::Particles(belief), AnyValue::Particles(message)) => {
                if let AnyValue::Particles(own) = &mut out.value {
                    return belief.quotient_into(message, own);
                }
                let quotient = belief.quotient(message);
                quotient.map(|quotient| out.value = AnyValue::Particles(quotient)).is_some()
            }
            (AnyValue::Particles(belief), AnyValue::Gaussian(message)) => {
                let mut quotient = belief.clone();
                for (log, point) in
                    quotient.log_weights.iter_mut().zip(belief.points().chunks_exact(belief.dimension()))
                {
                    *log -= log_value(message, &self.coordinates, point);
                }
                let divided = quotient.normalise("the quotient of messages").is_ok();
                out.value = AnyValue::Particles(quotient);
                divided
            }
            (AnyValue::Gaussian(_), AnyValue::Particles(message)) => {
                out.value.clone_from(&self.value);
                message.is_empty()
            }
        }
    }

    fn change(&self, previous: &Self) -> f64 {
        match (&self.value, &previous.value) {
            (AnyValue::Gaussian(new), AnyValue::Gaussian(old)) => new.change(old),
            (AnyValue::Particles(new), AnyValue::Particles(old)) => new.change(old),
            _ => 1.0,
        }
    }

    fn damp(&mut self, previous: &Self, damping: f64) -> bool {
        match (&mut self.value, &previous.value) {
            (AnyValue::Gaussian(new), AnyValue::Gaussian(old)) => new.damp(old, damping),
            (AnyValue::Particles(new), AnyValue::Particles(old)) => new.damp(old, damping),
            (AnyValue::Particles(_), AnyValue::Gaussian(old)) => old.is_flat(),
            (AnyValue::Gaussian(_), AnyValue::Particles(old)) => old.is_empty(),
        }
    }

    fn check_form(form: &AnyForm, space: &Space) -> Result<(), String> {
        match form {
            AnyForm::Gaussian(form) => DynamicGaussian::check_form(form, space),
            AnyForm::Particles(form) => Particles::check_form(form, space),
        }
    }

    fn belief_form<'a>(edges: impl Iterator<Item = &'a AnyForm>) -> AnyForm {
        let mut richest = AnyForm::default();
        for form in edges {
            if form.richness() > richest.richness() {
                richest = *form;
            }
        }
        richest
    }

    fn is_proper(&self) -> bool {
        match &self.value {
            AnyValue::Gaussian(gaussian) => gaussian.is_proper(),
            AnyValue::Particles(particles) => particles.is_proper(),
        }
    }

    fn quality(&self) -> Quality {
        let effective_sample_size =
            self.particles().and_then(|particles| particles.quality().effective_sample_size);
        Quality { effective_sample_size, conversion_loss: self.loss }
    }
}

fn gaussian_product(incoming: Messages<'_, AnyMessage>, out: &mut AnyMessage) -> Result<(), MessageError> {
    if !matches!(out.value, AnyValue::Gaussian(_)) {
        out.value = AnyValue::Gaussian(DynamicGaussian::default());
    }
    let mut loss = 0.0;
    if let AnyValue::Gaussian(product) = &mut out.value {
        for (index, message) in incoming.iter().enumerate() {
            match &message.value {
                AnyValue::Gaussian(gaussian) if index == 0 => product.clone_from(gaussian),
                AnyValue::Gaussian(gaussian) => product.add(gaussian)?,
                AnyValue::Particles(particles) => {
                    let (gaussian, cost) = particles_to_gaussian(particles)?;
                    loss += cost;
                    if index == 0 { product.clone_from(&gaussian) } else { product.add(&gaussian)? }
                }
            }
        }
    }
    out.lose(loss);
    Ok(())
}

fn particle_product(
    incoming: Messages<'_, AnyMessage>,
    form: &ParticlesForm,
    stream: &mut Stream,
    out: &mut AnyMessage,
) -> Result<(), MessageError> {
    let all: SmallVec<[&AnyMessage; 16]> = incoming.iter().collect();
    let gaussians = || {
        all.iter().filter_map(|message| match &message.value {
            AnyValue::Gaussian(gaussian) if !gaussian.is_flat() => Some(gaussian),
            _ => None,
        })
    };
    let sets = all.iter().filter_map(|message| message.particles());
    let carried = carrier(sets.clone());
    let base = match carried {
        Some(sample) if sample.role() == Role::Sample => sample,
        // Likelihoods on points drawn from a known density: those points carry the product by importance.
        Some(values) if values.support.log_proposal.is_some() && gaussians().next().is_some() => values,
        Some(values) if gaussians().next().is_none() => values,
        _ => return drawn_product(&all, form, stream, out),
    };
    let d = base.dimension();
    let mut product = match &mut out.value {
        // The storage of the old belief serves the new one.
        AnyValue::Particles(old) => std::mem::take(old),
        AnyValue::Gaussian(_) => Particles::default(),
    };
    product.clone_from(base);
    for other in sets.filter(|other| !std::ptr::eq(*other, base)) {
        product.absorb(other)?;
    }
    for gaussian in gaussians() {
        for (log, point) in product.log_weights.iter_mut().zip(product.support.points.chunks_exact(d)) {
            *log += log_value(gaussian, &out.coordinates, point);
        }
    }
    if base.role() == Role::Likelihood
        && gaussians().next().is_some()
        && let Some(log_proposal) = &base.support.log_proposal
    {
        for (log, proposal) in product.log_weights.iter_mut().zip(log_proposal) {
            *log -= proposal;
        }
        product.role = Role::Sample;
    }
    product.normalise("the product of messages")?;
    out.value = AnyValue::Particles(product);
    Ok(())
}

/// No points yet, or only likelihoods whose points have no known density: points are drawn from the product of
/// the Gaussian messages. A product that is not yet a distribution stays Gaussian.
fn drawn_product(
    all: &[&AnyMessage],
    form: &ParticlesForm,
    stream: &mut Stream,
    out: &mut AnyMessage,
) -> Result<(), MessageError> {
    let mut product = DynamicGaussian::flat(out.coordinates.len());
    for message in all {
        if let AnyValue::Gaussian(gaussian) = &message.value {
            product.add(gaussian)?;
        }
    }
    if !product.is_proper() {
        out.value = AnyValue::Gaussian(product);
        return Ok(());
    }
    let (mut particles, loss) = gaussian_to_particles(&product, &out.coordinates, form.count, stream)?;
    for other in all.iter().filter_map(|message| message.particles()) {
        particles.absorb(other)?;
    }
    particles.normalise("the product of messages")?;
    out.value = AnyValue::Particles(particles);
    out.lose(loss);
    Ok(())
}

/// Log value of a Gaussian message at a point, angles taken on the turn nearest the message's mean.
fn log_value(gaussian: &DynamicGaussian, coordinates: &[Coordinate], point: &[f64]) -> f64 {
    if !coordinates.contains(&Coordinate::Angle) {
        return gaussian.log_value(point);
    }
    let mut mean: SmallVec<[f64; 6]> = SmallVec::from_elem(0.0, point.len());
    let mut near: SmallVec<[f64; 6]> = SmallVec::from_slice(point);
    if gaussian.mean_into(&mut mean).is_ok() {
        for ((x, mean), kind) in near.iter_mut().zip(&mean).zip(coordinates) {
            if *kind == Coordinate::Angle {
                *x = mean + sumprod_graph::wrap_angle(*x - mean);
            }
        }
    }
    gaussian.log_value(&near)
}

impl GaussianFamily for AnyMessage {
    fn gaussian_form(form: &AnyForm) -> GaussianForm {
        match form {
            AnyForm::Gaussian(form) => *form,
            AnyForm::Particles(_) => GaussianForm::default(),
        }
    }

    fn dimension(&self) -> usize {
        self.coordinates.len()
    }

    fn read_information(&self, information: &mut [f64], vector: &mut [f64]) -> Result<f64, MessageError> {
        let before = self.loss.unwrap_or(0.0);
        match &self.value {
            AnyValue::Gaussian(gaussian) => Ok(before + gaussian.read_information(information, vector)?),
            AnyValue::Particles(particles) => {
                let (gaussian, loss) = particles_to_gaussian(particles)?;
                gaussian.read_information(information, vector)?;
                Ok(before + loss)
            }
        }
    }

    fn write_information(
        &mut self,
        like: &Self,
        information: &[f64],
        vector: &[f64],
        loss: f64,
    ) -> Result<(), MessageError> {
        match &mut self.value {
            AnyValue::Gaussian(gaussian) => gaussian.fill_from(information, vector),
            value => *value = AnyValue::Gaussian(DynamicGaussian::from_information(information, vector)?),
        }
        self.coordinates.clone_from(&like.coordinates);
        self.loss = (loss != 0.0).then_some(loss);
        Ok(())
    }
}

/// A family that can be read and written as particles.
pub trait ParticleFamily: Message {
    /// How many particles an edge of this form holds; none where it does not hold particles.
    fn particles_form(form: &Self::Form) -> Option<ParticlesForm>;

    /// The message as particles, at most `count` where they must be drawn, and what that costs (nats). Vacuous
    /// messages are empty sets.
    ///
    /// # Errors
    ///
    /// Where the message is improper and cannot be drawn from.
    fn read_particles(&self, count: usize, stream: &mut Stream) -> Result<(Particles, f64), MessageError>;

    /// The particles, where it is held by particles.
    fn as_particles(&self) -> Option<&Particles>;

    /// The Gaussian, where it is held by one.
    fn as_gaussian(&self) -> Option<&DynamicGaussian>;

    /// The coordinates of the variable, real or angular.
    fn coordinates(&self) -> &[Coordinate];

    /// Lets `fill` rewrite the message as particles on the space of `like`, in storage it may reuse; `fill`
    /// returns what conversions cost (nats).
    ///
    /// # Errors
    ///
    /// Whatever `fill` returns.
    fn write_particles(
        &mut self,
        like: &Self,
        fill: impl FnOnce(&mut Particles) -> Result<f64, MessageError>,
    ) -> Result<(), MessageError>;
}

impl ParticleFamily for Particles {
    fn particles_form(form: &ParticlesForm) -> Option<ParticlesForm> {
        Some(*form)
    }

    fn read_particles(&self, _count: usize, _stream: &mut Stream) -> Result<(Particles, f64), MessageError> {
        Ok((self.clone(), 0.0))
    }

    fn as_particles(&self) -> Option<&Particles> {
        Some(self)
    }

    fn as_gaussian(&self) -> Option<&DynamicGaussian> {
        None
    }

    fn coordinates(&self) -> &[Coordinate] {
        Particles::coordinates(self)
    }

    fn write_particles(
        &mut self,
        _like: &Self,
        fill: impl FnOnce(&mut Particles) -> Result<f64, MessageError>,
    ) -> Result<(), MessageError> {
        fill(self).map(|_| ())
    }
}

impl ParticleFamily for AnyMessage {
    fn particles_form(form: &AnyForm) -> Option<ParticlesForm> {
        match form {
            AnyForm::Particles(form) => Some(*form),
            AnyForm::Gaussian(_) => None,
        }
    }

    fn read_particles(&self, count: usize, stream: &mut Stream) -> Result<(Particles, f64), MessageError> {
        let (particles, loss) = self.to_particles(count, stream)?;
        Ok((particles, self.loss.unwrap_or(0.0) + loss))
    }

    fn as_particles(&self) -> Option<&Particles> {
        self.particles()
    }

    fn as_gaussian(&self) -> Option<&DynamicGaussian> {
        match &self.value {
            AnyValue::Gaussian(gaussian) => Some(gaussian),
            AnyValue::Particles(_) => None,
        }
    }

    fn coordinates(&self) -> &[Coordinate] {
        &self.coordinates
    }

    fn write_particles(
        &mut self,
        like: &Self,
        fill: impl FnOnce(&mut Particles) -> Result<f64, MessageError>,
    ) -> Result<(), MessageError> {
        if !matches!(self.value, AnyValue::Particles(_)) {
            self.value = AnyValue::Particles(Particles::default());
        }
        if let AnyValue::Particles(particles) = &mut self.value {
            let loss = fill(particles)?;
            self.coordinates.clone_from(&like.coordinates);
            self.loss = (loss != 0.0).then_some(loss);
        }
        Ok(())
    }
}
