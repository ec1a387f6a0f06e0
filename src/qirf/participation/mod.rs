//! The generalized eigenproblem of one block (Q7): P u = lambda (N + eps I) u with P = W W^T of rank at most 8, and the
//! participation (Q8) q_i = sum over the leading r of lambda_k u_ik^2.
//!
//! With N + eps I = L L^T and B = L^-1 W, the 8x8 problem B^T B y = lambda y has the same eigenvalues and
//! u_k = L^-T B y_k / sqrt(lambda_k), so lambda_k u_ik^2 = (L^-T B y_k)_i^2: never divide by sqrt(lambda).

pub mod device;

use super::assemble::symmetric;
use super::dense::{Library, Real, serving};
use super::{CHANNELS, Row};
use crate::wording::named;
use serde::{Deserialize, Serialize};

/// Relative rounding of the entries of N, which are float32: 2^-24.
const ROUNDING: f64 = 1.0 / 16_777_216.0;

/// Slack of the energy's comparison with tau, so that float32 and float64 agree on a sum that hits it exactly.
const ENERGY_SLACK: f64 = 1e-6;

named! {
    /// Solver of the eigenproblem: the same solution at different costs. A block that a solver cannot factorise falls back
    /// to the next: from the device to `LowRank`, from there to the metric's canonical form.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
    #[serde(rename_all = "kebab-case")]
    pub enum Eigensolver {
        /// The full generalized eigenproblem in float64, as the paper solves it; it reads P.
        Dsygvd = "dsygvd",
        /// Cholesky and an 8x8 eigenproblem in float64, from W.
        #[default]
        LowRank = "low-rank",
        /// The same in float32; the 8x8 part stays float64.
        LowRankF32 = "low-rank-f32",
        /// The whole solution in float32 on the device; only participations and eigenvalues are read back ([`device`]).
        Device = "device",
    }
}

impl Eigensolver {
    /// The solvers that run on the host.
    pub const HOST: [Self; 3] = [Self::Dsygvd, Self::LowRank, Self::LowRankF32];
}

/// A block's metric in the eigenproblem: m x m, symmetric, epsilon on its diagonal.
#[derive(Clone, Debug)]
pub struct Gram {
    library: &'static dyn Library,
    m: usize,
    values: Vec<f64>,
    epsilon: f64,
    /// Entries of N that were not finite and count as no overlap (1 on the diagonal).
    pub repaired: usize,
}

impl Gram {
    /// N + epsilon I of size `m` x `m`; with `self_overlaps` S_ii, the raw S_ij = N_ij sqrt(S_ii S_jj) replaces N.
    ///
    /// # Panics
    /// If `overlap` does not hold m x m numbers.
    pub fn new(m: usize, overlap: &[f32], self_overlaps: Option<&[f64]>, epsilon: f64) -> Self {
        assert_eq!(overlap.len(), m * m, "overlaps of {m} Gaussians");
        let mut repaired = 0;
        let mut values = Vec::with_capacity(m * m);
        for (i, row) in overlap.chunks_exact(m.max(1)).enumerate() {
            for (j, &n) in row.iter().enumerate() {
                let diagonal = if i == j { 1.0 } else { 0.0 };
                values.push(if n.is_finite() { f64::from(n) } else { diagonal });
                repaired += usize::from(!n.is_finite());
            }
        }
        if let Some(own) = self_overlaps {
            let root: Vec<f64> = own.iter().map(|s| if s.is_finite() { s.max(0.0).sqrt() } else { 0.0 }).collect();
            for (i, row) in values.chunks_exact_mut(m.max(1)).enumerate() {
                row.iter_mut().zip(&root).for_each(|(v, r)| *v *= root[i] * r);
            }
        }
        (0..m).for_each(|i| values[i * m + i] += epsilon);
        Self { library: serving(), m, values, epsilon, repaired }
    }

    /// The same metric, to be solved by `library`.
    #[must_use]
    pub fn by(self, library: &'static dyn Library) -> Self {
        Self { library, ..self }
    }

