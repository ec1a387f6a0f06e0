//! Axis conventions, and conversions of models between them.

use super::Gaussians;
use glam::DVec3;

/// Right-up-back: SPZ, OpenGL.
pub(super) const RIGHT_UP_BACK: u32 = 4;
/// Right-down-front: 3DGS PLY, COLMAP, and so our model.
pub(super) const RIGHT_DOWN_FRONT: u32 = 6;
/// Left-up-front: glTF.
pub(super) const LEFT_UP_FRONT: u32 = 7;

/// Mirrors the axes in which two coordinate systems of the unrotated family (1..=8) differ.
///
/// Numbers are those of SPZ's extension: the number minus one has one bit per axis. Quaternions and SH follow from the
/// parity of x, y, z in each component.
pub(super) fn convert(model: &mut Gaussians, from: u32, to: u32) {
    let [x, y, z] = signs(from, to);
    if [x, y, z] == [1.0; 3] {
        return;
    }
    let sh: [&[f32]; 4] = [&[1.0], &[y, z, x], &[x * y, y * z, 1.0, x * z, 1.0], &[y, x * y * z, y, z, x, z, x]];
    for mean in &mut model.means {
        *mean = [mean[0] * x, mean[1] * y, mean[2] * z];
    }
    for q in &mut model.rotations {
        *q = [q[0], q[1] * y * z, q[2] * x * z, q[3] * x * y];
    }
    for (band, signs) in model.sh.iter_mut().zip(sh) {
        for (coefficient, sign) in band.chunks_exact_mut(3).zip(signs.iter().cycle()) {
            for value in coefficient {
                *value *= sign;
            }
        }
    }
}

/// A place in the other axes.
pub(super) fn convert_place(place: DVec3, from: u32, to: u32) -> DVec3 {
    place * DVec3::from(signs(from, to).map(f64::from)) + DVec3::ZERO // no minus zeros
}

/// 1 or -1 by axis.
fn signs(from: u32, to: u32) -> [f32; 3] {
    let differ = from.wrapping_sub(1) ^ to.wrapping_sub(1);
    [0, 1, 2].map(|axis| if differ >> axis & 1 == 1 { -1.0 } else { 1.0 })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gaussians::sh::basis;

    #[test]
    fn a_mirrored_model_looks_the_same_from_the_mirrored_side() {
        let mut model = Gaussians::zeroed(2, 3);
        for (i, value) in model.sh.iter_mut().flatten().enumerate() {
            *value = (i as f32 * 0.7).sin();
        }
        for to in 1..=8u32 {
            let differ = (RIGHT_UP_BACK - 1) ^ (to - 1);
            let turn = |v: [f32; 3]| [0, 1, 2].map(|a: usize| if differ >> a & 1 == 1 { -v[a] } else { v[a] });
            let mut turned = model.clone();
            turned.means[1] = [1.0, 2.0, 3.0];
            convert(&mut turned, RIGHT_UP_BACK, to);
            assert_eq!(turned.means[1], turn([1.0, 2.0, 3.0]));
            let colour = |m: &Gaussians, l: usize, direction: [f32; 3]| -> f64 {
                let red = m.sh[l].iter().skip(Gaussians::band_width(l)).step_by(3);
                let basis = basis(DVec3::from(direction.map(f64::from)));
                red.zip(&basis[l * l..]).map(|(c, b)| f64::from(*c) * b).sum()
            };
            for l in 0..=3 {
                for direction in [[0.36, 0.48, 0.8f32], [-0.6, 0.64, 0.48]] {
                    assert_eq!(colour(&model, l, direction), colour(&turned, l, turn(direction)), "band {l} to {to}");
                }
            }
            convert(&mut turned, to, RIGHT_UP_BACK);
            assert_eq!(turned.sh, model.sh);
        }
    }

    #[test]
    fn a_turn_about_x_turns_the_quaternion_with_it() {
        let mut model = Gaussians::zeroed(1, 0);
        model.rotations[0] = [0.5, 0.1, 0.2, 0.3];
        convert(&mut model, RIGHT_UP_BACK, RIGHT_DOWN_FRONT);
        assert_eq!(model.rotations[0], [0.5, 0.1, -0.2, -0.3]);
    }
}
