//! Chains of labels, one component of each input: what every Gibbs sampler of products shares.

use super::super::Mixture;
use super::super::kernels::{Kernels, Query, Scratch};
use super::super::sample::push_draw;
use super::super::small::{Small, difference, invert, multiply, root, wrap_point};
use super::quality::{PROBES, ProductQuality, Weighted, check_agreement, log_products, sort};
use super::{GibbsStart, Product};
use crate::Particles;
use rand::RngExt;
use sumprod_graph::{FastStream, MessageError};

/// The inputs laid out for conditionals, and the storage of one chain.
pub(super) struct Chains<'a> {
    inputs: Vec<Input<'a>>,
    pub(super) scratch: Scratch,
    mean: Small,
    covariance: Small,
    precision: Small,
    vector: Small,
    offset: Small,
}

struct Input<'a> {
    mixture: &'a Mixture,
    kernels: Kernels,
    cumulative: Vec<f64>,
    /// Inverse covariances, one where they are shared.
    precisions: Vec<f64>,
}

impl Input<'_> {
    fn precision(&self, label: usize, entries: usize) -> &[f64] {
        let start = if self.mixture.shared { 0 } else { label * entries };
        &self.precisions[start..start + entries]
    }
}

impl<'a> Chains<'a> {
    pub(super) fn new(inputs: impl Iterator<Item = &'a Mixture>) -> Self {
        let inputs: Vec<Input<'a>> = inputs
            .map(|mixture| {
                let d = mixture.dimension();
                let matrices = if mixture.shared { 1 } else { mixture.len() };
                let mut precisions = vec![0.0; matrices * d * d];
                for (i, out) in precisions.chunks_exact_mut(d * d).enumerate() {
                    invert(mixture.covariance_of(i), d, out);
                }
                Input {
                    mixture,
                    kernels: Kernels::new(mixture),
                    cumulative: mixture.cumulative(),
                    precisions,
                }
            })
            .collect();
        let d = inputs.first().map_or(0, |input| input.mixture.dimension());
        Self {
            inputs,
            scratch: Scratch::default(),
            mean: Small::from_elem(0.0, d),
            covariance: Small::from_elem(0.0, d * d),
            precision: Small::from_elem(0.0, d * d),
            vector: Small::from_elem(0.0, d),
            offset: Small::from_elem(0.0, d),
        }
    }

    pub(super) fn len(&self) -> usize {
        self.inputs.len()
    }

    /// Computes the Gaussian product of the components chosen in the inputs `among`.
    fn joint(&mut self, labels: &[u32], among: impl Iterator<Item = usize>) -> Result<(), MessageError> {
        let d = self.mean.len();
        self.precision.iter_mut().for_each(|entry| *entry = 0.0);
        self.vector.iter_mut().for_each(|entry| *entry = 0.0);
        let mut reference: Option<&[f64]> = None;
        for l in among {
            let input = &self.inputs[l];
            let label = labels[l] as usize;
            let mean = input.mixture.mean_of(label);
            // Relative to the first mean, so that angles have one branch and large coordinates keep their digits.
            let reference = *reference.get_or_insert(mean);
            difference(input.mixture.coordinates(), mean, reference, &mut self.offset);
            let precision = input.precision(label, d * d);
            for row in 0..d {
                for column in 0..d {
                    let entry = precision[row * d + column];
                    self.precision[row * d + column] += entry;
                    self.vector[row] += entry * self.offset[column];
                }
            }
        }
        let Some(reference) = reference else {
            let reason = "a label has no conditional where there is no other input";
            return Err(MessageError::Unsupported(reason.into()));
        };
        if invert(&self.precision, d, &mut self.covariance).is_none() {
            let what = "the precision of a product of components";
            return Err(MessageError::NotPositiveDefinite {
                what,
                pivot: d - 1,
                value: self.precision[d * d - 1],
            });
        }
        multiply(&self.covariance, &self.vector, &mut self.mean);
        self.mean.iter_mut().zip(reference).for_each(|(m, r)| *m += r);
        if let Some(input) = self.inputs.first() {
            wrap_point(input.mixture.coordinates(), &mut self.mean);
        }
        Ok(())
    }

    /// Draws the label of input `l` by its agreement with the Gaussian of the last [`Chains::joint`].
    fn choose(&mut self, l: usize, heat: f64, random: &mut FastStream) -> Result<u32, MessageError> {
        let query = Query { mean: &self.mean, covariance: &self.covariance, heat };
        let picked = self.inputs[l].kernels.pick(query, random.random(), &mut self.scratch);
        picked.map(|(label, _)| label as u32).ok_or_else(singular)
    }

