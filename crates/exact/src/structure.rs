//! The shape of a problem's information matrix: the order of elimination, the sparse lower triangle in that order, and
//! where each factor's blocks go in it.
//!
//! Rows and columns of one variable stay together, so that a block of a factor is a run in each of its columns, and the
//! order is found on the graph of variables, which is smaller than that of coordinates.

use crate::cholesky::Symbolic;
use crate::{ExactError, Problem};
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::sparse::SymbolicSparseColMatRef;
use faer::sparse::linalg::amd;

/// In which order variables are eliminated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Ordering {
    /// Approximate minimum degree (Amestoy, Davis and Duff 1996).
    #[default]
    MinimumDegree,
    /// The graph's own order: best for chains and bands.
    Natural,
}

/// Where one block of a factor's information goes: entry (r, c) of the block at
/// `base + c * stride - c (c - 1) / 2 + r` of the values.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Place {
    pub(crate) base: u32,
    pub(crate) stride: u32,
    /// Whether the first of the two ports is the block's row.
    pub(crate) first_is_row: bool,
}

/// The pattern and its analysis.
#[derive(Debug)]
pub(crate) struct Structure {
    /// First column of each variable.
    pub(crate) first: Vec<u32>,
    /// The variable of each place in the order.
    pub(crate) order: Vec<u32>,
    pub(crate) column_pointer: Vec<usize>,
    pub(crate) row_index: Vec<usize>,
    /// Per factor the first of its places, one per pair of ports (p, q ≤ p).
    pub(crate) place_pointer: Vec<u32>,
    pub(crate) places: Vec<Place>,
    pub(crate) symbolic: Symbolic,
}

impl Structure {
    /// Analyses a problem; near-linear in edges plus the factor's size.
    pub(crate) fn new(problem: &Problem<'_>, ordering: Ordering) -> Result<Self, ExactError> {
        let layout = problem.layout();
        let count = layout.variables();
        let order = match ordering {
            Ordering::Natural => (0..count as u32).collect(),
            Ordering::MinimumDegree => minimum_degree(count, |visit| each_factor(problem, visit))?,
        };
        let mut position = vec![0u32; count];
        let mut start = vec![0u32; count + 1];
        for (place, &variable) in order.iter().enumerate() {
            position[variable as usize] = place as u32;
            start[place + 1] = start[place] + layout.freedoms(variable as usize).len() as u32;
        }
        let (block_pointer, block_row) = blocks_below(&position, |visit| each_factor(problem, visit));
        let size = layout.size();
        let mut column_pointer = Vec::with_capacity(size + 1);
        let mut row_index = Vec::new();
        column_pointer.push(0);
        for place in 0..count {
            let rows = &block_row[block_pointer[place] as usize..block_pointer[place + 1] as usize];
            for column in start[place]..start[place + 1] {
                row_index.extend(column as usize..start[place + 1] as usize);
                for &row in rows {
                    row_index.extend(start[row as usize] as usize..start[row as usize + 1] as usize);
                }
                column_pointer.push(row_index.len());
            }
        }
        if u32::try_from(row_index.len()).is_err() {
            let entries = row_index.len();
            return Err(ExactError::Sparse(format!(
                "the information has {entries} entries, over the limit of 4e9"
            )));
        }
        let (place_pointer, places) =
            places(problem, &position, &start, &column_pointer, (&block_pointer, &block_row));
        let symbolic = Symbolic::new(&column_pointer, &row_index)?;
        let first = position.iter().map(|&place| start[place as usize]).collect();
        Ok(Self { first, order, column_pointer, row_index, place_pointer, places, symbolic })
    }

    /// Number of rows.
    pub(crate) fn size(&self) -> usize {
        self.column_pointer.len() - 1
    }

    /// A vector of all variables' local coordinates, from the order of elimination to the graph's.
    pub(crate) fn unpermuted(&self, problem: &Problem<'_>, permuted: &[f64]) -> Vec<f64> {
        let mut out = vec![0.0; permuted.len()];
        for (variable, &first) in self.first.iter().enumerate() {
            let own = problem.layout().freedoms(variable);
            let length = own.len();
            out[own].copy_from_slice(&permuted[first as usize..][..length]);
        }
        out
    }

    /// The variable at a row.
    pub(crate) fn variable_at(&self, row: usize) -> usize {
        let place = self.order.partition_point(|&variable| self.first[variable as usize] as usize <= row);
        self.order.get(place.saturating_sub(1)).map_or(0, |&variable| variable as usize)
    }
}

/// Visits the variables of every factor.
fn each_factor(problem: &Problem<'_>, visit: &mut dyn FnMut(&[u32])) {
    (0..problem.factor_count()).for_each(|factor| visit(problem.ports(factor)));
}

