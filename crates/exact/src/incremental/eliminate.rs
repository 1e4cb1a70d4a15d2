//! Elimination of some variables into cliques, by dense fronts.

use super::quadratic::Quadratic;
use super::tree::{Clique, NONE, Tree};
use crate::ExactError;
use crate::layout::Layout;
use crate::structure::{minimum_degree, out_of_memory};
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{
    LltError, LltParams, LltRegularization, cholesky_in_place, cholesky_in_place_scratch,
};
use faer::linalg::matmul::triangular::{BlockStructure, matmul};
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::{Accum, MatMut, Par, Spec};

/// When a variable is eliminated, among others.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Turn {
    /// Before those that stay: it is to leave the tree.
    First,
    /// Where it makes the least fill.
    Any,
    /// Near the root: factors to come will touch it.
    Last,
}

/// Why an elimination stopped.
#[derive(Debug)]
pub(super) enum Stop {
    /// At a pivot of this variable that is not positive.
    Pivot(u32),
    /// For another reason.
    Error(ExactError),
}

/// What is eliminated.
pub(super) struct Elimination<'a> {
    pub(super) layout: &'a Layout,
    /// Variables, each with its turn.
    pub(super) variables: Vec<(u32, Turn)>,
    /// Factors over these variables.
    pub(super) factors: Vec<&'a Quadratic>,
    /// Cliques whose messages are factors as well, to become children.
    pub(super) orphans: &'a [u32],
}

/// The order and the fill: for every place the variable, and the higher places it is joined to when its turn comes.
struct Fill {
    order: Vec<(u32, Turn)>,
    columns: Vec<Vec<u32>>,
}

