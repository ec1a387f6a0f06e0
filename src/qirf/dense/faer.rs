//! [faer](https://docs.rs/faer), a library in pure Rust.

use super::{Cholesky, Library};
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{LltRegularization, cholesky_in_place, cholesky_in_place_scratch};
use faer::linalg::evd::{ComputeEigenvectors, self_adjoint_evd, self_adjoint_evd_scratch};
use faer::linalg::triangular_solve::{solve_lower_triangular_in_place, solve_upper_triangular_in_place};
use faer::traits::RealField;
use faer::{MatMut, MatRef, Par, Spec, diag::DiagMut};

/// faer on one thread per call: blocks are solved in parallel.
#[derive(Debug)]
pub struct Faer;

impl<T: RealField + Copy> Cholesky<T> for Faer {
    fn potrf(&self, n: usize, a: &mut [T]) -> bool {
        let mut memory = MemBuffer::new(cholesky_in_place_scratch::<T>(n, Par::Seq, Spec::default()));
        let (a, stack) = (MatMut::from_column_major_slice_mut(a, n, n), MemStack::new(&mut memory));
        cholesky_in_place(a, LltRegularization::default(), Par::Seq, stack, Spec::default()).is_ok()
    }

    fn trtrs(&self, transposed: bool, n: usize, columns: usize, l: &[T], b: &mut [T]) -> bool {
        let (l, b) = (MatRef::from_column_major_slice(l, n, n), MatMut::from_column_major_slice_mut(b, n, columns));
        if (0..n).any(|i| l[(i, i)] == T::zero_impl()) {
            return false;
        }
        if transposed {
            solve_upper_triangular_in_place(l.transpose(), b, Par::Seq);
        } else {
            solve_lower_triangular_in_place(l, b, Par::Seq);
        }
        true
    }
}

impl Library for Faer {
    fn name(&self) -> &'static str {
        "faer"
    }

    fn eigenpairs(&self, n: usize, a: &mut [f64]) -> Option<Vec<f64>> {
        let wanted = ComputeEigenvectors::Yes;
        let mut memory = MemBuffer::new(self_adjoint_evd_scratch::<f64>(n, wanted, Par::Seq, Spec::default()));
        let (mut values, mut vectors) = (vec![0.0; n], vec![0.0; n * n]);
        self_adjoint_evd(
            MatRef::from_column_major_slice(a, n, n),
            DiagMut::from_slice_mut(&mut values),
            Some(MatMut::from_column_major_slice_mut(&mut vectors, n, n)),
            Par::Seq,
            MemStack::new(&mut memory),
            Spec::default(),
        )
        .ok()?;
        a.copy_from_slice(&vectors);
        Some(values)
    }

    /// With B = L L^T, the symmetric L^-1 A L^-T has the same eigenvalues, and u = L^-T v.
    fn generalized_eigenpairs(&self, n: usize, a: &mut [f64], b: &mut [f64]) -> Option<Vec<f64>> {
        if !self.potrf(n, b) {
            return None;
        }
        let l = MatRef::from_column_major_slice(&*b, n, n);
        let mut whole = MatMut::from_column_major_slice_mut(a, n, n);
        for j in 0..n {
            (0..j).for_each(|i| whole[(i, j)] = whole[(j, i)]);
        }
        solve_lower_triangular_in_place(l, whole.as_mut(), Par::Seq);
        solve_lower_triangular_in_place(l, whole.transpose_mut(), Par::Seq);
        let values = self.eigenpairs(n, a)?;
        self.trtrs(true, n, n, b, a);
        Some(values)
    }
}
