//! Mixtures of Gaussian messages of any rank: what a factor that reads part of a variable says of it.
//!
//! m(x) = Σₖ exp(aₖ + gₖ'δ - ½ δ'Λₖδ), δ = x - cₖ with angular differences wrapped. A range between two robots says
//! where each may be but nothing of its velocity: Λₖ leaves those directions open, and no covariance could say so.
//! Each component is written about the point cₖ it was linearised at.

use super::small::{Small, difference, invert, multiply, wrap_point};
use super::times::Local;
use super::{Evaluator, Mixture, finite, size};
use crate::DynamicGaussian;
use crate::vector::log_sum;
use serde::{Deserialize, Serialize};
use std::f64::consts::{PI, TAU};
use sumprod_graph::{Coordinate, MessageError, Space};

/// Variance up to which a Gaussian knows an angle (rad²): three standard deviations make half a turn.
const KNOWN_ANGLE: f64 = PI * PI / 9.0;

/// A mixture of Gaussian messages of any rank.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "PotentialRecord", into = "PotentialRecord")]
pub struct Potential {
    pub(super) coordinates: Vec<Coordinate>,
    /// Component by component, the log of the message at its centre; the largest is zero.
    pub(super) log_values: Vec<f64>,
    pub(super) centres: Vec<f64>,
    pub(super) gradients: Vec<f64>,
    /// Row-major, component by component.
    pub(super) informations: Vec<f64>,
}

impl Potential {
    /// A potential without components, to be filled by [`Potential::push`].
    pub fn new(coordinates: &[Coordinate]) -> Self {
        Self {
            coordinates: coordinates.to_vec(),
            log_values: Vec::new(),
            centres: Vec::new(),
            gradients: Vec::new(),
            informations: Vec::new(),
        }
    }

    /// What says nothing: one component of no information.
    pub fn flat(coordinates: &[Coordinate]) -> Self {
        let d = coordinates.len();
        let mut flat = Self::new(coordinates);
        flat.push(0.0, &vec![0.0; d], &vec![0.0; d], &vec![0.0; d * d]);
        flat
    }

    /// A Gaussian message. Angles that it knows are written about its mean, others about zero.
    pub fn from_gaussian(coordinates: &[Coordinate], gaussian: &DynamicGaussian) -> Self {
        let d = coordinates.len();
        let mut information = Small::from_elem(0.0, d * d);
        gaussian.write_matrix(&mut information);
        let mut centre = Small::from_elem(0.0, d);
        if let Ok(moments) = gaussian.moments() {
            for (k, kind) in coordinates.iter().enumerate() {
                if *kind == Coordinate::Real || moments.covariance_at(k, k) <= KNOWN_ANGLE {
                    centre[k] = moments.mean[k];
                }
            }
        }
        let mut gradient = Small::from_elem(0.0, d);
        multiply(&information, &centre, &mut gradient);
        gradient.iter_mut().zip(gaussian.information_vector()).for_each(|(g, eta)| *g = eta - *g);
        let mut potential = Self::new(coordinates);
        potential.push(0.0, &centre, &gradient, &information);
        potential
    }

    /// Adds exp(`log_value` + gradient'δ - ½ δ' information δ), δ = x - centre; the information row-major.
    ///
    /// Every slice has the size that the coordinates ask for; what is longer is cut, what is shorter counts as zero.
    pub fn push(&mut self, log_value: f64, centre: &[f64], gradient: &[f64], information: &[f64]) {
        let d = self.coordinates.len();
        let padded = |slice: &[f64], count: usize| {
            slice.iter().copied().chain(std::iter::repeat(0.0)).take(count).collect::<Small>()
        };
        self.log_values.push(log_value);
        let start = self.centres.len();
        self.centres.extend(padded(centre, d));
        wrap_point(&self.coordinates, &mut self.centres[start..]);
        self.gradients.extend(padded(gradient, d));
        self.informations.extend(padded(information, d * d));
    }