    /// Largest over smallest eigenvalue: infinite if the metric is not positive definite, `None` if it is empty or
    /// the solver does not converge.
    pub fn condition(&self) -> Option<f64> {
        let mut vectors = self.values.clone();
        let values = (self.m > 0).then(|| self.library.syevd(self.m, &mut vectors)).flatten()?;
        let (least, most) = (*values.first()?, *values.last()?);
        Some(if least > 0.0 { most / least } else { f64::INFINITY })
    }

    /// Largest error of an eigenvalue by the rounding of N, no entry of which exceeds the mean of its two diagonal ones.
    fn rounding(&self) -> f64 {
        ROUNDING * (0..self.m).map(|i| self.values[i * self.m + i]).sum::<f64>()
    }

    /// An orthonormal basis of the functions that the metric distinguishes: columns v_k / sqrt(d_k) of its eigenpairs
    /// (d_k, v_k), without those with d_k below `least` (canonical orthogonalisation); m x p, column-major.
    ///
    /// `None` only if the solver does not converge.
    fn canonical(&self, least: f64) -> Option<Vec<f64>> {
        let mut vectors = self.values.clone();
        let values = self.library.syevd(self.m, &mut vectors)?;
        let mut basis = Vec::with_capacity(vectors.len());
        for (column, &d) in vectors.chunks_exact(self.m).zip(&values) {
            if d >= least && d > 0.0 {
                let scale = d.sqrt().recip();
                basis.extend(column.iter().map(|v| v * scale));
            }
        }
        Some(basis)
    }
}

/// Leading eigenvalues and participation of one block.
#[derive(Clone, Debug, PartialEq)]
pub struct Participation {
    /// The eight largest eigenvalues, descending; beyond the rank of P they are zero.
    pub spectrum: [f64; CHANNELS],
    /// The fewest eigenvalues whose sum reaches tau of the whole; 1 for a block without any response.
    pub r: usize,
    /// q of each member, m; all zero for a block without any response.
    pub q: Vec<f64>,
    /// True if the metric was not positive definite and its canonical form was solved instead.
    pub canonical: bool,
}

/// A metric factored for several right-hand sides W.
#[derive(Debug)]
pub struct Factor {
    library: &'static dyn Library,
    form: Form,
}

#[derive(Debug)]
enum Form {
    Identity,
    /// Lower Cholesky factor, m x m, float64.
    Cholesky(Vec<f64>),
    /// Lower Cholesky factor, m x m, float32.
    CholeskyF32(Vec<f32>),
    /// Columns of the canonical basis, m x p, for a metric that is not positive definite.
    Canonical(Vec<f64>),
}

impl Factor {
    /// The factor of the identity, of any size.
    pub fn identity() -> Self {
        Self { library: serving(), form: Form::Identity }
    }

    /// Factors `metric`, in float32 for [`Eigensolver::LowRankF32`] and otherwise in float64; falls back to its
    /// canonical form.
    pub fn new(metric: &Gram, solver: Eigensolver) -> Self {
        let Gram { library, m, ref values, epsilon, .. } = *metric;
        let factored = match solver {
            _ if m == 0 => Some(Form::Identity),
            Eigensolver::LowRankF32 => {
                let mut l: Vec<f32> = values.iter().map(|&v| v as f32).collect();
                f32::by(library).potrf(m, &mut l).then_some(Form::CholeskyF32(l))
            }
            _ => {
                let mut l = values.clone();
                f64::by(library).potrf(m, &mut l).then_some(Form::Cholesky(l))
            }
        };
        let canonical = || metric.canonical(epsilon.max(metric.rounding())).map(Form::Canonical);
        // Without convergence nothing is known of the metric: the identity ranks by the responses themselves.
        let form = factored.or_else(canonical).unwrap_or(Form::Identity);
        Self { library, form }
    }

