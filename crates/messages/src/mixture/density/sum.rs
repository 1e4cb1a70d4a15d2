//! The inner loops: kernel sums with one point per vector lane.

#![allow(
    clippy::needless_range_loop,
    reason = "rows and columns of small matrices are named by their indices"
)]

use super::super::small::Small;
use super::interpolation::NODES;
use super::{Evaluator, Group, LANES, Plan};
use crate::vector::{exp, round};
use std::f64::consts::TAU;
use sumprod_graph::Coordinate;

/// The sums of one group.
pub(super) struct Sum<'a> {
    pub(super) evaluator: &'a Evaluator<'a>,
    pub(super) group: &'a Group,
    pub(super) plan: &'a Plan,
    pub(super) shift: f64,
    pub(super) sums: &'a mut [f64; LANES],
}

impl pulp::NullaryFnOnce for Sum<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let angles = self.evaluator.mixture.coordinates().contains(&Coordinate::Angle);
        let whitened = !self.evaluator.common.is_empty();
        match (self.evaluator.mixture.dimension(), whitened, angles) {
            (1, true, _) if self.group.used <= NODES => self.run::<1, NODES, true, false>(),
            (1, true, _) => self.run::<1, LANES, true, false>(),
            (2, true, _) => self.run::<2, LANES, true, false>(),
            (3, true, _) => self.run::<3, LANES, true, false>(),
            (1, false, false) => self.run::<1, LANES, false, false>(),
            (2, false, false) => self.run::<2, LANES, false, false>(),
            (3, false, false) => self.run::<3, LANES, false, false>(),
            (1, false, true) => self.run::<1, LANES, false, true>(),
            (2, false, true) => self.run::<2, LANES, false, true>(),
            (3, false, true) => self.run::<3, LANES, false, true>(),
            _ => self.run_any_dimension(),
        }
    }
}

impl Sum<'_> {
    #[inline(always)]
    fn run<const D: usize, const WIDTH: usize, const WHITE: bool, const ANGLES: bool>(self) {
        let Some(columns) = self.group.points.first_chunk::<D>() else { return };
        let mut turns = [0.0; D];
        let mut inverse = [0.0; D];
        for (k, kind) in self.evaluator.mixture.coordinates().iter().enumerate().take(D) {
            if *kind == Coordinate::Angle {
                (turns[k], inverse[k]) = (TAU, 1.0 / TAU);
            }
        }
        let mut sums = [0.0; WIDTH];
        let width = self.evaluator.width;
        for &(begin, end) in &self.plan.direct {
            let range = begin as usize * width..end as usize * width;
            for component in self.evaluator.components[range].chunks_exact(width) {
                let constant = component[0] - self.shift;
                let mut mean = [0.0; D];
                let mut matrix = [[0.0; D]; D];
                for row in 0..D {
                    mean[row] = component[1 + row];
                    if !WHITE {
                        for column in 0..=row {
                            matrix[row][column] = component[1 + D + row * (row + 1) / 2 + column];
                        }
                    }
                }
                for lane in 0..WIDTH {
                    let mut offset = [0.0; D];
                    let mut squared = 0.0;
                    for k in 0..D {
                        offset[k] = columns[k][lane] - mean[k];
                        if ANGLES {
                            let turn = round(offset[k] * inverse[k]);
                            offset[k] -= turns[k] * turn;
                        }
                        let mut white = offset[k];
                        if !WHITE {
                            white = 0.0;
                            for column in 0..=k {
                                white += matrix[k][column] * offset[column];
                            }
                        }
                        squared += white * white;
                    }
                    sums[lane] += exp(constant - 0.5 * squared);
                }
            }
        }
        for &number in &self.plan.expanded {
            let Some(expansion) = self.evaluator.expansion(number as usize) else { continue };
            let constant = expansion.log_factor - self.shift;
            let mut mean = [0.0; D];
            mean.copy_from_slice(&expansion.mean[..D]);
            let mut spread = [[0.0; D]; D];
            let mut trace = 0.0;
            for row in 0..D {
                for column in 0..=row {
                    spread[row][column] = expansion.spread[row * (row + 1) / 2 + column];
                }
                trace += spread[row][row];
            }
            for lane in 0..WIDTH {
                let mut offset = [0.0; D];
                let (mut squared, mut form) = (0.0, 0.0);
                for k in 0..D {
                    offset[k] = columns[k][lane] - mean[k];
                    squared += offset[k] * offset[k];
                    for column in 0..=k {
                        form += spread[k][column] * offset[k] * offset[column];
                    }
                }
                sums[lane] += exp(constant - 0.5 * squared) * (1.0 + 0.5 * (form - trace));
            }
        }
        self.sums[..WIDTH].copy_from_slice(&sums);
    }

    #[inline(always)]
    fn run_any_dimension(self) {
        let mut sums = [0.0; LANES];
        let width = self.evaluator.width;
        for &(begin, end) in &self.plan.direct {
            let range = begin as usize * width..end as usize * width;
            for component in self.evaluator.components[range].chunks_exact(width) {
                for (lane, sum) in sums.iter_mut().enumerate() {
                    let squared = self.evaluator.squared(component, self.group, lane);
                    *sum += exp(component[0] - self.shift - 0.5 * squared);
                }
            }
        }
        for &number in &self.plan.expanded {
            let Some(expansion) = self.evaluator.expansion(number as usize) else { continue };
            for (lane, sum) in sums.iter_mut().enumerate() {
                let offset: Small = expansion
                    .mean
                    .iter()
                    .zip(&self.group.points)
                    .map(|(m, column)| column[lane] - m)
                    .collect();
                let squared: f64 = offset.iter().map(|x| x * x).sum();
                *sum += exp(expansion.log_factor - self.shift - 0.5 * squared) * expansion.factor(&offset);
            }
        }
        *self.sums = sums;
    }
}