    /// Draws every label by the density of its component at `point`.
    pub(super) fn choose_at(
        &mut self,
        point: &[f64],
        labels: &mut [u32],
        random: &mut FastStream,
    ) -> Result<(), MessageError> {
        let zero = Small::from_elem(0.0, point.len() * point.len());
        for (input, label) in self.inputs.iter().zip(labels) {
            let query = Query { mean: point, covariance: &zero, heat: 1.0 };
            let picked = input.kernels.pick(query, random.random(), &mut self.scratch);
            *label = picked.ok_or_else(singular)?.0 as u32;
        }
        Ok(())
    }

    /// First labels of a chain.
    pub(super) fn start(
        &mut self,
        start: GibbsStart,
        heat: f64,
        labels: &mut [u32],
        random: &mut FastStream,
    ) -> Result<(), MessageError> {
        for l in 0..self.len() {
            if l > 0 && start == GibbsStart::Sequential {
                self.joint(labels, 0..l)?;
                labels[l] = self.choose(l, heat, random)?;
            } else {
                let input = &self.inputs[l];
                let total = input.cumulative.last().copied().unwrap_or(1.0);
                let height = random.random::<f64>() * total;
                let label = input.cumulative.partition_point(|&sum| sum <= height);
                labels[l] = label.min(input.cumulative.len() - 1) as u32;
            }
        }
        Ok(())
    }

    /// Draws every label once given all others; returns how many changed. The covariances of all components are
    /// multiplied by `heat`. `counted_twice` lets the conditional of a label include its own present component, as
    /// the paper of P-MPA may be read, which is not a Gibbs sampler of the product.
    pub(super) fn sweep(
        &mut self,
        labels: &mut [u32],
        heat: f64,
        counted_twice: bool,
        random: &mut FastStream,
    ) -> Result<usize, MessageError> {
        let mut changed = 0;
        for l in 0..self.len() {
            let count = self.len();
            self.joint(labels, (0..count).filter(|&other| counted_twice || other != l))?;
            let label = self.choose(l, heat, random)?;
            changed += usize::from(label != labels[l]);
            labels[l] = label;
        }
        Ok(changed)
    }

    /// A point of the product of the chosen components.
    pub(super) fn draw(
        &mut self,
        labels: &[u32],
        random: &mut FastStream,
        points: &mut Vec<f64>,
    ) -> Result<(), MessageError> {
        self.joint(labels, 0..labels.len())?;
        let d = self.mean.len();
        let factor = root(&self.covariance, d).ok_or_else(singular)?;
        if let Some(input) = self.inputs.first() {
            push_draw(input.mixture, &self.mean, &factor, random, points);
        }
        Ok(())
    }

    /// The product with one point per chain (`labels` chain by chain), and what these labels say of its quality.
    pub(super) fn finish(
        mut self,
        method: &str,
        labels: &[u32],
        label_change: Option<f64>,
        random: &mut FastStream,
    ) -> Result<Product, MessageError> {
        let inputs: Vec<&Mixture> = self.inputs.iter().map(|input| input.mixture).collect();
        let d = self.mean.len();
        let chains = labels.len() / self.len();
        let shared = inputs.iter().all(|input| input.shared);
        let mut points = Vec::with_capacity(chains * d);
        let mut means = Vec::with_capacity(chains * d);
        let mut covariances = Vec::new();
        for chain in labels.chunks_exact(self.len()) {
            self.draw(chain, random, &mut points)?;
            means.extend_from_slice(&self.mean);
            if covariances.is_empty() || !shared {
                covariances.extend_from_slice(&self.covariance);
            }
        }
        let coordinates = inputs[0].coordinates();
        let (chosen, _) = Mixture::assemble(coordinates, vec![0.0; chains], means, covariances, shared)?;
        let probes: Vec<f64> =
            points.chunks_exact(d).step_by(chains.div_ceil(PROBES)).flatten().copied().collect();
        let sorted = sort(&chosen, &probes);
        let log_p = log_products(&inputs, &probes, &sorted, 1e-6)?;
        let log_q = log_products(&[&chosen], &probes, &sorted, 1e-6)?;
        let weighted = Weighted::new(&log_p, &log_q);
        let mut quality = ProductQuality::new(method, chains as f64);
        quality.label_change = label_change;
        // Drawn from q, not from p: KL(q ‖ p) is ln Z - E[ln p/q].
        let mean: f64 = log_p.iter().zip(&log_q).map(|(p, q)| p - q).sum::<f64>() / log_p.len() as f64;
        quality.divergence = Some((weighted.log_normaliser - mean).max(0.0));
        check_agreement(&inputs, log_p.iter().copied().fold(f64::NEG_INFINITY, f64::max), &mut quality)?;
        let space = sumprod_graph::Space::new(coordinates);
        Ok(Product {
            particles: Particles::equally_weighted(&space, points)?,
            mixture: None,
            near: Some(chosen),
            log_normaliser: Some(weighted.log_normaliser),
            quality,
        })
    }
}

fn singular() -> MessageError {
    let reason = "a sum of two components' covariances is singular, so their agreement has no value";
    MessageError::Unsupported(reason.into())
}
