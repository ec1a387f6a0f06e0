//! Eigenpairs of 3 x 3 matrices by Jacobi's rotations: independent of the serving library, so always the same bits.

use super::turn;
use glam::{DMat3, DVec3};

/// Sweeps after which the rotations end, converged or not; covariances were seen to need at most six.
const SWEEPS: usize = 20;

/// Eigenvalues, ascending, and eigenvectors, as columns, of a symmetric 3 x 3 matrix, of which the lower triangle is
/// read.
///
/// Small eigenvalues of a positive definite matrix are as exact as large ones: a rotation is skipped only if its entry
/// is a rounding error of both its diagonal entries.
pub fn eigen3(matrix: &DMat3) -> (DVec3, DMat3) {
    let mut a: [[f64; 3]; 3] = std::array::from_fn(|i| std::array::from_fn(|j| matrix.col(i.min(j))[i.max(j)]));
    let mut vectors = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]; // rows
    for _ in 0..SWEEPS {
        let mut rotated = false;
        for (p, q, other) in [(0, 1, 2), (0, 2, 1), (1, 2, 0)] {
            let off = a[p][q];
            if off.abs() <= f64::EPSILON * (a[p][p] * a[q][q]).abs().sqrt() {
                continue;
            }
            rotated = true;
            let theta = (a[q][q] - a[p][p]) / (2.0 * off);
            let tangent = theta.signum() / (theta.abs() + (theta * theta + 1.0).sqrt());
            let cosine = (tangent * tangent + 1.0).sqrt().recip();
            let sine = tangent * cosine;
            a[p][p] -= tangent * off;
            a[q][q] += tangent * off;
            (a[p][q], a[q][p]) = (0.0, 0.0);
            let (x, y) = (a[p][other], a[q][other]);
            let turned = [cosine * x - sine * y, sine * x + cosine * y];
            ([a[p][other], a[q][other]], [a[other][p], a[other][q]]) = (turned, turned);
            for c in 0..3 {
                let (x, y) = (vectors[p][c], vectors[q][c]);
                (vectors[p][c], vectors[q][c]) = (cosine * x - sine * y, sine * x + cosine * y);
            }
        }
        if !rotated {
            break;
        }
    }
    let mut order = [0, 1, 2];
    order.sort_by(|&i, &j| a[i][i].total_cmp(&a[j][j]));
    for vector in &mut vectors {
        turn(vector);
    }
    (DVec3::from_array(order.map(|i| a[i][i])), DMat3::from_cols_array_2d(&order.map(|i| vectors[i])))
}
