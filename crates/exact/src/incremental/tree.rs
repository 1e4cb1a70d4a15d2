//! The tree of cliques: what elimination leaves, kept so that a change touches only the way to the root.
//!
//! A clique's own variables were eliminated together, given the rest of it; its message to its parent is what remains of
//! all factors below. Along any way down, a variable that is left does not come back.

use super::quadratic::Quadratic;
use crate::layout::Layout;
use crate::selected::own_block;
use faer::{MatMut, MatRef};

/// No clique.
pub(super) const NONE: u32 = u32::MAX;

/// A clique: p(own | rest), as L₁₁' δ(own) = y - L₂₁' δ(rest).
#[derive(Debug, Default)]
pub(super) struct Clique {
    pub(super) own: Vec<u32>,
    /// [L₁₁; L₂₁], column-major; what lies above the diagonal is not read.
    pub(super) factor: Vec<f64>,
    /// y.
    pub(super) right: Vec<f64>,
    /// What it says about the rest, whose variables these are.
    pub(super) message: Quadratic,
    /// [`NONE`] of a root.
    pub(super) parent: u32,
    pub(super) children: Vec<u32>,
    /// Whether its own steps are yet to be found.
    pub(super) fresh: bool,
    pub(super) cut: bool,
}

impl Clique {
    /// Its own variables, then the rest.
    pub(super) fn variables(&self) -> impl Iterator<Item = u32> + '_ {
        self.own.iter().chain(&self.message.variables).copied()
    }

    /// Rows of its factor.
    fn rows(&self) -> usize {
        self.right.len() + self.message.vector.len()
    }
}

/// All cliques: a tree for every connected part.
#[derive(Debug, Default)]
pub(super) struct Tree {
    cliques: Vec<Clique>,
    free: Vec<u32>,
    /// The clique that has each variable for its own.
    pub(super) clique_of: Vec<u32>,
    /// The round in which each variable's step last changed.
    changed: Vec<u32>,
    round: u32,
}

/// What was cut out of a tree.
#[derive(Debug, Default)]
pub(super) struct Cut {
    /// Variables that have lost their clique.
    pub(super) variables: Vec<u32>,
    /// Cliques that have lost their parent.
    pub(super) orphans: Vec<u32>,
}

impl Tree {
    /// Room for this many variables.
    pub(super) fn grow(&mut self, variables: usize) {
        self.clique_of.resize(variables, NONE);
        self.changed.resize(variables, 0);
    }

    pub(super) fn clique(&self, index: u32) -> &Clique {
        &self.cliques[index as usize]
    }

    /// Adds a clique that has no parent yet.
    pub(super) fn add(&mut self, mut clique: Clique) -> u32 {
        (clique.parent, clique.fresh) = (NONE, true);
        let index = self.free.pop().unwrap_or(self.cliques.len() as u32);
        clique.own.iter().for_each(|&variable| self.clique_of[variable as usize] = index);
        if index as usize == self.cliques.len() {
            self.cliques.push(clique);
        } else {
            self.cliques[index as usize] = clique;
        }
        index
    }

    pub(super) fn attach(&mut self, child: u32, parent: u32) {
        self.cliques[child as usize].parent = parent;
        self.cliques[parent as usize].children.push(child);
    }

    /// Takes a clique out from below its parent, with its message.
    pub(super) fn detach(&mut self, index: u32) -> Quadratic {
        let clique = std::mem::take(&mut self.cliques[index as usize]);
        clique.own.iter().for_each(|&variable| self.clique_of[variable as usize] = NONE);
        if clique.parent != NONE {
            self.cliques[clique.parent as usize].children.retain(|&child| child != index);
        }
        self.free.push(index);
        clique.message
    }

    /// The cliques of which a variable is part.
    pub(super) fn holding(&self, variable: u32, out: &mut Vec<u32>) {
        let own = self.clique_of[variable as usize];
        if own == NONE {
            return;
        }
        let first = out.len();
        out.push(own);
        let mut next = first;
        while let Some(&index) = out.get(next) {
            let children = &self.cliques[index as usize].children;
            let holds = |child: &u32| self.cliques[*child as usize].message.variables.contains(&variable);
            out.extend(children.iter().copied().filter(holds));
            next += 1;
        }
    }

