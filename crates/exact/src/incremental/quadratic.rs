//! A factor as the clique tree holds it: a quadratic of steps.

use crate::layout::Layout;
use sumprod_models::Expansion;

/// exp(η'δ - δ'Λδ / 2) over the steps δ of some variables.
#[derive(Clone, Debug, Default)]
pub(super) struct Quadratic {
    /// Numbers of its variables; one may stand twice.
    pub(super) variables: Vec<u32>,
    /// Λ, whole, column-major.
    pub(super) information: Vec<f64>,
    /// η.
    pub(super) vector: Vec<f64>,
}

impl Quadratic {
    /// Takes over what a factor says at a point: Λ = J'J, η = -J'r.
    pub(super) fn linearise(&mut self, expansion: &Expansion) {
        let Expansion { residual, jacobian, .. } = expansion;
        let n = jacobian.len() / residual.len().max(1);
        self.vector.clear();
        self.vector.resize(n, 0.0);
        self.information.clear();
        self.information.resize(n * n, 0.0);
        for (row, r) in jacobian.chunks_exact(n.max(1)).zip(residual) {
            for ((a, out), column) in
                row.iter().zip(&mut self.vector).zip(self.information.chunks_exact_mut(n))
            {
                *out -= a * r;
                column.iter_mut().zip(row).for_each(|(out, b)| *out += a * b);
            }
        }
    }

    /// Moves the point of a variable, from which steps count: η - Λ step. First order where the space is curved.
    pub(super) fn shift(&mut self, layout: &Layout, variable: u32, step: &[f64]) {
        let n = self.vector.len();
        let mut column = 0;
        for &own in &self.variables {
            let d = layout.freedoms(own as usize).len();
            if own == variable {
                for (k, x) in step.iter().enumerate() {
                    let entries = &self.information[(column + k) * n..][..n];
                    self.vector.iter_mut().zip(entries).for_each(|(out, entry)| *out -= entry * x);
                }
            }
            column += d;
        }
    }

    /// The information of one variable by itself: its diagonal, added to `out`.
    pub(super) fn add_diagonal(&self, layout: &Layout, variable: u32, out: &mut [f64]) {
        let n = self.vector.len();
        let mut first = 0;
        for &own in &self.variables {
            let d = layout.freedoms(own as usize).len();
            if own == variable {
                for (k, out) in out.iter_mut().enumerate() {
                    *out += self.information[(first + k) * (n + 1)];
                }
            }
            first += d;
        }
    }

    /// Adds this to a front of `size` rows, whose variables begin at `offset`; the lower triangle is what counts.
    pub(super) fn scatter(
        &self,
        layout: &Layout,
        offset: &[u32],
        front: &mut [f64],
        right: &mut [f64],
        size: usize,
    ) {
        let n = self.vector.len();
        let mut column = 0;
        for &across in &self.variables {
            let (d, to) = (layout.freedoms(across as usize).len(), offset[across as usize] as usize);
            let own = &self.vector[column..][..d];
            right[to..][..d].iter_mut().zip(own).for_each(|(out, x)| *out += x);
            let mut row = 0;
            for &down in &self.variables {
                let (e, below) = (layout.freedoms(down as usize).len(), offset[down as usize] as usize);
                if below >= to {
                    for k in 0..d {
                        let entries = &self.information[(column + k) * n + row..][..e];
                        let out = &mut front[(to + k) * size + below..][..e];
                        out.iter_mut().zip(entries).for_each(|(out, x)| *out += x);
                    }
                }
                row += e;
            }
            column += d;
        }
    }
}
