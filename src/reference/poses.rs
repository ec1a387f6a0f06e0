//! The gradient of a picture's loss by a small motion of all that its camera sees.

use super::Params;
use glam::DVec3;

/// From the gradients by a model's parameters: the gradient by a turn about `centre` and the one by a shift, in world
/// axes. A turn moves means and axes; directions, and with them colours, stay as they are, but the part of a mean's
/// gradient that comes from its direction cannot be told from the rest and counts as well.
pub fn gradient(params: &Params, by: &Params, centre: DVec3) -> [f64; 6] {
    let (mut turn, mut shift) = (DVec3::ZERO, DVec3::ZERO);
    for i in 0..params.means.len() {
        let by_mean = DVec3::from(by.means[i]);
        turn += (DVec3::from(params.means[i]) - centre).cross(by_mean) + by_turn(params.rotations[i], by.rotations[i]);
        shift += by_mean;
    }
    [turn.x, turn.y, turn.z, shift.x, shift.y, shift.z]
}

/// A turn w takes the quaternion q to q + 1/2 (0, w) q.
fn by_turn([w, x, y, z]: [f64; 4], [a, b, c, d]: [f64; 4]) -> DVec3 {
    0.5 * DVec3::new(-x * a + w * b - z * c + y * d, -y * a + z * b + w * c - x * d, -z * a - y * b + x * c + w * d)
}
