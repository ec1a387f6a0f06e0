//! Paints of surfaces: albedo in linear light as a function of position.

use std::f32::consts::{PI, TAU};

use glam::{Vec2, Vec3};

use super::noise::{cell, fbm, noise, pick, plane_fbm, rgb, step, whole};

/// Radius of the paved plaza in metres; grass lies beyond.
pub(super) const PLAZA: f32 = 3.4;

/// A painting, evaluated in the solid's own coordinates.
#[derive(Clone, Copy, Debug)]
pub(super) enum Paint {
    /// One colour, slightly uneven.
    Plain(Vec3),
    /// Courses of bricks with mortar.
    Brick,
    /// Boards with grain, dark towards the block's edges; half extents in metres.
    Planks(Vec3),
    /// Swirls of two colours with light veins.
    Marble(u32, u32),
    /// Coloured gores from pole to pole.
    Ball,
    /// Speckled stone.
    Stone(u32),
    /// Bands along the z axis of the given height in metres.
    Bands(u32, u32, f32),
    /// White letters on a painted board, on both broad faces; half extents in metres.
    Sign(Vec3),
    /// Terracotta with a light zigzag.
    Pot,
}

/// Reflection of a surface: Fresnel reflection and a Blinn-Phong highlight.
#[derive(Clone, Copy, Debug)]
pub(super) struct Gloss {
    /// Reflectance at normal incidence.
    pub f0: f32,
    /// Blinn-Phong exponent.
    pub shininess: f32,
}

impl Paint {
    /// Albedo at a point of the surface and its normal, both in the solid's coordinates.
    pub fn albedo(self, p: Vec3, normal: Vec3) -> Vec3 {
        match self {
            Self::Plain(colour) => colour * (0.9 + 0.2 * noise(p * 23.0)),
            Self::Brick => brick(p, normal),
            Self::Planks(half) => planks(p, normal, half),
            Self::Marble(a, b) => marble(p, a, b),
            Self::Ball => ball(p),
            Self::Stone(colour) => {
                let grain = fbm(p * 14.0, 3);
                let specks = step(0.72, 0.8, noise(p * 60.0));
                rgb(colour) * (0.6 + 0.8 * grain) * (1.0 - 0.45 * specks)
            }
            Self::Bands(a, b, height) => {
                let s = (p.z / height).rem_euclid(2.0);
                rgb(if s < 1.0 { a } else { b }) * (0.9 + 0.2 * noise(p * 30.0))
            }
            Self::Sign(half) => sign(p, normal, half),
            Self::Pot => {
                let turn = p.y.atan2(p.x) / TAU * 14.0;
                let zigzag = 0.2 + 0.06 * ((turn.rem_euclid(1.0) - 0.5).abs() * 2.0);
                let line = step(0.022, 0.012, (p.z - zigzag).abs());
                let clay = rgb(0xb8623c) * (0.75 + 0.5 * fbm(p * 18.0, 2));
                clay.lerp(rgb(0xf0dcb8), line)
            }
        }
    }
}

/// Coordinates on the face of a block that `normal` belongs to: horizontal, vertical.
fn face(p: Vec3, normal: Vec3) -> Vec2 {
    let a = normal.abs();
    if a.x > 0.5 {
        Vec2::new(p.y, p.z)
    } else if a.y > 0.5 {
        Vec2::new(p.x, p.z)
    } else {
        Vec2::new(p.x, p.y)
    }
}

fn brick(p: Vec3, normal: Vec3) -> Vec3 {
    const LENGTH: f32 = 0.21;
    const HEIGHT: f32 = 0.085;
    let q = face(p, normal) + Vec2::splat(10.0);
    let course = (q.y / HEIGHT).floor();
    let along = q.x / LENGTH + if course.rem_euclid(2.0) < 1.0 { 0.5 } else { 0.0 };
    let (u, v) = ((along - along.floor()) * LENGTH, q.y - course * HEIGHT);
    let edge = u.min(LENGTH - u).min(v.min(HEIGHT - v));
    let tone = cell(along.floor() as i32, course as i32, (normal.x.abs() * 3.0) as i32);
    let clay = pick(&[0xa8452f, 0xb9583c, 0x94402e, 0xc46a48, 0x7d3a30, 0xb04c34], tone);
    let rough = 0.7 + 0.6 * fbm(p * 26.0, 2);
    (rgb(0xcfc4b2) * (0.85 + 0.3 * noise(p * 50.0))).lerp(clay * rough, step(0.005, 0.013, edge))
}

