//! Selection of one rotation per Gaussian among the equivalent ones.

use glam::{DMat3, DQuat};
use std::sync::LazyLock;

/// A turn of the cube, and the axis that each of its axes comes from.
type Turn = (DQuat, [usize; 3]);

/// The 24 turns of a cube onto itself.
static TURNS: LazyLock<Vec<Turn>> = LazyLock::new(|| {
    let mut turns: Vec<Turn> = Vec::new();
    for code in 0..81 {
        let part = |n: u32| f64::from(code / 3_i32.pow(n) % 3 - 1);
        let q = DQuat::from_xyzw(part(0), part(1), part(2), part(3));
        // Each turn is there twice, with both signs: one of them comes first.
        let first = [q.w, q.x, q.y, q.z].into_iter().find(|c| *c != 0.0).is_some_and(|c| c > 0.0);
        if first && [1.0, 2.0, 4.0].contains(&q.length_squared()) {
            let q = q.normalize();
            let m = DMat3::from_quat(q);
            let from = [m.x_axis, m.y_axis, m.z_axis].map(|column| column.abs().max_position());
            turns.push((q, from));
        }
    }
    turns
});

/// The rotation (w, x, y, z) that turns least among the 24 that differ by a turn of the Gaussian's own cube, and the scales in the
/// order of its axes. Its real part is the greatest, and the others are at most 0.51: fewer bits say which rotation it is. A
/// rotation of length zero, or one that is not finite, becomes the identity.
pub(super) fn least_turn(rotation: [f32; 4], scales: [f32; 3]) -> ([f64; 4], [f32; 3]) {
    let [w, x, y, z] = rotation.map(f64::from);
    let q = DQuat::from_xyzw(x, y, z, w);
    if !q.length().is_finite() || q.length() == 0.0 {
        return ([1.0, 0.0, 0.0, 0.0], scales);
    }
    let q = q.normalize();
    let mut best = (DQuat::IDENTITY, [0, 1, 2], -1.0);
    for (turn, from) in TURNS.iter() {
        let turned = q * *turn;
        if turned.w.abs() > best.2 + 1e-9 {
            best = (turned, *from, turned.w.abs());
        }
    }
    let q = if best.0.w < 0.0 { -best.0 } else { best.0 };
    ([q.w, q.x, q.y, q.z], best.1.map(|axis| scales[axis]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    fn covariance([w, x, y, z]: [f64; 4], scales: [f32; 3]) -> DMat3 {
        let axes = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize());
        let scaled = axes * DMat3::from_diagonal(DVec3::from(scales.map(|s| f64::from(s).exp())));
        scaled * scaled.transpose()
    }

    #[test]
    fn the_least_turn_is_the_same_gaussian() {
        assert_eq!(TURNS.len(), 24);
        for i in 0..500 {
            let part = |k: i32| ((i * 37 + k * 11) as f32 * 0.7).sin();
            let (rotation, scales) = ([0, 1, 2, 3].map(part), [4, 5, 6].map(part));
            let (least, turned) = least_turn(rotation, scales);
            let difference = covariance(rotation.map(f64::from), scales) - covariance(least, turned);
            assert!(difference.to_cols_array().iter().all(|d| d.abs() < 1e-5), "{rotation:?}");
            assert!(least[0] > 0.85 && least[1..].iter().all(|c| c.abs() < 0.52), "{least:?}");
        }
        assert_eq!(least_turn([0.0; 4], [1.0, 2.0, 3.0]), ([1.0, 0.0, 0.0, 0.0], [1.0, 2.0, 3.0]));
    }
}
