//! Value noise and other parts of procedural textures.

use glam::{Vec2, Vec3};

/// A number in [0, 1) for a cell of the integer lattice.
pub(super) fn cell(x: i32, y: i32, z: i32) -> f32 {
    let mut h = (x as u32).wrapping_mul(0x8da6_b343) ^ (y as u32).wrapping_mul(0xd816_3841);
    h ^= (z as u32).wrapping_mul(0xcb1a_b31f);
    h = (h ^ (h >> 15)).wrapping_mul(0x2c1b_3c6d);
    h = (h ^ (h >> 12)).wrapping_mul(0x297a_2d39);
    ((h ^ (h >> 15)) >> 8) as f32 * (-24f32).exp2()
}

/// The cell that contains `x`; `f32::floor` is a call into the C library where the CPU's baseline has no such
/// instruction.
pub(super) fn whole(x: f32) -> i32 {
    let cut = x as i32;
    cut.wrapping_sub(i32::from(cut as f32 > x))
}

/// Smooth value noise in [0, 1), one cell per unit.
pub(super) fn noise(p: Vec3) -> f32 {
    let (x, y, z) = (whole(p.x), whole(p.y), whole(p.z));
    let f = p - Vec3::new(x as f32, y as f32, z as f32);
    let u = f * f * (3.0 - 2.0 * f);
    let edge = |dy: i32, dz: i32| {
        let a = cell(x, y.wrapping_add(dy), z.wrapping_add(dz));
        a + (cell(x.wrapping_add(1), y.wrapping_add(dy), z.wrapping_add(dz)) - a) * u.x
    };
    let face = |dz: i32| {
        let a = edge(0, dz);
        a + (edge(1, dz) - a) * u.y
    };
    let a = face(0);
    a + (face(1) - a) * u.z
}

/// Smooth value noise in the plane, in [0, 1), one cell per unit, at half the cost of [`noise`].
fn plane_noise(p: Vec2, layer: i32) -> f32 {
    let (x, y) = (whole(p.x), whole(p.y));
    let f = p - Vec2::new(x as f32, y as f32);
    let u = f * f * (3.0 - 2.0 * f);
    let edge = |dy: i32| {
        let a = cell(x, y.wrapping_add(dy), layer);
        a + (cell(x.wrapping_add(1), y.wrapping_add(dy), layer) - a) * u.x
    };
    let a = edge(0);
    a + (edge(1) - a) * u.y
}

/// [`fbm`] in the plane; `layer` separates textures.
pub(super) fn plane_fbm(mut p: Vec2, layer: i32, octaves: u32) -> f32 {
    let (mut sum, mut weight, mut total) = (0.0, 0.5, 0.0);
    for octave in 0..octaves {
        sum += weight * plane_noise(p, layer + octave as i32);
        total += weight;
        weight *= 0.5;
        p *= 2.03;
    }
    sum / total
}

/// Sum of `octaves` of noise, each twice as fine and half as strong as the last; about [0, 1], mean 0.5.
pub(super) fn fbm(mut p: Vec3, octaves: u32) -> f32 {
    let (mut sum, mut weight, mut total) = (0.0, 0.5, 0.0);
    for _ in 0..octaves {
        sum += weight * noise(p);
        total += weight;
        weight *= 0.5;
        // Shifted as well as scaled, so that the lattices do not line up at the origin.
        p = p * 2.03 + Vec3::new(17.1, 5.3, 9.7);
    }
    sum / total
}

/// 0 below `low`, 1 above `high`, smooth between.
pub(super) fn step(low: f32, high: f32, x: f32) -> f32 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Linear light of a colour given as 0xRRGGBB in sRGB.
pub(super) fn rgb(hex: u32) -> Vec3 {
    // The square is near enough to sRGB's curve for paints chosen by eye.
    let channel = |shift: u32| (((hex >> shift) & 255) as f32 / 255.0).powi(2);
    Vec3::new(channel(16), channel(8), channel(0))
}

/// One of the paints, chosen by `t` in [0, 1).
pub(super) fn pick(paints: &[u32], t: f32) -> Vec3 {
    let i = ((t * paints.len() as f32) as usize).min(paints.len().saturating_sub(1));
    paints.get(i).map_or(Vec3::ONE, |&p| rgb(p))
}
