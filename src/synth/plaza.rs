//! The embedded scene: the objects on the plaza.

use std::f32::consts::TAU;

use glam::{Mat3, Vec3};

use super::{
    builder::{Builder, Surface},
    geometry::Solid,
    materials::{Gloss, Paint},
    noise::{pick, rgb},
    random::{Random, Stream},
};

/// The polish of the one glossy object.
const ENAMEL: Gloss = Gloss { f0: 0.16, shininess: 180.0 };
/// Puts everything that stands on the plaza.
pub(super) fn build(b: &mut Builder, seed: u64) {
    glossy_sphere(b);
    buildings(b);
    bush(b, seed);
    wheel(b);
    fence(b);
    pennant(b);
    marbles(b, seed);
}

/// The one glossy object, on its plinth.
fn glossy_sphere(b: &mut Builder) {
    b.put(Solid::Cylinder { base: Vec3::ZERO, radius: 0.62, height: 0.12 }, Paint::Stone(0xb9ad9a));
    b.put(Solid::Cylinder { base: Vec3::Z * 0.12, radius: 0.46, height: 0.24 }, Paint::Bands(0xd8cfbd, 0x8c8377, 0.06));
    let sphere = Solid::Sphere { centre: Vec3::new(0.0, 0.0, 0.97), radius: 0.63 };
    b.solids.push(sphere);
    b.surfaces.push(Surface { paint: Paint::Plain(rgb(0x8e1f2f)), gloss: Some(ENAMEL), thin: false });
}

/// Brick wall, crates, the sign, the large balls.
fn buildings(b: &mut Builder) {
    let wall = Vec3::new(-1.25, 0.95, 0.45);
    b.put(Solid::block(wall, Vec3::new(0.72, 0.13, 0.45), 38.0), Paint::Brick);
    b.put(Solid::block(wall.with_z(0.93), Vec3::new(0.77, 0.17, 0.035), 38.0), Paint::Stone(0xc8bca6));
    let crate_half = Vec3::splat(0.34);
    b.put(Solid::block(Vec3::new(1.3, 0.85, 0.34), crate_half, 22.0), Paint::Planks(crate_half));
    let small_half = Vec3::splat(0.21);
    b.put(Solid::block(Vec3::new(1.25, 0.9, 0.89), small_half, 55.0), Paint::Planks(small_half));
    let flat_half = Vec3::new(0.3, 0.2, 0.12);
    b.put(Solid::block(Vec3::new(0.75, 1.35, 0.12), flat_half, -20.0), Paint::Planks(flat_half));
    b.put(Solid::Sphere { centre: Vec3::new(0.45, -1.4, 0.46), radius: 0.46 }, Paint::Marble(0x1d6f78, 0x9fd0c0));
    b.put(Solid::Sphere { centre: Vec3::new(-0.55, -1.35, 0.32), radius: 0.32 }, Paint::Ball);
    let half = Vec3::new(0.55, 0.03, 0.2);
    let axes = Mat3::from_rotation_z(14f32.to_radians()) * Mat3::from_rotation_x(-0.12);
    let centre = Vec3::new(-0.25, 1.6, 0.85);
    b.solids.push(Solid::Block { centre, half, axes });
    b.surfaces.push(Surface { paint: Paint::Sign(half), gloss: None, thin: false });
    for side in [-0.4, 0.4] {
        // The heads lie inside the board, so that they hide no letter.
        let head = centre + axes * Vec3::new(side, 0.0, 0.0);
        b.put(Solid::rod(head.with_z(0.0), head, 0.026), Paint::Plain(rgb(0x5a4026)));
    }
}

/// A pot with a bush of many small leaves and a few fruits.
fn bush(b: &mut Builder, seed: u64) {
    let base = Vec3::new(-1.5, -0.6, 0.0);
    b.put(Solid::Cylinder { base, radius: 0.24, height: 0.36 }, Paint::Pot);
    b.put(Solid::Cylinder { base: base.with_z(0.34), radius: 0.27, height: 0.06 }, Paint::Plain(rgb(0xb8623c)));
    b.put(Solid::rod(base.with_z(0.38), base.with_z(0.7), 0.035), Paint::Plain(rgb(0x5f4530)));
    let mut random = Random::new(seed, Stream::Scatter, 0);
    for i in 0..90 {
        let z = random.between(-0.95, 1.0) as f32;
        let turn = random.unit() as f32 * TAU;
        let side = (1.0 - z * z).sqrt();
        let reach = random.between(0.24, 0.42) as f32;
        let centre = base.with_z(0.95) + Vec3::new(side * turn.cos(), side * turn.sin(), z) * reach;
        let fruit = i % 12 == 0;
        let radius = if fruit { 0.045 } else { random.between(0.045, 0.1) as f32 };
        let green = pick(&[0x4d7a2e, 0x6b9a3a, 0x3d6a30, 0x86ab45, 0x587f2a], random.unit() as f32);
        b.put(Solid::Sphere { centre, radius }, Paint::Plain(if fruit { rgb(0xe8842a) } else { green }));
    }
}

