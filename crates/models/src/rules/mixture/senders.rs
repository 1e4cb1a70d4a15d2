//! The senders' mixtures, one component of each at a time.

use super::super::MixtureView;
use crate::small::{Vector, zero_vector};
use crate::{Linearised, Ring, RingCentre};
use smallvec::SmallVec;
use sumprod_graph::{MessageError, Port};
use sumprod_messages::{Mixture, MixtureForm};

/// One component of each sender.
#[derive(Clone)]
pub(super) struct Combination {
    pub(super) log_weight: f64,
    pub(super) parts: Vec<Part>,
    /// Where the receiver's coordinates begin in the stacked point, and all of its numbers.
    pub(super) receiver: usize,
    point: Vector,
}

/// A component of the sender at a port.
#[derive(Clone)]
pub(super) struct Part {
    pub(super) port: Port,
    /// Where its coordinates begin in the stacked point.
    pub(super) start: usize,
    pub(super) mean: Vector,
    pub(super) covariance: Vec<f64>,
}

impl Combination {
    /// All ports' variables, the receiver's being `point`.
    pub(super) fn stacked(&self, point: &[f64]) -> Vector {
        let mut all = self.point.clone();
        all[self.receiver..][..point.len()].copy_from_slice(point);
        all
    }
}

/// What the senders say.
pub(super) enum Senders {
    /// Distributions: every combination of their components, heaviest first, and what reading them cost (nats).
    Distributions(Vec<Combination>, f64),
    /// One says nothing at all, and so does the factor.
    Flat,
    /// Gaussians that leave directions open, which the Gaussian rule knows how to sum out.
    Open,
}

/// Combinations of the senders' components, of which no more are kept than the form's number of components.
/// Of the centre of a `ring` its place alone is read, and the rest of its state taken to be known.
pub(super) fn combinations(
    model: &dyn Linearised,
    ring: Option<&Ring>,
    to: Port,
    view: &dyn MixtureView,
    form: &MixtureForm,
) -> Result<Senders, MessageError> {
    let dimensions = model.dimensions();
    let count: usize = dimensions.iter().sum();
    let receiver: usize = dimensions.iter().take(to).sum();
    let point = Vector::from_elem(0.0, count);
    let mut all = vec![Combination { log_weight: 0.0, parts: Vec::new(), receiver, point }];
    let (mut start, mut loss, mut open) = (0, 0.0, false);
    for (port, &dimension) in dimensions.iter().enumerate() {
        if port != to {
            let place = match ring.map(|ring| &ring.centre) {
                Some(RingCentre::Port(centre, place)) if *centre == port => Some(place.as_slice()),
                _ => None,
            };
            let marginal = match place {
                Some(place) => {
                    view.marginal(port, place, form)?.map(|(message, cost)| (message, cost, place))
                }
                None => None,
            };
            let whole: SmallVec<[usize; 6]> = (0..dimension).collect();
            let (message, cost, read) = match marginal {
                Some(marginal) => marginal,
                None => {
                    let (message, cost) = view.mixture(port, form)?;
                    (message, cost, whole.as_slice())
                }
            };
            if message.is_flat() {
                return Ok(Senders::Flat);
            }
            loss += cost;
            match message.to_density() {
                Ok(density) => {
                    let sender = Sender { port, start, dimension, read, density: &density };
                    all = joined(&all, &sender, form.components);
                }
                Err(_) if message.len() == 1 => open = true,
                Err(error) => return Err(error),
            }
        }
        start += dimension;
    }
    if open {
        return Ok(Senders::Open);
    }
    all.sort_by(|a, b| b.log_weight.total_cmp(&a.log_weight));
    Ok(Senders::Distributions(all, loss))
}

/// The mixture at a port, on those of its coordinates that the factor reads.
struct Sender<'a> {
    port: Port,
    start: usize,
    dimension: usize,
    read: &'a [usize],
    density: &'a Mixture,
}

/// Every combination with every component of a sender, the heaviest `count` of them.
fn joined(all: &[Combination], sender: &Sender<'_>, count: usize) -> Vec<Combination> {
    let Sender { port, start, dimension, read, density } = *sender;
    let mut longer = Vec::with_capacity(all.len() * density.len());
    for combination in all {
        for i in 0..density.len() {
            let mut next = combination.clone();
            let (mut mean, mut covariance) = (zero_vector(dimension), vec![0.0; dimension * dimension]);
            for (row, &to) in read.iter().enumerate() {
                mean[to] = density.mean_of(i)[row];
                for (column, &from) in read.iter().enumerate() {
                    covariance[to * dimension + from] = density.covariance_of(i)[row * read.len() + column];
                }
            }
            next.log_weight += density.log_weights()[i];
            next.point[start..][..dimension].copy_from_slice(&mean);
            next.parts.push(Part { port, start, mean, covariance });
            longer.push(next);
        }
    }
    longer.sort_by(|a, b| b.log_weight.total_cmp(&a.log_weight));
    longer.truncate(count.max(1));
    longer
}
