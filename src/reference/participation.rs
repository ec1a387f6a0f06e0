//! Participation of a block's members in its leading modes, by definition: P u = lambda (N + eps I) u with P = W W^T
//! (Q7), q_i = sum over the leading k of lambda_k u_ik^2 (Q8).
//!
//! Computed directly: N + eps I = L L^T, then all m eigenpairs of L^-1 P L^-T by Jacobi rotations. It uses neither
//! LAPACK nor P's low rank.

use super::rrdm;
use crate::random::uniform;

/// Rotations stop when the off-diagonal part is below this share of the matrix.
const CONVERGED: f64 = 1e-30;
/// Largest number of sweeps of rotations; convergence is quadratic from about the third on.
const SWEEPS: usize = 60;
/// Slack of the energy's comparison with tau, as in `participation.comp` and `qirf::participation`.
const SLACK: f64 = 1e-6;

/// The solution of one block of m members.
#[derive(Clone, Debug, PartialEq)]
pub struct Participation {
    /// All m eigenvalues, descending; negative ones from rounding are set to 0.
    pub spectrum: Vec<f64>,
    /// The fewest eigenvalues whose sum reaches tau of the whole, at least 1.
    pub r: usize,
    /// Participation of each member, m.
    pub q: Vec<f64>,
}

/// Solves a block: `overlap` is N (m x m, symmetric), `w` the rows of W (m x 8), `epsilon` is added to N's diagonal and
/// `tau` is the share of the energy that the leading modes reach. `None` if N + epsilon I is not positive definite.
///
/// # Panics
/// If `overlap` does not hold m x m numbers.
pub fn participation(overlap: &[f64], w: &[[f64; 8]], epsilon: f64, tau: f64) -> Option<Participation> {
    let m = w.len();
    assert_eq!(overlap.len(), m * m, "overlaps of {m} members");
    let mut l = overlap.to_vec();
    (0..m).for_each(|i| l[i * m + i] += epsilon);
    factorise(&mut l, m)?;
    // L^-1 P L^-T: P is symmetric, so both sides are the same substitution, with a transposition between.
    let mut c = rrdm::p(w);
    for _ in 0..2 {
        (0..m).for_each(|column| substitute(&l, m, &mut c, column));
        transpose(&mut c, m);
    }
    let vectors = diagonalise(&mut c, m);
    let mut order: Vec<usize> = (0..m).collect();
    order.sort_by(|a, b| c[b * m + b].total_cmp(&c[a * m + a]));
    let spectrum: Vec<f64> = order.iter().map(|k| c[k * m + k].max(0.0)).collect();
    let r = leading(&spectrum, tau);
    let mut q = vec![0.0; m];
    for (&k, lambda) in order.iter().zip(&spectrum).take(r) {
        let u = substitute_back(&l, m, vectors[k * m..(k + 1) * m].to_vec());
        q.iter_mut().zip(u).for_each(|(q, u)| *q += lambda * u * u);
    }
    Some(Participation { spectrum, r, q })
}

/// The change of each member's participation, m, that rounding can cause in a solver with unit roundoff `roundoff`
/// (2^-24 for float32): the largest change over `draws` random changes of the input of the size of the solver's
/// backward error.
///
/// A Cholesky factor is exact for a matrix that differs by gamma |L| |L^T|, whose entries are at most gamma (1 +
/// epsilon) because N's diagonal is 1; gamma grows as sqrt(m) roundoff (Higham and Mary 2019). W and its substitution
/// differ by a few roundings. This is statistical condition estimation (Kenney and Laub 1994). `None` if N + epsilon I,
/// changed in this way, is not positive definite.
///
/// # Panics
/// If `overlap` does not hold m x m numbers.
pub fn uncertainty(
    overlap: &[f64],
    w: &[[f64; 8]],
    [epsilon, tau]: [f64; 2],
    roundoff: f64,
    draws: u64,
) -> Option<Vec<f64>> {
    let m = w.len();
    let exact = participation(overlap, w, epsilon, tau)?.q;
    let gamma = (m as f64).sqrt() * roundoff;
    let mut most = vec![0.0_f64; m];
    for draw in 0..draws {
        let noise =
            |kind: u64, i: usize, j: usize| 2.0 * uniform(&[draw, kind, i.min(j) as u64, i.max(j) as u64]) - 1.0;
        let changed: Vec<f64> = (0..m * m).map(|k| overlap[k] + gamma * noise(0, k / m, k % m)).collect();
        let row = |(i, row): (usize, &[f64; 8])| {
            std::array::from_fn(|c| row[c] * (1.0 + 4.0 * roundoff * noise(1, i, m + c)))
        };
        let rows: Vec<[f64; 8]> = w.iter().enumerate().map(row).collect();
        let q = participation(&changed, &rows, epsilon, tau)?.q;
        most.iter_mut().zip(q.iter().zip(&exact)).for_each(|(most, (q, exact))| *most = most.max((q - exact).abs()));
    }
    Some(most)
}