    /// Checks the numbers, leaves out components that vanish beside the largest, and makes that one zero.
    ///
    /// # Errors
    ///
    /// Where there is no component, or a number is not finite.
    pub fn checked(mut self, what: &'static str) -> Result<Self, MessageError> {
        if let Some(&value) = self.log_values.iter().find(|log| log.is_nan() || **log == f64::INFINITY) {
            return Err(MessageError::NotFinite { what, value });
        }
        for numbers in [&self.centres, &self.gradients, &self.informations] {
            finite(what, numbers)?;
        }
        let largest = self.log_values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        if largest == f64::NEG_INFINITY {
            let remedy = "give at least one component a positive weight";
            return Err(MessageError::NoWeight { what, largest, remedy });
        }
        if self.log_values.contains(&f64::NEG_INFINITY) {
            let kept: Vec<usize> = (0..self.len()).filter(|&k| self.log_values[k].is_finite()).collect();
            self = self.select(&kept);
        }
        self.log_values.iter_mut().for_each(|log| *log -= largest);
        Ok(self)
    }

    /// Number of components.
    pub fn len(&self) -> usize {
        self.log_values.len()
    }

    /// Whether there is no component.
    pub fn is_empty(&self) -> bool {
        self.log_values.is_empty()
    }

    /// Number of coordinates.
    pub fn dimension(&self) -> usize {
        self.coordinates.len()
    }

    /// The coordinates, real or angular.
    pub fn coordinates(&self) -> &[Coordinate] {
        &self.coordinates
    }

    /// Whether it says nothing.
    pub fn is_flat(&self) -> bool {
        self.informations.iter().chain(&self.gradients).all(|&number| number == 0.0)
    }

    /// Log of the message at its centre, of one component.
    pub fn log_value_of(&self, component: usize) -> f64 {
        self.log_values[component]
    }

    /// The point that one component is written about.
    pub fn centre_of(&self, component: usize) -> &[f64] {
        let d = self.dimension();
        &self.centres[component * d..][..d]
    }

    /// The gradient of one component's log at its centre.
    pub fn gradient_of(&self, component: usize) -> &[f64] {
        let d = self.dimension();
        &self.gradients[component * d..][..d]
    }

    /// The information of one component, row-major.
    pub fn information_of(&self, component: usize) -> &[f64] {
        let entries = self.dimension() * self.dimension();
        &self.informations[component * entries..][..entries]
    }

