//! LAPACK through `lapack-src`: the system's OpenBLAS, with the sizes of its arguments checked.

#![allow(unsafe_code)]

use super::{Cholesky, Library};
use lapack_src as _; // links OpenBLAS, which is BLAS and LAPACK in one
use std::sync::Once;

unsafe extern "C" {
    fn openblas_set_num_threads(threads: i32);
}

/// Limits BLAS to one thread per call: blocks are solved in parallel, which a threaded BLAS would only slow down.
fn single_threaded() {
    static ONCE: Once = Once::new();
    // SAFETY: OpenBLAS exports this function with this signature; it sets one global, here once before any other call.
    ONCE.call_once(|| unsafe { openblas_set_num_threads(1) });
}

/// LAPACK.
#[derive(Debug)]
pub struct Lapack;

macro_rules! cholesky {
    ($t:ty, $potrf:path, $trtrs:path) => {
        impl Cholesky<$t> for Lapack {
            fn potrf(&self, n: usize, a: &mut [$t]) -> bool {
                single_threaded();
                assert!(n > 0 && a.len() == n * n, "a square matrix");
                let mut info = 0;
                // SAFETY: `a` holds n x n numbers with leading dimension n > 0, and LAPACK reads and writes no others.
                unsafe { $potrf(b'L', n as i32, a, n as i32, &mut info) };
                info == 0
            }

            fn trtrs(&self, transposed: bool, n: usize, columns: usize, l: &[$t], b: &mut [$t]) -> bool {
                single_threaded();
                assert!(n > 0 && l.len() == n * n && b.len() == n * columns, "a factor and its right-hand sides");
                if columns == 0 {
                    return true;
                }
                let trans = if transposed { b'T' } else { b'N' };
                let (rows, columns, mut info) = (n as i32, columns as i32, 0);
                // SAFETY: `l` holds n x n and `b` n x columns numbers, both with leading dimension n > 0.
                unsafe { $trtrs(b'L', trans, b'N', rows, columns, l, rows, b, rows, &mut info) };
                info == 0
            }
        }
    };
}

cholesky!(f32, lapack::spotrf, lapack::strtrs);
cholesky!(f64, lapack::dpotrf, lapack::dtrtrs);

impl Library for Lapack {
    fn name(&self) -> &'static str {
        "lapack"
    }

    fn eigenpairs(&self, n: usize, a: &mut [f64]) -> Option<Vec<f64>> {
        single_threaded();
        assert!(n > 0 && a.len() == n * n, "a square matrix");
        let (work, iwork) = (1 + 6 * n + 2 * n * n, 3 + 5 * n);
        let (mut values, mut w, mut iw, mut info) = (vec![0.0; n], vec![0.0; work], vec![0; iwork], 0);
        let n = n as i32;
        let (lwork, liwork) = (work as i32, iwork as i32);
        // SAFETY: `a` holds n x n numbers; the workspaces have the sizes that dsyevd's documentation asks for with vectors.
        unsafe {
            lapack::dsyevd(b'V', b'L', n, a, n, &mut values, &mut w, lwork, &mut iw, liwork, &mut info);
        }
        (info == 0).then_some(values)
    }

    fn generalized_eigenpairs(&self, n: usize, a: &mut [f64], b: &mut [f64]) -> Option<Vec<f64>> {
        single_threaded();
        assert!(n > 0 && a.len() == n * n && b.len() == n * n, "two square matrices");
        let (work, iwork) = (1 + 6 * n + 2 * n * n, 3 + 5 * n);
        let (mut values, mut w, mut iw, mut info) = (vec![0.0; n], vec![0.0; work], vec![0; iwork], 0);
        let n = n as i32;
        let (lwork, liwork) = (work as i32, iwork as i32);
        // SAFETY: `a` and `b` hold n x n numbers; the workspaces have the sizes that dsygvd's documentation asks for.
        unsafe {
            lapack::dsygvd(&[1], b'V', b'L', n, a, n, b, n, &mut values, &mut w, lwork, &mut iw, liwork, &mut info);
        }
        (info == 0).then_some(values)
    }
}