impl Elimination<'_> {
    /// Builds the cliques into the tree, children first, and returns them in that order. `place` is scratch by variable.
    pub(super) fn run(&self, tree: &mut Tree, place: &mut Vec<u32>) -> Result<Vec<u32>, Stop> {
        place.resize(tree.clique_of.len(), NONE);
        let fill = self.fill(tree, place)?;
        let count = fill.order.len();
        // Cliques by place, roots first.
        let mut clique_at = vec![0u32; count];
        let mut owns: Vec<Vec<u32>> = Vec::new();
        for at in (0..count).rev() {
            let column = &fill.columns[at];
            let joined = column.first().map(|&parent| (clique_at[parent as usize], parent)).filter(
                |&(clique, parent)| {
                    let leaves = |place: usize| fill.order[place].1 == Turn::First;
                    owns[clique as usize].last() == Some(&parent)
                        && column.len() == fill.columns[parent as usize].len() + 1
                        && leaves(at) == leaves(parent as usize)
                },
            );
            clique_at[at] = match joined {
                Some((clique, _)) => clique,
                None => {
                    owns.push(Vec::new());
                    owns.len() as u32 - 1
                }
            };
            owns[clique_at[at] as usize].push(at as u32);
        }
        let lowest = |variables: &[u32]| variables.iter().map(|&v| place[v as usize]).min();
        let mut factors_of: Vec<Vec<u32>> = vec![Vec::new(); owns.len()];
        for (number, factor) in self.factors.iter().enumerate() {
            if let Some(low) = lowest(&factor.variables) {
                factors_of[clique_at[low as usize] as usize].push(number as u32);
            }
        }
        let mut children_of: Vec<Vec<u32>> = vec![Vec::new(); owns.len()];
        for &orphan in self.orphans {
            if let Some(low) = lowest(&tree.clique(orphan).message.variables) {
                children_of[clique_at[low as usize] as usize].push(orphan);
            }
        }
        let mut offset = vec![0u32; place.len()];
        let mut made = Vec::with_capacity(owns.len());
        for number in (0..owns.len()).rev() {
            let places = &owns[number];
            let rest = places.first().map_or(&[][..], |&top| &fill.columns[top as usize]);
            let named = |&place: &u32| fill.order[place as usize].0;
            let own: Vec<u32> = places.iter().rev().map(named).collect();
            let rest: Vec<u32> = rest.iter().map(named).collect();
            let factors = factors_of[number].iter().map(|&factor| self.factors[factor as usize]);
            let children = &children_of[number];
            let messages = children.iter().map(|&child| &tree.clique(child).message);
            let clique = self.clique(own, rest, factors.chain(messages), &mut offset)?;
            let parent = lowest(&clique.message.variables).map(|low| clique_at[low as usize]);
            let index = tree.add(clique);
            for &child in &children_of[number] {
                tree.attach(child, index);
            }
            if let Some(parent) = parent {
                children_of[parent as usize].push(index);
            }
            made.push(index);
        }
        Ok(made)
    }

    /// Orders the variables and finds the fill; writes each variable's place.
    fn fill(&self, tree: &Tree, place: &mut [u32]) -> Result<Fill, Stop> {
        for (number, (variable, _)) in self.variables.iter().enumerate() {
            place[*variable as usize] = number as u32;
        }
        let messages = self.orphans.iter().map(|&orphan| &tree.clique(orphan).message);
        let groups: Vec<&[u32]> = self
            .factors
            .iter()
            .copied()
            .chain(messages)
            .map(|quadratic| quadratic.variables.as_slice())
            .collect();
        let count = self.variables.len();
        let order = minimum_degree(count, |visit| {
            let mut local = Vec::new();
            for group in &groups {
                local.clear();
                local.extend(group.iter().map(|&variable| place[variable as usize]));
                visit(&local);
            }
        })
        .map_err(Stop::Error)?;
        let mut order: Vec<(u32, Turn)> =
            order.iter().map(|&number| self.variables[number as usize]).collect();
        order.sort_by_key(|&(_, turn)| turn);
        for (at, (variable, _)) in order.iter().enumerate() {
            place[*variable as usize] = at as u32;
        }
        let mut columns: Vec<Vec<u32>> = vec![Vec::new(); count];
        for group in &groups {
            if let Some(low) = group.iter().map(|&variable| place[variable as usize]).min() {
                let others = group.iter().map(|&variable| place[variable as usize]);
                columns[low as usize].extend(others.filter(|&other| other != low));
            }
        }
        for at in 0..count {
            let mut own = std::mem::take(&mut columns[at]);
            own.sort_unstable();
            own.dedup();
            if let Some((&parent, beyond)) = own.split_first() {
                columns[parent as usize].extend_from_slice(beyond);
            }
            columns[at] = own;
        }
        Ok(Fill { order, columns })
    }

    /// Sums the factors of a clique and eliminates its own variables.
    fn clique<'q>(
        &self,
        own: Vec<u32>,
        rest: Vec<u32>,
        factors: impl Iterator<Item = &'q Quadratic>,
        offset: &mut [u32],
    ) -> Result<Clique, Stop> {
        let width = |variable: &u32| self.layout.freedoms(*variable as usize).len();
        let (mut n, mut k) = (0, 0);
        for (number, variable) in own.iter().chain(&rest).enumerate() {
            offset[*variable as usize] = n as u32;
            n += width(variable);
            if number + 1 == own.len() {
                k = n;
            }
        }
        let (mut front, mut right) = (vec![0.0; n * n], vec![0.0; n]);
        for factor in factors {
            factor.scatter(self.layout, offset, &mut front, &mut right, n);
        }
        if let Err(row) = eliminate(&mut front, n, k)? {
            let after = own.iter().take_while(|variable| offset[**variable as usize] as usize <= row).last();
            return Err(Stop::Pivot(after.copied().unwrap_or_default()));
        }
        for j in 0..k {
            let column = &front[j * n..][..n];
            right[j] /= column[j];
            let y = right[j];
            right[j + 1..].iter_mut().zip(&column[j + 1..]).for_each(|(out, entry)| *out -= entry * y);
        }
        let m = n - k;
        let mut information = Vec::with_capacity(m * m);
        for column in 0..m {
            let lower = |row: usize| front[(k + row.min(column)) * n + k + row.max(column)];
            information.extend((0..m).map(lower));
        }
        let vector = right.split_off(k);
        front.truncate(k * n);
        let message = Quadratic { variables: rest, information, vector };
        Ok(Clique { own, factor: front, right, message, ..Clique::default() })
    }
}

/// Eliminates the first `k` of a front's `n` columns; the row of a pivot that is not positive otherwise.
fn eliminate(front: &mut [f64], n: usize, k: usize) -> Result<Result<(), usize>, Stop> {
    let parameters = Spec::<LltParams, f64>::default();
    let request = cholesky_in_place_scratch::<f64>(k, Par::Seq, parameters);
    let mut memory = MemBuffer::try_new(request).map_err(|_| Stop::Error(out_of_memory()))?;
    let whole = MatMut::from_column_major_slice_mut(front, n, n);
    let (mut top, _, bottom, corner) = whole.split_at_mut(k, k);
    let factored = cholesky_in_place(
        top.as_mut(),
        LltRegularization::default(),
        Par::Seq,
        MemStack::new(&mut memory),
        parameters,
    );
    if let Err(LltError::NonPositivePivot { index }) = factored {
        return Ok(Err(index));
    }
    if k < n {
        let mut bottom = bottom;
        solve_lower_triangular_in_place(top.as_ref(), bottom.as_mut().transpose_mut(), Par::Seq);
        matmul(
            corner,
            BlockStructure::TriangularLower,
            Accum::Add,
            bottom.as_ref(),
            BlockStructure::Rectangular,
            bottom.as_ref().transpose(),
            BlockStructure::Rectangular,
            -1.0,
            Par::Seq,
        );
    }
    Ok(Ok(()))
}
