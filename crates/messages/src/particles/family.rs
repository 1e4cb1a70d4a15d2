//! Particles as a family of messages: products on shared points, else by kernels.

use super::{Particles, ParticlesForm, Role, Support};
use std::sync::Arc;
use sumprod_graph::{Message, MessageError, Messages, Quality, Space, Stream};

/// Which of several messages carries the product: a sample before a likelihood, and among those the one whose
/// points most others share; the first of equals.
pub(crate) fn carrier<'a>(messages: impl Iterator<Item = &'a Particles> + Clone) -> Option<&'a Particles> {
    let score = |particles: &Particles| {
        let shared = messages.clone().filter(|other| other.same_support(particles)).count();
        (particles.role == Role::Sample, shared)
    };
    let mut best: Option<(&Particles, (bool, usize))> = None;
    for particles in messages.clone().filter(|particles| !particles.is_empty()) {
        let own = score(particles);
        if best.is_none_or(|(_, other)| own > other) {
            best = Some((particles, own));
        }
    }
    best.map(|(particles, _)| particles)
}

impl Message for Particles {
    type Form = ParticlesForm;
    const EXACT_QUOTIENT: bool = true;

    fn vacuous(space: &Space) -> Self {
        let coordinates = space.coordinates().unwrap_or_default().to_vec();
        let support = Support { coordinates, points: Vec::new(), log_proposal: None };
        Self { support: Arc::new(support), log_weights: Vec::new(), role: Role::Sample }
    }

    fn product(
        incoming: Messages<'_, Self>,
        form: &ParticlesForm,
        stream: &mut Stream,
    ) -> Result<Self, MessageError> {
        let mut product = Self::default();
        Self::product_into(incoming, form, stream, &mut product)?;
        Ok(product)
    }

    fn product_into(
        incoming: Messages<'_, Self>,
        _form: &ParticlesForm,
        _stream: &mut Stream,
        out: &mut Self,
    ) -> Result<(), MessageError> {
        let all: smallvec::SmallVec<[&Self; 16]> = incoming.iter().collect();
        let Some(base) = carrier(all.iter().copied()) else {
            if let Some(first) = all.first() {
                out.clone_from(first);
            }
            return Ok(());
        };
        out.clone_from(base);
        for other in all.iter().filter(|other| !std::ptr::eq(**other, base)) {
            out.absorb(other)?;
        }
        out.normalise("the product of messages")
    }

    fn quotient(&self, incoming: &Self) -> Option<Self> {
        let mut quotient = Self::default();
        self.quotient_into(incoming, &mut quotient).then_some(quotient)
    }

    fn quotient_into(&self, incoming: &Self, out: &mut Self) -> bool {
        if incoming.is_empty() {
            out.clone_from(self);
            return true;
        }
        let divisible = incoming.role == Role::Likelihood && self.same_support(incoming);
        let lost = |(own, other): (&f64, &f64)| *other == f64::NEG_INFINITY && *own == f64::NEG_INFINITY;
        if !divisible || self.log_weights.iter().zip(&incoming.log_weights).any(lost) {
            return false;
        }
        out.clone_from(self);
        for (a, b) in out.log_weights.iter_mut().zip(&incoming.log_weights) {
            *a -= b;
        }
        out.normalise("the quotient of messages").is_ok()
    }

    /// Total variation on the same points; else the largest shift of a mean in standard deviations.
    fn change(&self, previous: &Self) -> f64 {
        if self.is_empty() || previous.is_empty() {
            return if self.len() == previous.len() { 0.0 } else { 1.0 };
        }
        if self.same_support(previous) {
            let (a, b) = (self.largest_log_weight(), previous.largest_log_weight());
            if a == f64::NEG_INFINITY || b == f64::NEG_INFINITY {
                // No weight at all: whoever multiplies will say so.
                return if self.log_weights == previous.log_weights { 0.0 } else { 1.0 };
            }
            let totals = |log_weights: &[f64], largest: f64| -> f64 {
                log_weights.iter().map(|log| (log - largest).exp()).sum()
            };
            let (of_a, of_b) = (totals(&self.log_weights, a), totals(&previous.log_weights, b));
            let pairs = self.log_weights.iter().zip(&previous.log_weights);
            return 0.5
                * pairs.map(|(x, y)| ((x - a).exp() / of_a - (y - b).exp() / of_b).abs()).sum::<f64>();
        }
        let (new, old) = (self.moments(), previous.moments());
        let mut offset = vec![0.0; new.dimension()];
        self.offset(&new.mean, &old.mean, &mut offset);
        let scaled = offset.iter().enumerate().map(|(k, shift)| {
            let variance = new.covariance_at(k, k).max(old.covariance_at(k, k));
            if *shift == 0.0 { 0.0 } else { shift.abs() / variance.max(f64::MIN_POSITIVE).sqrt() }
        });
        scaled.fold(0.0, f64::max).min(f64::MAX)
    }

    fn damp(&mut self, previous: &Self, damping: f64) -> bool {
        if previous.is_empty() {
            return true;
        }
        if !self.same_support(previous) || self.role != previous.role {
            return false;
        }
        for (a, b) in self.log_weights.iter_mut().zip(&previous.log_weights) {
            // A weight that was zero stays as the new message has it.
            if b.is_finite() && a.is_finite() {
                *a += (b - *a) * damping;
            }
        }
        true
    }

    fn check_form(form: &ParticlesForm, space: &Space) -> Result<(), String> {
        if form.count == 0 {
            return Err("the number of particles is 0; it must be at least 1".into());
        }
        if form.senders == Some(0) {
            return Err("the number of senders is 0; it must be at least 1".into());
        }
        match space {
            Space::Continuous(coordinates) if coordinates.is_empty() => {
                Err("particles cannot hold a variable without coordinates".into())
            }
            Space::Continuous(_) | Space::Se2 => Ok(()),
            Space::Se3 => Err("particles cannot hold a pose in space: a mean of quaternions is none".into()),
            Space::Finite(states) => Err(format!("particles cannot hold a variable of {states} states")),
        }
    }

    fn is_proper(&self) -> bool {
        !self.is_empty() && self.role == Role::Sample
    }

    fn quality(&self) -> Quality {
        let effective_sample_size = (!self.is_empty()).then(|| self.effective_sample_size());
        Quality { effective_sample_size, ..Quality::default() }
    }
}
