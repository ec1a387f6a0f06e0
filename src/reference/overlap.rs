//! Normalised overlap (Q4) N_ij = S_ij / sqrt(S_ii S_jj) of two Gaussians, S_ij the integral of their product.
//!
//! With d = p_i - p_j: ln N = 3/2 ln 2 + 1/2 sum(ln s_i + ln s_j) - 1/2 ln |Si + Sj| - 1/2 d^T (Si + Sj)^-1 d.
//! [`Form::Qr`] never forms Si + Sj: in the frame of the flatter Gaussian the 6x3 stack [diag(s_i); diag(s_j) Rj^T Ri]
//! has a QR factor with R^T R = Ri^T (Si + Sj) Ri, so the determinant is that of R and the exponent |R^-T Ri^T d|^2.
//! The other form shows the cost of forming the sum, in float64 and in float32.
//!
//! The device uses Householder's method, too. The device's tests compare with a second twin
//! (`tests/device/overlap/twin.rs`) that shares neither code nor method with this one, and `selftest` with values
//! computed by other means.

use num_traits::{Float, ToPrimitive};

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
    /// Raises its scales to at least [`SCALE_FLOOR`] of the largest.
    #[must_use]
    pub fn floored(mut self) -> Self {
        let largest = self.scales.iter().copied().fold(0.0, f64::max);
        self.scales = self.scales.map(|s| s.max(SCALE_FLOOR * largest));
        self
    }
}

/// Formula of an overlap.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// Householder QR of the stacked roots.
    Qr,
    /// Determinant and adjugate of Si + Sj.
    Determinant,
}

/// N of two Gaussians in float64, scales floored as on the device.
pub fn overlap(a: &Primitive, b: &Primitive) -> f64 {
    overlap_as::<f64>(Form::Qr, &a.floored(), &b.floored())
}

/// N of two Gaussians by `form`, computed in `T` throughout, without a floor; NaN if the form breaks down.
pub fn overlap_as<T: Float>(form: Form, a: &Primitive, b: &Primitive) -> f64 {
    let (a, b) = (Shape::<T>::of(a), Shape::<T>::of(b));
    let ln = match form {
        Form::Qr => qr(&a, &b),
        Form::Determinant => return determinant(&a, &b).to_f64().unwrap_or(f64::NAN),
    };
    let n = ln.exp().to_f64().unwrap_or(f64::NAN);
    // Clamped as on the device, except that a NaN stays NaN.
    if n > 1.0 { 1.0 } else { n }
}

/// Symmetric m x m matrix of N over `primitives`, row by row, its diagonal 1.
pub fn block(primitives: &[Primitive]) -> Vec<f64> {
    let entry = |i: usize, j: usize| if i == j { 1.0 } else { overlap(&primitives[i.min(j)], &primitives[i.max(j)]) };
    (0..primitives.len()).flat_map(|i| (0..primitives.len()).map(move |j| entry(i, j))).collect()
}

/// Rounds a float64.
fn of<T: Float>(x: f64) -> T {
    T::from(x).expect("a float has all numbers, rounded")
}

type Vec3<T> = [T; 3];

struct Shape<T> {
    position: Vec3<T>,
    scales: Vec3<T>,
    /// Columns are the axes in the world: `axes[k]` is the k-th.
    axes: [Vec3<T>; 3],
}

impl<T: Float> Shape<T> {
    fn of(p: &Primitive) -> Self {
        let [w, x, y, z] = p.quaternion.map(of::<T>);
        // Divided by the largest first, so that neither a tiny nor a huge quaternion leaves the range of float32.
        let largest = [w, x, y, z].map(T::abs).into_iter().fold(T::zero(), T::max);
        let [w, x, y, z] = [w, x, y, z].map(|v| v / largest);
        let length = (w * w + x * x + y * y + z * z).sqrt();
        let [w, x, y, z] = [w, x, y, z].map(|v| v / length);
        let (one, two) = (T::one(), of::<T>(2.0));
        let axes = [
            [one - two * (y * y + z * z), two * (x * y + w * z), two * (x * z - w * y)],
            [two * (x * y - w * z), one - two * (x * x + z * z), two * (y * z + w * x)],
            [two * (x * z + w * y), two * (y * z - w * x), one - two * (x * x + y * y)],
        ];
        Self { position: p.position.map(of), scales: p.scales.map(of), axes }
    }

    /// Least over largest scale.
    fn thinness(&self) -> T {
        let [a, b, c] = self.scales;
        let (low, high) = if a < b { (a, b) } else { (b, a) };
        (if c < low { c } else { low }) / (if c > high { c } else { high })
    }

    /// Sum over axes of the logarithms of the scales times `unit`.
    fn ln_volume(&self, unit: T) -> T {
        self.scales.map(|s| (s * unit).ln()).into_iter().fold(T::zero(), |sum, ln| sum + ln)
    }

