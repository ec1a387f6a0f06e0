//! Rotation of real spherical harmonics: the matrix of each band for an orthonormal map of directions.

use super::sh::{self, COEFFICIENTS};
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

/// Changes a model's bands above 0 as its Gaussians are rotated (or mirrored) by an orthonormal matrix R, so that the colour seen
/// along R d afterwards is the one seen along d before; band 0 is equal in all directions.
///
/// By projection: with Y the basis of [`sh::basis`], entry (j, i) of a band's matrix is the integral of `Y_j(d) Y_i(R^T
/// d)` over the sphere, which a rule of 32 directions computes exactly.
pub(super) fn rotate_bands(sh: &mut [Vec<f32>], rotation: DMat3) {
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
    for (l, band) in sh.iter_mut().enumerate().skip(1) {
        match l {
            1 => turn::<3>(&whole, band),
            2 => turn::<5>(&whole, band),
            _ => turn::<7>(&whole, band),
        }
    }
}

/// Multiplies each Gaussian's M coefficients of three colours by their band's matrix, a part of that of all bands.
fn turn<const M: usize>(whole: &[[f64; COEFFICIENTS]; COEFFICIENTS], band: &mut [f32]) {
    let (width, first) = (3 * M, (M - 1) * (M - 1) / 4);
    let rows: [[f64; M]; M] = std::array::from_fn(|j| std::array::from_fn(|i| whole[first + j][first + i]));
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
            rotate_bands(&mut after, rotation);
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
}