    /// Eigenvalues and participation for the rows W (m x 8) at energy share `tau`.
    pub fn participation(&self, w: &[Row], tau: f64) -> Participation {
        let m = w.len();
        if m == 0 || w.iter().flatten().all(|&x| x == 0.0) {
            return Participation { spectrum: [0.0; CHANNELS], r: 1, q: vec![0.0; m], canonical: false };
        }
        match &self.form {
            Form::Identity => self.low_rank(&columns::<f64>(w), m, tau, <[f64]>::to_vec),
            Form::Cholesky(l) => self.cholesky(l, w, tau),
            Form::CholeskyF32(l) => self.cholesky(l, w, tau),
            Form::Canonical(basis) => self.canonical(basis, w, tau),
        }
    }

    fn cholesky<T: Real>(&self, l: &[T], w: &[Row], tau: f64) -> Participation {
        let (m, routines) = (w.len(), T::by(self.library));
        let mut b = columns::<T>(w);
        routines.trtrs(false, m, CHANNELS, l, &mut b);
        self.low_rank(&b, m, tau, |c| {
            let mut back: Vec<T> = c.iter().map(|&x| T::of(x)).collect();
            routines.trtrs(true, m, back.len() / m, l, &mut back);
            back.iter().map(|x| x.to()).collect()
        })
    }

    fn canonical(&self, basis: &[f64], w: &[Row], tau: f64) -> Participation {
        let m = w.len();
        let p = basis.len() / m;
        if p == 0 {
            return Participation { spectrum: [0.0; CHANNELS], r: 1, q: vec![0.0; m], canonical: true };
        }
        let mut b = vec![0.0; p * CHANNELS];
        for (k, column) in basis.chunks_exact(m).enumerate() {
            for c in 0..CHANNELS {
                b[c * p + k] = column.iter().zip(w).map(|(x, row)| x * row[c]).sum();
            }
        }
        self.low_rank(&b, p, tau, |c| {
            let mut back = vec![0.0; m * (c.len() / p)];
            for (out, along) in back.chunks_exact_mut(m).zip(c.chunks_exact(p)) {
                for (column, a) in basis.chunks_exact(m).zip(along) {
                    out.iter_mut().zip(column).for_each(|(o, x)| *o += a * x);
                }
            }
            back
        })
    }

    /// The 8x8 problem of B (p x 8, column-major); `back` maps the p x r matrix B Y to the members (m x r).
    fn low_rank<T: Real>(&self, b: &[T], p: usize, tau: f64, back: impl Fn(&[f64]) -> Vec<f64>) -> Participation {
        let column = |c: usize| &b[c * p..(c + 1) * p];
        let mut gram = [0.0; CHANNELS * CHANNELS];
        for i in 0..CHANNELS {
            for j in 0..=i {
                let sum: f64 = column(i).iter().zip(column(j)).map(|(x, y)| x.to() * y.to()).sum();
                gram[i * CHANNELS + j] = sum;
                gram[j * CHANNELS + i] = sum;
            }
        }
        let ascending = self.library.syevd(CHANNELS, &mut gram).unwrap_or_else(|| vec![0.0; CHANNELS]);
        let mut spectrum = [0.0; CHANNELS];
        spectrum.iter_mut().zip(ascending.iter().rev()).for_each(|(s, &l)| *s = l.max(0.0));
        let r = leading(&spectrum, spectrum.iter().sum(), tau);
        let mut by = vec![0.0; p * r];
        for (k, out) in by.chunks_exact_mut(p.max(1)).enumerate() {
            let y = &gram[(CHANNELS - 1 - k) * CHANNELS..][..CHANNELS];
            for (c, &weight) in y.iter().enumerate() {
                out.iter_mut().zip(column(c)).for_each(|(o, x)| *o += weight * x.to());
            }
        }
        let brought = back(&by);
        let m = brought.len() / r;
        let mut q = vec![0.0; m];
        for column in brought.chunks_exact(m.max(1)) {
            q.iter_mut().zip(column).for_each(|(q, x)| *q += x * x);
        }
        Participation { spectrum, r, q, canonical: matches!(self.form, Form::Canonical(_)) }
    }
}

