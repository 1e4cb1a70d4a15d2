//! The sparse Cholesky factor A = L L', by supernodes, on faer's analysis and dense kernels.

use crate::ExactError;
use crate::structure::out_of_memory;
use faer::dyn_stack::{MemBuffer, MemStack, StackReq};
use faer::linalg::cholesky::llt::factor::{LltError, LltParams, LltRegularization};
use faer::sparse::linalg::SymbolicSupernodalParams;
use faer::sparse::linalg::cholesky::{simplicial, supernodal};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
use faer::{Conj, MatMut, Par, Spec};

/// The supernodes of the factor.
#[derive(Debug)]
pub(crate) struct Symbolic {
    pub(crate) supernodes: supernodal::SymbolicSupernodalCholesky<usize>,
    numeric_memory: StackReq,
}

impl Symbolic {
    /// Analyses a sparse lower triangle.
    pub(crate) fn new(column_pointer: &[usize], row_index: &[usize]) -> Result<Self, ExactError> {
        let size = column_pointer.len() - 1;
        let (upper_pointer, upper_index) = transpose(column_pointer, row_index);
        let upper = SymbolicSparseColMatRef::new_checked(size, size, &upper_pointer, None, &upper_index);
        let request = StackReq::any_of(&[
            simplicial::prefactorize_symbolic_cholesky_scratch::<usize>(size, row_index.len()),
            supernodal::factorize_supernodal_symbolic_cholesky_scratch::<usize>(size),
        ]);
        let mut memory = MemBuffer::try_new(request).map_err(|_| out_of_memory())?;
        let stack = MemStack::new(&mut memory);
        let (mut tree, mut counts) = (vec![0isize; size], vec![0usize; size]);
        let tree = simplicial::prefactorize_symbolic_cholesky(&mut tree, &mut counts, upper, stack);
        let supernodes = supernodal::factorize_supernodal_symbolic_cholesky(
            upper,
            tree,
            &counts,
            stack,
            SymbolicSupernodalParams::default(),
        )
        .map_err(|error| ExactError::Sparse(format!("the factor cannot be planned: {error:?}")))?;
        let numeric_memory = supernodal::factorize_supernodal_numeric_llt_scratch::<usize, f64>(
            &supernodes,
            Par::Seq,
            Spec::<LltParams, f64>::default(),
        );
        Ok(Self { supernodes, numeric_memory })
    }
}

/// The rows of each column of the transposed pattern.
fn transpose(column_pointer: &[usize], row_index: &[usize]) -> (Vec<usize>, Vec<usize>) {
    let size = column_pointer.len() - 1;
    let mut pointer = vec![0usize; size + 1];
    for &row in row_index {
        pointer[row + 1] += 1;
    }
    for k in 0..size {
        pointer[k + 1] += pointer[k];
    }
    let mut next = pointer.clone();
    let mut index = vec![0usize; row_index.len()];
    for column in 0..size {
        for &row in &row_index[column_pointer[column]..column_pointer[column + 1]] {
            index[next[row]] = column;
            next[row] += 1;
        }
    }
    (pointer, index)
}

/// Numbers of a factor, and the memory that computing them takes.
pub(crate) struct Numeric {
    pub(crate) values: Vec<f64>,
    memory: MemBuffer,
}

impl Numeric {
    /// Storage for a factor.
    pub(crate) fn new(symbolic: &Symbolic) -> Result<Self, ExactError> {
        let memory = MemBuffer::try_new(symbolic.numeric_memory).map_err(|_| out_of_memory())?;
        let mut values = Vec::new();
        let length = symbolic.supernodes.len_val();
        values.try_reserve_exact(length).map_err(|_| out_of_memory())?;
        values.resize(length, 0.0);
        Ok(Self { values, memory })
    }

    /// Factorises the matrix of this lower triangle; the row of a pivot that is not positive otherwise.
    pub(crate) fn factorise(
        &mut self,
        symbolic: &Symbolic,
        column_pointer: &[usize],
        row_index: &[usize],
        lower: &[f64],
    ) -> Result<(), usize> {
        let size = column_pointer.len() - 1;
        let pattern = SymbolicSparseColMatRef::new_checked(size, size, column_pointer, None, row_index);
        let result = supernodal::factorize_supernodal_numeric_llt(
            &mut self.values,
            SparseColMatRef::new(pattern, lower),
            LltRegularization::default(),
            &symbolic.supernodes,
            Par::Seq,
            MemStack::new(&mut self.memory),
            Spec::<LltParams, f64>::default(),
        );
        match result {
            Ok(_) => Ok(()),
            Err(LltError::NonPositivePivot { index }) => Err(index),
        }
    }

    /// Solves A X = B in place, `columns` right-hand sides one after the other.
    pub(crate) fn solve(
        &self,
        symbolic: &Symbolic,
        right: &mut [f64],
        columns: usize,
    ) -> Result<(), ExactError> {
        let size = symbolic.supernodes.nrows();
        if size == 0 || columns == 0 {
            return Ok(());
        }
        let request = symbolic.supernodes.solve_in_place_scratch::<f64>(columns, Par::Seq);
        let mut memory = MemBuffer::try_new(request).map_err(|_| out_of_memory())?;
        supernodal::SupernodalLltRef::new(&symbolic.supernodes, &self.values).solve_in_place_with_conj(
            Conj::No,
            MatMut::from_column_major_slice_mut(right, size, columns),
            Par::Seq,
            MemStack::new(&mut memory),
        );
        Ok(())
    }

    /// The diagonal of L, row by row.
    pub(crate) fn diagonal(&self, symbolic: &Symbolic) -> Vec<f64> {
        let factor = supernodal::SupernodalLltRef::new(&symbolic.supernodes, &self.values);
        let mut diagonal = Vec::with_capacity(symbolic.supernodes.nrows());
        for s in 0..symbolic.supernodes.n_supernodes() {
            let block = factor.supernode(s).val();
            diagonal.extend((0..block.ncols()).map(|k| block[(k, k)]));
        }
        diagonal
    }
}
