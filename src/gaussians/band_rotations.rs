//! Rotation of real spherical harmonics: the matrix of each band for an orthonormal map of directions.

use super::sh::{self, COEFFICIENTS};
use super::{Gaussians, MAX_SH_DEGREE};
use glam::{DMat3, DVec3};
use rayon::prelude::*;

/// Heights of the Gauss-Legendre rule with four nodes, which is exact to degree 7, and their weights.
const HEIGHTS: [(f64, f64); 4] = [
    (-0.861136311594052575224, 0.347854845137453857373),
    (-0.339981043584856264803, 0.652145154862546142627),
    (0.339981043584856264803, 0.652145154862546142627),
    (0.861136311594052575224, 0.347854845137453857373),
];
/// Directions at each height: exact for products of two bands of degree 3, which contain at most the sixth harmonic
/// around the axis.
const ROUND: u32 = 8;
/// Gaussians per task.
const TASK: usize = 4096;

/// The matrices by which a model's bands change when its Gaussians are rotated (or mirrored) by an orthonormal matrix
/// R, so that the colour seen along R d afterwards is the one seen along d before.
///
/// By projection: with Y the basis of [`sh::basis`], entry (j, i) of a band's matrix is the integral of `Y_j(d) Y_i(R^T
/// d)` over the sphere, which a rule of 32 directions computes exactly.
#[derive(Clone, Debug, PartialEq)]
pub struct BandRotations {
    /// By degree from 0; (2 l + 1) squared numbers, row by row.
    bands: [Vec<f64>; MAX_SH_DEGREE + 1],
}

impl BandRotations {
    /// The matrices for an orthonormal matrix.
    pub fn new(rotation: DMat3) -> Self {
        let back = rotation.transpose();
        let mut whole = [[0.0; COEFFICIENTS]; COEFFICIENTS];
        for (z, weight) in HEIGHTS {
            let side = (1.0 - z * z).sqrt();
            for k in 0..ROUND {
                let (sin, cos) = (std::f64::consts::TAU * f64::from(k) / f64::from(ROUND)).sin_cos();
                let d = DVec3::new(side * cos, side * sin, z);
                let (to, from) = (sh::basis(d), sh::basis(back * d));
                let area = weight * std::f64::consts::TAU / f64::from(ROUND);
                for (row, to) in whole.iter_mut().zip(to) {
                    row.iter_mut().zip(from).for_each(|(entry, from)| *entry += area * to * from);
                }
            }
        }
        let bands = std::array::from_fn(|l| {
            let own = l * l..(l + 1) * (l + 1);
            whole[own.clone()].iter().flat_map(|row| row[own.clone()].iter().copied()).collect()
        });
        Self { bands }
    }

    /// The matrix of a band, (2 l + 1) squared numbers, row by row.
    ///
    /// # Panics
    /// If `l` is above [`MAX_SH_DEGREE`].
    pub fn band(&self, l: usize) -> &[f64] {
        &self.bands[l]
    }

    /// Rotates the coefficients of all bands above 0; band 0 is equal in all directions.
    ///
    /// # Panics
    /// If the model has more bands than [`MAX_SH_DEGREE`] + 1.
    pub fn apply(&self, sh: &mut [Vec<f32>]) {
        for (l, band) in sh.iter_mut().enumerate().skip(1) {
            match l {
                1 => turn::<3>(&self.bands[1], band),
                2 => turn::<5>(&self.bands[2], band),
                _ => turn::<7>(&self.bands[3], band),
            }
        }
    }
}

