//! Rotation, scaling and translation of Gaussians, including spherical harmonics.

use glam::{DMat3, DQuat, DVec3};
use rayon::prelude::*;

use super::Gaussians;
use crate::gaussians::BandRotations;

/// Applies x -> size * turn x + shift.
pub(super) fn similarity(model: &mut Gaussians, size: f64, turn: DQuat, shift: DVec3) {
    let grown = size.ln();
    let moved = |mean: &mut [f32; 3]| {
        let at = DVec3::from(mean.map(f64::from));
        *mean = (turn * (at * size) + shift).to_array().map(|x| x as f32);
    };
    model.means.par_iter_mut().for_each(moved);
    model.log_scales.as_flattened_mut().par_iter_mut().for_each(|s| *s = (f64::from(*s) + grown) as f32);
    if turn == DQuat::IDENTITY {
        return;
    }
    model.rotations.par_iter_mut().for_each(|q| {
        let [w, x, y, z] = q.map(f64::from);
        let turned = turn * DQuat::from_xyzw(x, y, z, w);
        *q = [turned.w, turned.x, turned.y, turned.z].map(|c| c as f32);
    });
    BandRotations::new(DMat3::from_quat(turn)).apply(&mut model.sh);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gaussians::sh::basis;

    #[test]
    fn a_turned_model_has_its_colours_in_turned_directions() {
        let mut model = Gaussians::zeroed(3, 3);
        for (i, value) in model.sh.iter_mut().flatten().enumerate() {
            *value = (i as f32 * 0.7).sin();
        }
        model.rotations.fill([0.5, -0.5, 0.5, 0.5]);
        let turn = DQuat::from_xyzw(0.3, -0.2, 0.6, 0.7).normalize();
        let mut turned = model.clone();
        similarity(&mut turned, 2.0, turn, DVec3::new(1.0, 0.0, 0.0));
        for direction in [DVec3::new(0.36, 0.48, 0.8), DVec3::new(-0.6, 0.64, 0.48)] {
            let (before, after) = (basis(direction), basis(turn * direction));
            for l in 0..=3 {
                for i in 0..9 {
                    let width = Gaussians::band_width(l);
                    let colour = |m: &Gaussians, basis: &[f64]| -> f64 {
                        let row = &m.sh[l][i / 3 * width..][..width];
                        (0..=2 * l).map(|k| f64::from(row[3 * k + i % 3]) * basis[l * l + k]).sum()
                    };
                    let (a, b) = (colour(&model, &before), colour(&turned, &after));
                    assert!((a - b).abs() < 1e-6, "band {l}: {a} {b}");
                }
            }
        }
        let axis = |m: &Gaussians| {
            let [w, x, y, z] = m.rotations[0].map(f64::from);
            DQuat::from_xyzw(x, y, z, w) * DVec3::Z
        };
        assert!((turn * axis(&model) - axis(&turned)).length() < 1e-6);
        assert_eq!((turned.means[1], turned.log_scales[0][2]), ([1.0, 0.0, 0.0], 2f32.ln()));
    }
}
