//! Real spherical harmonics to degree 3 (3DGS's signs) and their derivatives by the direction.
//!
//! The polynomials hold on the unit sphere only; off it they are one extension of many, so a derivative has a meaning
//! only once its radial part is removed (see [`through_normalisation`]).

use crate::kernels::constants::sh::float64::{
    SH_C0, SH_C1, SH_C2_XX, SH_C2_XY, SH_C2_ZZ, SH_C3_XXX, SH_C3_XXZ, SH_C3_XYZ, SH_C3_XZZ, SH_C3_ZZZ,
};
use glam::DVec3;

/// Coefficients per colour channel at degree 3.
pub const COEFFICIENTS: usize = 16;

/// The basis at unit direction `d`, bands 0..=3 one after the other, each in the order m = -l..=l.
pub fn basis(d: DVec3) -> [f64; COEFFICIENTS] {
    let DVec3 { x, y, z } = d;
    let (xx, yy, zz) = (x * x, y * y, z * z);
    [
        SH_C0,
        -SH_C1 * y,
        SH_C1 * z,
        -SH_C1 * x,
        SH_C2_XY * x * y,
        -SH_C2_XY * y * z,
        SH_C2_ZZ * (2.0 * zz - xx - yy),
        -SH_C2_XY * x * z,
        SH_C2_XX * (xx - yy),
        -SH_C3_XXX * y * (3.0 * xx - yy),
        SH_C3_XYZ * x * y * z,
        -SH_C3_XZZ * y * (4.0 * zz - xx - yy),
        SH_C3_ZZZ * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
        -SH_C3_XZZ * x * (4.0 * zz - xx - yy),
        SH_C3_XXZ * z * (xx - yy),
        -SH_C3_XXX * x * (xx - 3.0 * yy),
    ]
}

/// The derivatives of [`basis`]'s polynomials by x, y, z, each treated as independent.
pub fn basis_gradient(d: DVec3) -> [DVec3; COEFFICIENTS] {
    let DVec3 { x, y, z } = d;
    let (xx, yy, zz) = (x * x, y * y, z * z);
    let v = DVec3::new;
    [
        DVec3::ZERO,
        v(0.0, -SH_C1, 0.0),
        v(0.0, 0.0, SH_C1),
        v(-SH_C1, 0.0, 0.0),
        SH_C2_XY * v(y, x, 0.0),
        -SH_C2_XY * v(0.0, z, y),
        SH_C2_ZZ * v(-2.0 * x, -2.0 * y, 4.0 * z),
        -SH_C2_XY * v(z, 0.0, x),
        SH_C2_XX * v(2.0 * x, -2.0 * y, 0.0),
        -SH_C3_XXX * v(6.0 * x * y, 3.0 * (xx - yy), 0.0),
        SH_C3_XYZ * v(y * z, x * z, x * y),
        -SH_C3_XZZ * v(-2.0 * x * y, 4.0 * zz - xx - 3.0 * yy, 8.0 * y * z),
        SH_C3_ZZZ * v(-6.0 * x * z, -6.0 * y * z, 6.0 * zz - 3.0 * xx - 3.0 * yy),
        -SH_C3_XZZ * v(4.0 * zz - 3.0 * xx - yy, -2.0 * x * y, 8.0 * x * z),
        SH_C3_XXZ * v(2.0 * x * z, -2.0 * y * z, xx - yy),
        -SH_C3_XXX * v(3.0 * (xx - yy), -6.0 * x * y, 0.0),
    ]
}

/// Gradient by an offset `r d`, given the gradient `dl_dd` by its unit direction `d`: (I - d d^T) dl_dd / r.
pub fn through_normalisation(d: DVec3, r: f64, dl_dd: DVec3) -> DVec3 {
    (dl_dd - d * d.dot(dl_dd)) / r
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The integral of Y_i Y_j over the sphere is delta_ij (midpoint rule in z, hence the tolerance).
    #[test]
    fn basis_is_orthonormal() {
        let (steps, mut gram) = (64, [[0.0; COEFFICIENTS]; COEFFICIENTS]);
        for i in 0..steps {
            let z = -1.0 + (i as f64 + 0.5) * 2.0 / steps as f64;
            for j in 0..steps {
                let (s, c) = (std::f64::consts::TAU * j as f64 / steps as f64).sin_cos();
                let r = (1.0 - z * z).sqrt();
                let y = basis(DVec3::new(r * c, r * s, z));
                for a in 0..COEFFICIENTS {
                    for b in 0..COEFFICIENTS {
                        gram[a][b] += y[a] * y[b] * 4.0 * std::f64::consts::PI / f64::from(steps * steps);
                    }
                }
            }
        }
        for a in 0..COEFFICIENTS {
            for b in 0..COEFFICIENTS {
                let expected = f64::from(u8::from(a == b));
                assert!((gram[a][b] - expected).abs() < 5e-3, "<{a}, {b}> = {}", gram[a][b]);
            }
        }
    }
}