/// A wheel of wire: rims, hub and spokes thinner than a pixel or about as thin.
fn wheel(b: &mut Builder) {
    let centre = Vec3::new(1.55, -0.62, 0.74);
    let axle = Vec3::new(0.72, -0.66, 0.0).normalize();
    let across = Vec3::Z.cross(axle);
    let at = |turn: f32, radius: f32| centre + (across * turn.cos() + Vec3::Z * turn.sin()) * radius;
    for i in 0..40 {
        let (from, to) = (i as f32 / 40.0 * TAU, (i + 1) as f32 / 40.0 * TAU);
        b.thin(Solid::rod(at(from, 0.7), at(to, 0.7), 0.022), 0x3a3f4a);
        if i % 2 == 0 {
            let to = (i + 2) as f32 / 40.0 * TAU;
            b.thin(Solid::rod(at(from, 0.42), at(to, 0.42), 0.011), 0xd9a441);
        }
    }
    for i in 0..20 {
        let turn = i as f32 / 20.0 * TAU;
        let side = if i % 2 == 0 { 0.07 } else { -0.07 };
        b.thin(Solid::rod(centre + axle * side, at(turn, 0.7), 0.011), if i % 5 == 0 { 0xc0392b } else { 0xc9ccd2 });
    }
    b.thin(Solid::rod(centre - axle * 0.12, centre + axle * 0.12, 0.05), 0x3a3f4a);
    for side in [-0.12f32, 0.12] {
        for lean in [-0.3f32, 0.3] {
            let foot = (centre + axle * side * 2.2 + across * lean).with_z(0.0);
            b.thin(Solid::rod(foot, centre + axle * side, 0.018), 0x6d4a2f);
        }
    }
}

/// An arc of fence at the plaza's rim: posts, two rails and a picket every few degrees.
fn fence(b: &mut Builder) {
    let at = |degrees: f32, z: f32| {
        let turn = degrees.to_radians();
        Vec3::new(2.6 * turn.cos(), 2.6 * turn.sin(), z)
    };
    for panel in 0..4 {
        let (from, to) = (62.0 + 24.0 * panel as f32, 86.0 + 24.0 * panel as f32);
        for z in [0.16, 0.46] {
            b.thin(Solid::rod(at(from, z), at(to, z), 0.014), 0xe9e4d6);
        }
        for picket in 1..8 {
            // Pickets stand on the chord between the posts, as the rails do.
            let foot = at(from, 0.0).lerp(at(to, 0.0), picket as f32 / 8.0);
            b.thin(Solid::rod(foot, foot.with_z(0.58), 0.013), 0xf3efe4);
        }
    }
    for post in 0..5 {
        let foot = at(62.0 + 24.0 * post as f32, 0.0);
        b.put(Solid::rod(foot, foot.with_z(0.68), 0.038), Paint::Plain(rgb(0x7a5636)));
    }
}

/// A pole with a striped pennant.
fn pennant(b: &mut Builder) {
    let foot = Vec3::new(0.35, 0.75, 0.0);
    b.thin(Solid::rod(foot, foot.with_z(2.15), 0.016), 0xe6e2da);
    let axes = Mat3::from_rotation_z(-0.5) * Mat3::from_rotation_y(std::f32::consts::FRAC_PI_2);
    let half = Vec3::new(0.14, 0.012, 0.26);
    let centre = foot.with_z(1.98) + axes * Vec3::new(0.0, 0.0, 0.27);
    b.put(Solid::Block { centre, half, axes }, Paint::Bands(0xf2b632, 0x2f5f9e, 0.075));
}

/// Small balls strewn over the plaza, clear of the larger objects.
fn marbles(b: &mut Builder, seed: u64) {
    let fixed = b.solids.len();
    let mut random = Random::new(seed, Stream::Scatter, 1);
    let mut placed = 0;
    for _ in 0..400 {
        let radius = random.between(0.05, 0.12) as f32;
        let (reach, turn) = (random.between(0.8, 2.3) as f32, random.unit() as f32 * TAU);
        let tone = random.unit() as f32;
        let centre = Vec3::new(reach * turn.cos(), reach * turn.sin(), radius);
        let clearance =
            if b.solids[..fixed].iter().all(|s| s.distance(centre) > radius + 0.05) { 0.02 } else { f32::MAX };
        if placed < 14 && b.solids[fixed..].iter().all(|s| s.distance(centre) > radius + clearance) && clearance < 1.0 {
            let paint = match placed % 3 {
                0 => Paint::Marble(0xd9762e, 0xf2d08a),
                1 => Paint::Plain(pick(&[0x3f6fb5, 0xe0b83c, 0xc94f6d, 0x58a06a], tone)),
                _ => Paint::Stone(0x9a8fb0),
            };
            b.put(Solid::Sphere { centre, radius }, paint);
            placed += 1;
        }
    }
}

/// The moving object: a little matte figure that stands at `foot`.
pub(super) fn mover(foot: Vec3) -> Vec<(Solid, Paint)> {
    vec![
        (Solid::rod(foot.with_z(0.2), foot.with_z(0.55), 0.2), Paint::Bands(0xd0359a, 0xf7e04a, 0.12)),
        (Solid::Sphere { centre: foot.with_z(0.9), radius: 0.15 }, Paint::Plain(rgb(0xf0c9a0))),
    ]
}