fn planks(p: Vec3, normal: Vec3, half: Vec3) -> Vec3 {
    const WIDTH: f32 = 0.16;
    let q = face(p, normal);
    let limit = face(half, normal);
    let board = (q.y / WIDTH + 0.5).floor();
    let within = (q.y / WIDTH + 0.5 - board - 0.5).abs() * WIDTH;
    let tone = cell(board as i32, (normal.dot(Vec3::new(1.0, 2.0, 3.0)) * 2.0) as i32, 7);
    let grain = noise(Vec3::new(q.x * 5.0 + 9.0 * tone, q.y * 70.0, 3.0 * tone + normal.x * 4.0));
    let rings = (q.x * 3.0 + 6.0 * noise(Vec3::new(q.x * 2.0, q.y * 9.0, tone * 31.0))).sin();
    let wood = rgb(0xb98a55) * (0.62 + 0.35 * tone + 0.3 * grain + 0.08 * rings);
    let gap = step(0.5 * WIDTH - 0.012, 0.5 * WIDTH - 0.004, within);
    let frame = (limit - q.abs()).min_element();
    let framed = if frame < 0.06 { rgb(0x8a5a30) * (0.75 + 0.5 * noise(p * 40.0)) } else { wood * (1.0 - 0.75 * gap) };
    framed * (0.45 + 0.55 * step(0.0, 0.006, (frame - 0.06).abs()))
}

fn marble(p: Vec3, a: u32, b: u32) -> Vec3 {
    let warp = Vec3::new(fbm(p * 2.3, 3), fbm(p * 2.3 + 11.0, 3), fbm(p * 2.3 + 23.0, 3));
    let swirl = fbm(p * 1.6 + warp * 3.2, 3);
    let vein = 1.0 - step(0.0, 0.05, (swirl - 0.5).abs());
    rgb(a).lerp(rgb(b), step(0.32, 0.68, swirl)).lerp(rgb(0xf6efdf), 0.85 * vein)
}

fn ball(p: Vec3) -> Vec3 {
    // Tilted, so that the poles show.
    let q = Vec3::new(p.x, 0.8 * p.y - 0.6 * p.z, 0.6 * p.y + 0.8 * p.z).normalize_or(Vec3::Z);
    let gore = (q.y.atan2(q.x) / TAU + 0.5) * 8.0;
    let cap = step(0.955, 0.965, q.z.abs());
    let paint = [0xd8432f, 0xf4f0e4, 0x2f6fb0, 0xf2b632, 0xf4f0e4, 0x3c9a5f, 0xd8432f, 0xf2b632];
    rgb(paint[(gore as usize).min(7)]).lerp(rgb(0xf4f0e4), cap)
}

fn sign(p: Vec3, normal: Vec3, half: Vec3) -> Vec3 {
    /// Q, I, R, F: five columns by seven rows, the upper row first, the leftmost column in bit 4.
    const LETTERS: [[u8; 7]; 4] = [
        [0b01110, 0b10001, 0b10001, 0b10001, 0b10101, 0b10010, 0b01101],
        [0b01110, 0b00100, 0b00100, 0b00100, 0b00100, 0b00100, 0b01110],
        [0b11110, 0b10001, 0b10001, 0b11110, 0b10100, 0b10010, 0b10001],
        [0b11111, 0b10000, 0b10000, 0b11110, 0b10000, 0b10000, 0b10000],
    ];
    let board = rgb(0x1f5068) * (0.8 + 0.4 * fbm(p * 9.0, 2));
    if normal.y.abs() < 0.5 {
        return rgb(0x6b4a2c);
    }
    // Text runs from left to right on either face.
    let x = if normal.y < 0.0 { p.x } else { -p.x };
    let rim = (half.x - x.abs()).min(half.z - p.z.abs());
    if rim < 0.035 {
        return rgb(0xe3c27a);
    }
    let dot = half.x * 2.0 / 27.0;
    let (column, row) = ((x / dot + 11.5).floor(), (3.5 - p.z / dot).floor());
    if !(0.0..23.0).contains(&column) || !(0.0..7.0).contains(&row) {
        return board;
    }
    let (letter, bit) = (column as usize / 6, column as usize % 6);
    let lit = bit < 5 && LETTERS[letter][row as usize] >> (4 - bit) & 1 == 1;
    if lit { rgb(0xf7f2e2) } else { board }
}

/// Albedo of the floor: a mosaic, rings of stones round it, grass and flowers beyond, haze far away.
pub(super) fn floor(p: Vec3) -> Vec3 {
    let r = p.truncate().length();
    let turn = if r < PLAZA { p.y.atan2(p.x) } else { 0.0 };
    let grain = if r < PLAZA { plane_fbm(p.truncate() * 9.0, 30, 3) } else { 0.5 };
    if r < 1.3 {
        return medallion(r, turn) * (0.8 + 0.4 * grain);
    }
    if r < PLAZA {
        return stones(r, turn) * (0.65 + 0.7 * grain);
    }
    let edge = step(PLAZA, PLAZA + 0.07, r);
    rgb(0x6a6258).lerp(meadow(p, r), edge)
}

