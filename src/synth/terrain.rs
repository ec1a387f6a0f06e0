//! A strip of a model landscape, seen by a drone that flies along it in parallel lines: houses, trees and rocks on fields. Its
//! length grows with the number of photos, so that the photos of one end show nothing of the other.
//!
//! x points along the strip. Lengths are those of the model: a house is half a metre wide.

use glam::{DVec3, Mat3, Vec2, Vec3};

use super::{
    Kind, SynthOptions,
    builder::{Builder, Ground},
    geometry::Solid,
    materials::Paint,
    noise::{cell, pick, plane_fbm, rgb, step, whole},
    random::{Random, Stream},
    sky,
};

/// Lines that the drone flies.
const LINES: usize = 3;
/// Its height over the ground.
const HEIGHT: f64 = 3.2;
/// Field of view of a photo's shorter side, in degrees.
pub(super) const FIELD: f64 = 50.0;
/// Tangent of the angle by which it looks ahead of straight down.
const AHEAD: f64 = 0.27;
/// Distance between two photos of a line: a quarter of what one shows.
const ALONG: f64 = 0.75;
/// Distance between two lines: 0.4 of what a photo shows across.
const ACROSS: f64 = 1.6;
/// Ground around the outermost cameras that has things on it.
const MARGIN: f64 = 2.6;
/// Side of the squares that hold one thing each.
const PLOT: f64 = 0.8;
/// Side of a field.
const FIELD_SIDE: f32 = 1.7;

/// Photos of a line.
fn per_line(views: usize) -> usize {
    views.div_ceil(LINES)
}

/// Half the length of the drone's lines.
fn half_length(views: usize) -> f64 {
    0.5 * ALONG * per_line(views).saturating_sub(1) as f64
}

/// Position, target and up direction of photo `i`. The drone flies along parallel lines, back and forth.
pub(super) fn pose(options: &SynthOptions, i: usize) -> [DVec3; 3] {
    let mut random = Random::new(options.seed, Stream::Path, i as u64);
    let mut jitter = |size: f64| random.between(-size, size);
    let (line, step) = (i / per_line(options.views), i % per_line(options.views));
    let back = line % 2 == 1;
    let along = ALONG * step as f64 - half_length(options.views);
    let x = if back { -along } else { along };
    let y = ACROSS * (line as f64 - 0.5 * (LINES - 1) as f64);
    let eye = DVec3::new(x + jitter(0.08), y + jitter(0.08), HEIGHT * (1.0 + jitter(0.03)));
    let ahead = if back { DVec3::NEG_X } else { DVec3::X };
    let gaze = DVec3::NEG_Z + ahead * (AHEAD + jitter(0.03)) + DVec3::Y * jitter(0.03);
    [eye, eye + gaze * HEIGHT, ahead + DVec3::Y * jitter(0.03)]
}

/// Puts the landscape's things; returns its ground.
pub(super) fn build(b: &mut Builder, options: &SynthOptions) -> Ground {
    let half =
        Vec2::new((half_length(options.views) + MARGIN) as f32, (0.5 * ACROSS * (LINES - 1) as f64 + MARGIN) as f32);
    let [columns, rows] = [half.x, half.y].map(|h| (2.0 * f64::from(h) / PLOT).ceil() as u64);
    hills(b, options.seed, half);
    for plot in 0..columns * rows {
        let mut random = Random::new(options.seed, Stream::Scatter, 16 + plot);
        let place = |cell: u64, half: f32, within: f64| (cell as f64 + 0.5 + within) * PLOT - f64::from(half);
        let shift = [random.between(-0.2, 0.2), random.between(-0.2, 0.2)];
        let (x, y) = (place(plot % columns, half.x, shift[0]), place(plot / columns, half.y, shift[1]));
        let at = Vec3::new(x as f32, y as f32, 0.0);
        match random.unit() {
            t if t < 0.16 => house(b, &mut random, at),
            t if t < 0.52 => tree(b, &mut random, at),
            t if t < 0.60 => rock(b, &mut random, at),
            t if t < 0.66 => silo(b, &mut random, at),
            t if t < 0.72 => pole(b, at),
            _ => {}
        }
    }
    let far = half.length();
    Ground { kind: Kind::Terrain, dome: sky::DOME.max(4.0 * far), shadows: f32::INFINITY, walls: f32::INFINITY }
}

/// Low hills: caps of large balls, one every few metres.
fn hills(b: &mut Builder, seed: u64, half: Vec2) {
    let mut random = Random::new(seed, Stream::Scatter, 2);
    for i in 0..(half.x / 2.0).ceil() as u32 {
        let (radius, height) = (random.between(2.0, 5.0) as f32, random.between(0.08, 0.3) as f32);
        let y = random.between(f64::from(-half.y), f64::from(half.y)) as f32;
        let x = -half.x + 4.0 * (i as f32 + random.unit() as f32);
        b.put(Solid::Sphere { centre: Vec3::new(x, y, height - radius), radius }, Paint::Stone(0x7d9150));
    }
}