/// Solves a block: `w` are the rows of W (m x 8), `density` is the packed lower triangle of P, which only
/// [`Eigensolver::Dsygvd`] reads. Also returns the metric's factor.
///
/// # Panics
/// If `dsygvd` gets no P.
pub fn solve(metric: &Gram, w: &[Row], density: &[f32], solver: Eigensolver, tau: f64) -> (Participation, Factor) {
    let seen = w.iter().flatten().any(|&x| x != 0.0);
    if solver == Eigensolver::Dsygvd
        && seen
        && density.iter().all(|p| p.is_finite())
        && let Some(solved) = generalized(metric, density, tau)
    {
        return solved;
    }
    let factor = Factor::new(metric, solver);
    (factor.participation(w, tau), factor)
}

/// Norm of row i of (N + eps I)^(-1/2) W for each member, for each of the matrices in `w`: the Löwdin scores.
pub fn lowdin(metric: &Gram, w: &[&[Row]]) -> Vec<Vec<f64>> {
    let m = metric.m;
    // Half of epsilon: rounding puts the eigenvalues of duplicates on either side of it, and all of them count here.
    let Some(basis) = (m > 0).then(|| metric.canonical(0.5 * metric.epsilon)).flatten() else {
        return w.iter().map(|w| w.iter().map(norm).collect()).collect();
    };
    // (N + eps I)^(-1/2) = sum of v v^T / sqrt(d) = sum of b b^T sqrt(d), where b = v / sqrt(d) and |b|^2 = 1/d.
    let weights: Vec<f64> =
        basis.chunks_exact(m).map(|b| b.iter().map(|x| x * x).sum::<f64>().sqrt().recip()).collect();
    let scores = |w: &&[Row]| {
        let mut rows = vec![[0.0; CHANNELS]; m];
        for (b, weight) in basis.chunks_exact(m).zip(&weights) {
            let mut along = [0.0; CHANNELS];
            for (x, row) in b.iter().zip(*w) {
                (0..CHANNELS).for_each(|c| along[c] += x * row[c]);
            }
            for (x, row) in b.iter().zip(&mut rows) {
                (0..CHANNELS).for_each(|c| row[c] += x * weight * along[c]);
            }
        }
        rows.iter().map(norm).collect()
    };
    w.iter().map(scores).collect()
}

/// Euclidean length of a row.
pub fn norm(row: &Row) -> f64 {
    row.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// The fewest leading eigenvalues (descending) whose sum reaches `tau` of `total`; 1 if all are zero.
fn leading(spectrum: &[f64], total: f64, tau: f64) -> usize {
    let mut sum = 0.0;
    let enough = |&lambda: &f64| {
        sum += lambda;
        sum >= (tau - ENERGY_SLACK) * total
    };
    spectrum.iter().position(enough).map_or(spectrum.len(), |at| at + 1).max(1)
}

fn columns<T: Real>(w: &[Row]) -> Vec<T> {
    (0..CHANNELS).flat_map(|c| w.iter().map(move |row| T::of(row[c]))).collect()
}

/// Solves P u = lambda (N + eps I) u directly; also returns the Cholesky factor that this leaves. `None` if that fails.
fn generalized(metric: &Gram, density: &[f32], tau: f64) -> Option<(Participation, Factor)> {
    let m = metric.m;
    assert_eq!(density.len(), m * (m + 1) / 2, "P of {m} members");
    let mut p: Vec<f64> = symmetric(m, density);
    let mut b = metric.values.clone();
    let ascending = metric.library.sygvd(m, &mut p, &mut b)?;
    let descending: Vec<f64> = ascending.iter().rev().map(|l| l.max(0.0)).collect();
    // P has rank at most 8: further eigenvalues are rounding errors.
    let known = &descending[..m.min(CHANNELS)];
    let r = leading(known, known.iter().sum(), tau);
    let mut spectrum = [0.0; CHANNELS];
    spectrum[..known.len()].copy_from_slice(known);
    let mut q = vec![0.0; m];
    for (k, lambda) in known.iter().take(r).enumerate() {
        let u = &p[(m - 1 - k) * m..][..m];
        q.iter_mut().zip(u).for_each(|(q, x)| *q += lambda * x * x);
    }
    Some((
        Participation { spectrum, r, q, canonical: false },
        Factor { library: metric.library, form: Form::Cholesky(b) },
    ))
}
