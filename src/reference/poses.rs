//! The gradient of a picture's loss by a small motion of all that its camera sees.

use super::{Params, project};
use crate::gaussians::sh;
use crate::kernels::constants::sh::float64::SH_C0;
use glam::DVec3;

/// The gradients by a turn about `centre` and by a shift, in world axes, from those by a model's parameters, drawn to
/// `sh_degree`. A turn of the camera leaves view directions, and with them colours, as they are, so what a mean's
/// gradient has from its direction is taken out of the turn.
pub fn gradient(params: &Params, by: &Params, centre: DVec3, sh_degree: usize) -> [f64; 6] {
    let (mut turn, mut shift) = (DVec3::ZERO, DVec3::ZERO);
    for i in 0..params.means.len() {
        let (from, by_mean) = (DVec3::from(params.means[i]) - centre, DVec3::from(by.means[i]));
        let direction = from.normalize_or_zero();
        turn += from.cross(by_mean) - direction.cross(by_direction(params, by, i, direction, sh_degree));
        turn += by_turn(params.rotations[i], by.rotations[i]);
        shift += by_mean;
    }
    [turn.x, turn.y, turn.z, shift.x, shift.y, shift.z]
}

/// The gradient by Gaussian `i`'s view direction: the gradient by its colour follows from that by band 0.
fn by_direction(params: &Params, by: &Params, i: usize, direction: DVec3, sh_degree: usize) -> DVec3 {
    let by_colour = DVec3::from_slice(&by.sh[0][3 * i..3 * i + 3]) / SH_C0;
    let gradients = sh::basis_gradient(direction);
    let mut sum = DVec3::ZERO;
    for l in 1..project::bands(params, sh_degree) {
        for m in 0..=2 * l {
            let at = (i * (2 * l + 1) + m) * 3;
            sum += gradients[l * l + m] * by_colour.dot(DVec3::from_slice(&params.sh[l][at..at + 3]));
        }
    }
    sum
}

/// A turn w takes the quaternion q to q + 1/2 (0, w) q.
fn by_turn([w, x, y, z]: [f64; 4], [a, b, c, d]: [f64; 4]) -> DVec3 {
    0.5 * DVec3::new(-x * a + w * b - z * c + y * d, -y * a + z * b + w * c - x * d, -z * a - y * b + x * c + w * d)
}
