//! A residual that no line serves: lines at the points of a lattice, each kept to its surroundings by a window.
//!
//! Around each component of the receiver's belief, on the coordinates that the residual reads, stand points
//! m + s L k for integer k, L L' = P. Gaussian windows of covariance s²P at these points sum to the same everywhere to
//! within 1e-8, so that Σₖ window × line is the factor itself but for what the lines miss within a window. The spacing
//! s is such that this is little, or what the number of points allows.

use super::senders::Combination;
use super::{LINEAR, Target, Weighed};
use crate::small::{Vector, zero_vector, zeros};
use std::f64::consts::{PI, TAU};
use sumprod_graph::{Coordinate, MessageError, wrap_angle};
use sumprod_messages::{Cholesky, Mixture, MixtureForm, Potential};

/// Components of the belief that a lattice is laid around.
const LATTICES: usize = 8;

/// Lines drawn in all.
const LINES: usize = 4_000;

/// How far a lattice goes, in standard deviations of its component.
const EXTENT: f64 = 4.0;

/// Deviation from the line two standard deviations of a window away, in standard deviations of the residual.
const WITHIN: f64 = 2.0 * LINEAR;

/// How far an angle that turns goes over two standard deviations of a window: a quarter of a turn.
const TURN_WITHIN: f64 = 0.5 * PI;

/// A lattice around one component of the belief.
struct Lattice {
    mean: Vector,
    /// Of the component, on the coordinates read.
    root: Cholesky,
    spacing: f64,
}

/// The message's components, with their masses in the belief `guide`.
pub(super) fn kernels(
    target: &Target<'_>,
    combinations: &[Combination],
    guide: &Mixture,
    form: &MixtureForm,
) -> Result<Weighed, MessageError> {
    let d = target.dimension();
    let guide = guide.reduce(LATTICES.min(form.components))?.0;
    let read = target.read(combinations, &guide);
    if read.is_empty() {
        return Ok(Weighed { potential: Potential::flat(target.coordinates), log_masses: None });
    }
    let senders = &combinations[..combinations.len().min(LINES / 100)];
    let room = LINES / (senders.len() * guide.len()).max(1);
    let lattices = lattices(target, senders, &guide, &read, room)?;
    let kinds: Vec<Coordinate> = read.iter().map(|&k| target.coordinates[k]).collect();
    let belief = guide.marginal(&read)?;
    let mut potential = Potential::new(target.coordinates);
    let mut log_masses = Vec::new();
    let n = read.len();
    for (i, lattice) in lattices.iter().enumerate() {
        let mut window = zeros(n * n);
        lattice.root.inverse(&mut window);
        window.iter_mut().for_each(|entry| *entry /= lattice.spacing * lattice.spacing);
        let mut point = Vector::from_slice(guide.mean_of(i));
        lattice.each(&kinds, |place| {
            let crowd: f64 = lattices.iter().map(|other| other.windows_at(&kinds, place)).sum();
            for (&k, x) in read.iter().zip(place) {
                point[k] = *x;
            }
            let share = -crowd.max(0.1).ln();
            let here = belief.log_density(place)?;
            for senders in senders {
                let (log_value, gradient, mut information) = target.component(senders, &point)?;
                for (row, &to) in read.iter().enumerate() {
                    for (column, &from) in read.iter().enumerate() {
                        information[to * d + from] += window[row * n + column];
                    }
                }
                potential.push(log_value + share, &point, &gradient, &information);
                log_masses.push(log_value + share + here);
            }
            Ok(())
        })?;
    }
    Ok(Weighed { potential, log_masses: Some(log_masses) })
}

fn lattices(
    target: &Target<'_>,
    senders: &[Combination],
    guide: &Mixture,
    read: &[usize],
    room: usize,
) -> Result<Vec<Lattice>, MessageError> {
    let marginal = guide.marginal(read)?;
    (0..guide.len())
        .map(|i| {
            let deviation = target.deviation(senders, guide.mean_of(i), guide.covariance_of(i))?;
            let root = Cholesky::new(marginal.covariance_of(i), read.len(), "the belief's covariance")?;
            // A line's miss grows with the square of the distance, an angle with the distance.
            let mut spacing = (WITHIN / deviation.miss.max(1e-9)).sqrt().min(1.0);
            spacing = spacing.min(0.5 * TURN_WITHIN / deviation.turning.max(1e-9));
            while points(spacing, read.len()) > room.max(1) as f64 && spacing < EXTENT {
                spacing *= 1.1;
            }
            let mean = Vector::from_slice(marginal.mean_of(i));
            Ok(Lattice { mean, root, spacing })
        })
        .collect()
}

/// About how many lattice points lie within the extent.
fn points(spacing: f64, n: usize) -> f64 {
    let ball = match n {
        1 => 2.0,
        2 => PI,
        3 => 4.2,
        _ => 5.0,
    };
    ball * (EXTENT / spacing).powi(n as i32)
}

impl Lattice {
    /// Visits every point of the lattice, once around where a coordinate is an angle.
    fn each(
        &self,
        kinds: &[Coordinate],
        mut visit: impl FnMut(&[f64]) -> Result<(), MessageError>,
    ) -> Result<(), MessageError> {
        let n = self.mean.len();
        let side = (EXTENT / self.spacing).floor() as i64;
        let mut steps = vec![-side; n];
        let (mut unit, mut place) = (zero_vector(n), zero_vector(n));
        loop {
            unit.iter_mut().zip(&steps).for_each(|(x, &step)| *x = self.spacing * step as f64);
            if unit.iter().map(|x| x * x).sum::<f64>() <= EXTENT * EXTENT {
                self.root.multiply_lower(&unit, &mut place);
                let angles = place.iter().zip(kinds).filter(|(_, kind)| **kind == Coordinate::Angle);
                let once = angles.clone().all(|(offset, _)| offset.abs() <= PI);
                place.iter_mut().zip(&self.mean).for_each(|(x, mean)| *x += mean);
                if once {
                    visit(&place)?;
                }
            }
            let Some(next) = steps.iter().position(|&step| step < side) else { return Ok(()) };
            steps[next] += 1;
            steps[..next].fill(-side);
        }
    }

    /// The sum of this lattice's windows at a place: one within its extent, none beyond.
    fn windows_at(&self, kinds: &[Coordinate], place: &[f64]) -> f64 {
        let n = self.mean.len();
        let mut offset = zero_vector(n);
        for (k, kind) in kinds.iter().enumerate() {
            let difference = place[k] - self.mean[k];
            offset[k] = if *kind == Coordinate::Angle { wrap_angle(difference) } else { difference };
        }
        let beyond = self.root.squared_length(&mut offset).sqrt() - EXTENT;
        // A sum of windows falls off at its edge as the integral of one does.
        let inside = 1.0 / (1.0 + (1.7 * beyond / self.spacing).exp());
        inside * TAU.powf(0.5 * n as f64)
    }
}