/// The lower Cholesky factor in place of the lower triangle (row by row); `None` if a pivot is not positive.
fn factorise(a: &mut [f64], m: usize) -> Option<()> {
    for c in 0..m {
        for row in c..m {
            let before: f64 = a[row * m..row * m + c].iter().zip(&a[c * m..c * m + c]).map(|(x, y)| x * y).sum();
            a[row * m + c] -= before;
            if row > c {
                a[row * m + c] /= a[c * m + c];
            } else if a[c * m + c] > 0.0 {
                a[c * m + c] = a[c * m + c].sqrt();
            } else {
                return None;
            }
        }
    }
    Some(())
}

/// Replaces a column x of `matrix` by L^-1 x.
fn substitute(l: &[f64], m: usize, matrix: &mut [f64], column: usize) {
    for row in 0..m {
        let before: f64 = (0..row).map(|k| l[row * m + k] * matrix[k * m + column]).sum();
        matrix[row * m + column] = (matrix[row * m + column] - before) / l[row * m + row];
    }
}

/// L^-T x.
fn substitute_back(l: &[f64], m: usize, mut x: Vec<f64>) -> Vec<f64> {
    for row in (0..m).rev() {
        let after: f64 = (row + 1..m).map(|k| l[k * m + row] * x[k]).sum();
        x[row] = (x[row] - after) / l[row * m + row];
    }
    x
}

fn transpose(a: &mut [f64], m: usize) {
    for row in 0..m {
        for column in 0..row {
            a.swap(row * m + column, column * m + row);
        }
    }
}

/// Jacobi's rotations: leaves the eigenvalues on the diagonal of `a`, and returns the eigenvectors as rows.
fn diagonalise(a: &mut [f64], m: usize) -> Vec<f64> {
    let mut vectors = vec![0.0; m * m];
    (0..m).for_each(|k| vectors[k * m + k] = 1.0);
    for _ in 0..SWEEPS {
        let square = |row: usize, column: usize| a[row * m + column] * a[row * m + column];
        let off: f64 =
            (0..m).flat_map(|row| (0..row).map(move |column| (row, column))).map(|(r, c)| square(r, c)).sum();
        let trace: f64 = (0..m).map(|k| square(k, k)).sum();
        if off <= CONVERGED * trace {
            break;
        }
        for p in 0..m {
            for q in p + 1..m {
                rotate(a, &mut vectors, m, [p, q]);
            }
        }
    }
    vectors
}

/// Turns axes p and q so that the entry between them vanishes.
fn rotate(a: &mut [f64], vectors: &mut [f64], m: usize, [p, q]: [usize; 2]) {
    let between = a[p * m + q];
    if between == 0.0 {
        return;
    }
    let (sin, cos) = (0.5 * (2.0 * between).atan2(a[q * m + q] - a[p * m + p])).sin_cos();
    let turn = |x: f64, y: f64| (cos * x - sin * y, sin * x + cos * y);
    // Indices: a quarter of the time of iterators in builds for tests.
    let mut k = 0;
    while k < m {
        (a[p * m + k], a[q * m + k]) = turn(a[p * m + k], a[q * m + k]);
        (vectors[p * m + k], vectors[q * m + k]) = turn(vectors[p * m + k], vectors[q * m + k]);
        k += 1;
    }
    k = 0;
    while k < m {
        (a[k * m + p], a[k * m + q]) = turn(a[k * m + p], a[k * m + q]);
        k += 1;
    }
}

/// The fewest leading eigenvalues (descending) whose sum reaches `tau` of the total; 1 if all are zero.
fn leading(spectrum: &[f64], tau: f64) -> usize {
    let total: f64 = spectrum.iter().sum();
    let mut sum = 0.0;
    let reaches = |lambda: &f64| {
        sum += lambda;
        sum >= (tau - SLACK) * total
    };
    spectrum.iter().position(reaches).map_or(spectrum.len(), |k| k + 1).max(1)
}