/// Pairs of different variables that share a group, as sorted lists of each variable's higher neighbours in the order
/// of `position`.
fn blocks_below(position: &[u32], groups: impl Fn(&mut dyn FnMut(&[u32]))) -> (Vec<u32>, Vec<u32>) {
    let count = position.len();
    let each = |visit: &mut dyn FnMut(usize, u32)| {
        groups(&mut |ports| {
            for (p, &a) in ports.iter().enumerate() {
                for &b in &ports[..p] {
                    let (a, b) = (position[a as usize], position[b as usize]);
                    if a != b {
                        visit(a.min(b) as usize, a.max(b));
                    }
                }
            }
        });
    };
    let mut pointer = vec![0u32; count + 1];
    each(&mut |low, _| pointer[low + 1] += 1);
    for k in 0..count {
        pointer[k + 1] += pointer[k];
    }
    let mut next = pointer.clone();
    let mut rows = vec![0u32; pointer[count] as usize];
    each(&mut |low, high| {
        rows[next[low] as usize] = high;
        next[low] += 1;
    });
    let mut kept = Vec::with_capacity(rows.len());
    let mut kept_pointer = Vec::with_capacity(count + 1);
    kept_pointer.push(0);
    for k in 0..count {
        let own = &mut rows[pointer[k] as usize..pointer[k + 1] as usize];
        own.sort_unstable();
        let before = kept.len();
        for &row in own.iter() {
            if kept.len() == before || kept.last() != Some(&row) {
                kept.push(row);
            }
        }
        kept_pointer.push(kept.len() as u32);
    }
    (kept_pointer, kept)
}

fn places(
    problem: &Problem<'_>,
    position: &[u32],
    start: &[u32],
    column_pointer: &[usize],
    (block_pointer, block_row): (&[u32], &[u32]),
) -> (Vec<u32>, Vec<Place>) {
    // Rows before each block within its column, the diagonal block included.
    let mut before = Vec::with_capacity(block_row.len());
    for place in 0..position.len() {
        let mut rows = start[place + 1] - start[place];
        for &row in &block_row[block_pointer[place] as usize..block_pointer[place + 1] as usize] {
            before.push(rows);
            rows += start[row as usize + 1] - start[row as usize];
        }
    }
    let mut pointer = Vec::with_capacity(problem.factor_count() + 1);
    let mut places = Vec::new();
    pointer.push(0);
    for factor in 0..problem.factor_count() {
        let ports = problem.ports(factor);
        for (p, &first) in ports.iter().enumerate() {
            for &second in &ports[..=p] {
                let (a, b) = (position[first as usize], position[second as usize]);
                let (row, column) = (a.max(b), a.min(b) as usize);
                let offset = if a == b {
                    0
                } else {
                    let range = block_pointer[column] as usize..block_pointer[column + 1] as usize;
                    let found = block_row[range.clone()].partition_point(|&other| other < row);
                    before[range.start + found]
                };
                let head = start[column] as usize;
                let (own, next) =
                    (column_pointer[head], column_pointer.get(head + 1).copied().unwrap_or_default());
                let stride = next.saturating_sub(own).saturating_sub(1) as u32;
                places.push(Place { base: own as u32 + offset, stride, first_is_row: a >= b });
            }
        }
        pointer.push(places.len() as u32);
    }
    (pointer, places)
}

/// Approximate minimum degree on the graph of some variables, of which every group is joined pair by pair.
pub(crate) fn minimum_degree(
    count: usize,
    groups: impl Fn(&mut dyn FnMut(&[u32])),
) -> Result<Vec<u32>, ExactError> {
    let natural: Vec<u32> = (0..count as u32).collect();
    let (pointer, rows) = blocks_below(&natural, groups);
    let pointer: Vec<usize> = pointer.iter().map(|&p| p as usize).collect();
    let rows: Vec<usize> = rows.iter().map(|&r| r as usize).collect();
    let pattern = SymbolicSparseColMatRef::new_checked(count, count, &pointer, None, &rows);
    let (mut forward, mut inverse) = (vec![0usize; count], vec![0usize; count]);
    let request = amd::order_scratch::<usize>(count, rows.len());
    let mut memory = MemBuffer::try_new(request).map_err(|_| out_of_memory())?;
    let stack = MemStack::new(&mut memory);
    amd::order(&mut forward, &mut inverse, pattern, amd::Control::default(), stack).map_err(|error| {
        ExactError::Sparse(format!("the order of elimination could not be found: {error:?}"))
    })?;
    Ok(forward.iter().map(|&variable| variable as u32).collect())
}

pub(crate) fn out_of_memory() -> ExactError {
    ExactError::Sparse("there is not enough memory".into())
}
