//! The product of two matrices, used by both methods of convolution.

use ndarray::{ArrayView2, ArrayViewMut2, linalg::general_mat_mul};

/// c = a b, for row-major a (m x k), b (k x n) and c (m x n).
pub(super) fn matrix_product(a: &[f32], b: &[f32], c: &mut [f32], [m, k, n]: [usize; 3]) {
    // A mismatch of lengths is a bug in this module, not in any input.
    let a = ArrayView2::from_shape((m, k), a).expect("a is m x k");
    let b = ArrayView2::from_shape((k, n), b).expect("b is k x n");
    let mut c = ArrayViewMut2::from_shape((m, n), c).expect("c is m x n");
    general_mat_mul(1.0, &a, &b, 0.0, &mut c);
}
