//! Niantic SPZ (github.com/nianticlabs/spz): 8- to 24-bit attributes, gzip (versions 1 to 3) or zstd (version 4).
//!
//! Coordinates: an SPZ file is right-up-back unless an extension says otherwise, while 3DGS PLY, and so our model, is
//! right-down-front. Both directions turn by 180 degrees about x, as the official library does when told that the
//! cloud is RDF. (Its command-line tools leave the system unspecified and turn nothing.)

mod pack;
mod unpack;

use super::Gaussians;

pub(super) use pack::pack;
pub(super) use unpack::read;

const MAGIC: u32 = u32::from_le_bytes(*b"NGSP");

/// Colours are stored as 0.15 SH + 0.5, not 0.282 SH + 0.5: headroom for values that higher bands bring back.
const COLOUR_SCALE: f32 = 0.15;

/// Right-up-back in the numbering of the coordinate-system extension.
const RIGHT_UP_BACK: u32 = 4;
/// Right-down-front.
const RIGHT_DOWN_FRONT: u32 = 6;

/// Mirrors the axes in which two coordinate systems of the unrotated family (1..=8) differ.
///
/// The number less one holds a bit an axis. Quaternions and SH follow from the parity of x, y, z in each component.
fn convert(model: &mut Gaussians, from: u32, to: u32) {
    let differ = from.wrapping_sub(1) ^ to.wrapping_sub(1);
    let [x, y, z] = [0, 1, 2].map(|axis| if differ >> axis & 1 == 1 { -1.0f32 } else { 1.0 });
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn turning_about_x_flips_the_odd_components_and_back() {
        let mut model = Gaussians::zeroed(2, 3);
        model.means[1] = [1.0, 2.0, 3.0];
        model.rotations[1] = [0.5, 0.1, 0.2, 0.3];
        model.sh.iter_mut().for_each(|band| band.fill(1.0));
        let before = model.clone();
        convert(&mut model, RIGHT_UP_BACK, RIGHT_DOWN_FRONT);
        assert_eq!(model.means[1], [1.0, -2.0, -3.0]);
        assert_eq!(model.rotations[1], [0.5, 0.1, -0.2, -0.3]);
        let red = |l: usize| model.sh[l].iter().step_by(3).skip(2 * l + 1).copied().collect::<Vec<_>>();
        assert_eq!(red(1), [-1.0, -1.0, 1.0]);
        assert_eq!(red(2), [-1.0, 1.0, 1.0, -1.0, 1.0]);
        assert_eq!(red(3), [-1.0, 1.0, -1.0, -1.0, 1.0, -1.0, 1.0]);
        convert(&mut model, RIGHT_DOWN_FRONT, RIGHT_UP_BACK);
        assert_eq!(model, before);
    }
}