fn house(b: &mut Builder, random: &mut Random, at: Vec3) {
    let turn = (random.between(-25.0, 25.0) + if random.unit() < 0.5 { 90.0 } else { 0.0 }) as f32;
    let half = Vec3::new(random.between(0.2, 0.32) as f32, random.between(0.13, 0.19) as f32, 0.13);
    let paint = match random.unit() {
        t if t < 0.4 => Paint::Brick,
        t if t < 0.7 => Paint::Planks(half),
        _ => Paint::Stone(0xd9cfbb),
    };
    b.put(Solid::block(at.with_z(half.z), half, turn), paint);
    // A beam turned by 45 degrees about its length is a gable roof.
    let axes = Mat3::from_rotation_z(turn.to_radians()) * Mat3::from_rotation_x(std::f32::consts::FRAC_PI_4);
    let side = half.y * 0.75;
    let roof = Solid::Block { centre: at.with_z(2.0 * half.z), half: Vec3::new(half.x + 0.03, side, side), axes };
    let tiles = [(0xa8482f, 0x8d3a28), (0x5b6470, 0x49515c), (0x8a6a45, 0x75583a)];
    let (light, dark) = tiles[(random.unit() * 3.0) as usize % 3];
    b.put(roof, Paint::Bands(light, dark, 0.035));
}

fn tree(b: &mut Builder, random: &mut Random, at: Vec3) {
    let height = random.between(0.2, 0.5) as f32;
    b.put(Solid::rod(at, at.with_z(height), 0.025), Paint::Plain(rgb(0x5f4530)));
    let greens = [0x4d7a2e, 0x6b9a3a, 0x3d6a30, 0x86ab45, 0xa58a3c];
    let tone = random.unit() as f32;
    for _ in 0..7 {
        let offset = [0.12, 0.12, 0.1].map(|size| random.between(-size, size) as f32);
        let radius = random.between(0.06, 0.12) as f32;
        let green = pick(&greens, (tone + 0.3 * random.unit() as f32).fract());
        let centre = at.with_z(height) + Vec3::from_array(offset);
        b.put(Solid::Sphere { centre, radius }, Paint::Plain(green));
    }
}

fn rock(b: &mut Builder, random: &mut Random, at: Vec3) {
    for _ in 0..3 {
        let offset = [0.15, 0.15].map(|size| random.between(-size, size) as f32);
        let radius = random.between(0.05, 0.14) as f32;
        let centre = at + Vec3::new(offset[0], offset[1], 0.3 * radius);
        b.put(Solid::Sphere { centre, radius }, Paint::Stone(0x9a948c));
    }
}

fn silo(b: &mut Builder, random: &mut Random, at: Vec3) {
    let (radius, height) = (random.between(0.12, 0.2) as f32, random.between(0.2, 0.5) as f32);
    b.put(Solid::Cylinder { base: at, radius, height }, Paint::Bands(0xd8d2c4, 0x8f98a3, 0.06));
    b.put(Solid::Sphere { centre: at.with_z(height), radius: 0.9 * radius }, Paint::Ball);
}

fn pole(b: &mut Builder, at: Vec3) {
    b.thin(Solid::rod(at, at.with_z(0.6), 0.012), 0xe6e2da);
    b.put(Solid::Sphere { centre: at.with_z(0.62), radius: 0.05 }, Paint::Plain(rgb(0xd8432f)));
}

/// Albedo of the ground: fields with furrows, each in its own colour and direction, and paths between them.
pub(super) fn ground(p: Vec3) -> Vec3 {
    let q = Vec2::new(p.x, p.y) / FIELD_SIDE + 0.25 * plane_fbm(Vec2::new(p.x, p.y) * 0.7, 60, 2);
    let (x, y) = (whole(q.x), whole(q.y));
    let within = (q - Vec2::new(x as f32, y as f32)) * FIELD_SIDE;
    let crops = [0x6d8f3d, 0xb7a04e, 0x55803a, 0x8d7350, 0x93a857, 0xc4b26a];
    let crop = pick(&crops, cell(x, y, 71));
    let across = if cell(x, y, 72) < 0.5 { within.x } else { within.y };
    let spacing = 0.07 + 0.06 * cell(x, y, 73);
    let furrow = (across / spacing - (across / spacing).floor() - 0.5).abs() * 2.0;
    let grain = plane_fbm(Vec2::new(p.x, p.y) * 11.0, 80, 3);
    let field = crop * (0.6 + 0.5 * grain + 0.3 * step(0.2, 0.8, furrow));
    let edge = within.min(Vec2::splat(FIELD_SIDE) - within).min_element();
    let path = rgb(0xb9a98a) * (0.75 + 0.5 * plane_fbm(Vec2::new(p.x, p.y) * 30.0, 90, 2));
    path.lerp(field, step(0.04, 0.07, edge))
}
