//! Dense linear algebra of blocks: factors, triangular solutions and eigenpairs, by any of the libraries compiled in.
//!
//! Matrices are column-major, lower triangle. An eigenvector's sign is fixed: see `turn`.

mod faer;
mod jacobi;
#[cfg(all(feature = "lapack", target_os = "linux"))]
mod lapack;

pub use jacobi::eigen3;
use std::fmt::Debug;

/// The libraries compiled in; the first one serves by default.
pub const LIBRARIES: &[&dyn Library] = &[
    #[cfg(all(feature = "lapack", target_os = "linux"))]
    &lapack::Lapack,
    &faer::Faer,
];

/// A component can fix the sign of its vector if it reaches this share of the largest one. With this value, unlike 1 or
/// 1/sqrt 2, rounding alone makes no component of a symmetric problem cross the threshold.
const SIGNIFICANT: f64 = 0.6;

/// The library used unless another is named.
pub fn serving() -> &'static dyn Library {
    LIBRARIES[0]
}

/// A library's routines, named as in LAPACK, at one precision.
pub trait Cholesky<T> {
    /// The lower Cholesky factor of the n x n `a` in place; false if `a` is not positive definite.
    fn potrf(&self, n: usize, a: &mut [T]) -> bool;
    /// Solves L x = b, or L^T x = b, in place for `b` of n x `columns`; false if L is singular.
    fn trtrs(&self, transposed: bool, n: usize, columns: usize, l: &[T], b: &mut [T]) -> bool;
}

/// A library of dense linear algebra.
pub trait Library: Cholesky<f32> + Cholesky<f64> + Debug + Sync {
    /// Its name in files and on the command line.
    fn name(&self) -> &'static str;
    /// Like [`syevd`](Self::syevd), with arbitrary signs.
    fn eigenpairs(&self, n: usize, a: &mut [f64]) -> Option<Vec<f64>>;
    /// Like [`sygvd`](Self::sygvd), with arbitrary signs.
    fn generalized_eigenpairs(&self, n: usize, a: &mut [f64], b: &mut [f64]) -> Option<Vec<f64>>;

    /// Eigenvalues, ascending, of the symmetric n x n `a`, which receives the eigenvectors as columns.
    ///
    /// `None` without convergence, which does not happen for finite input.
    fn syevd(&self, n: usize, a: &mut [f64]) -> Option<Vec<f64>> {
        let values = self.eigenpairs(n, a)?;
        a.chunks_exact_mut(n).for_each(turn);
        Some(values)
    }

    /// Eigenvalues, ascending, of A u = lambda B u; `a` receives the vectors as columns, u^T B u = 1, and `b` the lower
    /// Cholesky factor of B.
    ///
    /// `None` if B is not positive definite, or without convergence.
    fn sygvd(&self, n: usize, a: &mut [f64], b: &mut [f64]) -> Option<Vec<f64>> {
        let values = self.generalized_eigenpairs(n, a, b)?;
        a.chunks_exact_mut(n).for_each(turn);
        Some(values)
    }
}

impl PartialEq for dyn Library {
    fn eq(&self, other: &Self) -> bool {
        self.name() == other.name()
    }
}

/// Real numbers in which a block can be solved.
pub trait Real: Copy + Send + Sync + Default + 'static {
    /// Rounds a float64.
    fn of(x: f64) -> Self;
    /// Widens to float64.
    fn to(self) -> f64;
    /// A library's routines at this precision.
    fn by(library: &dyn Library) -> &dyn Cholesky<Self>;
}

impl Real for f32 {
    fn of(x: f64) -> Self {
        x as Self
    }
    fn to(self) -> f64 {
        self.into()
    }
    fn by(library: &dyn Library) -> &dyn Cholesky<Self> {
        library
    }
}

impl Real for f64 {
    fn of(x: f64) -> Self {
        x
    }
    fn to(self) -> f64 {
        self
    }
    fn by(library: &dyn Library) -> &dyn Cholesky<Self> {
        library
    }
}

/// Gives an eigenvector the sign that makes its first significant component positive, for any library.
fn turn(vector: &mut [f64]) {
    let most = vector.iter().fold(0.0_f64, |most, x| most.max(x.abs()));
    if vector.iter().find(|x| x.abs() >= SIGNIFICANT * most).is_some_and(|x| *x < 0.0) {
        for x in vector {
            *x = -*x;
        }
    }
}

#[cfg(test)]
mod tests;