    /// Cuts out some cliques and all above them.
    pub(super) fn cut(&mut self, marked: &[u32]) -> Cut {
        let mut removed = Vec::new();
        for &index in marked {
            let mut at = index;
            while at != NONE && !self.cliques[at as usize].cut {
                self.cliques[at as usize].cut = true;
                removed.push(at);
                at = self.cliques[at as usize].parent;
            }
        }
        let mut cut = Cut::default();
        for &index in &removed {
            for child in std::mem::take(&mut self.cliques[index as usize].children) {
                if !self.cliques[child as usize].cut {
                    self.cliques[child as usize].parent = NONE;
                    cut.orphans.push(child);
                }
            }
        }
        for &index in &removed {
            let clique = std::mem::take(&mut self.cliques[index as usize]);
            clique.own.iter().for_each(|&variable| self.clique_of[variable as usize] = NONE);
            cut.variables.extend(clique.own);
            self.free.push(index);
        }
        cut
    }

    /// Finds the steps of new cliques from the roots down, and of old ones as far as steps above changed by more than
    /// `least`; `moved` gets the variables whose steps did.
    pub(super) fn substitute(
        &mut self,
        layout: &Layout,
        roots: Vec<u32>,
        least: f64,
        steps: &mut [f64],
        moved: &mut Vec<u32>,
    ) {
        self.round += 1;
        let mut stack = roots;
        let mut x = Vec::new();
        while let Some(index) = stack.pop() {
            let clique = &mut self.cliques[index as usize];
            clique.fresh = false;
            let (k, n) = (clique.right.len(), clique.rows());
            x.clear();
            x.extend_from_slice(&clique.right);
            for &variable in &clique.message.variables {
                x.extend_from_slice(&steps[layout.freedoms(variable as usize)]);
            }
            for j in (0..k).rev() {
                let column = &clique.factor[j * n..][..n];
                let below = crate::solve::dot(&column[j + 1..], &x[j + 1..]);
                x[j] = (x[j] - below) / column[j];
            }
            let mut first = 0;
            for &variable in &clique.own {
                let own = &mut steps[layout.freedoms(variable as usize)];
                let new = &x[first..][..own.len()];
                if own.iter().zip(new).any(|(old, new)| (old - new).abs() > least) {
                    self.changed[variable as usize] = self.round;
                    moved.push(variable);
                }
                own.copy_from_slice(new);
                first += own.len();
            }
            let (cliques, changed, round) = (&self.cliques, &self.changed, self.round);
            let wanted = |&child: &u32| {
                let child = &cliques[child as usize];
                let rest = &child.message.variables;
                child.fresh || rest.iter().any(|&variable| changed[variable as usize] == round)
            };
            stack.extend(cliques[index as usize].children.iter().copied().filter(wanted));
        }
    }

    /// The covariance of a variable's step, row-major: the inverse's blocks from the root down to it.
    pub(super) fn covariance(&self, layout: &Layout, variable: u32) -> Vec<f64> {
        let mut way = Vec::new();
        let mut at = self.clique_of[variable as usize];
        while at != NONE {
            way.push(at);
            at = self.cliques[at as usize].parent;
        }
        let (mut above, mut front, mut slope) = (Vec::new(), Vec::new(), Vec::new());
        let mut rows_above: Vec<(u32, usize)> = Vec::new();
        for &index in way.iter().rev() {
            let clique = &self.cliques[index as usize];
            let (k, n) = (clique.right.len(), clique.rows());
            front.clear();
            front.resize(n * n, 0.0);
            let rows = |variable: &u32| {
                let place = rows_above.binary_search_by_key(variable, |&(variable, _)| variable).ok()?;
                let first = rows_above[place].1;
                Some(first..first + layout.freedoms(*variable as usize).len())
            };
            let local: Vec<usize> = clique.message.variables.iter().filter_map(rows).flatten().collect();
            let size = above.len().isqrt();
            for (column, &from) in local.iter().enumerate() {
                let target = &mut front[(k + column) * n + k..][..local.len()];
                target.iter_mut().zip(&local).for_each(|(out, &row)| *out = above[from * size + row]);
            }
            let (top, bottom) = MatRef::from_column_major_slice(&clique.factor, n, k).split_at_row(k);
            own_block(top, bottom, &mut slope, MatMut::from_column_major_slice_mut(&mut front, n, n));
            rows_above.clear();
            let mut first = 0;
            for variable in clique.variables() {
                rows_above.push((variable, first));
                first += layout.freedoms(variable as usize).len();
            }
            rows_above.sort_unstable();
            std::mem::swap(&mut above, &mut front);
        }
        let d = layout.freedoms(variable as usize).len();
        let size = above.len().isqrt();
        let first = rows_above.iter().find(|(own, _)| *own == variable).map_or(0, |&(_, first)| first);
        let entry = |row: usize, column: usize| {
            let (a, b) = (first + row, first + column);
            0.5 * (above[a * size + b] + above[b * size + a])
        };
        (0..d * d).map(|k| entry(k / d, k % d)).collect()
    }
}