fn medallion(r: f32, turn: f32) -> Vec3 {
    let (cream, teal, clay, gold, ink) = (rgb(0xe9dcc0), rgb(0x2c7a7b), rgb(0xb5543a), rgb(0xd7a94b), rgb(0x2d3340));
    if !(0.09..=1.22).contains(&r) {
        return ink;
    }
    if r > 1.08 {
        let tooth = (turn / TAU * 48.0).rem_euclid(1.0);
        return if tooth < 0.5 { gold } else { teal };
    }
    // A star of sixteen points: straight edges between an outer and an inner radius; each half has its own tone.
    let star = |points: f32, outer: f32, inner: f32, shift: f32| {
        let sector = TAU / points;
        let a = (turn + shift).rem_euclid(sector) - 0.5 * sector;
        let (x, y) = (r * a.cos(), r * a.sin().abs());
        let valley = Vec2::new(inner * (0.5 * sector).cos(), inner * (0.5 * sector).sin());
        // Left of the line from the tip (outer, 0) to the valley.
        ((valley.x - outer) * y - valley.y * (x - outer) > 0.0).then_some(a > 0.0)
    };
    match (star(8.0, 1.02, 0.4, PI / 8.0), star(8.0, 0.84, 0.5, 0.0)) {
        (Some(true), _) => clay,
        (Some(false), _) => cream * 0.92,
        (None, Some(true)) => teal,
        (None, Some(false)) => gold,
        _ => cream * 0.55 + teal * 0.12,
    }
}

fn stones(r: f32, turn: f32) -> Vec3 {
    const WIDTH: f32 = 0.3;
    let ring = ((r - 1.3) / WIDTH).floor();
    let middle = 1.3 + (ring + 0.5) * WIDTH;
    let number = (TAU * middle / 0.46).round();
    let along = (turn / TAU + 0.5) * number + 0.37 * ring;
    let (u, v) = ((along - along.floor()) * TAU * r / number, r - (middle - 0.5 * WIDTH));
    let edge = u.min(TAU * r / number - u).min(v.min(WIDTH - v));
    // The last stone of a ring is the first one.
    let tone = cell(along.floor().rem_euclid(number) as i32, ring as i32, 3);
    let stone = pick(&[0xbfae93, 0xa89a86, 0xc9b48e, 0x94897c, 0xb49c7c, 0xd2c3a4, 0x8b8f92, 0xa9866a], tone);
    rgb(0x5b5248).lerp(stone, step(0.008, 0.02, edge))
}

fn meadow(p: Vec3, r: f32) -> Vec3 {
    // Fine detail fades before it falls below a pixel.
    let near = 1.0 - step(5.0, 16.0, r);
    let broad = plane_fbm(p.truncate() * 0.3, 40, 3);
    let blades = if near > 0.0 { near * (plane_fbm(p.truncate() * 5.0, 50, 3) - 0.5) } else { 0.0 };
    let grass = rgb(0x5d8a3a).lerp(rgb(0x9aa84e), step(0.3, 0.7, broad)) * (1.0 + 1.1 * blades);
    let haze = grass.lerp(rgb(0x9db08a), 0.75 * step(8.0, 44.0, r));
    let cover = if near > 0.0 { near * bloom(p) } else { 0.0 };
    if cover > 0.0 { haze.lerp(flower(p), cover) } else { haze }
}

/// Cover of the grass by a flower, 0..=1: some cells of a grid contain one, away from the cell's border.
fn bloom(p: Vec3) -> f32 {
    let (x, y) = (whole(p.x / 0.34), whole(p.y / 0.34));
    if cell(x, y, 21) > 0.42 {
        return 0.0;
    }
    let centre = |axis: i32, c: i32| (c as f32 + 0.25 + 0.5 * cell(x, y, 22 + axis)) * 0.34;
    let d = Vec2::new(p.x - centre(0, x), p.y - centre(1, y)).length();
    let size = 0.035 + 0.035 * cell(x, y, 25);
    step(size, 0.6 * size, d)
}

fn flower(p: Vec3) -> Vec3 {
    let tone = cell(whole(p.x / 0.34), whole(p.y / 0.34), 24);
    pick(&[0xf7f3e6, 0xf2c83b, 0xf7f3e6, 0xb06fc0, 0xe0604c], tone)
}
