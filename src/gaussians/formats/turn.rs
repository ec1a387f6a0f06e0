//! Places of a file's parts in its world.

use glam::{DAffine3, DMat3, DQuat, DVec3};

use super::Gaussians;
use crate::scene::origin::near;

/// Largest deviation of a matrix from a turn times a number.
const EVEN: f64 = 1e-4;

/// Moves a part of a model to its place in the file's world. Where the first part goes far from the world's origin, all count
/// from there: `origin` gets that place. False for a map that scales axes by different factors.
pub(super) fn place(model: &mut Gaussians, map: &DAffine3, origin: &mut Option<DVec3>) -> bool {
    // Below 0 for a map that mirrors, which is a turn and a reflection through the origin.
    let size = map.matrix3.determinant().cbrt();
    let turn = map.matrix3 * size.recip();
    if size == 0.0 || !(turn.transpose() * turn).abs_diff_eq(DMat3::IDENTITY, EVEN) {
        return false;
    }
    let far =
        || near(map.translation, size.abs() * middle(&model.means.iter().map(|m| wide(*m)).collect::<Vec<_>>()).1);
    let from = *origin.get_or_insert_with(|| if far() == DVec3::ZERO { DVec3::ZERO } else { map.translation });
    let shift = map.translation - from;
    if map.matrix3 != DMat3::IDENTITY || shift != DVec3::ZERO {
        // Only nearly orthonormal until it is a quaternion.
        let turn = DMat3::from_quat(DQuat::from_mat3(&turn).normalize());
        model.transform(turn * size.signum(), size.abs(), shift);
    }
    true
}

/// The middle of places, and their extent without the outermost twentieth at each end of each axis; places that are not finite do
/// not count.
pub(super) fn middle(places: &[DVec3]) -> (DVec3, f64) {
    let ends = |axis: usize| {
        let mut values: Vec<f64> = places.iter().map(|p| p[axis]).filter(|v| v.is_finite()).collect();
        values.sort_unstable_by(f64::total_cmp);
        let at = |share: f64| values.get((share * values.len() as f64) as usize).copied().unwrap_or_default();
        [at(0.05), at(0.5), at(0.95)]
    };
    let [x, y, z] = [ends(0), ends(1), ends(2)];
    (DVec3::new(x[1], y[1], z[1]), DVec3::new(x[2] - x[0], y[2] - y[0], z[2] - z[0]).length())
}

fn wide(mean: [f32; 3]) -> DVec3 {
    DVec3::from(mean.map(f64::from))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gaussians::sh::basis;

    #[test]
    fn a_turned_or_mirrored_model_has_its_colours_in_the_same_directions() {
        for size in [2.0, -2.0] {
            let mut model = Gaussians::zeroed(3, 3);
            for (i, value) in model.sh.iter_mut().flatten().enumerate() {
                *value = (i as f32 * 0.7).sin();
            }
            model.means[1] = [0.25, -1.0, 0.5];
            model.rotations.fill([0.5, -0.5, 0.5, 0.5]);
            let turn = DQuat::from_xyzw(0.3, -0.2, 0.6, 0.7).normalize();
            let matrix = DMat3::from_quat(turn) * size;
            let (mut turned, mut origin) = (model.clone(), Some(DVec3::ZERO));
            let map = DAffine3 { matrix3: matrix, translation: DVec3::X };
            assert!(place(&mut turned, &map, &mut origin));
            for direction in [DVec3::new(0.36, 0.48, 0.8), DVec3::new(-0.6, 0.64, 0.48)] {
                let (before, after) = (basis(direction), basis(matrix * direction / 2.0));
                for l in 0..=3 {
                    for i in 0..9 {
                        let width = Gaussians::band_width(l);
                        let colour = |m: &Gaussians, basis: &[f64]| -> f64 {
                            let row = &m.sh[l][i / 3 * width..][..width];
                            (0..=2 * l).map(|k| f64::from(row[3 * k + i % 3]) * basis[l * l + k]).sum()
                        };
                        let (a, b) = (colour(&model, &before), colour(&turned, &after));
                        assert!((a - b).abs() < 1e-6, "{size}, band {l}: {a} {b}");
                    }
                }
            }
            let axis = |m: &Gaussians| {
                let [w, x, y, z] = m.rotations[0].map(f64::from);
                DQuat::from_xyzw(x, y, z, w) * DVec3::Z
            };
            // Either end of an axis is the same ellipsoid.
            assert!((matrix * axis(&model) / size - axis(&turned)).length() < 1e-6);
            assert!((map.transform_point3(wide(model.means[1])) - wide(turned.means[1])).length() < 1e-6);
            assert_eq!(turned.log_scales[0][2], 2f32.ln());
        }
    }
}
