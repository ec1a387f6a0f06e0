//! Merging (Q10): dropped functions are projected onto the kept ones of their block, if that lowers the local error.
//!
//! A Gaussian's function is alpha c phi; with phi of unit norm its coefficient is alpha c sqrt(S_ii), and the squared
//! error of coefficients e is e^T N e. X = (N_AA + 1e-3 I)^-1 N_AD acts on unit-norm functions; alpha scales the
//! others, hence the root in X_ad sqrt(S_dd / S_aa).

use crate::kernels::constants::sh::float64::SH_C0;
use crate::qirf::dense::{Cholesky, serving};

/// Added to the diagonal of the kept functions' overlaps, so that near duplicates share the projection.
const RIDGE: f64 = 1e-3;
/// Smallest share to which merging lowers a kept opacity.
const LEAST_SHARE: f64 = 0.5;
/// Largest opacity after merging.
const MOST_OPACITY: f64 = 0.99;

/// One block's functions; `sh` holds m rows of `width` numbers, red, green and blue of the constant band first.
#[derive(Clone, Debug, PartialEq)]
pub struct Functions {
    /// Opacities in 0..1, m.
    pub alpha: Vec<f64>,
    /// Spherical harmonics of all bands, m x `width`.
    pub sh: Vec<f64>,
    /// Numbers per row of `sh`: 3 or more.
    pub width: usize,
    /// S_ii up to a common factor, m (see [`crate::qirf::overlap::Metric::self_overlap`]).
    pub self_overlaps: Vec<f64>,
}

/// Errors of a block before and after merging, and whether merging was accepted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Merged {
    /// Squared function error without merging.
    pub dropped: f64,
    /// Squared function error after merging.
    pub merged: f64,
    /// True if the error fell and the kept functions were changed.
    pub accepted: bool,
}

/// Changes the kept functions of a block so that they also represent the dropped ones, if that lowers the local error.
///
/// `overlap` is N, m x m. Only `alpha` and `sh` of kept members change. `None` if there is nothing to merge, or if the
/// overlaps of the kept members cannot be factored.
///
/// # Panics
/// If the arrays disagree on the block's size, or `width` is below 3.
pub fn merge(overlap: &[f32], keep: &[bool], functions: &mut Functions) -> Option<Merged> {
    let m = keep.len();
    let width = functions.width;
    assert!(overlap.len() == m * m && functions.alpha.len() == m && functions.self_overlaps.len() == m);
    assert!(width >= 3 && functions.sh.len() == m * width);
    let n = |i: usize, j: usize| Some(f64::from(overlap[i * m + j])).filter(|x| x.is_finite()).unwrap_or(0.0);
    let (kept, dropped): (Vec<usize>, Vec<usize>) = (0..m).partition(|&i| keep[i]);
    if kept.is_empty() || dropped.is_empty() {
        return None;
    }
    let a = kept.len();
    let mut factor: Vec<f64> =
        kept.iter().flat_map(|&i| kept.iter().map(move |&j| (i, j))).map(|(i, j)| n(i, j)).collect();
    (0..a).for_each(|i| factor[i * a + i] += RIDGE);
    // Projection is linear: only the sums of alpha and alpha c are projected, not each function.
    let before = functions.clone();
    let root: Vec<f64> = before.self_overlaps.iter().map(|s| s.max(0.0).sqrt()).collect();
    let weight = |d: usize| before.alpha[d] * root[d];
    let mut right = vec![0.0; a * (1 + width)];
    for (row, &i) in kept.iter().enumerate() {
        for &d in &dropped {
            let share = n(i, d) * weight(d);
            right[row] += share;
            for c in 0..width {
                right[(1 + c) * a + row] += share * before.sh[d * width + c];
            }
        }
    }
    let library: &dyn Cholesky<f64> = serving();
    if !(library.potrf(a, &mut factor)
        && library.trtrs(false, a, 1 + width, &factor, &mut right)
        && library.trtrs(true, a, 1 + width, &factor, &mut right))
    {
        return None;
    }
    for (row, &i) in kept.iter().enumerate() {
        let (alpha, own) = (before.alpha[i], root[i]);
        let gained = right[row] / own;
        let whole = alpha + gained;
        if !(alpha > 0.0 && own > 0.0 && whole.is_finite()) {
            continue;
        }
        let least = LEAST_SHARE * alpha;
        functions.alpha[i] = whole.clamp(least, MOST_OPACITY.max(least));
        // If the projection almost removes a function, the resulting mean colour is noise.
        if whole > least {
            for c in 0..width {
                let merged = (alpha * before.sh[i * width + c] + right[(1 + c) * a + row] / own) / whole;
                if merged.is_finite() {
                    functions.sh[i * width + c] = merged;
                }
            }
        }
    }
    let only_dropped = error(m, n, &before, &root, |i| if keep[i] { Some(before.at(i)) } else { None });
    let merged = error(m, n, &before, &root, |i| if keep[i] { Some(functions.at(i)) } else { None });
    let accepted = merged < only_dropped;
    if !accepted {
        *functions = before;
    }
    Some(Merged { dropped: only_dropped, merged, accepted })
}

impl Functions {
    /// Opacity, and opacity times each colour, of member `i`.
    fn at(&self, i: usize) -> [f64; 4] {
        let colour = |c: usize| 0.5 + SH_C0 * self.sh[i * self.width + c];
        let alpha = self.alpha[i];
        [alpha, alpha * colour(0), alpha * colour(1), alpha * colour(2)]
    }
}

/// e^T N e summed over opacity and three colours, where e is the difference between the block's functions and those of
/// `now`.
fn error(
    m: usize,
    n: impl Fn(usize, usize) -> f64,
    whole: &Functions,
    root: &[f64],
    now: impl Fn(usize) -> Option<[f64; 4]>,
) -> f64 {
    let off = |i: usize| {
        let (was, is) = (whole.at(i), now(i).unwrap_or_default());
        std::array::from_fn::<f64, 4, _>(|c| (was[c] - is[c]) * root[i])
    };
    let e: Vec<[f64; 4]> = (0..m).map(off).collect();
    let row = |i: usize| (0..m).map(|j| n(i, j) * (0..4).map(|c| e[i][c] * e[j][c]).sum::<f64>()).sum::<f64>();
    (0..m).map(row).sum()
}