/// Multiplies each Gaussian's M coefficients of three colours by an M x M matrix.
fn turn<const M: usize>(matrix: &[f64], band: &mut [f32]) {
    let width = 3 * M;
    debug_assert_eq!(width, Gaussians::band_width((M - 1) / 2));
    let rows: [[f64; M]; M] = std::array::from_fn(|j| std::array::from_fn(|i| matrix[j * M + i]));
    band.par_chunks_mut(TASK * width).for_each(|task| {
        for row in task.chunks_exact_mut(width) {
            let mut turned = [[0.0_f64; 3]; M];
            for (i, colour) in row.as_chunks::<3>().0.iter().enumerate() {
                let colour = colour.map(f64::from);
                for j in 0..M {
                    for c in 0..3 {
                        turned[j][c] += rows[j][i] * colour[c];
                    }
                }
            }
            row.iter_mut().zip(turned.as_flattened()).for_each(|(to, from)| *to = *from as f32);
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    fn direction(random: &mut Random) -> DVec3 {
        let (z, turn) = (random.within(-1.0, 1.0), random.within(0.0, std::f64::consts::TAU));
        let side = (1.0 - z * z).sqrt();
        DVec3::new(side * turn.cos(), side * turn.sin(), z)
    }

    fn any(random: &mut Random) -> DMat3 {
        let axis = direction(random);
        DMat3::from_axis_angle(axis, random.within(-180.0, 180.0).to_radians())
    }

    /// The twin: colours seen along rotated directions, summed from the basis.
    #[test]
    fn colours_turn_with_the_model() {
        let mut random = Random(5);
        for case in 0..40 {
            let mirror = if case % 4 == 3 { DMat3::from_diagonal(DVec3::new(1.0, -1.0, 1.0)) } else { DMat3::IDENTITY };
            let rotation = any(&mut random) * mirror;
            let before: Vec<Vec<f32>> =
                (0..4).map(|l| (0..3 * (2 * l + 1)).map(|_| random.within(-1.0, 1.0) as f32).collect()).collect();
            let mut after = before.clone();
            BandRotations::new(rotation).apply(&mut after);
            let seen = |bands: &[Vec<f32>], d: DVec3| -> [f64; 3] {
                let basis = sh::basis(d);
                std::array::from_fn(|c| {
                    let of = |l: usize, m: usize| basis[l * l + m] * f64::from(bands[l][3 * m + c]);
                    (0..4).flat_map(|l| (0..=2 * l).map(move |m| (l, m))).map(|(l, m)| of(l, m)).sum()
                })
            };
            for _ in 0..20 {
                let d = direction(&mut random);
                let (a, b) = (seen(&before, d), seen(&after, rotation * d));
                assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < 2e-6), "{a:?} {b:?}");
            }
        }
    }

    /// The matrices are a representation: orthonormal, and the matrix of a product is the product of the matrices.
    #[test]
    fn matrices_are_orthonormal_and_multiply() {
        let mut random = Random(9);
        for _ in 0..20 {
            let (a, b) = (any(&mut random), any(&mut random));
            let [of_a, of_b, both] = [a, b, a * b].map(BandRotations::new);
            for l in 0..=MAX_SH_DEGREE {
                let m = 2 * l + 1;
                let entry = |matrix: &BandRotations, j: usize, i: usize| matrix.band(l)[j * m + i];
                for j in 0..m {
                    for i in 0..m {
                        let product: f64 = (0..m).map(|k| entry(&of_a, j, k) * entry(&of_b, k, i)).sum();
                        assert!((product - entry(&both, j, i)).abs() < 1e-13);
                        let gram: f64 = (0..m).map(|k| entry(&of_a, k, j) * entry(&of_a, k, i)).sum();
                        assert!((gram - f64::from(u8::from(i == j))).abs() < 1e-13);
                    }
                }
            }
        }
    }

    /// A half turn about z, from captures' axes to glTF's, changes the signs of odd m.
    #[test]
    fn a_half_turn_about_z_changes_signs_of_odd_m() {
        let turns = BandRotations::new(DMat3::from_axis_angle(DVec3::Z, std::f64::consts::PI));
        for l in 0..=MAX_SH_DEGREE {
            for j in 0..=2 * l {
                let sign = if (j + l).is_multiple_of(2) { 1.0 } else { -1.0 };
                assert!((turns.band(l)[j * (2 * l + 1) + j] - sign).abs() < 1e-14, "{l} {j}");
            }
        }
    }
}
