//! The selected inverse: the blocks of A⁻¹ on the diagonal, without the rest (Takahashi, Fagan and Chen 1973).
//!
//! With a supernode's columns L₁₁ and the rows R below them L₂₁, Y = L₂₁ L₁₁⁻¹, and Z = A⁻¹,
//!
//! Z(R, s) = -Z(R, R) Y,   Z(s, s) = (L₁₁ L₁₁')⁻¹ - Y' Z(R, s).
//!
//! R lies within the columns and rows of the parent supernode, whose block of Z is known when parents come first; it is
//! kept until the last child has read it. Twice the work of the factorisation, by dense products.

use crate::cholesky::{Numeric, Symbolic};
use crate::structure::Structure;
use faer::linalg::matmul::matmul;
use faer::linalg::triangular_solve::{solve_lower_triangular_in_place, solve_upper_triangular_in_place};
use faer::sparse::linalg::cholesky::supernodal::SupernodalLltRef;
use faer::{Accum, MatMut, MatRef, Par};

/// A block of the inverse over a supernode's columns and rows, square and whole.
#[derive(Default)]
struct Front {
    entries: Vec<f64>,
    children: usize,
}

/// Visits the inverse's block over each supernode's own columns: first column, number of columns, entries
/// (column-major, with this leading dimension).
fn each_block(symbolic: &Symbolic, numeric: &Numeric, mut visit: impl FnMut(usize, usize, &[f64], usize)) {
    let supernodes = &symbolic.supernodes;
    let count = supernodes.n_supernodes();
    let factor = SupernodalLltRef::new(supernodes, &numeric.values);
    let mut fronts: Vec<Front> = (0..count).map(|_| Front::default()).collect();
    let begin = supernodes.supernode_begin();
    let parent_of = |s: usize| {
        let first = *supernodes.supernode(s).pattern().first()?;
        Some(begin.partition_point(|&b| b <= first) - 1)
    };
    let parents: Vec<Option<usize>> = (0..count).map(parent_of).collect();
    for &parent in parents.iter().flatten() {
        fronts[parent].children += 1;
    }
    let mut spare: Vec<Vec<f64>> = Vec::new();
    let (mut slope, mut local) = (Vec::new(), Vec::new());
    for s in (0..count).rev() {
        let node = factor.supernode(s);
        let (pattern, block) = (node.pattern(), node.val());
        let (k, m) = (block.ncols(), pattern.len());
        let n = k + m;
        let mut entries = spare.pop().unwrap_or_default();
        entries.clear();
        entries.resize(n * n, 0.0);
        if let Some(parent) = parents[s] {
            let above = supernodes.supernode(parent);
            let width = factor.supernode(parent).val().ncols();
            places(pattern, above.start(), width, above.pattern(), &mut local);
            let size = width + above.pattern().len();
            gather(&fronts[parent].entries, size, &local, &mut entries, n, k);
            fronts[parent].children -= 1;
            if fronts[parent].children == 0 {
                spare.push(std::mem::take(&mut fronts[parent].entries));
            }
        }
        let (top, bottom) = block.split_at_row(k);
        own_block(top, bottom, &mut slope, MatMut::from_column_major_slice_mut(&mut entries, n, n));
        visit(node.start(), k, &entries, n);
        if fronts[s].children == 0 {
            spare.push(entries);
        } else {
            fronts[s].entries = entries;
        }
    }
}

/// Where each row of `pattern` lies within a front of `width` columns from `start` and the rows `above`; both sorted.
fn places(pattern: &[usize], start: usize, width: usize, above: &[usize], out: &mut Vec<usize>) {
    out.clear();
    let mut next = 0;
    for &row in pattern {
        if row < start + width {
            out.push(row - start);
            continue;
        }
        while next < above.len() && above[next] < row {
            next += 1;
        }
        out.push(width + next);
    }
}

/// Copies the rows and columns `local` of a square front (column-major) into the lower right of another.
fn gather(front: &[f64], size: usize, local: &[usize], out: &mut [f64], n: usize, offset: usize) {
    for (column, &from) in local.iter().enumerate() {
        let source = &front[from * size..][..size];
        let target = &mut out[(offset + column) * n + offset..][..local.len()];
        for (target, &row) in target.iter_mut().zip(local) {
            *target = source[row];
        }
    }
}

/// Fills a front whose lower right is known.
pub(crate) fn own_block(
    top: MatRef<'_, f64>,
    bottom: MatRef<'_, f64>,
    slope: &mut Vec<f64>,
    front: MatMut<'_, f64>,
) {
    let (k, m) = (top.ncols(), bottom.nrows());
    let (own, right, below, rest) = front.split_at_mut(k, k);
    // Y' = L₁₁⁻ᵀ L₂₁'.
    slope.clear();
    slope.resize(k * m, 0.0);
    let mut slope = MatMut::from_column_major_slice_mut(slope, k, m);
    slope.copy_from(bottom.transpose());
    solve_upper_triangular_in_place(top.transpose(), slope.as_mut(), Par::Seq);
    let mut below = below;
    matmul(below.as_mut(), Accum::Replace, rest.as_ref(), slope.as_ref().transpose(), -1.0, Par::Seq);
    let mut right = right;
    right.copy_from(below.as_ref().transpose());
    // (L₁₁ L₁₁')⁻¹ from the identity, then the correction.
    let mut own = own;
    own.fill(0.0);
    for j in 0..k {
        own[(j, j)] = 1.0;
    }
    solve_lower_triangular_in_place(top, own.as_mut(), Par::Seq);
    solve_upper_triangular_in_place(top.transpose(), own.as_mut(), Par::Seq);
    matmul(own.as_mut(), Accum::Add, slope.as_ref(), below.as_ref(), -1.0, Par::Seq);
}

/// Visits the inverse's diagonal block of every variable: its number, the block's entries (column-major) and their
/// leading dimension.
pub(crate) fn each_variable(
    structure: &Structure,
    numeric: &Numeric,
    mut visit: impl FnMut(usize, &[f64], usize),
) {
    // Supernodes come last first, and variables never straddle two of them.
    let mut place = structure.order.len();
    each_block(&structure.symbolic, numeric, |start, _, entries, stride| {
        while place > 0 {
            let variable = structure.order[place - 1] as usize;
            let first = structure.first[variable] as usize;
            if first < start {
                break;
            }
            visit(variable, &entries[(first - start) * stride + first - start..], stride);
            place -= 1;
        }
    });
}
