//! Photos: sixteen stratified samples a pixel, a tone curve, eight bits.

use glam::{DVec2, Vec3};

use super::{
    Calibration, Effect, SynthOptions,
    lens::Lens,
    path::View,
    place::Place,
    random::{Random, Stream},
    shade::{Openness, Sun, Thing, World},
    tiles::{Outlook, TILE},
};
use crate::scene::lens::Lens as Calibrated;

/// Samples along either side of a pixel.
const GRID: usize = 4;
const SAMPLES: usize = GRID * GRID;

/// A finished photo with its mask.
pub(super) struct Picture {
    pub width: u32,
    pub height: u32,
    /// Red, green, blue, alpha; rows from the top; alpha is straight, not premultiplied.
    pub pixels: Vec<[u8; 4]>,
    /// True for pixels free of the moving object; empty if nothing moves.
    pub mask: Vec<bool>,
    /// Depths along the camera's axis, or along rays if readers cut the photo into faces, at pixels' middles; 0 in the sky.
    /// Empty unless asked for.
    pub depths: Vec<f32>,
}

/// Takes the photo with index `index`.
pub(super) fn picture(place: &Place, view: &View, options: &SynthOptions, index: usize) -> Picture {
    let (width, height) = (view.camera.width, view.camera.height);
    let world = World { place, mover: &view.mover };
    let sun = Sun::new();
    let cut_out = options.has(Effect::Alpha);
    let number = width as usize * height as usize;
    let (mut pixels, mut touched) = (Vec::with_capacity(number), Vec::with_capacity(number));
    let origin = view.camera.centre().as_vec3();
    let turn = view.camera.rotation.transpose();
    let outlook = Outlook::new(&place.solids, origin);
    let mut lists = vec![Vec::new(); width.div_ceil(TILE) as usize];
    for y in 0..height {
        if y % TILE == 0 {
            for (column, list) in lists.iter_mut().enumerate() {
                outlook.tile(view, column as u32 * TILE, y, list);
            }
        }
        for x in 0..width {
            let list = &lists[(x / TILE) as usize];
            let key = (index as u64) << 32 | u64::from(y) << 16 | u64::from(x);
            let mut random = Random::new(options.seed, Stream::Pixel, key);
            // Each sample has its own cell of the pixel and its own cell of the sun; the pairing differs by pixel.
            let shift = random.bits() as usize % SAMPLES;
            let (mut sum, mut opaque, mut moved, mut open) = (Vec3::ZERO, 0, false, Openness::default());
            for s in 0..SAMPLES {
                let bits = random.bits();
                let jitter = |k: u32| (bits >> (16 * k) & 0xffff) as f64 / 65536.0;
                let within = |cell: usize, k: u32| (cell as f64 + jitter(k)) / GRID as f64;
                let place = DVec2::new(x as f64 + within(s % GRID, 0), y as f64 + within(s / GRID, 1));
                let local = view.lens.direction((place - view.camera.principal) / view.camera.focal);
                let direction = (turn * local).normalize().as_vec3();
                let cell = (s * 7 + shift) % SAMPLES;
                let ray = super::geometry::Ray { origin, direction };
                let sample = world.trace(&ray, list, sun.towards(cell, bits >> 32), &mut open);
                moved |= sample.moved;
                if !(cut_out && matches!(sample.thing, Thing::Floor | Thing::Sky)) {
                    sum += sample.colour;
                    opaque += 1;
                }
            }
            let mean = sum / (opaque.max(1) as f32);
            let toned = [mean.x, mean.y, mean.z].map(tone);
            let channel = |c: usize| (toned[c] * view.gain[c]).clamp(0.0, 1.0) * 255.0 + 0.5;
            let alpha = opaque as f32 / SAMPLES as f32 * 255.0 + 0.5;
            pixels.push([channel(0) as u8, channel(1) as u8, channel(2) as u8, alpha as u8]);
            touched.push(moved);
        }
    }
    let mask = if view.mover.is_empty() { Vec::new() } else { grown(&touched, width as usize) };
    let depths = if options.depth { depths(&world, view, is_cut(view, options)) } else { Vec::new() };
    Picture { width, height, pixels, mask, depths }
}

/// True if readers cut the photo into faces: a panorama, or that of a wide fisheye.
fn is_cut(view: &View, options: &SynthOptions) -> bool {
    let (width, height) = (view.camera.width.into(), view.camera.height.into());
    let is_wide = |own: &Calibration| {
        let lens = Calibrated::from_colmap(own.model, width, height, &own.parameters);
        lens.is_ok_and(|lens| lens.is_cut())
    };
    view.lens == Lens::Panorama || options.lens.as_ref().is_some_and(is_wide)
}

/// The depth at the centre of each pixel, along the ray or along the camera's axis.
fn depths(world: &World<'_>, view: &View, along_rays: bool) -> Vec<f32> {
    let (camera, origin) = (&view.camera, view.camera.centre().as_vec3());
    let depth = |n: u32| {
        let place = DVec2::new(f64::from(n % camera.width), f64::from(n / camera.width)) + 0.5;
        let local = view.lens.direction((place - camera.principal) / camera.focal).normalize();
        let direction = (camera.rotation.transpose() * local).as_vec3();
        let (distance, thing) = world.hit(&super::geometry::Ray { origin, direction });
        let share = if along_rays { 1.0 } else { local.z as f32 };
        if thing == Thing::Sky { 0.0 } else { distance * share }
    };
    (0..camera.width * camera.height).map(depth).collect()
}

/// From linear radiance to display values: an exponential shoulder (like film's), then sRGB's curve (IEC 61966-2-1).
fn tone(radiance: f32) -> f32 {
    let light = 1.0 - (-0.95 * radiance.max(0.0)).exp();
    if light <= 0.0031308 { 12.92 * light } else { 1.055 * light.powf(1.0 / 2.4) - 0.055 }
}

/// True where no pixel of the 3 x 3 neighbourhood is touched.
fn grown(touched: &[bool], width: usize) -> Vec<bool> {
    let height = touched.len() / width;
    let free = |i: usize| {
        let (x, y) = (i % width, i / width);
        let columns = x.saturating_sub(1)..(x + 2).min(width);
        let mut rows = y.saturating_sub(1)..(y + 2).min(height);
        rows.all(|row| columns.clone().all(|column| !touched[row * width + column]))
    };
    (0..touched.len()).map(free).collect()
}

impl Picture {
    /// Colour (0..=255) interpolated between the four nearest pixels; none if one of them is masked or mostly
    /// transparent.
    pub fn colour_at(&self, place: DVec2) -> Option<[f32; 3]> {
        let at = (place - 0.5).max(DVec2::ZERO);
        let (x, y) = (at.x as usize, at.y as usize);
        let (fx, fy) = ((at.x - x as f64) as f32, (at.y - y as f64) as f32);
        let mut sum = [0.0; 3];
        for (dx, dy, weight) in
            [(0, 0, (1.0 - fx) * (1.0 - fy)), (1, 0, fx * (1.0 - fy)), (0, 1, (1.0 - fx) * fy), (1, 1, fx * fy)]
        {
            let (x, y) = ((x + dx).min(self.width as usize - 1), (y + dy).min(self.height as usize - 1));
            let i = y * self.width as usize + x;
            let pixel = self.pixels[i];
            if pixel[3] < 128 || self.mask.get(i) == Some(&false) {
                return None;
            }
            for c in 0..3 {
                sum[c] += weight * f32::from(pixel[c]);
            }
        }
        Some(sum)
    }
}