    fn covariance(&self) -> [Vec3<T>; 3] {
        let entry = |i: usize, j: usize| {
            let along = |k: usize| self.axes[k][i] * self.scales[k] * (self.axes[k][j] * self.scales[k]);
            along(0) + along(1) + along(2)
        };
        std::array::from_fn(|i| std::array::from_fn(|j| entry(i, j)))
    }
}

fn dot<T: Float>(a: Vec3<T>, b: Vec3<T>) -> T {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn difference<T: Float>(a: &Shape<T>, b: &Shape<T>) -> Vec3<T> {
    std::array::from_fn(|c| a.position[c] - b.position[c])
}

/// ln N by Householder QR.
fn qr<T: Float>(a: &Shape<T>, b: &Shape<T>) -> T {
    let (i, j) = if b.thinness() < a.thinness() { (b, a) } else { (a, b) };
    let zero = T::zero();
    let mut order = [0, 1, 2];
    order.sort_by(|&k, &l| i.scales[l].partial_cmp(&i.scales[k]).unwrap_or(std::cmp::Ordering::Equal));
    // A power of two scales all lengths, so that no square leaves the range of float32.
    let largest = i.scales.iter().chain(&j.scales).filter_map(ToPrimitive::to_f64).fold(0.0, f64::max);
    let power = (-largest.log2().floor()).exp2();
    let unit = of::<T>(if power.is_finite() { power } else { 1.0 });

    let mut stack = [[zero; 3]; 6]; // rows
    let mut right = [zero; 3];
    let d = difference(i, j);
    for (column, &k) in order.iter().enumerate() {
        stack[column][column] = i.scales[k] * unit;
        for row in 0..3 {
            stack[3 + row][column] = j.scales[row] * unit * dot(j.axes[row], i.axes[k]);
        }
        right[column] = dot(i.axes[k], d) * unit;
    }
    let mut ln_r = zero;
    let mut quadratic = zero;
    let mut solved = [zero; 3];
    for k in 0..3 {
        let length = (k..6).fold(zero, |sum, row| sum + stack[row][k] * stack[row][k]).sqrt();
        let diagonal = if stack[k][k] > zero { -length } else { length };
        // Householder vector v = x - diagonal e_k; v.v = 2 length (length + |x_k|).
        let mut v = [zero; 6];
        (k..6).for_each(|row| v[row] = stack[row][k]);
        v[k] = v[k] - diagonal;
        let half = -(diagonal * v[k]);
        for column in k + 1..3 {
            let along = (k..6).fold(zero, |sum, row| sum + v[row] * stack[row][column]) / half;
            (k..6).for_each(|row| stack[row][column] = stack[row][column] - along * v[row]);
        }
        stack[k][k] = diagonal;
        ln_r = ln_r + length.ln();
        // Row k of R^T z = right.
        let known = (0..k).fold(zero, |sum, l| sum + stack[l][k] * solved[l]);
        solved[k] = (right[k] - known) / diagonal;
        quadratic = quadratic + solved[k] * solved[k];
    }
    // Logarithms of the scaled values: three times ln 2^-40, to be cancelled later, would cost float32 its last digits.
    of::<T>(1.5 * std::f64::consts::LN_2) + (i.ln_volume(unit) + j.ln_volume(unit)) / of::<T>(2.0)
        - ln_r
        - quadratic / of::<T>(2.0)
}

fn sum<T: Float>(a: &Shape<T>, b: &Shape<T>) -> [Vec3<T>; 3] {
    let (x, y) = (a.covariance(), b.covariance());
    std::array::from_fn(|i| std::array::from_fn(|j| x[i][j] + y[i][j]))
}

/// N by determinants, as the formula is written.
fn determinant<T: Float>(a: &Shape<T>, b: &Shape<T>) -> T {
    let s = sum(a, b);
    let d = difference(a, b);
    let minor = |r: (usize, usize), c: (usize, usize)| s[r.0][c.0] * s[r.1][c.1] - s[r.0][c.1] * s[r.1][c.0];
    let adjugate = [
        [minor((1, 2), (1, 2)), -minor((0, 2), (1, 2)), minor((0, 1), (1, 2))],
        [-minor((1, 2), (0, 2)), minor((0, 2), (0, 2)), -minor((0, 1), (0, 2))],
        [minor((1, 2), (0, 1)), -minor((0, 2), (0, 1)), minor((0, 1), (0, 1))],
    ];
    let det = s[0][0] * adjugate[0][0] + s[0][1] * adjugate[1][0] + s[0][2] * adjugate[2][0];
    let quadratic = dot(d, adjugate.map(|row| dot(row, d))) / det;
    let volumes = a.scales.iter().chain(&b.scales).fold(T::one(), |product, &s| product * s);
    (of::<T>(8.0) * volumes / det).sqrt() * (-(quadratic / of::<T>(2.0))).exp()
}