    pub(super) fn local(&self, component: usize) -> Local<'_> {
        Local {
            centre: self.centre_of(component),
            gradient: self.gradient_of(component),
            information: self.information_of(component),
        }
    }

    /// Log of the message at a point, up to a constant. O(K d²).
    pub fn log_value(&self, point: &[f64]) -> f64 {
        let d = self.dimension();
        let (mut delta, mut pulled) = (Small::from_elem(0.0, d), Small::from_elem(0.0, d));
        let logs: Small = (0..self.len())
            .map(|k| {
                difference(&self.coordinates, point, self.centre_of(k), &mut delta);
                multiply(self.information_of(k), &delta, &mut pulled);
                let terms = delta.iter().zip(self.gradient_of(k)).zip(&pulled);
                self.log_values[k] + terms.map(|((x, g), p)| x * (g - 0.5 * p)).sum::<f64>()
            })
            .collect();
        log_sum(&logs)
    }

    /// [`Potential::log_value`] at many points, point by point.
    pub(super) fn log_values(&self, points: &[f64], out: &mut [f64]) -> Result<(), MessageError> {
        let d = self.dimension();
        size("the points", points.len(), out.len() * d)?;
        let read = self.read();
        if self.len() > 1
            && !read.is_empty()
            && let Ok((density, log_total)) = self.density_on(&read)
        {
            let points: Vec<f64> =
                points.chunks_exact(d).flat_map(|point| read.iter().map(|&k| point[k])).collect();
            Evaluator::new(&density).log_densities(&points, out)?;
            out.iter_mut().for_each(|log| *log += log_total);
            return Ok(());
        }
        for (log, point) in out.iter_mut().zip(points.chunks_exact(d)) {
            *log = self.log_value(point);
        }
        Ok(())
    }

    /// The components of these numbers.
    pub(super) fn select(&self, components: &[usize]) -> Self {
        let mut chosen = Self::new(&self.coordinates);
        for &k in components {
            chosen.push(self.log_values[k], self.centre_of(k), self.gradient_of(k), self.information_of(k));
        }
        chosen
    }

    /// The coordinates that it reads: those of which some component has information.
    pub fn read(&self) -> Vec<usize> {
        let d = self.dimension();
        let reads = |k: &usize| {
            (0..self.len()).any(|i| {
                self.gradient_of(i)[*k] != 0.0
                    || self.information_of(i)[*k * d..][..d].iter().any(|&entry| entry != 0.0)
            })
        };
        (0..d).filter(reads).collect()
    }

    /// The one component as a Gaussian message; none where there are several.
    pub fn as_gaussian(&self) -> Option<DynamicGaussian> {
        if self.len() != 1 {
            return None;
        }
        let mut vector = Small::from_elem(0.0, self.dimension());
        multiply(&self.informations, &self.centres, &mut vector);
        vector.iter_mut().zip(&self.gradients).for_each(|(eta, g)| *eta += g);
        DynamicGaussian::from_information(&self.informations, &vector).ok()
    }

    /// Every component times exp(`power` · log of the one component of `other`), written about its own centre.
    pub(super) fn times_single(&self, other: Local<'_>, power: f64) -> Self {
        let d = self.dimension();
        let mut product = self.clone();
        let (mut delta, mut pulled) = (Small::from_elem(0.0, d), Small::from_elem(0.0, d));
        for k in 0..self.len() {
            difference(&self.coordinates, self.centre_of(k), other.centre, &mut delta);
            multiply(other.information, &delta, &mut pulled);
            for row in 0..d {
                product.log_values[k] += power * delta[row] * (other.gradient[row] - 0.5 * pulled[row]);
                product.gradients[k * d + row] += power * (other.gradient[row] - pulled[row]);
            }
            for (entry, added) in product.informations[k * d * d..][..d * d].iter_mut().zip(other.information)
            {
                *entry += power * added;
            }
        }
        product
    }

    /// One over the message of one component.
    pub(super) fn negated(&self) -> Self {
        let mut inverse = self.clone();
        let numbers = inverse.log_values.iter_mut().chain(&mut inverse.gradients);
        numbers.chain(&mut inverse.informations).for_each(|number| *number = -*number);
        inverse
    }

    /// The share `damping` of `previous` and the rest of this, by weight, in at most `count` components; none where
    /// they do not read the same coordinates or leave directions open among them.
    pub(super) fn blend(&self, previous: &Self, damping: f64, count: usize) -> Option<Self> {
        let read = self.read();
        if read.is_empty() || read != previous.read() {
            return (read.is_empty() && previous.read().is_empty()).then(|| self.clone());
        }
        let (new, old) = (self.density_on(&read).ok()?.0, previous.density_on(&read).ok()?.0);
        let (both, _) = new.blend(&old, damping).and_then(|both| both.fewer(count, None)).ok()?;
        Some(Self::from_density_on(&self.coordinates, &read, &both))
    }

    /// As a density and the log of its total weight: each component's mean, covariance and mass.
    ///
    /// # Errors
    ///
    /// Where a component leaves a direction open.
    pub(super) fn to_density(&self) -> Result<(Mixture, f64), MessageError> {
        let all: Vec<usize> = (0..self.dimension()).collect();
        self.density_on(&all)
    }

    /// The density on the coordinates `read`, in their order; the others must be open in every component.
    pub(super) fn density_on(&self, read: &[usize]) -> Result<(Mixture, f64), MessageError> {
        let (d, n) = (self.dimension(), read.len());
        let coordinates: Vec<Coordinate> = read.iter().map(|&k| self.coordinates[k]).collect();
        let mut log_weights = Vec::with_capacity(self.len());
        let mut means = Vec::with_capacity(self.len() * n);
        let mut covariances = vec![0.0; self.len() * n * n];
        let mut information = Small::from_elem(0.0, n * n);
        let mut step = Small::from_elem(0.0, n);
        for (k, covariance) in covariances.chunks_exact_mut(n * n).enumerate() {
            let own = self.information_of(k);
            for (row, &i) in read.iter().enumerate() {
                for (column, &j) in read.iter().enumerate() {
                    information[row * n + column] = own[i * d + j];
                }
            }
            let gradient: Small = read.iter().map(|&i| self.gradient_of(k)[i]).collect();
            let Some(log_determinant) = invert(&information, n, covariance) else {
                return Err(crate::moments::improper("a component of the message", &information, n));
            };
            multiply(covariance, &gradient, &mut step);
            let gain: f64 = step.iter().zip(&gradient).map(|(a, b)| a * b).sum();
            log_weights.push(self.log_values[k] + 0.5 * (gain + n as f64 * TAU.ln() - log_determinant));
            let start = means.len();
            means.extend(read.iter().zip(&step).map(|(&i, s)| self.centre_of(k)[i] + s));
            wrap_point(&coordinates, &mut means[start..]);
        }
        Mixture::assemble(&coordinates, log_weights, means, covariances, false)
    }

    /// The coordinates that it reads and the density on them; none where it reads nothing or leaves a direction open.
    pub(super) fn density_on_read(&self) -> Option<(Vec<usize>, Mixture)> {
        let read = self.read();
        let (density, _) = (!read.is_empty()).then(|| self.density_on(&read).ok()).flatten()?;
        Some((read, density))
    }

    /// A density on the coordinates `read` as a message that leaves the others open.
    pub(super) fn from_density_on(coordinates: &[Coordinate], read: &[usize], density: &Mixture) -> Self {
        let (d, n) = (coordinates.len(), read.len());
        let mut potential = Self::new(coordinates);
        let mut inverse = Small::from_elem(0.0, n * n);
        let (mut centre, mut information) = (Small::from_elem(0.0, d), Small::from_elem(0.0, d * d));
        for i in 0..density.len() {
            let log = invert(density.covariance_of(i), n, &mut inverse).unwrap_or(f64::INFINITY);
            for (row, &to) in read.iter().enumerate() {
                centre[to] = density.mean_of(i)[row];
                for (column, &from) in read.iter().enumerate() {
                    information[to * d + from] = inverse[row * n + column];
                }
            }
            let log_value = density.log_weights()[i] - 0.5 * (log + n as f64 * TAU.ln());
            potential.push(log_value, &centre, &vec![0.0; d], &information);
        }
        let largest = potential.log_values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        potential.log_values.iter_mut().for_each(|log| *log -= largest);
        potential
    }

    /// At most `count` components, and an upper bound of the divergence that costs (nats). Where `masses` are given
    /// they say how much each component matters, instead of its weight. Components that leave a direction open among
    /// the coordinates read are not merged: the heaviest stay, and the loss is that of the weight left out.
    ///
    /// # Errors
    ///
    /// Where `count` is zero.
    pub fn reduce(&self, count: usize, masses: Option<&[f64]>) -> Result<(Self, f64), MessageError> {
        if count == 0 {
            let reason = "a mixture cannot be reduced to 0 components; keep at least 1";
            return Err(MessageError::Unsupported(reason.into()));
        }
        if self.len() <= count {
            return Ok((self.clone(), 0.0));
        }
        let read = self.read();
        if !read.is_empty()
            && let Ok((density, _)) = self.density_on(&read)
        {
            let (fewer, loss) = density.fewer(count, masses)?;
            return Ok((Self::from_density_on(&self.coordinates, &read, &fewer), loss));
        }
        let worth: Vec<f64> = match masses {
            Some(masses) => masses.iter().map(|mass| mass.ln()).collect(),
            None => self.log_values.clone(),
        };
        let mut order: Vec<usize> = (0..self.len()).collect();
        order.sort_by(|&a, &b| worth[b].total_cmp(&worth[a]));
        order.truncate(count);
        order.sort_unstable();
        let kept: Vec<f64> = order.iter().map(|&k| worth[k]).collect();
        let loss = (log_sum(&worth) - log_sum(&kept)).max(0.0);
        Ok((self.select(&order).checked("the message")?, loss))
    }
}

/// A potential as it is written.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct PotentialRecord {
    coordinates: Vec<Coordinate>,
    log_values: Vec<f64>,
    centres: Vec<f64>,
    gradients: Vec<f64>,
    informations: Vec<f64>,
}

impl From<Potential> for PotentialRecord {
    fn from(potential: Potential) -> Self {
        let Potential { coordinates, log_values, centres, gradients, informations } = potential;
        Self { coordinates, log_values, centres, gradients, informations }
    }
}

impl TryFrom<PotentialRecord> for Potential {
    type Error = MessageError;

    fn try_from(record: PotentialRecord) -> Result<Self, MessageError> {
        let PotentialRecord { coordinates, log_values, centres, gradients, informations } = record;
        let (d, count) = (coordinates.len(), log_values.len());
        size("the centres of a message", centres.len(), count * d)?;
        size("the gradients of a message", gradients.len(), count * d)?;
        size("the informations of a message", informations.len(), count * d * d)?;
        Self { coordinates, log_values, centres, gradients, informations }.checked("a number of the message")
    }
}

/// The space of these coordinates.
pub(super) fn space_of(coordinates: &[Coordinate]) -> Space {
    Space::new(coordinates)
}
