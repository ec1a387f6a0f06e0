//! The few LAPACK routines that the solvers need, with their sizes checked. Matrices are column-major, lower triangle.

#![allow(unsafe_code)]

use lapack_src as _; // links the system's OpenBLAS, which is BLAS and LAPACK in one
use std::sync::Once;

unsafe extern "C" {
    fn openblas_set_num_threads(threads: i32);
}

/// Fortran's `//` as gfortran calls it: the only function of its runtime that the routines below need. With it, a program
/// with OpenBLAS inside needs no libgfortran.
#[cfg(feature = "static")]
mod fortran {
    /// Writes `a` and `b`, one after the other, into `out`: cut off at its end, or filled up with blanks.
    ///
    /// # Safety
    /// The pointers are valid for their lengths, and `out` overlaps neither `a` nor `b`.
    #[unsafe(no_mangle)]
    unsafe extern "C" fn _gfortran_concat_string(
        length: usize,
        out: *mut u8,
        a_length: usize,
        a: *const u8,
        b_length: usize,
        b: *const u8,
    ) {
        // SAFETY: gfortran passes the buffer of a new string and two strings with their lengths, which are not null even
        // where a length is zero.
        let (out, a, b) = unsafe {
            (
                std::slice::from_raw_parts_mut(out, length),
                std::slice::from_raw_parts(a, a_length),
                std::slice::from_raw_parts(b, b_length),
            )
        };
        for (to, from) in out.iter_mut().zip(a.iter().chain(b).chain(std::iter::repeat(&b' '))) {
            *to = *from;
        }
    }
}

/// Limits BLAS to one thread per call: blocks are solved in parallel, which a threaded BLAS would only slow down.
pub fn single_threaded() {
    static ONCE: Once = Once::new();
    // SAFETY: OpenBLAS exports this function with this signature; it sets one global, here once before any other call.
    ONCE.call_once(|| unsafe { openblas_set_num_threads(1) });
}

/// Real numbers that LAPACK supports.
pub trait Real: Copy + Send + Sync + Default + 'static {
    /// Rounds a float64.
    fn of(x: f64) -> Self;
    /// Widens to float64.
    fn to(self) -> f64;
    /// The lower Cholesky factor of the n x n `a` in place; false if `a` is not positive definite.
    fn potrf(n: usize, a: &mut [Self]) -> bool;
    /// Solves L x = b, or L^T x = b, in place for `b` of n x `columns`; false if L is singular.
    fn trtrs(transposed: bool, n: usize, columns: usize, l: &[Self], b: &mut [Self]) -> bool;
}

macro_rules! real {
    ($t:ty, $potrf:path, $trtrs:path) => {
        impl Real for $t {
            fn of(x: f64) -> Self {
                x as Self
            }
            fn to(self) -> f64 {
                self.into()
            }
            fn potrf(n: usize, a: &mut [Self]) -> bool {
                single_threaded();
                assert!(n > 0 && a.len() == n * n, "a square matrix");
                let mut info = 0;
                // SAFETY: `a` holds n x n numbers with leading dimension n > 0, and LAPACK reads and writes no others.
                unsafe { $potrf(b'L', n as i32, a, n as i32, &mut info) };
                info == 0
            }
            fn trtrs(transposed: bool, n: usize, columns: usize, l: &[Self], b: &mut [Self]) -> bool {
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

real!(f32, lapack::spotrf, lapack::strtrs);
real!(f64, lapack::dpotrf, lapack::dtrtrs);

/// Eigenvalues, ascending, of the symmetric n x n `a`, which receives the eigenvectors as columns.
///
/// `None` if LAPACK does not converge, which for finite input it does.
pub fn syevd(n: usize, a: &mut [f64]) -> Option<Vec<f64>> {
    single_threaded();
    assert!(n > 0 && a.len() == n * n, "a square matrix");
    let (work, iwork) = (1 + 6 * n + 2 * n * n, 3 + 5 * n);
    let (mut values, mut w, mut iw, mut info) = (vec![0.0; n], vec![0.0; work], vec![0; iwork], 0);
    let n = n as i32;
    // SAFETY: `a` holds n x n numbers; the workspaces have the sizes that dsyevd's documentation asks for with vectors.
    unsafe {
        lapack::dsyevd(b'V', b'L', n, a, n, &mut values, &mut w, work as i32, &mut iw, iwork as i32, &mut info);
    }
    (info == 0).then_some(values)
}

/// Eigenvalues, ascending, of A u = lambda B u; `a` receives the vectors as columns, u^T B u = 1.
///
/// `None` if B is not positive definite, or without convergence.
pub fn sygvd(n: usize, a: &mut [f64], b: &mut [f64]) -> Option<Vec<f64>> {
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
