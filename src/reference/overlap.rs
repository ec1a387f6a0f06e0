//! Normalised overlap (Q4) N_ij = S_ij / sqrt(S_ii S_jj) of two Gaussians, S_ij the integral of their product.
//!
//! With d = p_i - p_j: ln N = 3/2 ln 2 + 1/2 sum(ln s_i + ln s_j) - 1/2 ln |Si + Sj| - 1/2 d^T (Si + Sj)^-1 d.
//! Householder's method never forms Si + Sj: in the frame of the flatter Gaussian the 6x3 stack
//! [diag(s_i); diag(s_j) Rj^T Ri] has a QR factor with R^T R = Ri^T (Si + Sj) Ri, so the determinant is that of R and
//! the exponent |R^-T Ri^T d|^2.
//!
//! The device uses Householder's method, too. The device's tests compare with a second twin
//! (`tests/device/overlap/twin.rs`) that shares neither code nor method with this one, and `selftest` with values
//! computed by other means.

use super::project::rotation;
use glam::{DMat3, DVec3, DVec4};

pub use crate::kernels::constants::axes::float64::SCALE_FLOOR;

/// A Gaussian without its opacity and colour, on which an overlap does not depend.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Primitive {
    /// Centre in world units.
    pub position: [f64; 3],
    /// Standard deviations along the axes, in world units.
    pub scales: [f64; 3],
    /// Quaternion (w, x, y, z), not necessarily of unit length.
    pub quaternion: [f64; 4],
}

impl Primitive {
    /// The Gaussian of a model with this centre in world units, these logarithms of its standard deviations, and this
    /// quaternion (w, x, y, z).
    pub fn of(mean: [f32; 3], log_scales: [f32; 3], rotation: [f32; 4]) -> Self {
        Self {
            position: mean.map(f64::from),
            scales: log_scales.map(|s| f64::from(s).exp()),
            quaternion: rotation.map(f64::from),
        }
    }

    /// Raises its scales to at least [`SCALE_FLOOR`] of the largest.
    #[must_use]
    pub fn floored(mut self) -> Self {
        let largest = self.scales.iter().copied().fold(0.0, f64::max);
        self.scales = self.scales.map(|s| s.max(SCALE_FLOOR * largest));
        self
    }

    /// Its axes in the world, as columns; NaN for a quaternion of length zero.
    fn axes(&self) -> DMat3 {
        let quaternion = DVec4::from(self.quaternion);
        rotation((quaternion / quaternion.length()).to_array())
    }

    /// Least over largest scale.
    fn thinness(&self) -> f64 {
        let scales = DVec3::from(self.scales);
        scales.min_element() / scales.max_element()
    }
}

/// N of two Gaussians in float64, scales floored as on the device; NaN for a quaternion of length zero.
pub fn overlap(a: &Primitive, b: &Primitive) -> f64 {
    let n = qr(&a.floored(), &b.floored()).exp();
    // Clamped as on the device, except that a NaN stays NaN.
    if n > 1.0 { 1.0 } else { n }
}

/// Symmetric m x m matrix of N over `primitives`, row by row, its diagonal 1.
pub fn block(primitives: &[Primitive]) -> Vec<f64> {
    let entry = |i: usize, j: usize| if i == j { 1.0 } else { overlap(&primitives[i.min(j)], &primitives[i.max(j)]) };
    (0..primitives.len()).flat_map(|i| (0..primitives.len()).map(move |j| entry(i, j))).collect()
}

/// ln N by Householder QR, without a floor.
fn qr(a: &Primitive, b: &Primitive) -> f64 {
    let (i, j) = if b.thinness() < a.thinness() { (b, a) } else { (a, b) };
    let own = i.axes();
    // Column k is the k-th axis of i in the frame of j.
    let turned = j.axes().transpose() * own;
    let apart = own.transpose() * (DVec3::from(i.position) - DVec3::from(j.position));
    let mut order = [0, 1, 2];
    order.sort_by(|&k, &l| i.scales[l].total_cmp(&i.scales[k]));

    let mut stack = [[0.0; 3]; 6]; // rows
    for (column, &k) in order.iter().enumerate() {
        stack[column][column] = i.scales[k];
        for row in 0..3 {
            stack[3 + row][column] = j.scales[row] * turned.col(k)[row];
        }
    }
    let mut ln_r = 0.0;
    let mut quadratic = 0.0;
    let mut solved = [0.0; 3];
    for k in 0..3 {
        let length = (k..6).map(|row| stack[row][k] * stack[row][k]).sum::<f64>().sqrt();
        let diagonal = if stack[k][k] > 0.0 { -length } else { length };
        // Householder vector v = x - diagonal e_k; v.v = 2 length (length + |x_k|).
        let mut v = stack.map(|row| row[k]);
        v[k] -= diagonal;
        let half = -(diagonal * v[k]);
        for column in k + 1..3 {
            let along = (k..6).map(|row| v[row] * stack[row][column]).sum::<f64>() / half;
            for row in k..6 {
                stack[row][column] -= along * v[row];
            }
        }
        ln_r += length.ln();
        // Row k of R^T z = Ri^T d, in the order of the columns.
        let known = (0..k).map(|l| stack[l][k] * solved[l]).sum::<f64>();
        solved[k] = (apart[order[k]] - known) / diagonal;
        quadratic += solved[k] * solved[k];
    }
    let ln_volumes = i.scales.iter().chain(&j.scales).map(|s| s.ln()).sum::<f64>();
    1.5 * std::f64::consts::LN_2 + 0.5 * ln_volumes - ln_r - 0.5 * quadratic
}
